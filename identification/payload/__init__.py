"""Identification of a load, from logs of its own or from a short window while the arm works.

From logs, with unknown friction: `load_search` (the residual in mass, centre and friction, and its
fit), `logged_load` (`find_load`), `load` (its result, with warnings).

From a window: `posterior` (prior of a load, and its distribution), `kernel_estimate` (smooth
kernels on the torque equation), `genetic_estimate` (3.7 on the load parameters) and `worker` (both
in a separate process).
"""
