"""Checks of a log before it is used: does it agree with its own rig and law? One line per check and
joint.

Reading order: `finding` (a line, and the table) -> `signals`, `torque_regression` (what a log shows
without a model of the arm) -> `counts`, `lost_rows` (what is no measurement), `stamps`,
`quantisation`, `rounding`, `law_delay`, `tracking`, `wiring`, `units` (the checks) -> `examine`
(advice is tried before it is given).
"""
