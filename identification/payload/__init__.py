"""A load found from logs of its own, or from a short window of tracking while the arm works.

From logs, with friction unknown beside it: `loaded_prediction` (a prediction in mass, centre and friction),
`load_search` (their fit), `logged_load` (`find_load`), `load` (what it gives back, and its warnings).

From a window, by smooth kernels on the torque equation or by the genetic algorithm: `shape` (what is unknown of a
load), `torque_window` (both sides of the torque equation, alike smooth), `posterior` (mass and
interval within what is possible), `kernel_estimate` (these in one call), then `genetic_estimate` (3.7 on the load
parameters) and `worker` (that one in a process of its own).
"""
