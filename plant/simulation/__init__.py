"""The closed loop: one symbolic step, the kernels made of it, and the simulator."""

__all__: list[str] = []
