"""What every description is made of: parts with named numbers, and checks of what a user gives."""

__all__: list[str] = []
