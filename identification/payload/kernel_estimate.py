"""`KernelEstimator`: a load from 100 to 200 ms of counts and torque, by smooth kernels.

Both sides of the torque equation are convolved with a kernel that ends smoothly at zero, only where
it lies within the samples. Rates and accelerations are convolutions with its differences. So no
filter rings at the ends of a window; a zero-phase low-pass had ten times the error there.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error import LINEAR, balance
from identification.payload.posterior import (
    LoadShape,
    PayloadEstimate,
    information,
    posterior,
    unheard,
)
from identification.results import Identification
from plant import Arm, Rig
from plant.compiler import MapKernel
from plant.parts import Floats, array, frozen_settings, instance, real


@dataclass(frozen=True)
class Smoothing:
    """Smooth position, rate and acceleration by a Hann kernel and its differences.

    `length`: of the kernel [s]. `period`: sample period [s].
    """

    length: float
    period: float

    @functools.cached_property
    def _kernels(self):
        """Kernels of value, rate and acceleration (3, L + 2), for `numpy.convolve`."""
        # Three samples are the least that a second difference needs.
        count = max(3, round(self.length / self.period))
        hann = np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2
        hann /= hann.sum()
        h = self.period
        # `numpy.convolve` reverses the kernel, so the rate has its later sample first. The value is
        # padded to the length of the differences.
        stencils = ([0, 1, 0], np.array([1, 0, -1]) / (2 * h), np.array([1, -2, 1]) / h**2)
        return np.array([np.convolve(hann, stencil) for stencil in stencils])

    @property
    def samples(self) -> int:
        """Length of the kernels in samples, with one more at each end for the differences."""
        return self._kernels.shape[1]

    def value(self, x: Floats) -> Floats:
        """Smoothed samples (N - samples + 1, n) of x (N, n)."""
        return self._convolved(x, 0)

    def motion(self, q: Floats) -> tuple[Floats, Floats, Floats]:
        """Smoothed position, rate and acceleration, each (N - samples + 1, n), of q (N, n)."""
        return self._convolved(q, 0), self._convolved(q, 1), self._convolved(q, 2)

    @property
    def of_rounding(self) -> float:
        """Standard deviation of the acceleration over that of independent samples [1/s^2]."""
        return float(np.linalg.norm(self._kernels[2]))

    @property
    def per_independent(self) -> float:
        """Number of samples per independent sample of the acceleration; neighbours correlate.

        The kernel of the acceleration is one period of a cosine. Between samples that are a period
        over 2 pi apart, the correlation has fallen to 0.33.
        """
        return max(1.0, (self.samples - 2) / (2 * np.pi))

    def _convolved(self, x, order):
        # `numpy.convolve` exchanges the two where the samples are fewer: it would slide the samples
        # along the kernel.
        if len(x) < self.samples:
            raise ValueError(
                f"a window must have at least {self.samples} samples, the length of the kernel;"
                f" got {len(x)}. Give a longer window."
            )
        kernel = self._kernels[order]
        return np.column_stack([np.convolve(column, kernel, "valid") for column in x.T])


@frozen_settings
class KernelSettings:
    """Limits of the kernel estimator.

    Chosen by hand; ``tests/benchmarks/payload.py`` measures errors and intervals of the mass.

    Parameters
    ----------
    slow : float
        Speed that a joint, or the shaft of a coupled motor, must have throughout a kernel [rad/s,
        or m/s of a joint that slides]: a slower one may stick, and its friction is then unknown.
    misfit_rigid, misfit_elastic : float
        Misfit above which no load explains a window, on rigid gears, and on elastic ones, which
        oscillate.
    """

    # Rows that count, and windows that a load can explain.
    slow: float = 0.05
    misfit_rigid: float = 2.0
    misfit_elastic: float = 20.0


SETTINGS = KernelSettings()


@dataclass(frozen=True)
class Window:
    """Counts and torques of a controller over a segment of time.

    `counts` (N, n): encoder counts at each sample. `torque` (N, n): applied joint torque [N m],
    each from its sample to the next. `before` (n,): torque applied until sample 0 [N m].

    Raises
    ------
    ValueError
        Arrays of other shapes. NaN passes: no estimator uses a window that is not `finite`.
    """

    # The counts of n joints, and the torque between them.
    counts: Floats
    torque: Floats
    before: Floats

    def __post_init__(self) -> None:
        advice = "Give one row per sample, one column per joint."
        counts = array("counts", self.counts, ("N", "n"), advice=advice, finite=False)
        shapes = {"torque": counts.shape, "before": counts.shape[1:]}
        object.__setattr__(self, "counts", counts)
        for name, shape in shapes.items():
            value = array(name, getattr(self, name), shape, advice=advice, finite=False)
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.counts)

    def require_joints(self, n: int) -> None:
        """Refuse a window that is not of n joints."""
        if self.before.shape != (n,):
            raise ValueError(
                f"a window must have {n} joints like the arm; got {len(self.before)}. Give one"
                " column per joint."
            )

    @property
    def finite(self) -> bool:
        """Whether all counts and torques are finite."""
        return all(np.isfinite(x).all() for x in (self.counts, self.torque, self.before))

    @property
    def at_samples(self) -> Floats:
        """Torque (N, n) at each sample: the mean of those before and after it."""
        return (self.torque + np.vstack([self.before[None], self.torque[:-1]])) / 2


class TorqueWindow:
    """Torque equation of an identified arm and rig with a load, along windows.

    `unknown`: names of f and of friction, the columns of the equation. `uncertain`: whether errors
    of these numbers are estimated beside the load; if not, the numbers count as exact.

    Raises
    ------
    ValueError
        Friction that depends on the load.
    """

    def __init__(
        self,
        arm: Arm,
        rig: Rig,
        smoothing: Smoothing,
        unknown: Sequence[str],
        uncertain: bool = True,
    ) -> None:
        # The equation would not be linear in the load.
        if rig.drive.load_friction is not None:
            raise ValueError(
                "load_friction of the rig must be None for smooth kernels; got"
                f" {rig.drive.load_friction.share}. Take method='genetic'."
            )
        self.arm = arm
        self.rig = rig
        self.smoothing = smoothing
        self.unknown = tuple(unknown)
        self.uncertain = uncertain
        _, function = balance(arm.dynamics, rig, self.unknown, False)
        self._kernel = MapKernel(function, outer=1)
        self._numbers = np.concatenate([arm.f, rig.number_values()])[:, None]
        # A load changes f, so its columns are combinations of those of f.
        self._of_f = [self.unknown.index(name) for name in arm.dynamics.names]

    @functools.cached_property
    def _load(self):
        return self.arm.dynamics.load_matrix()

    def rows(self, window: Window, basis: Floats, loaded: Floats) -> tuple[Floats, Floats, Floats]:
        """Columns of a load and of the unknowns, and the torque that the empty arm leaves.

        A row is the torque on one shaft at one sample. It is divided by the standard deviation that
        the rounding of counts causes through the inertia; this is enlarged, since neighbouring rows
        are not independent (`rounding`).

        `basis` (b, 10): standard parameters of loads. `loaded` (10,): those of the load that the
        inertia includes.

        Returns load (R, b); uncertain (R, u); torque (R,).
        """
        # 1. Smooth both sides of the equation.
        n = self.arm.n
        u = len(self.unknown)
        rig = self.rig
        q, qd, qdd = self.smoothing.motion(rig.cell_centre(window.counts))
        torque = self.smoothing.value(window.at_samples)
        results = self._kernel(np.vstack([q.T, qd.T, qdd.T]), self._numbers)[:, 0]

        # 2. Columns of the unknowns, their torque, and columns of the load. casadi stores a matrix
        # column by column.
        uncertain = results[: n * u].reshape(u, n, -1)
        rest = torque.T - results[n * u :]
        coupling = rig.drive.coupling
        uncertain, rest = (
            np.moveaxis(coupling.shaft_torque(np.moveaxis(torques, -2, -1)), -1, -2)
            for torques in (uncertain, rest)
        )
        load = np.tensordot(basis @ self._load.T, uncertain[self._of_f], axes=1)

        # 3. Use a shaft only while it slides in one direction throughout the kernel: friction and
        # encoders are on the shafts.
        speed, acceleration = (np.abs(coupling.shaft(x).T) for x in (qd, qdd))
        sliding = speed > SETTINGS.slow + acceleration * self.smoothing.length / 2

        # 4. Rounding errors of all shafts act through the inertia.
        inertia = self.arm.dynamics.D(q[len(q) // 2], self.arm.f + self._load @ loaded)
        inertia = coupling.shaft_inertia(inertia).full()
        scale = 1 / (self.rounding * np.linalg.norm(inertia * self._per_count, axis=1))
        weight = np.broadcast_to(scale[:, None], sliding.shape)[sliding]
        return (
            load[:, sliding].T * weight[:, None],
            uncertain[:, sliding].T * weight[:, None],
            rest[sliding] * weight,
        )

    @functools.cached_property
    def rounding(self) -> float:
        """Standard deviation of the acceleration by rounding, of one independent row [1/s^2].

        Rounding errors of neighbouring rows have opposite signs and cancel in part. So their
        variance counts half if no number is uncertain.
        """
        share = 1.0 if self.uncertain else 0.5
        return self.smoothing.of_rounding * np.sqrt(share * self.smoothing.per_independent / 12)

    @functools.cached_property
    def _per_count(self):
        """Angle of one count of each shaft (n,) [rad]."""
        joints = self.rig.to_angle(np.eye(self.arm.n))
        return np.abs(np.diagonal(self.rig.drive.coupling.shaft(joints)))


KERNEL = 0.04  # length of the smooth kernel on rigid gears [s]


def kernel_length(arm: Arm, rig: Rig, shape: LoadShape) -> float:
    """Length of the kernel [s]: 40 ms, or two periods of the lowest resonance of elastic gears.

    A Hann kernel of that length has its first zero at the resonance. This is the resonance of the
    links with the heaviest load, at its middle centre, against locked motors at joint angles of
    zero.
    """
    gears = rig.drive.elasticity
    if gears is None:
        return KERNEL
    heaviest = shape.mass[1] * shape.per_kg[len(shape.places) // 2]
    loaded = arm.f + arm.dynamics.load_matrix() @ heaviest
    # Gears and rotors are on the shafts.
    inertia = rig.drive.coupling.shaft_inertia(arm.dynamics.D(np.zeros(arm.n), loaded)).full()
    links = inertia - np.diag(rig.drive.reflected_inertia())
    # Generalised eigenvalues of inertia over stiffness: the largest is the slowest period.
    root = 1 / np.sqrt(gears.stiffness)
    slowest = 2 * np.pi * np.sqrt(np.linalg.eigvalsh(root[:, None] * links * root)[-1])
    return float(max(KERNEL, 2 * slowest))


def friction_names(rig: Rig) -> list[str]:
    """Names of the levels of viscous and Coulomb friction."""
    return [f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(rig.n)]


def uncertainty(
    arm: Arm, rig: Rig, identification: Identification | None, friction: float
) -> tuple[tuple[str, ...], Floats]:
    """Names (u) of the uncertain numbers beside the load, and a root (u, v) of their covariance.

    `arm`, `rig`: those of the law. `identification`: the one that gave them, for its covariance, or
    None. `friction`: relative standard deviation of those friction levels that this covariance does
    not contain.
    """
    if real("friction", friction, "Give a share, such as 0.05.") < 0:
        raise ValueError(
            f"friction must not be negative; got {friction}. Give a share, such as 0.05."
        )
    names = arm.dynamics.names
    root = np.zeros((arm.dynamics.p, 0))
    if identification is not None:
        instance(
            "found", identification, Identification, "Pass what identify gave, or leave it out."
        )
        # Without a covariance every error of f would be taken for a load.
        if identification.covariance is None:
            raise ValueError(
                f"found must have a covariance; {identification.search.method!r} provides none."
                " Leave it out, or search on."
            )
        fit = identification.fit
        linear_names = (*names, *(name for name in rig.number_names() if name.startswith(LINEAR)))
        linear = [i for i, name in enumerate(fit.unknown) if name in linear_names]
        if identification.arm.dynamics.names != names:
            raise ValueError(
                "found must be of the law's arm; its f has other names. Pass the one that gave the"
                " arm."
            )
        # A root by eigenvectors: the covariance of fixed numbers is singular.
        values, vectors = np.linalg.eigh(identification.covariance[np.ix_(linear, linear)])
        names = tuple(fit.unknown[i] for i in linear)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
    # Levels of friction without a covariance are independent of all others.
    stated = [name for name in friction_names(rig) if name not in names] if friction else []
    levels = rig.numbers()
    deviations = np.diag([friction * abs(levels[name]) for name in stated])
    above = np.zeros((len(names), len(stated)))
    below = np.zeros((len(stated), root.shape[1]))
    return (*names, *stated), np.block([[root, above], [below, deviations]])


class KernelEstimator:
    """Least squares of a load on the smooth torque equation, with uncertain arm and friction.

    `arm`: without a load. `root` (u, v): root of the covariance of the unknowns; without columns
    all are exact.

    The equation contains the applied torque, so that a saturated amplifier does no harm. Elastic
    gears are treated as rigid: the kernel is long enough to remove their resonance
    (`kernel_length`).
    """

    def __init__(
        self, arm: Arm, rig: Rig, shape: LoadShape, unknown: Sequence[str], root: ArrayLike
    ) -> None:
        self.shape = shape
        # Oscillating gears leave a residual that no load causes.
        rigid = rig.drive.elasticity is None
        self._limit = SETTINGS.misfit_rigid if rigid else SETTINGS.misfit_elastic
        self._root = array("root", root, (len(unknown), None), advice="Give a row per unknown.")
        smoothing = Smoothing(kernel_length(arm, rig, shape), rig.period)
        self._window = TorqueWindow(arm, rig, smoothing, unknown, uncertain=self._root.shape[1] > 0)

    def __call__(self, window: Window) -> PayloadEstimate:
        """Estimate from a window, which must be as long as a kernel and should be as long as three.

        Raises
        ------
        ValueError
            A window that is shorter than the kernel, or of other joints.
        """
        window.require_joints(self._window.arm.n)
        if not window.finite:
            return unheard(self.shape, finite=False)
        load, uncertain, torque = self._window.rows(window, self.shape.basis, self.shape.prior)
        # The root scales the unknowns to independent numbers of unit deviation.
        matrix, vector, square = information(load, uncertain @ self._root, torque)
        return posterior(self.shape, matrix, vector, square, len(torque), self._limit)
