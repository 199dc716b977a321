"""The error loop linearised: margins, and gains by design."""

__all__: list[str] = []
