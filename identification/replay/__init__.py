"""The experiment repeated with other numbers: objective (4), prediction error, their least squares.

Read `experiment`, `objective`; then `residual` (the protocol of a fit), `followed`, `prediction`
(innovations), `weak_directions` (what readings do not determine), `gauss_newton` and
`whole_deviations` (a covariance that holds over its deviations); `timing` is a use of them.
`resonances` is a prediction in other coordinates, `profile_likelihood` the interval of one of them.
`extended` is a prediction with what its rig leaves out, `optimum` its least sum of squares.
"""
