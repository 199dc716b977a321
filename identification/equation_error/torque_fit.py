"""Equation error: the measured torque against regressor times unknowns, by weighted least squares.

tau = Y(q, qd, qdd) f + friction(qd) is linear in f and in the linear numbers of the drive (`drive.viscous[0]`,
`drive.coulomb[0]`, `drive.curve.offset[0]`), so one weighted least-squares fit finds them all
(`identification.equation_error.regressor`).

Source: M. Gautier, Dynamic identification of robots with power model, ICRA 1997 (parallel filtering and decimation).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.equation_error.labels import short_names
from identification.equation_error.least_squares import least_squares
from identification.equation_error.regressor import Places, System, regressor_and_torque
from plant import Dynamics, Rig
from plant.parts.arguments import array, choice, instance, known_options, real
from plant.parts.frozen import Frozen

__all__ = ["TorqueFit", "fit_torque", "weighted"]

_POOR = 0.3
"""Relative torque error above which something is wrong with the log rather than with the arm."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class TorqueFit(Frozen):
    """What a fit of the torque found.

    Attributes
    ----------
    dynamics : Dynamics
        What its names of f mean.
    names : tuple of str
    values : (k,) numpy.ndarray
    covariance : (k, k) numpy.ndarray
        Of the values, from the variance of each joint's residual, taken as white after decimation. Errors that are not
        noise (filters at the reversals of friction, timing, what the model lacks) come on top.
    sigma : (n,) numpy.ndarray
        Standard deviation of each joint's residual [N m]; the weights of the fit are 1 / sigma.
    relative_error : float
        Length of the residual over length of the torque, all rows that were used.
    rows : int
        Equations that were used.
    condition : float
        Condition number of the weighted columns, scaled to one length.
    """

    dynamics: Dynamics
    names: tuple[str, ...]
    values: NDArray[np.float64]
    covariance: NDArray[np.float64]
    sigma: NDArray[np.float64]
    relative_error: float
    rows: int
    condition: float

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviations (k,) of the values."""
        return np.sqrt(np.diag(self.covariance))

    def __getitem__(self, name: str) -> float:
        """Value of one name."""
        return self.values[self.names.index(choice("a name of this fit", name, self.names))]

    def __str__(self) -> str:
        names = short_names(self.dynamics, self.names)
        width = max(map(len, names))
        lines = [
            f"{name:<{width}} {value:12.5g} +- {std:.2g}"
            for name, value, std in zip(names, self.values, self.std, strict=True)
        ]
        end = f"{self.rows} equations, relative torque error {self.relative_error:.2%}, condition {self.condition:.0f}"
        legend = self.dynamics.legend.splitlines()
        return "\n".join([*lines, end, *(f"warning: {text}" for text in self.warnings), *legend])

    @property
    def warnings(self) -> list[str]:
        """What looks wrong, one line each."""
        negative = [
            name for name, value in zip(self.names, self.values, strict=True)
            if name.startswith(("drive.viscous", "drive.coulomb")) and value < 0
        ]  # fmt: skip
        found = [f"friction must not be negative; check signs and units ({', '.join(negative)})"] if negative else []
        if self.relative_error > _POOR:
            found.append(
                f"{self.relative_error:.0%} of the torque is not explained; check units (rad, joint side N m), signs "
                "and the order of the joints"
            )
        return found


@known_options
def fit_torque(
    dynamics: Dynamics,
    q: ArrayLike,
    torque: ArrayLike,
    *,
    rig: Rig,
    cutoff: float,
    band: float,
    every: int = 1,
    unknown: Iterable[str] | None = None,
    least_speed: ArrayLike = 0.0,
    extra: Mapping[str, Callable[..., ArrayLike]] | None = None,
) -> TorqueFit:
    """Fit f, and linear numbers of the drive, to logged positions and torques.

    Parameters
    ----------
    dynamics : Dynamics
    q : (N, n) array_like
        Joint positions [rad], one row per period of the rig.
    torque : (N, n) array_like
        Measured torque of the motors, joint side [N m] (``rig.drive.joint_torque``).
    rig : Rig
        Its friction is part of the equation: what is unknown of it is found, the rest is taken as given.
    cutoff : float
        Of the low-pass before differentiation [Hz].
    band : float
        Of the low-pass that regressor and measured torque pass [Hz].
    every : int
        One row out of so many is used; rows at more than twice the band hold little new.
    unknown : sequence of str, optional
        All names of f, and any of ``drive.viscous[i]``, ``drive.coulomb[i]``, ``drive.curve.offset[i]``; by default f.
    least_speed : float or (n,) array_like
        Joint speed [rad/s] below which a joint's equation is left out: there the sign of its friction is uncertain.
    extra : dict of str to callable, optional
        Further columns: (q, qd, qdd), each (N, n), to the torque (N, n) per unit of the name.

    Returns
    -------
    TorqueFit

    Raises
    ------
    ValueError
        Bad input, a number that does not enter linearly, or unknowns that are not separately identifiable (with names).
    """
    instance("dynamics", dynamics, Dynamics, "Pass the equations with f open.")
    rig = instance("rig", rig, Rig, "Pass the rig of the log.")
    rig.require_fit(dynamics.chain)
    q = array("q", q, ("N", dynamics.n), advice="Give one row per sample, one column per joint [rad].")
    torque = array("torque", torque, q.shape, advice="Give one row per sample, one column per joint [N m].")
    slowest = np.full(dynamics.n, least_speed) if np.ndim(least_speed) == 0 else least_speed
    slowest = array("least_speed", slowest, (dynamics.n,), advice="Give one speed, or one per joint [rad/s].")
    if (slowest < 0).any():
        raise ValueError(f"least_speed must not be negative; got {slowest}. 0 uses every row.")
    real("band", band, "Give Hz.", positive=True)
    if band > real("cutoff", cutoff, "Give Hz.", positive=True):
        raise ValueError(f"band must not exceed cutoff, {cutoff:g} Hz; got {band:g}. Lower it.")
    if not isinstance(every, (int, np.integer)) or isinstance(every, bool) or every < 1:
        raise ValueError(f"every must be a whole number of at least 1; got {every!r}. 1 uses every row.")
    if isinstance(unknown, str):
        raise ValueError(f"unknown must be a sequence of names; got {unknown!r}. Write (*dynamics.names, {unknown!r}).")
    unknown, extra = tuple(dynamics.names if unknown is None else unknown), dict(extra or {})
    system = regressor_and_torque(dynamics, q, torque, rig, cutoff, band, every, unknown, slowest, extra)
    return weighted(dynamics, (*unknown, *extra), [system])


def weighted(dynamics: Dynamics, names: tuple[str, ...], systems: Iterable[System]) -> TorqueFit:
    """Least squares of one or more logs' equations, each joint weighted by its residual in an unweighted fit."""
    systems = tuple(systems)
    regressor, torque, used = (
        np.concatenate([getattr(system, part) for system in systems]) for part in ("regressor", "torque", "used")
    )
    if used.sum() <= len(names):
        raise ValueError(
            f"a fit of {len(names)} numbers needs more equations; {used.sum()} are left. "
            "Log longer, move faster, or lower least_speed or every."
        )
    places = Places.of(systems)
    joint = places.joint
    rows, target = regressor[used], torque[used]
    weight = np.ones(len(target))
    for _ in range(2):
        values, covariance, condition = least_squares(names, rows * weight[:, None], target * weight)
        residual = target - rows @ values
        freedom = 1 - len(values) / len(target)  # degrees of freedom that are left, per equation
        sigma = np.array([np.sqrt(np.mean(residual[joint == j] ** 2) / freedom) for j in range(torque.shape[1])])
        weight = 1 / np.maximum(sigma, 1e-9 * np.abs(target).max())[joint]
    return TorqueFit(
        dynamics=dynamics,
        names=names,
        values=values,
        covariance=covariance,
        sigma=sigma,
        relative_error=float(np.linalg.norm(residual) / np.linalg.norm(target)),
        rows=len(target),
        condition=condition,
    )
