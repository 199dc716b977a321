"""References: where the arm is to be, and what a motion demands of the drives and shows of f."""

__all__: list[str] = []
