"""One arm under one law on elastic gears of many resonances, simulated side by side."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identification import Identification
from plant import Arm, Elasticity, Law, Reference, Rig
from plant.machine.elasticity import DAMPING_RATIO
from plant.parts.arguments import array, real
from plant.simulation.population import Population, Runs

RIGID = 1e5
"""Resonance [Hz] of a gear that moves like a rigid one."""


_FOLLOWED = 0.6
"""Phase [rad] of a locked-rotor resonance in one sub-step up to which the vibration of motor against link, which is
faster, is right to 1 % in its frequency: of the arms of `plant.puma560`, at 1.1 rad and to 0.3 %."""

_CRITICAL = 1.0


def require_followed(name: str, hz: ArrayLike, step: float) -> None:
    """Refuse resonances [Hz] that sub-steps of this length [s] cannot follow.

    Raises
    ------
    ValueError
    """
    highest, most = float(np.max(hz)), _FOLLOWED / (2 * np.pi * step)
    if highest > most:
        raise ValueError(
            f"{name} must be below {most:.0f} Hz, which sub-steps of {1e3 * step:.3g} ms can follow; got {highest:g}. "
            "Lower it: such a gear is rigid; or take more steps_per_sample where there are."
        )


def require_swinging(damping_ratio: float) -> None:
    """Refuse a damping ratio with which nothing swings.

    Raises
    ------
    ValueError
    """
    if damping_ratio > _CRITICAL:
        raise ValueError(
            f"damping_ratio must be at most {_CRITICAL:g}, critical damping; got {damping_ratio:g}. Gears have "
            f"{DAMPING_RATIO:g} to 0.03, no percent."
        )


def damping_of(damping_ratio: Any) -> float:
    """A damping ratio with which gears swing, or its refusal.

    Raises
    ------
    ValueError
    """
    advice = f"Give that of the gears, such as {DAMPING_RATIO:g}."
    ratio = real("damping_ratio", damping_ratio, advice, positive=True)
    require_swinging(ratio)
    return ratio


def arm_of(arm: Any) -> Any:
    """The arm of an identification; anything else as it is."""
    return arm.arm if isinstance(arm, Identification) else arm


class HeavyMotorsError(ValueError):
    """Motors that weigh more than the arm: there is no link behind the gear."""


class OnGears:
    """An arm with a rigid rig, ready to be simulated on elastic gears, all joints alike.

    Parameters
    ----------
    arm, rig, law, reference
        A gear's resonance is that at the reference's first pose.
    damping_ratio : float
    initial : (2, n) array_like, optional
    options
        Of `plant.simulation.population.Population`.

    Raises
    ------
    ValueError
        A rig whose gears are elastic; as `HeavyMotorsError`, motors that weigh more than the arm.
    """

    def __init__(
        self, arm: Arm, rig: Rig, law: Law, reference: Reference, damping_ratio: float, *,
        initial: ArrayLike | None = None, **options: Any,
    ) -> None:  # fmt: skip
        if rig.drive.elasticity is not None:
            raise ValueError("the rig must have rigid gears; got elastic ones. Evaluate it as it is instead.")
        given = None if initial is None else array("initial", initial, (2, rig.n), advice="Give q and qd at t = 0.")
        self._gears: Any = Elasticity.from_resonance(arm, RIGID, damping_ratio, q=reference(np.zeros(1)).q[0])
        self._drive = rig.drive
        try:
            elastic = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=self._gears))
        except ValueError as error:
            raise HeavyMotorsError(str(error)) from None
        self._loop, self._options = (arm, elastic, law, reference), options | {"initial": given}
        self._names = [f"drive.elasticity.{name}[{i}]" for name in ("stiffness", "damping") for i in range(rig.n)]

    def runs(self, hz: ArrayLike, threads: int) -> Runs:
        """One run for each of these resonances (P,) [Hz]."""
        each = [dataclasses.replace(self._gears, hz=np.full(self._drive.n, value)).of(self._drive)
                for value in np.asarray(hz, float)]  # fmt: skip
        values = np.array([np.append(gear.stiffness, gear.damping) for gear in each])
        return Population(*self._loop, self._names, values, **self._options).run(threads)
