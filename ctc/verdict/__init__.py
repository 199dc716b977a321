"""One arm under one law, in encoder pulses; several laws compared; animated."""

__all__: list[str] = []
