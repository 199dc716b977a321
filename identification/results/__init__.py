"""What was found: the identification, its warnings and figures, bodies, loads, oscillation.

Read `identification`, `diagnostics`, `trust` (warnings), `plots`; `physical`, `load` and `oscillation` stand alone.
"""

__all__: list[str] = []
