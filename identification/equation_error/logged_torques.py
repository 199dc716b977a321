"""`fit_torque`: f and linear numbers of the drive from logged positions and torques."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error.band_choice import SHARES, choose_band, choose_speed
from identification.equation_error.friction_trial import KINDS, FrictionTrial, friction_trials
from identification.equation_error.least_squares import NotIdentifiableError, dependent_columns
from identification.equation_error.regressor import System, regressor_along
from identification.equation_error.torque_equations import (
    Columns,
    TorqueEquations,
    cutoff_of,
    equations_of,
    every_of,
)
from identification.equation_error.torque_fit import TorqueFit, weighted
from plant import Dynamics, FrictionCurve, Record, Rig
from plant.motion.reference import Motion
from plant.parts.arguments import array, known_options, real, whole
from plant.parts.fields import Floats


@known_options
def fit_torque(
    dynamics: Dynamics,
    q: ArrayLike | Record | Sequence[Any],
    torque: ArrayLike | Sequence[Any] | None = None,
    *,
    rig: Rig | None = None,
    cutoff: float | None = None,
    band: float | Sequence[float] | None = None,
    every: int | None = None,
    unknown: Iterable[str] | None = None,
    least_speed: ArrayLike | None = None,
    extra: Columns | None = None,
    known: Mapping[str, float] | None = None,
    weights: ArrayLike | None = None,
    joints: Iterable[int | str] | None = None,
) -> TorqueFit:
    """Fit f, and linear numbers of the drive, to logged positions and torques.

    ``fit_torque(dynamics, records)`` is all that is needed; what is stated is taken as stated, the
    rest is chosen by how well it predicts segments of the logs that the fit has not seen, and
    reported.

    Parameters
    ----------
    dynamics : Dynamics
    q : Record, sequence of Record, (N, n) array_like, or sequence of (N_k, n) array_like
        Records: positions are their counts, torques their column of torque or current, or else what
        their law gave (one without memory, or in a stated state, `plant.Resumed`); samples that are
        not valid are left out. Or joint positions [rad], one row per period of the rig, of one log
        or of several.
    torque : (N, n) array_like or sequence of (N_k, n) array_like, optional
        Beside positions: measured torque of the motors, joint side [N m]
        (``rig.drive.joint_torque``). The column of a joint without a sensor is NaN throughout.
    rig : Rig, optional
        Beside positions. Its friction is part of the equation: what is unknown of it is found, the
        rest is taken as given.
    cutoff : float, optional
        Of the low-pass before differentiation [Hz]; by default 2.5 times the band.
    band : float or sequence of float, optional
        Of the low-pass that regressor and measured torque pass [Hz]; chosen from several, by
        default half octaves from 0.5 Hz to a sixth of the sample rate.
    every : int, optional
        One row out of so many is used; rows at more than twice the band hold little new. By default
        all rows with a stated band, and two per period of a band that is chosen.
    unknown : sequence of str, optional
        All names of f that are not known, and any of ``drive.viscous[i]``, ``drive.coulomb[i]``,
        ``drive.curve.offset[i]``; by default f.
    least_speed : float or (n,) array_like, optional
        Joint speed [rad/s] below which a joint's equation is left out: there the sign of its
        friction is uncertain. By default 0 with a stated band, and chosen together with a band that
        is chosen.
    extra : dict of str to callable, optional
        Further columns: (q, qd, qdd), each (N, n), to the torque (N, n) per unit of the name.
    known : dict of str to float, optional
        Values of some of f (names may be short), of friction or of extra columns, which are not
        searched.
    weights : (n,) or (R, n) array_like, optional
        Of each joint, or of each log and joint, up to a common factor: one over the standard
        deviation of its torque. By default from the scatter of each joint.
    joints : sequence of int or str, optional
        The joints whose torques are used, by place or label. By default all but those of which the
        torque is missing or one constant throughout, log by log.

    Returns
    -------
    TorqueFit

    Raises
    ------
    ValueError
        Bad input, a number that does not enter linearly, or unknowns that are not separately
        identifiable (with names).

    See Also
    --------
    identification.identify

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import fit_torque
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference())
    >>> print(fit_torque(puma560.dynamics(), record).relative_error < 0.2)
    True
    """
    task = equations_of(dynamics, q, torque, rig, unknown, extra, known, joints)
    stated = _weights(weights, task)
    slowest = _slowest(least_speed, task.dynamics.n)
    if every is not None:
        whole("every", every, "1 uses every row.")
    if cutoff is not None:
        real("cutoff", cutoff, "Give Hz.", positive=True)
    report: dict[str, Any] = {
        "known": dict(task.known),
        "left_out": task.left_out(joints is not None),
    }
    if band is None or np.ndim(band) > 0:
        tried = (
            task.bands(cutoff)
            if band is None
            else sorted(_band(each, cutoff) for each in np.ravel(band).tolist())
        )
        width, slowest, trials = _chosen(task, tried, cutoff, slowest, stated)
        report |= trials
    else:
        width = _band(band, cutoff)
        every = 1 if every is None else every
        slowest = np.zeros(task.dynamics.n) if slowest is None else slowest
    names, systems = task.systems(width, cutoff, every, slowest)
    report |= {"band": width, "cutoff": cutoff_of(width, cutoff), "least_speed": slowest}
    report["every"] = tuple(every_of(width, log.rig.period, every) for log in task.logs)
    report["freed"] = dict(_freed(task, (width, cutoff, every, slowest), stated))
    try:
        fit = weighted(task.dynamics, names, systems, stated, task.seconds, **report)
        return dataclasses.replace(
            fit, friction=_friction(task, fit, (width, cutoff, None, slowest))
        )
    except NotIdentifiableError as error:
        raise NotIdentifiableError(
            _advice(names, systems, report["left_out"]), error.name
        ) from error


def _chosen(
    task: TorqueEquations,
    bands: list[float],
    cutoff: float | None,
    slowest: Floats | None,
    weights: Floats | None,
) -> tuple[float, Floats, dict[str, Any]]:
    """Band, least speeds, and what these choices rest on."""
    usual = task.usual_speed()

    def above(share: float, band: float) -> list[System]:
        least = task.least(usual, share, band) if slowest is None else slowest
        return task.systems(band, cutoff, None, least, thin=True)[1]

    width, bands_tried = choose_band(
        bands, lambda band: above(SHARES[0], band), task.seconds, weights
    )
    if slowest is not None:
        return width, slowest, {"bands": bands_tried}
    slow = task.systems(width, cutoff, None, np.zeros(task.dynamics.n), thin=True)[1]

    def faster(share: float) -> list[System]:
        least = task.least(usual, share, width)
        return [dataclasses.replace(each, used=each.used & (each.speed > least)) for each in slow]

    share, speeds_tried = choose_speed(SHARES, faster, task.seconds, 1 / width, weights)
    return (
        width,
        task.least(usual, share, width),
        {"bands": bands_tried, "least_speeds": speeds_tried},
    )


def _freed(
    task: TorqueEquations, settings: tuple[Any, ...], weights: Floats | None
) -> Iterator[tuple[str, tuple[float, float]]]:
    """Each known number that the torques tell from the unknowns: what they ask for, and its
    standard deviation.
    """
    for name in task.known:
        known = {other: value for other, value in task.known.items() if other != name}
        names, systems = dataclasses.replace(task, known=known).systems(*settings)
        try:
            fit = weighted(task.dynamics, names, systems, weights, task.seconds)
        except ValueError:  # not separately identifiable, or too few equations
            continue
        yield name, (fit[name], float(fit.std[names.index(name)]))


# Stribeck speeds, and those at which viscous friction saturates, that are tried, in the usual speed
# of each joint; and those tried then about a Stribeck speed that predicts better, in that: of all
# joints, then of one after another.
_SHARES = (0.02, 0.1, 0.5)
_FINER = (0.5, 0.63, 0.8, 1.25, 1.6, 2.0)


def _friction(
    task: TorqueEquations, fit: TorqueFit, settings: tuple[Any, ...]
) -> tuple[FrictionTrial, ...]:
    """Kinds of friction beyond Coulomb and viscous, on the joints whose Coulomb friction is
    unknown.
    """
    dynamics, rig, usual = task.dynamics, task.logs[0].rig, np.maximum(task.usual_speed(), 1e-9)
    coupling = rig.drive.coupling
    joints = [
        j for j in range(dynamics.n) if f"drive.coulomb[{j}]" in fit.names and fit.sigma[j] > 0
    ]

    def shape(motion: Motion, kind: str, share: Floats) -> Floats:
        qd = coupling.shaft(motion.qd)
        if kind == KINDS[0]:
            return 1 + 0 * qd
        if kind == KINDS[1]:
            regressor, _ = regressor_along(dynamics, rig, dynamics.names, motion)
            return np.abs(coupling.shaft_torque((regressor * fit.f).sum(axis=2))) * np.sign(qd)
        if kind == KINDS[2]:
            curve = FrictionCurve(offset=0 * usual, breakaway=1 + 0 * usual, speed=share * usual)
            return curve.level(qd) * np.sign(qd)
        return np.tanh(qd / (share * usual))

    def column(kind: str, share: tuple[float, ...] | None, joint: int) -> Callable[..., Floats]:
        own = np.arange(dynamics.n) == joint
        return lambda *motion: coupling.joint_torque(
            shape(Motion(*motion), kind, np.array(share)) * own
        )

    def trials(*candidates: tuple[str, tuple[float, ...] | None]) -> tuple[FrictionTrial, ...]:
        columns = {
            f"{kind}, {share}, {j}": column(kind, share, j)
            for kind, share in candidates
            for j in joints
        }
        systems = dataclasses.replace(task, extra={**task.extra, **columns}).systems(
            *settings, thin=True
        )[1]
        weights = np.tile(1 / fit.sigma, (len(task.logs), 1))
        return friction_trials(
            systems, candidates, joints, task.seconds, 1 / settings[0], weights, usual
        )

    if not joints:
        return ()
    every = [(kind, (share,) * dynamics.n) for share in _SHARES for kind in KINDS[2:]]
    found = trials(*((kind, None) for kind in KINDS[:2]), *every)
    for some in (joints, *([j] for j in joints if len(joints) > 1)):
        if found and found[0].kind == KINDS[2] and found[0].clear and (share := found[0].share):
            moved = (
                np.where(np.isin(np.arange(dynamics.n), some), np.array(_FINER)[:, None], 1.0)
                * share
            )
            found = (*found, *trials(*((KINDS[2], tuple(row)) for row in moved.tolist())))
            found = tuple(sorted(found, key=lambda trial: -trial.better))
    return found


def _weights(weights: ArrayLike | None, task: TorqueEquations) -> Floats | None:
    if weights is None:
        return None
    shape = (len(task.logs), task.dynamics.n)
    if np.ndim(weights) == 1:
        weights = np.broadcast_to(
            array("weights", weights, shape[1:], advice="Give one per joint."), shape
        )
    found = array("weights", weights, shape, advice="Give one per joint, or a row of them per log.")
    if not (found > 0).all():
        raise ValueError(
            f"weights must be positive; got {found.min():g}. Leave a joint out by joints=."
        )
    return found


def _slowest(least_speed: ArrayLike | None, n: int) -> Floats | None:
    if least_speed is None:
        return None
    slowest = np.full(n, least_speed) if np.ndim(least_speed) == 0 else least_speed
    slowest = array(
        "least_speed", slowest, (n,), advice="Give one speed, or one per joint [rad/s]."
    )
    if (slowest < 0).any():
        raise ValueError(f"least_speed must not be negative; got {slowest}. 0 uses every row.")
    return slowest


def _band(band: Any, cutoff: float | None) -> float:
    band = real("band", band, "Give Hz.", positive=True)
    if cutoff is not None and band > cutoff:
        raise ValueError(f"band must not exceed cutoff, {cutoff:g} Hz; got {band:g}. Lower it.")
    return band


def _advice(names: Sequence[str], systems: Sequence[System], left_out: Mapping[str, str]) -> str:
    """Which unknowns the equations do not tell apart, and what to do."""
    found = dependent_columns(
        names, np.concatenate([system.regressor[system.used] for system in systems])
    )
    idle = [name for name, of in found.items() if not of]
    said = (
        [f"{', '.join(idle)} {'do' if len(idle) > 1 else 'does'} not in this motion"]
        if idle
        else []
    )
    said += [f"{name} is a combination of {', '.join(of)}" for name, of in found.items() if of]
    out = (
        f" (left out: {'; '.join(f'{joint}, {why}' for joint, why in left_out.items())})"
        if left_out
        else ""
    )
    fixed = ", ".join(f"{name!r}: ..." for name in found)
    return (
        f"unknowns must act on the log and be separately identifiable; {'; '.join(said)}{out}. Log"
        f" a motion that excites more, or state them: known={{{fixed}}}."
    )
