"""What a controller is made of: an arm and its rig, with a covariance of what was estimated."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from plant import Arm, Reference, Rig
from plant.parts import Floats


@runtime_checkable
class Estimate(Protocol):
    """An estimated arm: result of `identify`, or of `fit_torque`."""

    @property
    def arm(self) -> Arm:
        """With the estimated f."""

    @property
    def rig(self) -> Rig:
        """With the estimated numbers of the drives."""

    @property
    def f(self) -> Floats:
        """Parameters (p,) of the arm."""

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names (k) of what was estimated."""

    @property
    def covariance(self) -> Floats | None:
        """Covariance (k, k) of what was estimated; None where it is not known."""

    @property
    def path(self) -> Reference | None:
        """Reference of the first log, if it has one."""

    def covariance_of(self, names: Sequence[str]) -> Floats:
        """Covariance (m, m) of numbers by their names; zero of numbers that were not unknown."""
