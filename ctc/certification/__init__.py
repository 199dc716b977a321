"""Probability of leaving a pulse limit under parameter uncertainty, by simulation."""

__all__: list[str] = []
