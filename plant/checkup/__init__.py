"""Checks of a log before it is used: does it agree with its rig and its control law?

Reading order: `hypothesis` (mistakes, their score and ranking) -> `finding` (one line per check and
joint, and their table) -> `innovation` (how far counts deviate from their motion) -> `signals` and
`torque_regression` (signals that need no model of the arm) -> `counts`, `lost_rows` and `stamps`
(rows that are no measurement, and their times) -> `quantisation`, `rounding` and `oscillation` ->
`along_log` (a law, run along a log) -> `filtered`, `motor_equation` and `priors` (columns that one
filter smooths; a motor's torque, regressed on them; what is known of its coefficients) -> `score`
(how likely a log is) -> `undo`, `evidence`, `gain_units` and `without_arm` (mistakes undone; what
shows them; gains in another unit; the table of what can be wrong) -> `trials` (its rows, tried on a
log) -> `views` (its causes as findings) -> `examine` (`record.check()`: all checks of a record).
"""
