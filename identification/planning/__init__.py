"""Before the experiment: ranges, pulse budget, excitation, motor tests, and whether a log is informative.

Each file stands alone: `ranges` (3.6), `motor`, `budget` (Cramer-Rao bound), `excitation`, `quality`.
"""
