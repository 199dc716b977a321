"""Is a log what its rig says? One line per check.

Reading order: `finding` (a line, and the table) -> `signals`, `balance`, `swing` (what a log shows without a model) ->
`stamps`, `counts`, `quantisation`, `tracking`, `wiring`, `units`, `torques` (the checks) -> `examine`.
"""

__all__: list[str] = []
