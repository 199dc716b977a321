"""Control laws as symbolic steps: what a law has to give, and P, PD, PID, cascade and laws that
repeat a log.

Reading order: `law` -> `terms` -> `pid`, `replayed`.
"""
