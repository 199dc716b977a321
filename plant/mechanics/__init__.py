"""Rigid bodies: from links to one joint torque, and D, h, C, Y read off it."""

__all__: list[str] = []
