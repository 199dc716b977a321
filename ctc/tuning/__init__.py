"""Search for the controller with the least chatter that keeps a pulse limit under uncertainty.

Read `tuning` (families of laws, ranges of their numbers, the result), `search` (populations of
tunings, and its settings), `tune`.
"""
