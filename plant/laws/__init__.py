"""Control laws that a log may have been made with, and what a law has to give."""

__all__: list[str] = []
