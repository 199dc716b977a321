"""The controller with the least chatter that keeps a pulse limit over stated uncertainty, by
simulated populations.

Read `tuning` (which laws, between which numbers, and what comes of them), `search` (populations of
tunings), `tune`.
"""
