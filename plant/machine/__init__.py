"""What stands between a control program and the links: gears, friction, encoders, late torque."""

__all__: list[str] = []
