"""What was found: the identification, its warnings and figures, what contradicts it, bodies, loads,
oscillation.

Read `identification`, `diagnostics`, `trust` (warnings), `plots`; for what contradicts the model
`alternatives` (tests), `stepwise` (one after another), `detection` (the result); `physical` and
`oscillation` stand alone. `model_files` writes inertials back (`realised`: bodies that have f;
`nearest_bodies`: the search).
"""
