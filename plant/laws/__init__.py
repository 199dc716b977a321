"""Control laws as symbolic steps: the contract, P, PD, PID and cascade, laws that repeat a log.

Reading order: `law` (the contract) -> `terms` (rate, integral) -> `pid` -> `replayed`, `resumed`.
"""
