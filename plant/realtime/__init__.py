"""A law at work: guards, safe stop, the compiled step, and its C."""

__all__: list[str] = []
