"""What the stated model has that the log contradicts: the sign of gravity, or of one joint; rotors.

Signs by least squares of the smoothed torques on the smoothed motion, with base parameters and
friction of any value. Where a sampled law's torque was not logged, it is run along the log, and
what it integrated before is a constant.
"""

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any

import numpy as np

from identification.equation_error.law_memory import along_log
from identification.equation_error.torque_logs import torque_of
from identification.search.predictive import ROUGH
from plant import Dynamics, Record
from plant.checkup.counts import hardly_moving
from plant.checkup.signals import Signals
from plant.machine.motor_inertia import rotors_alone, shaft_inertias
from plant.parts.fields import Floats

# Share of what a chain leaves that another has to stay below, to be named: of wrong ones it is 0.74
# at most, of right ones 1.33 at least; and rows of a log that are compared.
_CLOSER = 0.8
_ROWS = 400

# By how many standard deviations, and by what share of itself, an inertia has to fall below that of
# its rotor.
_SURE = 4.0
_ROOM = 0.05

# Share of a rotor's inertia by which the one found may differ: what turns with it in the gear is
# seldom stated.
_OTHER = 0.2


@functools.lru_cache(maxsize=4)
def restated(dynamics: Dynamics, record: Record) -> list[str]:
    """A line about the one sign whose change explains the torques of a record much better, or
    none.
    """
    law = record.law
    logged = record.torque is not None or record.current is not None
    if runs := not logged and law is not None and bool(law.period) and law.has_memory(record.n):
        record = dataclasses.replace(record, torque=torque_of(along_log(record)))
    signals = Signals(record)
    every = np.ones(dynamics.n)
    if signals.motor_torque is None or not signals.long_enough:
        return []
    left = functools.partial(_left, dynamics, signals, integrated=runs)
    before = left(every)
    tried = {"gravity acts the other way": left(every, gravity=-1.0)}
    for i, label in enumerate(dynamics.chain.joint_labels if dynamics.n > 1 else ()):
        said = f"{label} turns the other way: its axis, or the signs of all its columns, are wrong"
        tried[said] = left(np.where(np.arange(dynamics.n) == i, -1.0, 1.0))
    best = min(tried, key=tried.__getitem__)
    if not tried[best] < _CLOSER * before:  # nor where nothing moves
        return []
    return [
        f"{best}. So stated, the equation of motion leaves {tried[best]:.1%} of the torques (rms);"
        f" as it is, {before:.1%}. Correct that, and identify again."
    ]


def _left(
    dynamics: Dynamics,
    signals: Signals,
    sign: Floats,
    gravity: float = 1.0,
    *,
    integrated: bool = False,
) -> float:
    """Share (rms) of the smoothed torques that the equation of motion leaves.

    `sign` (n,): by which joints are turned. `gravity`: factor of what it is stated to be.
    `integrated`: whether a constant of each torque is open.
    """
    rig = signals.rig
    rows = np.flatnonzero(signals.clear)
    rows = rows[:: max(1, len(rows) // _ROWS)]
    zero = rig.to_angle(np.zeros(signals.n))
    still = np.zeros(signals.n)
    q, qd, qdd = (
        sign * (rig.to_angle(each[rows]) - (k > 0) * zero) for k, each in enumerate(signals.motion)
    )
    torque = sign * rig.drive.gear * signals.smooth(signals.motor_torque)[rows]  # type: ignore[arg-type]  # there is one
    dry = np.column_stack([signals.smooth_even(np.sign(each)) for each in signals.motion[1].T])[
        rows
    ]
    Y = np.array([dynamics.Y(*state) for state in zip(q, qd, qdd, strict=True)])
    if gravity != 1:
        Y += (gravity - 1) * np.array([dynamics.Y(pose, still, still) for pose in q])
    own = (qd, dry, np.ones_like(qd)) if integrated else (qd, dry)
    rubs = [np.eye(signals.n)[None] * each[:, :, None] for each in own]
    scale = np.maximum(np.sqrt(np.mean(torque**2, axis=0)), 1e-300)
    scale[hardly_moving(signals.record)] = np.inf  # friction holds these, with any torque
    A = np.concatenate([Y, *rubs], axis=2) / scale[:, None]
    b = (torque / scale).ravel()
    A = A.reshape(torque.size, -1)
    A = A / np.maximum(np.abs(A).max(axis=0), 1e-300)
    return float(np.sqrt(np.mean((b - A @ np.linalg.lstsq(A, b, rcond=1e-9)[0]) ** 2)))


def of_rotors(found: Any) -> Iterator[str]:
    """A line for each joint whose rotor, as stated, the inertias found contradict.

    D at the motors' shafts is at least diag(Jm k^2), whatever the links are: the rotor turns with
    its joint. Where a base parameter is the inertia of one rotor and nothing else, it is the stated
    one.
    """
    rig = found.rig
    dynamics = found.arm.dynamics
    f = found.f
    rows = shaft_inertias(dynamics, rig, found.records[0].rig.to_angle(found.records[0].counts[0]))
    inertia = f @ rows
    rotors = rig.drive.reflected_inertia()
    alone = (
        {} if found.covariance is None or found.search.method in ROUGH else rotors_alone(dynamics)
    )
    covariance = found.fit.covariance_of(dynamics.names)
    std = np.sqrt(np.einsum("ki,kl,li->i", rows, covariance, rows))
    for i, label in enumerate(dynamics.chain.joint_labels):
        unit = "kg" if dynamics.chain.links[i].prismatic else "kg m^2"
        stated = f"Jm k^2 = {rotors[i]:.3g} {unit}"
        if inertia[i] + _SURE * std[i] + _ROOM * rotors[i] < rotors[i]:
            yield (
                f"the inertia of {label}, {inertia[i]:.3g} {unit}, is below that of its rotor as"
                f" stated, {stated}: check motor_inertia and gear."
            )
        elif i in alone and dynamics.names[alone[i]] in found.fit.unknown:
            name = dynamics.names[alone[i]]
            value = f[alone[i]]
            own_std = np.sqrt(covariance[alone[i], alone[i]])
            if abs(value - rotors[i]) > _SURE * own_std + _OTHER * rotors[i] > 0:
                yield (
                    f"the rotor of {label} is not as stated: {name} is {value:.3g} {unit},"
                    f" {stated}. The law has what was found; what is said of elastic joints has"
                    " what is stated. Check motor_inertia and gear."
                )
