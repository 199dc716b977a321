"""The experiment repeated with other numbers: objective (4), prediction error, their least squares.

Read `experiment`, `objective`; then `prediction` (innovations), `gauss_newton`; `timing` is a use of them.
"""

__all__: list[str] = []
