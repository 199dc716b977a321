"""The experiment repeated with other numbers: objective (4), prediction error, their least squares."""

__all__: list[str] = []
