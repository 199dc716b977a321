"""The linearised error loop of each joint under a sampled law: stability margins, and gains by
design.

Read `margins`; `design` (gains and observers) stands alone.
"""
