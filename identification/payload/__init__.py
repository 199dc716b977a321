"""A load found from a short window of tracking: by smooth kernels on the torque equation, by the genetic algorithm.

Read `shape` (what is unknown of a load), `smoothing` and `torque_window` (both sides of the torque equation, alike
smooth), `posterior` (mass and interval within what is possible), `kernel_estimate` (these in one call), then
`genetic_estimate` (3.7 on the load parameters) and `worker` (that one in a process of its own).
"""

__all__: list[str] = []
