"""A load found from logs of its own, or from a short window of tracking while the arm works.

From logs, with friction unknown beside it: `loaded_prediction` (a prediction in mass, centre and
friction), `load_search` (their fit), `logged_load` (`find_load`), `load` (what it gives back, and
its warnings).

From a window: `posterior` (what is unknown of a load, its mass and interval), `kernel_estimate`
(smooth kernels on the torque equation), `genetic_estimate` (3.7 on the load parameters) and
`worker` (that one in a process of its own).
"""
