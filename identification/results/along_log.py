"""Torques along a log that its model may lack: cogging, and friction that changes or rises.

Each is known along the log except for its size, and the innovations change in proportion to that.
Of wide backlash only the instants at which it acts are known.
"""

from collections.abc import Iterator, Mapping, Sequence

import casadi as ca
import numpy as np

from identification.equation_error import torque_of
from identification.replay import Optimum
from identification.results.assumed import smoothed
from plant import Record
from plant.compiler import shared_out
from plant.mechanics import lumped_torque
from plant.parts import Floats

CYCLES = 24  # of a motor's cogging per turn, at most

# Samples of the response of the innovations to an impulse of torque. With 64, all ten motors of
# five cogging logs of ``causes.py`` get the cycles that they have; by their power alone, four do.
_RESPONSE = 64

# Stribeck speed that is tried, relative to the usual speed of a joint (rms). In three logs of
# ``causes.py``, whose speed is 0.05 to 0.1 of it, the log odds are 180 to 5,500 with it, and 55 to
# 870 with twice that.
STRIBECK = 0.1

# Time [s] within which the teeth of a gear cross wide backlash and meet again; chosen by hand.
_CROSSING = 0.02

# Share of the log's torque (rms) at which the effect of a torque is taken: so small that it acts
# linearly; chosen by hand.
_SMALL = 0.01


# Share of the speed of a joint (rms) below which it rests; chosen by hand.
_MOVING = 0.1


def cogging(at: Optimum) -> dict[str, list[Floats]]:
    """Torques (N, n) [N m] along each record per N m of cogging of each motor, by name.

    ``cogging.6cos[i]`` and ``cogging.6sin[i]``, with the cycles per turn that show most. None on
    elastic gears: their swings pass the motor's positions at any number of cycles.
    """
    records = at.model.records
    stated = records[0].rig.drive.elasticity is not None
    if stated or any(name.startswith("drive.elasticity") for name in at.model.unknown):
        return {}
    n = at.model.dynamics.n
    residuals = [at.before[rows].reshape(-1, n) for rows in at.model.rows()]
    responses = _responses(at)
    torques = {}
    for i, joint in enumerate(np.eye(n)):
        angles = [record.rig.encoder.to_angle(record.counts)[:, i] for record in records]
        units = [record.rig.drive.joint_torque(joint) for record in records]
        cycles = _cycles(angles, [residual[:, i] for residual in residuals], responses[:, i])
        # A cosine and a sine together have any phase.
        for name, wave in (("cos", np.cos), ("sin", np.sin)):
            torques[f"cogging.{cycles}{name}[{i}]"] = [
                np.outer(wave(cycles * angle), unit)
                for angle, unit in zip(angles, units, strict=True)
            ]
    return torques


def drift(at: Optimum) -> dict[str, list[Floats]]:
    """Torques (N, n) [N m] along each record per relative change of each motor's stated friction.

    From half of it less to half of it more, linearly from the beginning of a record to its end.
    """
    frictions = []
    for record in at.model.records:
        drive = record.rig.drive
        motion = smoothed(record, record.rig.cell_centre(record.counts))
        speed = drive.motor_angle(motion.qd)
        stated = drive.viscous * speed + drive.coulomb * np.sign(speed)
        change = np.linspace(-0.5, 0.5, len(speed))[:, None]
        frictions.append(drive.joint_torque(-change * stated))
    return {
        f"drift[{i}]": [friction * joint for friction in frictions]
        for i, joint in enumerate(np.eye(at.model.dynamics.n))
    }


def breakaway(at: Optimum) -> dict[str, list[Floats]]:
    """Torques (N, n) [N m] along each record per relative rise of each motor's Coulomb friction.

    At standstill, as Stribeck's: ``breakaway.9.8[i]`` falls off at 9.8 rad/s of the motor.
    """
    speeds = [
        record.rig.drive.motor_angle(smoothed(record, record.rig.cell_centre(record.counts)).qd)
        for record in at.model.records
    ]
    falls = STRIBECK * np.sqrt(np.mean(np.concatenate(speeds) ** 2, axis=0))
    frictions = []
    for record, speed in zip(at.model.records, speeds, strict=True):
        drive = record.rig.drive
        # A joint that never moves has no such speed, and no friction of a known sign.
        ratio = speed / np.where(falls, falls, np.inf)
        frictions.append(drive.joint_torque(-drive.coulomb * np.sign(speed) * np.exp(-(ratio**2))))
    return {
        f"breakaway.{falls[i]:.2g}[{i}]": [friction * joint for friction in frictions]
        for i, joint in enumerate(np.eye(at.model.dynamics.n))
    }


def acting(torques: Mapping[str, Sequence[Floats]]) -> dict[str, list[Floats]]:
    """The torques that act, each as the mean from a sample to the next, in which it is held."""
    return {
        name: [_mean_while_held(torque) for torque in of_records]
        for name, of_records in torques.items()
        if any(map(np.any, of_records))
    }


def _arm(at):
    """The arm of the fitted values."""
    dynamics = at.model.dynamics
    return dynamics.arm([at.values[at.model.unknown.index(name)] for name in dynamics.names])


def efforts(parts: Sequence[Record]) -> Floats:
    """Torque [N m] and speed [rad/s] of each motor (2, n), rms over the parts of a record."""
    rig = parts[0].rig
    torque = rig.drive.motor_torque(np.concatenate([torque_of(part) for part in parts]))
    counted = np.concatenate([np.diff(part.counts, axis=0) for part in parts])
    speed = rig.encoder.to_angle(counted) / rig.period
    rms = np.array([np.sqrt((torque**2).mean(axis=0)), np.sqrt((speed**2).mean(axis=0))])
    # They are divided by: a joint at rest has a hundredth of the largest, so that none is zero.
    return np.maximum(rms, 1e-9 + 0.01 * rms.max(axis=1, keepdims=True))


def _mean_while_held(torque):
    return (torque + np.vstack([torque[1:], torque[-1:]])) / 2


def at_reversals(at: Optimum, innovations: Floats) -> Iterator[tuple[int, Floats, Floats]]:
    """Innovations (M,) of each joint while its load changes sign, and elsewhere: (joint, M, M).

    Where the joint itself turns back, friction changes sign as well: these samples are in neither.
    """
    arm = _arm(at)
    n = arm.dynamics.n
    crossing: list[list[Floats]] = [[] for _ in range(n)]
    elsewhere: list[list[Floats]] = [[] for _ in range(n)]
    for record, rows in zip(at.model.records, at.model.rows(), strict=True):
        motion = smoothed(record, record.rig.cell_centre(record.counts))
        # The teeth carry the torque of the links, without that which turns the rotor.
        load = _torque(arm, motion) - record.rig.drive.reflected_inertia() * motion.qdd
        residual = innovations[rows].reshape(load.shape)
        samples = max(4, round(_CROSSING / record.rig.period))
        for i in range(n):
            loaded = _after_flips(load[:, i], samples)
            speed = motion.qd[:, i]
            # Of a joint at rest the innovations are too small to compare with.
            moving = np.abs(speed) > _MOVING * np.sqrt(np.mean(speed**2))
            compared = moving & ~_after_flips(speed, samples)
            crossing[i].append(residual[loaded & compared, i])
            elsewhere[i].append(residual[~loaded & compared, i])
    for i in range(n):
        yield i, np.concatenate(crossing[i]), np.concatenate(elsewhere[i])


def _after_flips(x, samples):
    """Samples (N,) from a little before to so many after a change of the sign of a signal."""
    flips = np.flatnonzero(np.diff(np.sign(x)) != 0)
    # Count the intervals that have begun and not ended; each begins a quarter of its length early.
    begun = np.zeros(len(x) + 1)
    np.add.at(begun, np.maximum(flips - samples // 4, 0), 1)
    np.add.at(begun, np.minimum(flips + samples, len(x)), -1)
    return np.cumsum(begun)[:-1] > 0


def effects_along(at: Optimum, torques: Mapping[str, Sequence[Floats]]) -> dict[str, Floats]:
    """Effect (M,) on the innovations of each of these torques, per unit of its number."""
    # Torque of all joints together (rms).
    size = np.sqrt(np.mean(torque_of(at.model.records[0]) ** 2))

    def effect(of_records):
        step = _SMALL * size / np.sqrt(np.mean(np.concatenate(of_records) ** 2))
        moved = at.model.pushed([step * torque for torque in of_records]).innovations(at.values)
        return (moved - at.innovations) / step

    effects = shared_out(effect, list(torques.values()), at.model.threads)
    return dict(zip(torques, effects, strict=True))


def _responses(at):
    """Innovations (K, n) of each joint after an impulse of its torque, by one run of the model.

    Random torques act on all joints at once: each explains its own part of the change.
    """
    random = np.random.default_rng(0)
    records = at.model.records
    patterns = [random.choice((-1.0, 1.0), record.counts.shape) for record in records]
    size = records[0].rig.drive.joint_torque(_SMALL * efforts(records)[0])
    moved = at.model.pushed([size * pattern for pattern in patterns]).innovations(at.values)
    n = at.model.dynamics.n
    changes = [(moved - at.innovations)[rows].reshape(-1, n) for rows in at.model.rows()]

    def response(i):
        # Each row has the torques up to its sample, the latest one first.
        padded = [np.append(np.zeros(_RESPONSE - 1), pattern[:, i]) for pattern in patterns]
        windows = [np.lib.stride_tricks.sliding_window_view(row, _RESPONSE) for row in padded]
        change = np.concatenate([change[:, i] for change in changes])
        return np.linalg.lstsq(np.concatenate(windows)[:, ::-1], change, rcond=None)[0]

    return np.column_stack([response(i) for i in range(n)])


def _cycles(angles, residuals, response):
    """Cycles per turn of a motor at which a torque along its angles explains the residuals best.

    `angles`, `residuals`: (N,) of each record; `response` (K,): residuals after an impulse of the
    torque. Quick cycles leave less in the residuals than slow ones that are as large.
    """
    residual = np.concatenate(residuals)

    def explained(cycles):
        waves = [np.exp(1j * cycles * angle) for angle in angles]
        effect = np.concatenate(
            [np.convolve(wave, response)[: len(wave)] for wave in waves], dtype=complex
        )
        columns = np.column_stack([effect.real, effect.imag])
        return residual @ columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]

    return 1 + int(np.argmax([explained(cycles) for cycles in range(1, CYCLES + 1)]))


def _torque(arm, motion):
    """Torque (N, n) of an arm on a motion."""
    q, qd, qdd = (ca.SX.sym(name, arm.dynamics.n) for name in ("q", "qd", "qdd"))
    moving, at_rest = lumped_torque(
        arm.dynamics.chain, arm.dynamics.lumping, q, qd, qdd, ca.SX(arm.f)
    )
    torque = ca.Function("torque", [q, qd, qdd], [ca.densify(moving + at_rest)])
    return torque.map(len(motion.q))(*(signal.T for signal in motion)).full().T
