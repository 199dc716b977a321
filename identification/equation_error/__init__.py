"""Least squares on the torque equation, with logged torques or with those that the law gave."""

__all__: list[str] = []
