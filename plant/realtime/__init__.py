"""A controller at work: guards, safe stop, the compiled step, and the controller as C.

Reading order: `guards` (settings) -> `safety` (checks and stop, sample by sample) ->
`compiled_step` -> `running`; for C, `c_text` and the templates in ``c/`` -> `c_running` (with
guards), `c_export` (the law alone).
"""
