"""Results of an identification: values, warnings, contradictions, figures, bodies, model files.

Read `identification` (the result), `diagnostics` (how well it repeats the records), `summary` (its
text), `trust` (warnings) and `plots`. Contradictions: `alternatives` and `along_log` (score tests),
`corrections` (delays and lengths), `stepwise` (selection), `detection` (the result), `model_error`
(bias of the values), `each_record` (records that disagree), `restated` (signs and rotors).
Assumptions: `assumed` (sensitivities), `seen` (range of the logs, priors). `physical`, `gears`,
`oscillation` and `urscript` stand alone. `model_files` writes inertials back (`realised`: bodies
that have f; `nearest_bodies`: the search).
"""
