"""Before the identification: ranges, pulse budget, excitation, motor tests, frequency responses.

Each stands alone: `ranges` (3.6), `motor`, `budget` (Cramer-Rao bound), `excitation` (with the
limits and signals of `multisine`), `response` (with the resonances of `gear_resonances`).
"""
