"""The window estimator: a load from 100 to 200 ms of counts and torque, by smooth kernels on the torque equation."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from identification.payload.posterior import PayloadEstimate, information, posterior
from identification.payload.shape import LoadShape
from identification.payload.torque_window import Smoothing, TorqueWindow, Window
from identification.results.identification import Identification
from plant import Arm, Rig
from plant.parts.arguments import array, instance, real
from plant.parts.fields import Floats

KERNEL = 0.04
"""Length of the smooth kernel [s]."""


_RIGID, _ELASTIC = 2.0, 20.0
"""Misfit from which on no load explains a window: on rigid gears, and on elastic ones, which oscillate."""


def kernel_length(arm: Arm, rig: Rig, shape: LoadShape) -> float:
    """Length of the smooth kernel [s]: 40 ms, or on elastic gears two periods of the lowest resonance with a full load.

    There a Hann kernel has its first zero. The resonance is that of the links against locked motors, at joints' zero.
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


def uncertainty(arm: Arm, rig: Rig, found: Identification | None, friction: float) -> tuple[tuple[str, ...], Floats]:
    """Names of what is uncertain beside the load, and a root (u, v) of its covariance.

    `arm`, `rig`: as the law has them. `found`: that gave them, for its covariance. `friction`: standard deviation of
    the friction levels, as a share of them, where the identification does not have one.
    """
    if real("friction", friction, "Give a share, such as 0.05.") < 0:
        raise ValueError(f"friction must not be negative; got {friction}. Give a share, such as 0.05.")
    names, root = arm.dynamics.names, np.zeros((arm.dynamics.p, 0))
    if found is not None:
        instance("found", found, Identification, "Pass what identify gave, or leave it out.")
        if found.covariance is None:
            raise ValueError(
                f"found must have a covariance; {found.search.method!r} provides none. Leave it out, or search on."
            )
        linear = [i for i, name in enumerate(found.fit.unknown) if name in (*names, *friction_names(rig))]
        if found.arm.dynamics.names != names:
            raise ValueError("found must be of the law's arm; its f has other names. Pass the one that gave the arm.")
        values, vectors = np.linalg.eigh(found.covariance[np.ix_(linear, linear)])
        names, root = tuple(found.fit.unknown[i] for i in linear), vectors * np.sqrt(np.maximum(values, 0.0))
    more = [name for name in friction_names(rig) if name not in names] if friction else []
    levels = dict(zip(rig.number_names(), rig.number_values(), strict=True))
    own = np.diag([friction * abs(levels[name]) for name in more])
    zeros = np.zeros((len(names), len(more))), np.zeros((len(more), root.shape[1]))
    return (*names, *more), np.block([[root, zeros[0]], [zeros[1], own]])


class KernelEstimator:
    """Least squares on the smooth torque equation, with what is uncertain of arm and friction estimated along.

    `arm`: without a load. `root` (u, v): root of the covariance of the unknowns; with no columns all is known.

    Notes
    -----
    The applied torque is one side of the equation, so that a saturated amplifier does no harm to it. Behind elastic
    gears the equation is that of rigid ones: the kernel is long enough to take out their resonance (`kernel_length`).
    """

    def __init__(self, arm: Arm, rig: Rig, shape: LoadShape, unknown: Sequence[str], root: ArrayLike) -> None:
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
