"""Laws that know the arm: computed torque and its rivals."""

__all__: list[str] = []
