"""The quietest law that keeps a pulse limit over stated uncertainty, found by simulating populations of tunings.

Read `families` (which laws, and between which numbers), then `search` (populations of tunings), then `tune`.
"""
