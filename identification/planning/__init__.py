"""Before the experiment: ranges, pulse budget, excitation, motor tests, and whether a log can tell."""

__all__: list[str] = []
