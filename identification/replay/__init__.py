"""The experiment repeated with other numbers: objective (4), prediction error, their least squares.

Read `experiment`, `objective`; then `prediction` (innovations), `gauss_newton`; `timing` is a use
of them. `extended` is a prediction with what its rig leaves out, `optimum` where it follows the log
best.
"""
