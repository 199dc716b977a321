"""Result of learning from repetitions, and the part of the learnt torque that is f and friction."""

import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ctc.certification import Uncertainty, percent
from ctc.learning.learnt_torque import LearntTorque
from ctc.learning.path_plant import PathPlant
from ctc.learning.settings import SETTINGS, LearnSettings
from plant import Arm, Rig
from plant.parts import Floats, Frozen, Piece, Saved, Shown, Table, Verdict, by_joint, frozen, kept


@kept
@frozen
class Learning(Shown, Saved, Frozen):
    """Result of `learn`; give it in place of the law to learn on. Print it for the verdict.

    Attributes
    ----------
    law : LearntTorque
        For the next repetition.
    arm : Arm
        With corrected f, for other paths and other speeds.
    rig : Rig
        With corrected friction, likewise.
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
        Repetitions that were not used, and why.
    rest : float
        Part of the learnt torque that is neither f nor friction, rms [N m].
    gain : float
        Share of the missing torque by which the learnt torque is corrected.
    diverged : bool
        Whether the last correction did not help, and was taken back.
    before : (K n,) numpy.ndarray
        Terms of the learnt torque before the last correction.
    wanted : (K n,) numpy.ndarray
        Terms of the whole correction, of which the share `gain` is added.
    settings : LearnSettings
        Of the last call; the next one keeps them.
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
    settings: LearnSettings = SETTINGS

    @property
    def converged(self) -> bool:
        """Whether the last repetition missed less than a thousandth of the amplifiers' torque.

        Errors beyond ±1 pulse may remain (`beyond`): disturbances that do not repeat, or are too
        fast for the law.
        """
        # After a correction that was taken back, the last missing torque belongs to an older law.
        return (
            bool(self.missing)
            and not self.diverged
            and share(self.missing[-1], self.rig) <= self.settings.settled
        )

    @property
    def uncertainty(self) -> Uncertainty:
        """Of the mended arm and friction, for ``certify(result.arm, result.rig, ...)``."""
        levels = _friction_levels(self.rig)
        # A level of zero has no share of its own: it counts as wholly uncertain, or as known.
        shares = np.sign(self.friction_std)
        np.divide(self.friction_std, levels, out=shares, where=levels > 0)
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
            times = np.linspace(0, self.law.reference.duration, 1000)
            quantities = {
                "missing at first, rms [N m]": self.missing[0],
                "in the last [N m]": self.missing[-1],
                "added [N m]": np.sqrt(np.mean(self.law.torque(times) ** 2, axis=0)),
            }
            rows = [[name, *(f"{x:.3g}" for x in row)] for name, row in quantities.items()]
            yield by_joint(self.rig.joint_labels, rows)
        innovations = ", ".join(f"{x:.2f}" for x in self.innovations)
        yield f"innovations: {innovations} (1: as the model says)"
        yield from (f"left out: {line}" for line in self.left_out)
        if not self.missing:
            return
        std = np.sqrt(np.diag(self.covariance))
        lines = [*zip(self.arm.dynamics.short_names, self.arm.f, std, strict=True)]
        levels = _friction_levels(self.rig)
        for i, kind in enumerate(("viscous", "Coulomb")):
            names = [f"{kind}, {label}" for label in self.rig.joint_labels]
            lines += zip(names, levels[i], self.friction_std[i], strict=True)
        rows = [[name, f"{value:.4g}", f"{deviation:.2g}"] for name, value, deviation in lines]
        yield Table(("mended", "value", "std"), rows)
        yield f"Neither f nor friction: {self.rest:.2g} N m rms of the learnt torque."


def _friction_levels(rig: Rig) -> Floats:
    """Viscous and Coulomb friction (2, n), joint side, without what a friction curve adds."""
    drive = rig.drive
    return np.array([drive.joint_viscous(), drive.coulomb * np.abs(drive.gear)])


def share(missing: Floats, rig: Rig) -> float:
    """Missing torque (n,), rms, as a share of the amplifiers' limits, the largest of the joints."""
    # Amplifiers limit shafts, so that a coupled arm is compared there. The rms of a sum is at most
    # the sum of the rms, which opposite phases reach.
    shafts = np.abs(rig.drive.coupling.shaft_torque(np.diag(missing))).sum(axis=0)
    return float(np.max(shafts / np.abs(rig.drive.torque_limit())))


class Mending(NamedTuple):
    """Arm and rig corrected by a learnt torque.

    `covariance` (p, p) of f, `friction_std` (2, n) of viscous and Coulomb friction, joint side;
    `rest` is the torque that neither explains, rms [N m].
    """

    arm: Arm
    rig: Rig
    covariance: Floats
    friction_std: Floats
    rest: float


def mended(
    arm: Arm,
    rig: Rig,
    plant: PathPlant,
    learnt: Floats,
    moves: Any,
    speed: Floats,
    prior: Any,
    settings: LearnSettings,
) -> Mending:
    """Arm and rig corrected by a learnt torque (N, n), in a ridge regression where joints move.

    `speed` (N, n) is that of the shafts [rad/s]; `prior` the covariance before, or None.
    """
    n = arm.n
    p = len(arm.f)
    drive = rig.drive
    N = len(learnt)

    # 1. Rows of the regression: torque per parameter, per viscous and per Coulomb friction. Samples
    # at which a joint stands are left out: friction may then have any value up to Coulomb's.
    regressor = arm.dynamics._regressor.function.map(N)(plant.q.T, plant.qd.T, plant.qdd.T)
    # casadi stacks the samples side by side; the regression wants one matrix (n, p) per sample.
    Y = regressor.full().reshape(n, N, p).transpose(1, 0, 2)
    shafts = np.asarray(drive.coupling.joint_torque(np.eye(n))).T
    friction = [factor[:, None, :] * shafts for factor in (speed, np.sign(speed))]
    rows = np.concatenate([Y, *friction], axis=2)[moves]
    target = learnt[moves]

    # 2. The prior: the identification's covariance, or relative standard deviations.
    model_values = np.concatenate([arm.f, *_friction_levels(rig)])
    P = prior
    if P is None:
        # A level of zero gets zero prior variance: friction that the model lacks is not added.
        deviations = settings.f_deviation, settings.friction_deviation
        P = np.diag((np.repeat(deviations, [p, 2 * n]) * model_values) ** 2)
    # Where nothing was learnt, the torque has no residual that would show its noise.
    if not target.any():
        return Mending(arm, rig, P[:p, :p], np.sqrt(np.diag(P)[p:]).reshape(2, -1), 0.0)

    # 3. The smoother correlates neighbouring samples: `alike` of them count as one independent
    # sample. The variance of the residual is the noise, and depends on the solution in turn: three
    # rounds of the iteration converge.
    alike = max(settings.correlation_time / rig.period, 1.0)
    change = np.zeros(len(model_values))
    variance = float(np.mean(target**2)) + 1e-12
    for _ in range(3):
        # The covariance form (I + P A' A)^-1 P also works with such a singular prior.
        S = P @ rows.T @ rows / (variance * alike)
        covariance = np.linalg.solve(np.eye(len(P)) + S, P)
        change = covariance @ (rows.T @ target) / (variance * alike)
        variance = float(np.mean((target - rows @ change) ** 2)) + 1e-12

    # 4. Back to the motor side. Without the limit at zero, noise could give negative friction,
    # which would drive the joint.
    values = model_values + change
    corrected = dataclasses.replace(
        drive,
        viscous=np.maximum(values[p : p + n] / drive.gear**2, 0),
        coulomb=np.maximum(drive.coulomb + change[p + n :] / np.abs(drive.gear), 0),
    )
    mended_rig = dataclasses.replace(rig, drive=corrected)
    friction_std = np.sqrt(np.diag(covariance)[p:]).reshape(2, -1)
    return Mending(
        arm.dynamics.arm(values[:p]), mended_rig, covariance[:p, :p], friction_std, variance**0.5
    )
