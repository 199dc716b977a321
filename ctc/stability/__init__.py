"""The linearised error loop of each joint under a sampled law: stability margins, and gains by design.

Read `error_loop` (the loop transfer function), then `margins`; `design` (gains and observers) stands alone.
"""
