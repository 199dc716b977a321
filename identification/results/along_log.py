"""Torques along a log that its model may lack: cogging of the motors, the rate of a law's error.

Each is known along the log but for its size, with which the innovations change in proportion. Of
wide backlash only where it acts is known.
"""

from collections.abc import Iterator, Mapping, Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from identification.equation_error.torque_logs import torque_of
from identification.replay.optimum import Optimum
from identification.results.assumed import smoothed
from plant import Arm, Record
from plant.compiler.background import shared_out
from plant.laws.replayed import commanded_torque
from plant.mechanics.newton_euler import lumped_torque
from plant.motion.reference import Motion
from plant.parts.fields import Floats

CYCLES = 24  # of a motor's cogging per turn, at most

_CROSSING = 0.02  # within which the teeth of a gear cross wide backlash, and meet [s]

_SMALL = 0.01  # share of the log's torque (rms) by whose effect that of a torque is taken


def torques_along(at: Optimum) -> dict[str, list[Floats]]:
    """Torques (N, n) [N m] of each record, by the names of numbers that are zero in the model, per
    unit of them.

    ``cogging.6cos[i]`` [N m of the motor], of the number of cycles that shows most; ``lead[i]`` [s]
    of the torque of a law without memory.
    """
    model = at.model
    records = at.model.records
    found = dict[str, list[Floats]]()
    arm = _arm(at)
    left = [at.before[rows].reshape(-1, arm.dynamics.n) for rows in model.rows()]
    asked = [commanded_torque(record) for record in records]
    rates = [
        0 * r.counts if torque is None else smoothed(r, torque).qd
        for r, torque in zip(records, asked, strict=True)
    ]
    for i, own in enumerate(np.eye(arm.dynamics.n)):
        angles = [record.rig.encoder.to_angle(record.counts)[:, i] for record in records]
        cycles = _cycles(angles, [rest[:, i] for rest in left])
        for name, wave in (("cos", np.cos), ("sin", np.sin)):
            pairs = zip(
                angles, (record.rig.drive.joint_torque(own) for record in records), strict=True
            )
            found[f"cogging.{cycles}{name}[{i}]"] = [
                np.outer(wave(cycles * angle), unit) for angle, unit in pairs
            ]
        found[f"lead[{i}]"] = [rate * own for rate in rates]
    return {
        name: [_held(torque) for torque in own]
        for name, own in found.items()
        if any(map(np.any, own))
    }


def _arm(at: Optimum) -> Arm:
    """The arm of the values found."""
    dynamics = at.model.dynamics
    return dynamics.arm([at.values[at.model.unknown.index(name)] for name in dynamics.names])


def efforts(parts: Sequence[Record]) -> Floats:
    """Torque [N m] and speed [rad/s] of each motor (2, n), rms over parts of a record; a little
    where there is none.
    """
    rig = parts[0].rig
    torque = np.array([rig.drive.motor_torque(row) for part in parts for row in torque_of(part)])
    speed = (
        rig.encoder.to_angle(np.concatenate([np.diff(part.counts, axis=0) for part in parts]))
        / rig.period
    )
    rms = np.array([np.sqrt((torque**2).mean(axis=0)), np.sqrt((speed**2).mean(axis=0))])
    return np.maximum(rms, 1e-9 + 0.01 * rms.max(axis=1, keepdims=True))


def _held(torque: Floats) -> Floats:
    """Mean (N, n) from each sample to the next, in which it is held."""
    return (torque + np.vstack([torque[1:], torque[-1:]])) / 2


def at_reversals(at: Optimum) -> Iterator[tuple[int, Floats, Floats]]:
    """Of each joint, its place and what is left (M,) where its load changes sign, and elsewhere;
    not where it turns.
    """
    arm = _arm(at)
    near: list[list[Floats]] = [[] for _ in range(2 * arm.dynamics.n)]
    for record, rows in zip(at.model.records, at.model.rows(), strict=True):
        motion = smoothed(record, record.rig.cell_centre(record.counts))
        load = _torque(arm, motion) - record.rig.drive.reflected_inertia() * motion.qdd
        left = at.before[rows].reshape(load.shape)
        samples = max(4, round(_CROSSING / record.rig.period))
        for i in range(arm.dynamics.n):
            loaded, turned = (_after_flips(x[:, i], samples) for x in (load, motion.qd))
            near[2 * i].append(left[loaded & ~turned, i])
            near[2 * i + 1].append(left[~loaded & ~turned, i])
    for i in range(arm.dynamics.n):
        yield i, np.concatenate(near[2 * i]), np.concatenate(near[2 * i + 1])


def _after_flips(x: Floats, samples: int) -> NDArray[np.bool_]:
    """Samples (N,) from a little before to so many after those at which a signal changes sign."""
    flips = np.flatnonzero(np.diff(np.sign(x)) != 0)
    near = np.zeros(len(x) + 1)
    np.add.at(near, np.maximum(flips - samples // 4, 0), 1)
    np.add.at(near, np.minimum(flips + samples, len(x)), -1)
    return np.cumsum(near)[:-1] > 0


def effects_along(at: Optimum, torques: Mapping[str, Sequence[Floats]]) -> dict[str, Floats]:
    """Change of the innovations (M,) with each of these numbers."""
    size = np.sqrt(np.mean(torque_of(at.model.records[0]) ** 2))

    def effect(own: Sequence[Floats]) -> Floats:
        step = _SMALL * size / np.sqrt(np.mean(np.concatenate(own) ** 2))
        moved = at.model.pushed([step * torque for torque in own]).innovations(at.values)
        return np.asarray((moved - at.innovations) / step)

    return dict(
        zip(torques, shared_out(effect, list(torques.values()), at.model.threads), strict=True)
    )


def _cycles(motors: Sequence[Floats], left: Sequence[Floats]) -> int:
    """Cycles per turn of a motor at which what is left (N,) along its angles (N,) has most
    power, turn by turn.
    """
    power = np.zeros(CYCLES)
    for angle, rest in zip(motors, left, strict=True):
        _, turn, length = np.unique(
            np.floor(angle / (2 * np.pi)), return_inverse=True, return_counts=True
        )
        sums = np.zeros((len(length), CYCLES), complex)
        np.add.at(
            sums, turn, rest[:, None] * np.exp(-1j * np.outer(angle, np.arange(1, CYCLES + 1)))
        )
        power += (np.abs(sums) ** 2 / length[:, None]).sum(axis=0)
    return int(power.argmax()) + 1


def _torque(arm: Arm, motion: Motion) -> Floats:
    """Torque (N, n) of an arm on a motion."""
    q, qd, qdd = (ca.SX.sym(name, arm.dynamics.n) for name in ("q", "qd", "qdd"))
    moving, at_rest = lumped_torque(
        arm.dynamics.chain, arm.dynamics.lumping, q, qd, qdd, ca.SX(arm.f)
    )
    torque = ca.Function("torque", [q, qd, qdd], [ca.densify(moving + at_rest)])
    return np.asarray(torque.map(len(motion.q))(*(each.T for each in motion)).full().T)
