"""What was found: the identification, its warnings and figures, bodies, loads, oscillation."""

__all__: list[str] = []
