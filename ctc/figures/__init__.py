"""Figures of records and results, in one style: errors, torques, phase; loops over frequency.

Read `errors` and `loops`; colours, and how a figure is asked for, are in `plant.parts.figures`.
"""
