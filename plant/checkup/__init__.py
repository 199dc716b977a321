"""Checks of a log before it is used: does it agree with its rig and its control law?

Reading order: `hypothesis` (mistakes, their score and ranking) -> `finding` (one line per check and
joint, and their table) -> `innovation` (how far counts deviate from their motion) -> `signals` and
`torque_regression` (signals that need no model of the arm) -> `counts`, `lost_rows` and `stamps`
(rows that are no measurement, and their times) -> the checks `quantisation`, `rounding`,
`oscillation`, `law_delay`, `tracking` and `wiring` -> `corrections` (each correction is tried
before it is advised) -> `examine` (`record.check()`: all checks of a record, those of its torque
among them).
"""
