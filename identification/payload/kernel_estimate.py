"""The window estimator: a load from 100 to 200 ms of counts and torque, by smooth kernels on the
torque equation.

One kernel that ends smoothly at zero is convolved with both sides, only where it lies within the
samples; rates and accelerations are convolutions with its differences. So nothing rings at the ends
of a window, where a zero-phase low-pass erred ten times more.
"""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error.regressor import balance
from identification.payload.posterior import LoadShape, PayloadEstimate, information, posterior
from identification.results.identification import Identification
from plant import Arm, Rig
from plant.compiler.intrinsics import MapKernel
from plant.parts.arguments import array, instance, real
from plant.parts.fields import Floats


@dataclasses.dataclass(frozen=True)
class Smoothing:
    """A Hann kernel and its differences.

    `length`: of the kernel [s]. `period`: of the samples [s].
    """

    length: float
    period: float

    @functools.cached_property
    def _kernels(self) -> Floats:
        """Value, rate and acceleration (3, L + 2), for `numpy.convolve`."""
        count = max(3, round(self.length / self.period))
        hann = np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2
        hann /= hann.sum()
        h = self.period
        parts = ([0, 1, 0], np.array([1, 0, -1]) / (2 * h), np.array([1, -2, 1]) / h**2)
        return np.array([np.convolve(hann, part) for part in parts])

    @property
    def samples(self) -> int:
        """Of the kernel, with one more at each end for the differences."""
        return self._kernels.shape[1]

    def value(self, x: Floats) -> Floats:
        """Smoothed samples (N - samples + 1, n) of x (N, n)."""
        return self._convolved(x, 0)

    def motion(self, q: Floats) -> tuple[Floats, Floats, Floats]:
        """Smoothed position, its rate and its acceleration, each (N - samples + 1, n), of q (N,
        n).
        """
        return self._convolved(q, 0), self._convolved(q, 1), self._convolved(q, 2)

    @property
    def of_rounding(self) -> float:
        """Standard deviation of the acceleration per standard deviation of independent samples
        [1/s^2].
        """
        return float(np.linalg.norm(self._kernels[2]))

    @property
    def per_independent(self) -> float:
        """Samples per independent one of the acceleration: neighbours share theirs.

        The acceleration's kernel is one period of a cosine; shifted by that over 2 pi it has lost
        its correlation.
        """
        return max(1.0, (self.samples - 2) / (2 * np.pi))

    def _convolved(self, x: Floats, which: int) -> Floats:
        return np.column_stack(
            [np.convolve(column, self._kernels[which], "valid") for column in x.T]
        )


# Speed [rad/s] that a joint must have throughout a kernel: below, its friction is not known to
# slide one way.
_SLOW = 0.05


@dataclasses.dataclass(frozen=True)
class Window:
    """What a controller saw of a segment of time.

    `counts` (N, n): encoder counts at each sample. `torque` (N, n): applied joint torque [N m],
    each from its sample to the next. `before` (n,): applied up to the first sample [N m].
    """

    counts: Floats
    torque: Floats
    before: Floats

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def at_samples(self) -> Floats:
        """Torque (N, n) around each sample: the mean of those on both sides of it."""
        return (self.torque + np.vstack([self.before[None], self.torque[:-1]])) / 2


class TorqueWindow:
    """The torque equation of an arm and a rig as identified, with a load, along windows.

    `unknown`: names of what is `uncertain` beside the load, or else known: all of f, and friction.
    """

    def __init__(
        self,
        arm: Arm,
        rig: Rig,
        smoothing: Smoothing,
        unknown: Sequence[str],
        uncertain: bool = True,
    ) -> None:
        self.arm = arm
        self.rig = rig
        self.smoothing = smoothing
        self.unknown = tuple(unknown)
        self.uncertain = uncertain
        names, function = balance(arm.dynamics, rig, self.unknown, False)
        self._kernel = MapKernel(function, outer=1)
        values = dict(zip(names, np.concatenate([arm.f, rig.number_values()]), strict=True))
        self._numbers = np.array(list(values.values()))[:, None]
        self._of_f = [self.unknown.index(name) for name in arm.dynamics.names]

    @functools.cached_property
    def _load(self) -> Floats:
        return self.arm.dynamics.load_matrix()

    def rows(self, window: Window, basis: Floats, loaded: Floats) -> tuple[Floats, Floats, Floats]:
        """Columns of the load, columns of what is uncertain, and torque that the empty arm does not
        explain.

        Each row is divided by its standard deviation: that of the rounded counts, through the
        inertia, with a row counted as its share of an independent one.

        `basis` (b, 10): standard parameters of loads. `loaded` (10,): of the load with which the
        inertia is taken.

        Returns load (R, b); uncertain (R, u); torque (R,).
        """
        n = self.arm.n
        u = len(self.unknown)
        rig = self.rig
        q, qd, qdd = self.smoothing.motion(rig.cell_centre(window.counts))
        torque = self.smoothing.value(window.at_samples)
        results = self._kernel(np.vstack([q.T, qd.T, qdd.T]), self._numbers)[:, 0]
        # casadi's matrices are joined column by column
        uncertain = results[: n * u].reshape(u, n, -1)
        rest = torque.T - results[n * u :]
        load = np.tensordot(basis @ self._load.T, uncertain[self._of_f], axes=1)
        good = np.abs(qd.T) > _SLOW + np.abs(qdd.T) * self.smoothing.length / 2
        inertia = self.arm.dynamics.D(q[len(q) // 2], self.arm.f + self._load @ loaded).full()
        scale = 1 / (self.rounding * np.linalg.norm(inertia * self._per_count, axis=1))
        weight = np.broadcast_to(scale[:, None], good.shape)[good]
        return (
            load[:, good].T * weight[:, None],
            uncertain[:, good].T * weight[:, None],
            rest[good] * weight,
        )

    @functools.cached_property
    def rounding(self) -> float:
        """Standard deviation of a count's acceleration [1/s^2], as of one independent row.

        What rounding does to neighbouring rows has opposite signs and cancels in part: alone it
        counts half.
        """
        share = 1.0 if self.uncertain else 0.5
        return self.smoothing.of_rounding * np.sqrt(share * self.smoothing.per_independent / 12)

    @functools.cached_property
    def _per_count(self) -> Floats:
        """Angle of one count of each joint (n,) [rad]."""
        return np.asarray(np.abs(np.diagonal(self.rig.to_angle(np.eye(self.arm.n)))))


KERNEL = 0.04  # length of the smooth kernel [s]


# Misfit from which on no load explains a window: on rigid gears, and on elastic ones, which
# oscillate.
_RIGID = 2.0
_ELASTIC = 20.0


def kernel_length(arm: Arm, rig: Rig, shape: LoadShape) -> float:
    """Length of the smooth kernel [s]: 40 ms, or on elastic gears two periods of the lowest
    resonance with a full load.

    There a Hann kernel has its first zero. The resonance is that of the links against locked
    motors, at joints' zero.
    """
    gears = rig.drive.elasticity
    if gears is None:
        return KERNEL
    loaded = arm.f + arm.dynamics.load_matrix() @ (2 * shape.prior)
    links = arm.dynamics.D(np.zeros(arm.n), loaded).full() - np.diag(rig.drive.reflected_inertia())
    root = 1 / np.sqrt(gears.stiffness)
    slowest = 2 * np.pi * np.sqrt(np.linalg.eigvalsh(root[:, None] * links * root)[-1])
    return float(max(KERNEL, 2 * slowest))


def friction_names(rig: Rig) -> list[str]:
    """Names of the friction levels that enter the torque equation linearly."""
    return [f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(rig.n)]


def uncertainty(
    arm: Arm, rig: Rig, found: Identification | None, friction: float
) -> tuple[tuple[str, ...], Floats]:
    """Names of what is uncertain beside the load, and a root (u, v) of its covariance.

    `arm`, `rig`: as the law has them. `found`: that gave them, for its covariance. `friction`:
    standard deviation of the friction levels, as a share of them, where the identification does not
    have one.
    """
    if real("friction", friction, "Give a share, such as 0.05.") < 0:
        raise ValueError(
            f"friction must not be negative; got {friction}. Give a share, such as 0.05."
        )
    names = arm.dynamics.names
    root = np.zeros((arm.dynamics.p, 0))
    if found is not None:
        instance("found", found, Identification, "Pass what identify gave, or leave it out.")
        if found.covariance is None:
            raise ValueError(
                f"found must have a covariance; {found.search.method!r} provides none. Leave it"
                " out, or search on."
            )
        linear = [
            i for i, name in enumerate(found.fit.unknown) if name in (*names, *friction_names(rig))
        ]
        if found.arm.dynamics.names != names:
            raise ValueError(
                "found must be of the law's arm; its f has other names. Pass the one that gave the"
                " arm."
            )
        values, vectors = np.linalg.eigh(found.covariance[np.ix_(linear, linear)])
        names = tuple(found.fit.unknown[i] for i in linear)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
    more = [name for name in friction_names(rig) if name not in names] if friction else []
    levels = dict(zip(rig.number_names(), rig.number_values(), strict=True))
    own = np.diag([friction * abs(levels[name]) for name in more])
    zeros = np.zeros((len(names), len(more))), np.zeros((len(more), root.shape[1]))
    return (*names, *more), np.block([[root, zeros[0]], [zeros[1], own]])


class KernelEstimator:
    """Least squares on the smooth torque equation, with what is uncertain of arm and friction
    estimated along.

    `arm`: without a load. `root` (u, v): root of the covariance of the unknowns; with no columns
    all is known.

    The applied torque is one side of the equation, so that a saturated amplifier does no harm to
    it. Behind elastic gears the equation is that of rigid ones: the kernel is long enough to take
    out their resonance (`kernel_length`).
    """

    def __init__(
        self, arm: Arm, rig: Rig, shape: LoadShape, unknown: Sequence[str], root: ArrayLike
    ) -> None:
        self.shape, length = shape, kernel_length(arm, rig, shape)
        self._limit = _RIGID if rig.drive.elasticity is None else _ELASTIC
        self._root = array("root", root, (len(unknown), None), advice="Give a row per unknown.")
        smoothing = Smoothing(length, rig.period)
        self._window = TorqueWindow(arm, rig, smoothing, unknown, uncertain=self._root.shape[1] > 0)

    def __call__(self, window: Window) -> PayloadEstimate:
        """Estimate from a window of at least three kernels."""
        load, uncertain, torque = self._window.rows(window, self.shape.basis, self.shape.prior)
        matrix, vector, square = information(load, uncertain @ self._root, torque)
        return posterior(self.shape, matrix, vector, square, len(torque), self._limit)
