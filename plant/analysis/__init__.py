"""The loop linearised, python-control, and P gains."""

__all__: list[str] = []
