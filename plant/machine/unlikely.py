"""Statements of a rig that no arm fulfils: wrong units, friction of a wrong side, slow periods."""

from collections.abc import Iterator, Sequence

import numpy as np

from plant.machine.rig import Rig
from plant.parts import Floats

_LEAST_GEAR = 0.5  # turns of the motor per turn of the joint; an inverse ratio lies far below
SLOWEST = 0.1  # sampling period [s] that no controller of an arm has


def unlikely_statements(
    rig: Rig, q: Floats, qd: Floats, prismatic: Sequence[bool]
) -> Iterator[str]:
    """Messages on improbable numbers of a rig along a motion q, qd (N, n) [rad, rad/s]."""
    drive = rig.drive
    labels = rig.joint_labels
    if rig.period > SLOWEST:
        yield (
            f"a period of {rig.period:g} s is no arm's: state the time from sample to sample [s],"
            " such as 0.001; of a rate in Hz, 1 / rate."
        )
    # Limits of the motors and friction at the largest speed, both motor side [N m].
    turns = np.ptp(q, axis=0) / (2 * np.pi)
    limit = drive.motor_gain * drive.current_limit
    friction = drive.viscous * np.abs(drive.gear * qd).max(axis=0)
    for i in range(rig.n):
        # One line per joint: positions in other units would raise the friction as well.
        # No revolute joint of an arm makes three turns from end to end.
        if turns[i] > 3.0 and not prismatic[i]:
            yield (
                f"{labels[i]} moves over {turns[i]:.3g} turns: positions are in rad, resolutions in"
                " counts per turn of the motor. Are they in degrees, or per radian?"
            )
        elif friction[i] > limit[i]:
            yield (
                f"at the speed of this motion, the viscous friction of {labels[i]} is"
                f" {friction[i]:.3g} N m at the motor, which gives at most {limit[i]:.3g} N m:"
                " viscous is motor side [N m s/rad]."
            )
        elif drive.coulomb[i] > limit[i]:
            yield (
                f"the Coulomb friction of {labels[i]} is {drive.coulomb[i]:.3g} N m at the motor,"
                f" which gives at most {limit[i]:.3g} N m: coulomb is motor side [N m]."
            )
        # Gears of arms slow down; a direct drive has 1.
        if np.abs(drive.gear[i]) < _LEAST_GEAR and not prismatic[i]:
            yield (
                f"the gear of {labels[i]} is {drive.gear[i]:.3g}: a gear is turns of the motor per"
                f" turn of the joint. Is it {1 / drive.gear[i]:.4g}?"
            )
        # Any motor of an arm gives its rotor alone more than 30 rad/s^2.
        if limit[i] < 30.0 * drive.motor_inertia[i]:
            yield (
                f"the motor of {labels[i]} gives its rotor alone"
                f" {limit[i] / drive.motor_inertia[i]:.2g} rad/s^2 at most: motor_inertia is in kg"
                f" m^2, {drive.motor_inertia[i]:.3g} is stated. 1 g cm^2 is 1e-7 kg m^2."
            )
