"""A control law, or a geared arm with its drives and encoders, as a functional mock-up unit (FMI, co-simulation).

Reading order: `variables` (what is exchanged, as the model description lists it) -> `arm_source` (the C of an arm) ->
`export` (`to_fmu`). The interface itself is in the templates ``c/``.
"""
