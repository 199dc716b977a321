"""Settings of computed torque that seldom need a change: thresholds of its boost and friction."""

import dataclasses
from typing import Any

from plant import number, part
from plant.parts import Settings


@part
class ComputedTorqueSettings(Settings):
    """Design numbers of `ComputedTorque`; they are structure, so that no kernel has them as inputs.

    docs/background/computed_torque.md derives them and names the runs that tested them; numbers
    without such a run were chosen by hand.

    Parameters
    ----------
    sliding_speed : float
        Speed [pulses/s] from which on Coulomb friction is fed forward in full; below it in
        proportion, so that the torque does not jump where a joint turns back. The direction by
        which friction is learnt is full from the same speed on. Chosen by hand.
    friction_sweeps : int
        Gauss-Seidel sweeps over the joints for the impulse of predicted dry friction, which starts
        at that of the sample before. Chosen by hand.
    learning_rate : float
        Rate [1/s] at which friction is learnt where a joint turns back. Chosen by hand.
    learning_memory : float
        Time constant [s] of heading, viscous torque and disturbance before the turn, against which
        their change is measured. Chosen by hand.
    standing_dead_zone : float
        Factor on `dead_zone` where the reference stands: a count that flips there tells of no
        motion, and an answer to it would make a standing joint hum. Chosen by hand.
    predicted_stiffness : float
        Share of the stated stiffness of elastic gears with which deviations are predicted: a model
        that is too stiff loses stability first. With 0.8 the arm of the literature is stable for
        true stiffnesses from 0.82 to 1.24 of the stated one.
    boost_speed : float
        Speed of the reference [pulses/s] from which on the boost is full. Chosen by hand.
    boost_error : float
        Error [pulses] beyond which the boost falls in proportion: a large error would take the
        torque from limit to limit. Chosen by hand.
    boost_limit : float
        Largest product of boosted bandwidth and period; a `bandwidth` above it stays. Chosen by
        hand.
    swing_distance : float
        Predicted distance from the middle of the counted cell [pulses] that counts as a swing,
        without a dead zone. Benchmark: tests/benchmarks/everyday.py --mujoco 60 --hz 60.
    swing_dead_zone : float
        Decrease of `swing_distance` [pulses] with a dead zone of 1: the smaller the dead zone, the
        more of the rounding is predicted. Chosen by hand.
    load_distance : float
        Distance [pulses] beyond that of a swing, with the same sign for more than a sample, from
        which on the model lacks something, such as a load. Chosen by hand.
    swing_time : float
        Longest time between distances of opposite signs in a swing, less a sample, times
        `bandwidth`. Benchmark: as `swing_distance`.
    swing_memory : float
        Time constant [s] with which swings are forgotten. Chosen by hand.

    Raises
    ------
    ValueError
        A number that is negative or, where it must be positive, zero; a `predicted_stiffness`
        above 1.

    See Also
    --------
    ctc.ComputedTorque

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, ComputedTorqueSettings
    >>> settings = ComputedTorqueSettings(sliding_speed=60)
    >>> law = ComputedTorque(puma560.arm(), puma560.rig(), settings=settings)
    >>> law.settings.sliding_speed
    60.0
    """

    may_be_zero = ("learning_rate", "swing_dead_zone", "load_distance")
    at_most = {"predicted_stiffness": 1}  # noqa: RUF012  # declared as of the class

    sliding_speed: float = 30.0
    friction_sweeps: int = 4
    learning_rate: float = 40.0
    learning_memory: float = 0.4
    standing_dead_zone: float = 2.5
    predicted_stiffness: float = 0.8
    boost_speed: float = 10.0
    boost_error: float = 5.0
    boost_limit: float = 0.5
    swing_distance: float = 1.0
    swing_dead_zone: float = 0.75
    load_distance: float = 0.25
    swing_time: float = 0.67
    swing_memory: float = 10.0


SETTINGS = ComputedTorqueSettings()


@part
class VariedSettings(ComputedTorqueSettings):
    """The same as numbers of the law, ``law.settings.sliding_speed``: kernels take them as inputs.

    `tune` varies them so; the law that it returns has plain settings. `friction_sweeps` is the
    length of a loop, and `predicted_stiffness` is part of the table of gains on elastic gears: both
    stay as they are.
    """

    sliding_speed: float = number((), default=SETTINGS.sliding_speed)
    learning_rate: float = number((), default=SETTINGS.learning_rate)
    learning_memory: float = number((), default=SETTINGS.learning_memory)
    standing_dead_zone: float = number((), default=SETTINGS.standing_dead_zone)
    boost_speed: float = number((), default=SETTINGS.boost_speed)
    boost_error: float = number((), default=SETTINGS.boost_error)
    boost_limit: float = number((), default=SETTINGS.boost_limit)
    swing_distance: float = number((), default=SETTINGS.swing_distance)
    swing_dead_zone: float = number((), default=SETTINGS.swing_dead_zone)
    load_distance: float = number((), default=SETTINGS.load_distance)
    swing_time: float = number((), default=SETTINGS.swing_time)
    swing_memory: float = number((), default=SETTINGS.swing_memory)

    @classmethod
    def of(cls, settings: ComputedTorqueSettings) -> "VariedSettings":
        """The numbers of these settings."""
        return cls(**_values(settings))

    @property
    def plain(self) -> ComputedTorqueSettings:
        """The same as structure."""
        return ComputedTorqueSettings(**_values(self))


def _values(settings: ComputedTorqueSettings) -> dict[str, Any]:
    """Values of settings by name."""
    names = [field.name for field in dataclasses.fields(ComputedTorqueSettings)]
    return {name: getattr(settings, name) for name in names}
