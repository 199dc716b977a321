"""The controller with the least chatter that keeps a pulse limit over stated uncertainty, by simulated populations.

Read `families` (which laws, and between which numbers), then `search` (populations of tunings), then `tune`.
"""
