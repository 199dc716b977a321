"""`fit_torque`: f and linear numbers of the drive from logged positions and torques.

Of the equations of the logs (`torque_equations`) it chooses band, least speeds and rows, and of
friction (`logged_friction`) what has evidence.
"""

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error.arm_check import FittedArm
from identification.equation_error.band_choice import (
    SHARES,
    FitTrial,
    choose_band,
    choose_speed,
    tried,
)
from identification.equation_error.friction_trial import gain
from identification.equation_error.least_squares import NotIdentifiableError, dependent_columns
from identification.equation_error.logged_friction import (
    by_direction,
    friction_of,
    rising,
    stated_offsets,
)
from identification.equation_error.prior import Prior
from identification.equation_error.regressor import System
from identification.equation_error.restated import of_log
from identification.equation_error.torque_equations import SETTINGS as EQUATIONS
from identification.equation_error.torque_equations import (
    Columns,
    Selection,
    TorqueEquations,
    cutoff_of,
    equations_of,
)
from identification.equation_error.torque_error import error_of_logs
from identification.equation_error.torque_fit import TorqueFit
from plant import Dynamics, Record, Rig
from plant.parts import Floats, array, known_options, real, whole


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
    prior: Any = None,
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
        ``drive.curve.offset[i]``; by default f, and friction that the rig leaves open. Beside an
        unknown Coulomb level a friction offset, and of a rig without a curve a viscous friction by
        direction (``drive.curve.viscous_offset[i]``), are found where there is evidence of them,
        unless the rig states offsets. Viscous and Coulomb friction are not negative.
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
    prior : float, tuple of bodies or f and a float, or False, optional
        Relative spread of the chain's own bodies, or of others, or of f, as `identify` takes it:
        for what the logs do not excite. By default the chain's own bodies to 0.3, and only where
        they predict blocks kept aside better; False for none.

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
    given = None if prior is False else prior
    task = equations_of(dynamics, q, torque, rig, unknown, extra, known, joints, given)
    # All arguments are checked before the first fit, which takes seconds.
    stated = _weights(weights, task)
    slowest = _slowest(least_speed, task.dynamics.n)
    if every is not None:
        whole("every", every, "1 uses every row.")
    if cutoff is not None:
        real("cutoff", cutoff, "Give Hz.", positive=True)
    left_out = task.left_out(joints is not None)
    report: dict[str, Any] = {"known": dict(task.known), "left_out": left_out}

    # 1. Band, least speeds and rows: chosen, or as stated. A chosen band was judged on logs that
    # have no more samples than it needs, and its fit needs no more.
    thin = band is None or np.ndim(band) > 0
    if band is None or np.ndim(band) > 0:
        if band is None:
            bands = task.bands(cutoff)
        else:
            bands = sorted(_band(width, cutoff) for width in np.ravel(band).tolist())
        # Friction of the load must not pass for noise of a wide band: the load comes first, by a
        # band that holds the motion and moving joints.
        middle = min(bands, key=lambda width: abs(width - EQUATIONS.motion))
        cautious = task.least(task.usual_speed(), SHARES[0], middle)
        loaded = task.loaded(Selection(middle, cutoff, None, cautious), stated)
        width, slowest, trials = _chosen(loaded, bands, cutoff, slowest, stated)
        report |= trials
    else:
        width = _band(band, cutoff)
        every = 1 if every is None else every
        slowest = np.zeros(task.dynamics.n) if slowest is None else slowest

    # 2. Offsets that the torques ask for, the fit, and what is doubtful of it: known numbers, and
    # friction of other kinds.
    selection = Selection(width, cutoff, every, slowest)
    try:
        by_user = stated_offsets(task)
        task = by_direction(task.loaded(selection, stated), selection, stated)
        task, report["rising"], wider = rising(task, selection, stated)
        if report["rising"] is not None and "least_speeds" in report:
            # Slow rows were left out for a friction that they do not have.
            slowest, report["least_speeds"] = _speeds(task, width, cutoff, stated)
            selection = selection._replace(slowest=slowest)
        # All settings of the fit are reported, chosen or stated: with them it can be repeated.
        report |= {"band": width, "cutoff": cutoff_of(width, cutoff), "least_speed": slowest}
        report["every"] = tuple(
            round(filtering.every * log.rig.period / complete.rig.period)
            for complete, (log, filtering) in zip(
                task.logs, task.filtered(selection, thin), strict=True
            )
        )
        report["freed"] = dict(_freed(task, selection, stated, thin))
        fit = task.fit(selection, stated, thin=thin, extra=task.extra, **report)
        if prior is None:
            better, errors = _beside_bodies(task, fit, selection._replace(every=None))
            report["bodies"] = better, errors
            if better > EQUATIONS.better and errors > EQUATIONS.errors:
                task = replace(task, prior=Prior.of_model(dynamics, task.logs[0].rig))
                fit = task.fit(selection, stated, thin=thin, extra=task.extra, **report)
        fit = replace(fit, covariance=fit.covariance * np.outer(wider, wider), **report)
        friction = friction_of(task, fit, selection._replace(every=None), by_user)
        return replace(_judged(task, fit, width), friction=friction, prior=task.prior)
    except NotIdentifiableError as error:
        # Of all names at once: the error knows the first that depends on others.
        advice = _advice(*task.systems(selection), left_out)
        raise NotIdentifiableError(advice, error.name) from error


def _beside_bodies(
    task: TorqueEquations, fit: TorqueFit, selection: Selection
) -> tuple[float, float]:
    """Gain of a prior of the chain's own bodies on blocks kept aside: relative, standard errors.

    NaN without bodies.
    """
    prior = Prior.of_model(task.dynamics, task.logs[0].rig)
    if prior is None:
        return np.nan, np.nan
    # Only of logs that tell less of some parameter than the bodies do.
    known = np.diag(fit.covariance_of(task.dynamics.names))
    if not (known > np.diag(prior.covariance)).any():
        return np.nan, np.nan
    names, systems = task.systems(selection, thin=True)
    weights = np.tile(1 / fit.sigma, (len(task.logs), 1))
    arguments = systems, task.seconds, 1 / selection.band, weights
    fits = tried(*arguments), tried(*arguments, prior.rows(names, task.known))
    losses = [one.losses(one.without) for one in fits if one is not None]
    # Too few equations to leave blocks out judge nothing.
    if len(losses) < 2:
        return np.nan, np.nan
    # Block by block as a ratio: in one where a joint sticks both errors are large, and would decide
    # a mean of squares.
    ratios = np.log(losses[0] / losses[1])
    better, errors = gain(np.ones(1), ratios)
    return float(-np.expm1(-better)), errors


def _judged(task: TorqueEquations, fit: TorqueFit, width: float) -> TorqueFit:
    """The fit with its machine, its error on the logs, causes and doubts."""
    log = task.logs[0]
    arm = FittedArm(
        dynamics=task.dynamics,
        rig=log.rig,
        f=fit.f,
        covariance=fit.covariance_of(task.dynamics.names),
        q=log.q,
        fitted=fit.names,
        # Torques are biased in bands with fast motion, which no deviation covers.
        rough=True,
    )
    machine = log.rig.filled({**fit.known, **dict(zip(fit.names, fit.values, strict=True))})
    error = None
    # A log may be too short for the band that all errors are compared in.
    with contextlib.suppress(ValueError):
        error = error_of_logs(fit.arm, machine, task.logs, further=fit.further)
    judged = replace(fit, path=log.path, rig=machine, error=error, doubts=tuple(arm.doubts()))
    return replace(judged, causes=of_log(task.dynamics, log, width, bool(judged.warnings)))


def _chosen(
    task: TorqueEquations,
    bands: list[float],
    cutoff: float | None,
    slowest: Floats | None,
    weights: Floats | None,
) -> tuple[float, Floats, dict[str, Any]]:
    """Band, least speeds, and the trials on which these choices rest."""
    usual = task.usual_speed()

    def above(share: float, band: float) -> list[System]:
        least = task.least(usual, share, band) if slowest is None else slowest
        return task.systems(Selection(band, cutoff, None, least), thin=True)[1]

    # The band at the most cautious speeds, then the speeds in that band: the other way round, noise
    # of a band that is too wide would pass for uncertain signs of friction.
    width, bands_tried = choose_band(
        bands, lambda band: above(SHARES[0], band), task.seconds, weights
    )
    if slowest is not None:
        return width, slowest, {"bands": bands_tried}
    slowest, speeds_tried = _speeds(task, width, cutoff, weights)
    return width, slowest, {"bands": bands_tried, "least_speeds": speeds_tried}


def _speeds(
    task: TorqueEquations, width: float, cutoff: float | None, weights: Floats | None
) -> tuple[Floats, tuple[FitTrial, ...]]:
    """Least speeds (n,) [rad/s] in a band, and the trials on which they rest."""
    usual = task.usual_speed()
    # Least speeds select among these equations: they are filtered once.
    _, slow = task.systems(Selection(width, cutoff, None, np.zeros(task.dynamics.n)), thin=True)

    def faster(share: float) -> list[System]:
        least = task.least(usual, share, width)
        return [replace(system, used=system.used & (system.speed > least)) for system in slow]

    share, trials = choose_speed(SHARES, faster, task.seconds, 1 / width, weights)
    return task.least(usual, share, width), trials


def _freed(
    task: TorqueEquations, selection: Selection, weights: Floats | None, thin: bool
) -> Iterator[tuple[str, tuple[float, float]]]:
    """Each known number that the torques can identify: its estimate, and standard deviation."""
    for name in task.known:
        remaining = {key: value for key, value in task.known.items() if key != name}
        try:
            fit = replace(task, known=remaining).fit(selection, weights, thin=thin)
        except ValueError:
            # Not separately identifiable, or too few equations: the torques say nothing of it.
            continue
        yield name, (fit[name], float(fit.std[fit.names.index(name)]))


def _weights(weights: ArrayLike | None, task: TorqueEquations) -> Floats | None:
    if weights is None:
        return None
    shape = (len(task.logs), task.dynamics.n)
    # One weight per joint holds in all logs.
    if np.ndim(weights) == 1:
        weights = np.broadcast_to(
            array("weights", weights, shape[1:], advice="Give one per joint."), shape
        )
    weights = array(
        "weights", weights, shape, advice="Give one per joint, or a row of them per log."
    )
    # A weight of zero would leave a joint out without a reason in the report.
    if not (weights > 0).all():
        raise ValueError(
            f"weights must be positive; got {weights.min():g}. Leave a joint out by joints=."
        )
    return weights


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
    """Message on the unknowns that the equations cannot separate, and what to do."""
    rows = np.concatenate([system.regressor[system.used] for system in systems])
    # A column of zeros acts on no equation; any other dependent column has partners.
    dependent = dependent_columns(names, rows)
    idle = [name for name, combination in dependent.items() if not combination]
    faults = []
    if idle:
        faults.append(f"{', '.join(idle)} {'do' if len(idle) > 1 else 'does'} not in this motion")
    for name, combination in dependent.items():
        if combination:
            faults.append(f"{name} is a combination of {', '.join(combination)}")
    # A joint without equations is the usual reason for a parameter that does not act.
    out = "; ".join(f"{joint}, {reason}" for joint, reason in left_out.items())
    out = f" (left out: {out})" if out else ""
    # The advice is code to copy: the names of the dependent unknowns, values to fill in.
    fixed = ", ".join(f"{name!r}: ..." for name in dependent)
    return (
        f"unknowns must act on the log and be separately identifiable; {'; '.join(faults)}{out}."
        f" Log a motion that excites more, or state them: known={{{fixed}}}."
    )
