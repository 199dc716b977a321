"""What of a learnt torque is f and friction: a ridge regression, whose result serves other paths too."""

import dataclasses
from typing import Any

import numpy as np

from ctc.learning.path_plant import PathPlant
from plant import Arm, Rig
from plant.parts.fields import Floats

_F, _FRICTION = 0.05, 0.2
"""Relative standard deviations of f and of friction before, where no covariance is known."""

_CORRELATED = 0.02
"""Time [s] over which the rest of the torque is taken to be alike: two constants of the smoother."""


@dataclasses.dataclass(frozen=True, eq=False)
class Mended:
    """Arm and rig with what was learnt, and the covariance of f, viscous and Coulomb friction (joint side)."""

    arm: Arm
    rig: Rig
    covariance: Floats
    rest: float


def mended(arm: Arm, rig: Rig, plant: PathPlant, learnt: Floats, moves: Any, speed: Floats, prior: Any) -> Mended:
    """Arm and rig corrected by a learnt torque (N, n), where joints move (N, n), at speeds of the shafts (N, n)."""
    n, p, drive = arm.n, len(arm.f), rig.drive
    N = len(learnt)
    Y = np.asarray(arm.dynamics._regressor.function.map(N)(plant.q.T, plant.qd.T, plant.qdd.T).full())
    shafts = np.asarray(drive.coupling.joint_torque(np.eye(n))).T
    friction = [each[:, None, :] * shafts for each in (speed, np.sign(speed))]
    rows = np.concatenate([Y.reshape(n, N, p).transpose(1, 0, 2), *friction], axis=2)[moves]
    wanted, before = learnt[moves], np.concatenate([arm.f, drive.joint_viscous(), drive.joint_coulomb()])
    P = prior if prior is not None else np.diag((np.append(np.full(p, _F), np.full(2 * n, _FRICTION)) * before) ** 2)
    alike = max(_CORRELATED / rig.period, 1.0)
    change, variance = np.zeros(len(before)), float(np.mean(wanted**2)) + 1e-12
    for _ in range(3):  # the rest is what the regression leaves
        S = P @ rows.T @ rows / (variance * alike)
        covariance = np.linalg.solve(np.eye(len(P)) + S, P)
        change = covariance @ (rows.T @ wanted) / (variance * alike)
        variance = float(np.mean((wanted - rows @ change) ** 2)) + 1e-12
    after = before + change
    gear2, gear = drive.gear**2, np.abs(drive.gear)
    corrected = dataclasses.replace(
        drive, viscous=np.maximum(after[p : p + n] / gear2, 0),
        coulomb=np.maximum(drive.coulomb + change[p + n :] / gear, 0),
    )  # fmt: skip
    return Mended(arm.dynamics.arm(after[:p]), dataclasses.replace(rig, drive=corrected), covariance, variance**0.5)
