"""A law at work: guards, safe stop, the compiled step, and the law as C.

Reading order: `guards` (settings) -> `safety` (checks and stop, sample by sample) -> `compiled_step` -> `running`; for
C, `c_numbers`, `c_templates` -> `c_export`, `c_running`.
"""
