"""Results of an identification: values, warnings, contradictions, figures, bodies, model files.

Read `identification` (the result), `diagnostics` (how well it repeats the records, and the mean of
records that disagree), `summary` (its text), `trust` (warnings) and `plots`. Contradictions:
`with_arm` (one row per cause), `alternatives` and `along_log` (score tests), `refits` (fits of one
more cause), `stepwise` (selection), `detection` (the result), `model_error` (bias of the values),
and `equation_error.restated`. Assumptions: `assumed` (sensitivities), `seen` (range of the logs,
priors). `physical`, `gears`, `oscillation` and `urscript` stand alone. `model_files` writes
inertials back (`nearest_bodies`: the search).
"""
