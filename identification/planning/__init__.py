"""Before the experiment: ranges, pulse budget, excitation, motor tests.

Each file stands alone: `ranges` (3.6), `motor`, `budget` (Cramer-Rao bound), `excitation`.
"""
