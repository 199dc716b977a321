"""What was learnt from repetitions of a path; what of the torque is f and friction, which serves
other paths too.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from ctc.certification.statement import percent
from ctc.certification.uncertainty import Uncertainty
from ctc.learning.learnt_torque import LearntTorque
from ctc.learning.path_plant import PathPlant
from plant import Arm, Rig
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.saved import Saved
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table, by_joint

# missing torque, as a share of the amplifier's limit, below which nothing more is to be learnt
_SETTLED = 1e-3

# relative standard deviations of f and of friction before, where no covariance is known
_F = 0.05
_FRICTION = 0.2

# time [s] over which the rest of the torque is taken to be alike: two constants of the smoother
_CORRELATED = 0.02


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Learning(Shown, Saved, Frozen):
    """Result of `learn`; give it in place of the law to learn on. Print it for the verdict.

    Attributes
    ----------
    law : LearntTorque
        For the next repetition.
    arm, rig : Arm, Rig
        With f and friction mended, for other paths and other speeds.
    covariance : (p, p) numpy.ndarray
        Of f of that arm.
    friction_std : (2, n) numpy.ndarray
        Standard deviation of viscous [N m s/rad] and Coulomb [N m] friction, joint side.
    missing : tuple of (n,) numpy.ndarray
        Torque that was missing, rms where joints move [N m]: of each call that learnt.
    beyond, peak : tuple of float
        Of the same calls: share of the samples beyond ±1 pulse, and largest tracking error
        [pulses].
    innovations : tuple of float
        Mean normalised innovation of every repetition so far; 1 where model and log agree.
    left_out : tuple of str
        Repetitions that taught nothing, and why.
    rest : float
        What of the learnt torque is neither f nor friction, rms [N m].
    gain : float
        Share of what is missing by which the torque is corrected.
    diverged : bool
        Whether the last correction did not help, and was taken back.
    before, wanted : (K n,) numpy.ndarray
        Terms of the torque before the last correction, and of that correction at gain 1.
    """

    law: LearntTorque
    arm: Arm
    rig: Rig
    covariance: Floats
    friction_std: Floats
    missing: tuple[Floats, ...]
    beyond: tuple[float, ...]
    peak: tuple[float, ...]
    innovations: tuple[float, ...]
    left_out: tuple[str, ...]
    rest: float
    gain: float
    diverged: bool
    before: Floats
    wanted: Floats

    @property
    def converged(self) -> bool:
        """Whether less than a thousandth of the amplifiers' torque was missing in the last
        repetition.

        Of ±1 pulse `beyond` tells: what does not repeat, or comes too fast for the law, stays.
        """
        return (
            bool(self.missing)
            and not self.diverged
            and share(self.missing[-1], self.rig) <= _SETTLED
        )

    @property
    def uncertainty(self) -> Uncertainty:
        """Of the mended arm and friction, for ``certify(result.arm, result.rig, ...)``."""
        drive = self.rig.drive
        levels = np.array([drive.joint_viscous(), drive.joint_coulomb(np.zeros(drive.n))])
        shares = np.divide(self.friction_std, levels, out=np.zeros_like(levels), where=levels > 0)
        return Uncertainty(covariance=self.covariance, friction=float(min(shares.max(), 1.0)))

    def _short(self) -> str:
        if self.diverged:
            return "the last correction did not help: taken back, and half of it made"
        if not self.missing:
            return "nothing learnt: every repetition was left out"
        done = "nothing more to learn" if self.converged else "learn from another repetition"
        error = (
            f"{percent(self.beyond[-1])} of the samples beyond ±1 pulse, {self.peak[-1]:.0f} at"
            " most"
        )
        return f"{error}; missing torque {np.linalg.norm(self.missing[-1]):.3g} N m rms: {done}"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(self._short(), self.converged and not self.beyond[-1])
        if self.missing:
            first = self.missing[0]
            last = self.missing[-1]
            added = np.sqrt(
                np.mean(
                    self.law.torque(np.linspace(0, self.law.reference.duration, 1000)) ** 2, axis=0
                )
            )
            quantities = [
                ("missing at first, rms [N m]", first),
                ("in the last [N m]", last),
                ("added [N m]", added),
            ]
            yield by_joint(
                self.rig.joint_labels,
                [[name, *(f"{x:.3g}" for x in row)] for name, row in quantities],
            )
        yield (
            f"innovations: {', '.join(f'{x:.2f}' for x in self.innovations)} (1: as the model says)"
        )
        yield from (f"left out: {each}" for each in self.left_out)
        if not self.missing:
            return
        drive = self.rig.drive
        std = np.sqrt(np.diag(self.covariance))
        names = [*self.arm.dynamics.short_names]
        rows = [
            (name, f"{f:.4g}", f"{s:.2g}")
            for name, f, s in zip(names, self.arm.f, std, strict=True)
        ]
        kinds = (
            ("viscous", drive.joint_viscous()),
            ("Coulomb", drive.joint_coulomb(np.zeros(drive.n))),
        )
        for (kind, values), deviations in zip(kinds, self.friction_std, strict=True):
            labels = zip(self.rig.joint_labels, values, deviations, strict=True)
            rows += [(f"{kind}, {label}", f"{value:.4g}", f"{s:.2g}") for label, value, s in labels]
        yield Table(("mended", "value", "std"), rows)
        yield f"Neither f nor friction: {self.rest:.2g} N m rms of the learnt torque."


def share(missing: Floats, rig: Rig) -> float:
    """Missing torque (n,) as a share of the amplifiers' limits, the largest of the joints."""
    return float(
        np.max(np.abs(rig.drive.coupling.shaft_torque(missing)) / np.abs(rig.drive.torque_limit()))
    )


def mended(
    arm: Arm, rig: Rig, plant: PathPlant, learnt: Floats, moves: Any, speed: Floats, prior: Any
) -> tuple[Arm, Rig, Floats, float]:
    """Arm and rig corrected by a learnt torque (N, n) in a ridge regression, where joints move, at
    speeds of shafts; the covariance of f, viscous and Coulomb friction (joint side), and the torque
    that is left, rms [N m].
    """
    n = arm.n
    p = len(arm.f)
    drive = rig.drive
    N = len(learnt)
    Y = np.asarray(
        arm.dynamics._regressor.function.map(N)(plant.q.T, plant.qd.T, plant.qdd.T).full()
    )
    shafts = np.asarray(drive.coupling.joint_torque(np.eye(n))).T
    friction = [each[:, None, :] * shafts for each in (speed, np.sign(speed))]
    rows = np.concatenate([Y.reshape(n, N, p).transpose(1, 0, 2), *friction], axis=2)[moves]
    wanted = learnt[moves]
    before = np.concatenate([arm.f, drive.joint_viscous(), drive.joint_coulomb()])
    P = (
        prior
        if prior is not None
        else np.diag((np.append(np.full(p, _F), np.full(2 * n, _FRICTION)) * before) ** 2)
    )
    alike = max(_CORRELATED / rig.period, 1.0)
    change = np.zeros(len(before))
    variance = float(np.mean(wanted**2)) + 1e-12
    for _ in range(3):  # the rest is what the regression leaves
        S = P @ rows.T @ rows / (variance * alike)
        covariance = np.linalg.solve(np.eye(len(P)) + S, P)
        change = covariance @ (rows.T @ wanted) / (variance * alike)
        variance = float(np.mean((wanted - rows @ change) ** 2)) + 1e-12
    after = before + change
    gear2 = drive.gear**2
    gear = np.abs(drive.gear)
    corrected = dataclasses.replace(
        drive,
        viscous=np.maximum(after[p : p + n] / gear2, 0),
        coulomb=np.maximum(drive.coulomb + change[p + n :] / gear, 0),
    )
    return (
        arm.dynamics.arm(after[:p]),
        dataclasses.replace(rig, drive=corrected),
        covariance,
        variance**0.5,
    )
