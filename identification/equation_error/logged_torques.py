"""`fit_torque`: f and linear numbers of the drive from logged positions and torques."""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error.arm_check import FittedArm
from identification.equation_error.band_choice import SHARES, choose_band, choose_speed, tried
from identification.equation_error.filters import BAND_MOST, CUTOFF, derivatives
from identification.equation_error.friction_trial import (
    ASYMMETRIC,
    LOAD_DEPENDENT,
    SATURATING,
    STRIBECK,
    FrictionTrial,
    friction_trials,
    gain,
)
from identification.equation_error.friction_trial import SETTINGS as FRICTION
from identification.equation_error.least_squares import (
    NotIdentifiableError,
    dependent_columns,
)
from identification.equation_error.offsets import evident
from identification.equation_error.prior import Prior
from identification.equation_error.pulse_fit import speed_noise, without_known
from identification.equation_error.regressor import (
    LINEAR,
    Filtering,
    System,
    compared,
    regressor_along,
    regressor_and_torque,
)
from identification.equation_error.restated import of_log
from identification.equation_error.torque_error import error_of_logs
from identification.equation_error.torque_fit import TorqueFit, weighted
from identification.equation_error.torque_logs import TorqueLog, dead_columns, thinned, torque_logs
from plant import Dynamics, FrictionCurve, Record, Rig
from plant.motion.reference import Motion
from plant.parts.arguments import array, choice, instance, known_options, real, whole
from plant.parts.fields import Bools, Floats
from plant.parts.frozen import frozen
from plant.parts.settings import frozen_settings

OFFSET = "drive.curve.offset"
VISCOUS_OFFSET = "drive.curve.viscous_offset"
LOAD = "drive.load_friction"

# Further columns by name: (q, qd, qdd) -> torque (N, n) per unit.
Columns = Mapping[str, Callable[..., ArrayLike]]


@frozen_settings
class TorqueEquationSettings:
    """Bands that are tested; chosen by hand.

    Parameters
    ----------
    lowest : float
        Narrowest pass band that is tested [Hz]; then by half octaves.
    periods : float
        Periods of a band that the longest log must hold.
    motion : float
        Highest frequency of the motion of a joint [Hz]: faster signals are vibration and rounding.
    loads : int
        Fits by which the load of the gears is found, where friction depends on it: each is wrong
        by the share times the error of the one before.
    """

    lowest: float = 0.5
    periods: float = 4.0
    motion: float = 10.0
    loads: int = 3


SETTINGS = TorqueEquationSettings()


def cutoff_of(band: float, cutoff: float | None) -> float:
    """Cutoff of the low-pass before differentiation [Hz], as stated or by the band."""
    return CUTOFF * band if cutoff is None else cutoff


def every_of(band: float, period: float, every: int | None) -> int:
    """One row out of so many, as stated or two per period of the band."""
    return max(1, int(1 / (2 * band * period))) if every is None else every


class Selection(NamedTuple):
    """Which equations of the logs a fit uses, as stated.

    `band`: where both sides are compared [Hz]. `cutoff` [Hz], `every`: None by the band. `slowest`
    (n,): speeds below which a joint's equations are left out [rad/s].
    """

    band: float
    cutoff: float | None
    every: int | None
    slowest: Floats


@frozen
class TorqueEquations:
    """The checked arguments of `fit_torque`.

    `names`: of the columns, without the further ones: unknown or known. `extra`: further columns.
    `known`: values of some columns. `used` (R, n): of which logs and joints the torque is used.
    `prior`: of f, or None. `loading` (p,) or None: f by which the gears are loaded.
    """

    dynamics: Dynamics
    logs: tuple[TorqueLog, ...]
    names: tuple[str, ...]
    extra: Columns
    known: Mapping[str, float]
    used: Bools
    prior: Prior | None = None
    loading: Floats | None = None

    def loaded(self, selection: Selection, weights: Floats | None) -> Self:
        """The same with the load of the gears by the torques themselves, where friction needs it.

        First without friction of the load, then with that of the load so far.
        """
        drive = self.logs[0].rig.drive
        if drive.load_friction is None:
            return self
        shares = {name: 0.0 for name in self.names if name.startswith(LOAD)}
        loading = None
        task = replace(self, known={**self.known, **shares})
        for _ in range(SETTINGS.loads):
            fit = task.fit(selection, weights, thin=True)
            loading = fit.f
            task = replace(self, loading=loading)
        return task

    def fit(
        self, selection: Selection, weights: Floats | None, *, thin: bool = False, **report: Any
    ) -> TorqueFit:
        """Least squares on the selected equations, with friction that is not negative."""
        names, systems = self.systems(selection, thin=thin)
        prior = None if self.prior is None else self.prior.rows(names, self.known)
        return weighted(
            self.dynamics, names, systems, weights, self.seconds, prior, braking=True, **report
        )

    def with_directions(self, names: Sequence[str]) -> Self:
        """The same with these unknown numbers of friction that differs by direction."""
        if not names:
            return self
        zero = np.zeros(self.dynamics.n)
        # A curve has a slope by direction only where one is unknown: it is a number of the rig.
        slopes = any(name.startswith(VISCOUS_OFFSET) for name in names)
        logs = []
        for log in self.logs:
            drive = log.rig.drive
            curve = drive.curve or FrictionCurve(offset=zero)
            if slopes and curve.viscous_offset is None:
                curve = replace(curve, viscous_offset=zero)
            logs.append(replace(log, rig=replace(log.rig, drive=replace(drive, curve=curve))))
        # Known numbers stay behind the unknown ones.
        unknown = [name for name in self.names if name not in self.known]
        known = [name for name in self.names if name in self.known]
        return replace(self, logs=tuple(logs), names=(*unknown, *names, *known))

    def systems(
        self, selection: Selection, *, thin: bool = False
    ) -> tuple[tuple[str, ...], list[System]]:
        """Names of the unknowns, and one system per log in these alone."""
        systems = []
        names = (*self.names, *self.extra)
        for (log, filtering), used in zip(self.filtered(selection, thin), self.used, strict=True):
            system = regressor_and_torque(
                self.dynamics,
                log.q,
                log.torque,
                log.rig,
                filtering,
                self.names,
                self.extra,
                log.valid,
                self.loading,
            )
            systems.append(replace(system, used=system.used & used))
        return without_known(names, self.known, systems)

    def filtered(self, selection: Selection, thin: bool) -> Iterator[tuple[TorqueLog, Filtering]]:
        """Each log, with no more samples than needed if `thin`, and how its rows are selected."""
        band, cutoff, every, slowest = selection
        for complete in self.logs:
            log = thinned(complete, cutoff_of(band, cutoff)) if thin else complete
            step = every_of(band, log.rig.period, every)
            # A stated step counts rows of the whole log.
            if every is not None and log is not complete:
                step = max(1, round(every * complete.rig.period / log.rig.period))
            yield log, Filtering(cutoff_of(band, cutoff), band, step, slowest)

    def shapes(
        self, selection: Selection, shapes: Sequence[Callable[[Motion], Floats]]
    ) -> Iterator[Floats]:
        """Torques of shafts along each thinned log (N', n, m), filtered as its equations are."""
        for log, filtering in self.filtered(selection, True):
            motion = derivatives(log.q, log.rig.period, filtering.cutoff)
            signals = [0 * motion.q, *(shape(motion) for shape in shapes)]
            yield compared(signals, motion.qd, log.rig.period, filtering).regressor

    @property
    def seconds(self) -> Floats:
        """Length (R,) of each log."""
        return np.array([len(log.q) * log.rig.period for log in self.logs])

    def bands(self, cutoff: float | None) -> list[float]:
        """Pass bands to choose from [Hz]."""
        highest = cutoff
        if highest is None:
            highest = BAND_MOST / max(log.rig.period for log in self.logs)
        # A log must hold several periods of a band; above the highest band the low-pass before
        # differentiation would reach half of the sample rate.
        lowest = SETTINGS.periods / self.seconds.max()
        # Three digits: a band is printed, and can be stated again.
        half_octaves = SETTINGS.lowest * 2 ** np.arange(0, 30, 0.5)
        bands = [float(f"{band:.3g}") for band in half_octaves]
        return [band for band in bands if lowest < band < highest]

    def usual_speed(self) -> Floats:
        """Root mean square of each joint's speed (n,) [rad/s] in all logs, without vibration."""
        speeds = []
        for log in self.logs:
            period = log.rig.period
            cutoff = min(SETTINGS.motion, BAND_MOST / period)
            speeds.append(derivatives(log.q, period, cutoff).qd)
        return np.sqrt(np.mean(np.concatenate(speeds) ** 2, axis=0))

    def least(self, usual: Floats, share: float, band: float) -> Floats:
        """Least speeds (n,) [rad/s]: a share of the usual ones, and those that rounding makes."""
        # Positions that are no counts have no rounding that is known.
        # Below the speed that rounding alone makes, the sign of the friction is random.
        noise = [speed_noise(log.rig, band) for log in self.logs if log.counted]
        return np.max([share * usual, *noise], axis=0)

    def left_out(self, stated: bool) -> dict[str, str]:
        """Joint -> reason for which its equations are not used; `stated`: joints were stated."""
        messages = {}
        for j, label in enumerate(self.dynamics.chain.joint_labels):
            if stated and not self.used[:, j].any():
                messages[label] = "as stated"
                continue
            reasons = [
                dead_columns(log)[j]
                for log, used in zip(self.logs, self.used, strict=True)
                if not used[j]
            ]
            if reasons:
                messages[label] = "; ".join(reasons)
        return messages


def equations_of(
    dynamics: Dynamics,
    q: Any,
    torque: Any,
    rig: Rig | None,
    unknown: Iterable[str] | None,
    extra: Columns | None,
    known_values: Mapping[str, float] | None,
    joints: Iterable[int | str] | None,
    prior: Any = None,
) -> TorqueEquations:
    """The arguments of `fit_torque`, checked."""
    # 1. Names: known ones may be short, and f that is neither unknown nor known is forgotten.
    instance("dynamics", dynamics, Dynamics, "Pass the equations with f open.")
    if isinstance(unknown, str):
        raise ValueError(
            f"unknown must be a sequence of names; got {unknown!r}. Write (*dynamics.names,"
            f" {unknown!r})."
        )
    extra = dict(extra or {})
    # A further column may have the name of a short one: it goes before.
    long = dict(zip(dynamics.short_names, dynamics.names, strict=True))
    values = {
        name if name in extra else long.get(name, name): value
        for name, value in (known_values or {}).items()
    }
    logs = torque_logs(dynamics, q, torque, rig)
    if unknown is None:
        # Friction that a rig leaves open is unknown, too.
        unknown = [
            name for name in (*dynamics.names, *_open(logs[0].rig, dynamics)) if name not in values
        ]
    searched = tuple(unknown)
    for name, value in values.items():
        if name not in extra and not name.startswith(LINEAR):
            choice("a name in known", name, dynamics.names)
        values[name] = real(f"the known {name}", value, "Give its value in SI units.")
    missing = [name for name in dynamics.names if name not in searched and name not in values]
    # A parameter that is neither fitted nor stated would silently be zero.
    if missing:
        raise ValueError(
            f"unknown must name all of f that is not known; {missing[0]} is missing. Write"
            " (*dynamics.names, ...), or give its value in known."
        )
    # Known numbers keep their columns here: `systems` moves them to the measured torque.
    names = (*searched, *(name for name in values if name not in searched and name not in extra))
    if not set(names) | set(extra) > set(values):
        raise ValueError("a fit needs something unknown; all names are in known. Leave one out.")

    # 2. The joints whose torque is used in each log.
    used = np.ones((len(logs), dynamics.n), bool)
    # Log by log: a sensor may be missing in one alone.
    if joints is None:
        for k, log in enumerate(logs):
            used[k, list(dead_columns(log))] = False
    else:
        # A single label is a common slip: taken for a sequence, it would be read letter by letter.
        labels = (joints,) if isinstance(joints, str) else joints
        places = [_joint(dynamics, joint) for joint in labels]
        used[:, [j for j in range(dynamics.n) if j not in places]] = False
        for log in logs:
            for j in places:
                if np.isnan(log.torque[:, j]).any():
                    label = dynamics.chain.joint_labels[j]
                    raise ValueError(
                        f"the torque of {label} must be finite; {dead_columns(log)[j]}. Leave it"
                        " out."
                    )
    if not used.any():
        reasons = "; ".join(
            f"{dynamics.chain.joint_labels[j]}: {reason}"
            for j, reason in dead_columns(logs[0]).items()
        )
        raise ValueError(
            f"some joint must have a torque; none has ({reasons}). Check which columns were read."
        )
    return TorqueEquations(
        dynamics=dynamics,
        logs=tuple(logs),
        names=names,
        extra=extra,
        known=values,
        used=used,
        prior=None if prior is None else Prior.of(dynamics, logs[0].rig, prior),
    )


def _open(rig: Rig, dynamics: Dynamics) -> list[str]:
    """Names of the friction that a rig leaves open."""
    return [f"drive.{kind}[{j}]" for kind in rig.drive.left_open for j in range(dynamics.n)]


def _joint(dynamics: Dynamics, joint: Any) -> int:
    """Place of a joint that is given by its place, from either end, or by its label."""
    labels = dynamics.chain.joint_labels
    # True is an int in Python, and no joint.
    number = isinstance(joint, (int, np.integer)) and not isinstance(joint, bool)
    if number and -dynamics.n <= joint < dynamics.n:
        return int(joint) % dynamics.n
    return labels.index(choice("a joint", joint, labels))


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
    prior : float, or tuple of bodies or f and a float, optional
        Relative spread of the chain's own bodies, or of others, or of f, as `identify` takes it:
        for what the logs do not excite.

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
    task = equations_of(dynamics, q, torque, rig, unknown, extra, known, joints, prior)
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
        middle = min(bands, key=lambda width: abs(width - SETTINGS.motion))
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
        task = _by_direction(task.loaded(selection, stated), selection, stated)
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
        friction = _friction(task, fit, selection._replace(every=None), by_user)
        return replace(_judged(task, fit, width), friction=friction)
    except NotIdentifiableError as error:
        # Of all names at once: the error knows the first that depends on others.
        advice = _advice(*task.systems(selection), left_out)
        raise NotIdentifiableError(advice, error.name) from error


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
        extra_values = {name: (column, fit[name]) for name, column in task.extra.items()}
        error = error_of_logs(fit.arm, machine, task.logs, extra=extra_values)
    return replace(
        fit,
        path=log.path,
        rig=machine,
        error=error,
        causes=of_log(task.dynamics, log, width),
        doubts=tuple(arm.doubts()),
    )


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
    # Least speeds select among these equations: they are filtered once.
    _, slow = task.systems(Selection(width, cutoff, None, np.zeros(task.dynamics.n)), thin=True)

    def faster(share: float) -> list[System]:
        least = task.least(usual, share, width)
        return [replace(system, used=system.used & (system.speed > least)) for system in slow]

    share, speeds_tried = choose_speed(SHARES, faster, task.seconds, 1 / width, weights)
    trials = {"bands": bands_tried, "least_speeds": speeds_tried}
    return width, task.least(usual, share, width), trials


def stated_offsets(task: TorqueEquations) -> bool:
    """Whether the user has decided on offsets: states some, or names them unknown or known."""
    curve = task.logs[0].rig.drive.curve
    named = any(name.startswith(OFFSET) for name in task.names)
    return named or (curve is not None and bool(curve.offset.any()))


def _by_direction(
    task: TorqueEquations, selection: Selection, weights: Floats | None
) -> TorqueEquations:
    """The same with friction by direction, levels and slopes, where joints have evidence of it.

    Slopes must predict blocks kept aside clearly better, too: viscous friction that saturates looks
    like one by direction where a joint moves faster one way.
    """
    if stated_offsets(task):
        return task
    drive = task.logs[0].rig.drive
    unknown = set(task.names) - set(task.known)
    dry = [j for j in range(drive.n) if f"drive.coulomb[{j}]" in unknown]
    offsets = [f"{OFFSET}[{j}]" for j in dry]
    slopes = [f"{VISCOUS_OFFSET}[{j}]" for j in dry if f"drive.viscous[{j}]" in unknown]
    levels = _evident(task, offsets, selection, weights)
    if drive.curve is not None:
        return levels
    both = _evident(task, [*offsets, *slopes], selection, weights)
    if not any(name.startswith(VISCOUS_OFFSET) for name in both.names):
        return levels
    sigma = levels.fit(selection, weights, thin=True).sigma
    gap = 1 / selection.band
    # One set of weights, so that both are judged alike.
    common = np.tile(1 / sigma, (len(task.logs), 1))
    fits = [
        tried(one.systems(selection, thin=True)[1], task.seconds, gap, common)
        for one in (levels, both)
    ]
    if None in fits:
        return levels
    before, after = (fit.losses(fit.without) for fit in fits if fit is not None)
    better, errors = gain(before, before - after)
    return both if errors > FRICTION.clear and better > FRICTION.enough else levels


def _evident(
    task: TorqueEquations, names: Sequence[str], selection: Selection, weights: Floats | None
) -> TorqueEquations:
    """The same with those of these numbers by direction that have evidence."""
    if not names:
        return task
    try:
        fit = task.with_directions(names).fit(selection, weights, thin=True)
    except ValueError:
        # Some of them are not separately identifiable, or equations are too few: no evidence.
        return task
    gear = np.abs(task.logs[0].rig.drive.gear)
    # Of the size of what brakes both ways, or of a joint's errors, where a sensor has an offset.
    sizes = []
    usual = np.maximum(task.usual_speed() * gear, 1e-9)
    for name in names:
        kind, joint = name.rstrip("]").split("[")
        j = int(joint)
        error = fit.sigma[j] / gear[j]
        if kind == VISCOUS_OFFSET:
            sizes.append(max(fit[f"drive.viscous[{j}]"], error / usual[j]))
        else:
            sizes.append(max(fit[f"drive.coulomb[{j}]"], error))
    places = [fit.names.index(name) for name in names]
    chosen = evident(fit.values, fit.covariance, places, np.array(sizes))
    return task.with_directions([fit.names[place] for place in chosen])


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


def _friction(
    task: TorqueEquations, fit: TorqueFit, selection: Selection, asymmetric: bool
) -> tuple[FrictionTrial, ...]:
    """Trials of friction beyond Coulomb and viscous, on joints with unknown Coulomb friction.

    `asymmetric`: whether offsets are tried, too; else the evidence has decided on them already.
    """
    dynamics = task.dynamics
    rig = task.logs[0].rig
    usual = np.maximum(task.usual_speed(), 1e-9)
    coupling = rig.drive.coupling
    # Beside a Coulomb level that is fitted; a joint without a residual has nothing to explain.
    joints = [
        j for j in range(dynamics.n) if f"drive.coulomb[{j}]" in fit.names and fit.sigma[j] > 0
    ]

    if not joints:
        return ()
    drive = rig.drive
    curve = drive.curve or FrictionCurve(offset=0 * usual)
    columns = [*task.systems(selection, thin=True)[1]]
    # The weights of the fit itself, so that a gain is measured in its residual.
    weights = np.tile(1 / fit.sigma, (len(task.logs), 1))

    def shape(kind: str, share: tuple[float, ...] | None) -> Callable[[Motion], Floats]:
        """Torque on the shafts for a level of 1, at the speeds of the shafts."""
        speed = usual if share is None else np.array(share) * usual

        def torque(motion: Motion) -> Floats:
            qd = coupling.shaft(motion.qd)
            if kind == ASYMMETRIC:
                # A sum with zero gives an offset the shape of the speeds.
                return 1 + 0 * qd
            if kind == LOAD_DEPENDENT:
                # The load is the torque of the links by the fit itself.
                regressor, _ = regressor_along(dynamics, rig, dynamics.names, motion)
                load = (regressor * fit.f).sum(axis=2) - drive.rotor_torque(motion.qdd)
                return np.abs(coupling.shaft_torque(load)) * np.sign(qd)
            if kind == STRIBECK:
                stribeck = FrictionCurve(offset=0 * usual, breakaway=1 + 0 * usual, speed=speed)
                return stribeck.level(qd) * np.sign(qd)
            # Viscous friction that saturates: its level is slope times saturation.
            saturating = FrictionCurve(offset=0 * usual, saturation=speed)
            return saturating.coefficient(1 / speed, qd) * qd

        return torque

    def trials(*candidates: tuple[str, tuple[float, ...] | None]) -> tuple[FrictionTrial, ...]:
        made = task.shapes(selection, [shape(*candidate) for candidate in candidates])
        systems = []
        for system, torques in zip(columns, made, strict=True):
            # Column by column, joint by joint: the torque of one shaft may act on several joints.
            further = [
                coupling.joint_torque(torques[:, :, i] * (np.arange(dynamics.n) == j))
                for i in range(len(candidates))
                for j in joints
            ]
            regressor = np.concatenate([system.regressor, np.stack(further, axis=2)], axis=2)
            systems.append(replace(system, regressor=regressor))
        # Viscous friction that saturates stands in place of the one in proportion.
        places = [i for i, name in enumerate(fit.names) if name.startswith("drive.viscous")]
        return friction_trials(
            systems, candidates, joints, task.seconds, 1 / selection.band, weights, usual, places
        )

    # 1. All kinds that the drive does not state already, at coarse speeds.
    viscous = all(f"drive.viscous[{j}]" in fit.names for j in joints)
    kinds = list[tuple[str, tuple[float, ...] | None]]()
    if asymmetric:
        kinds.append((ASYMMETRIC, None))
    if drive.load_friction is None:
        kinds.append((LOAD_DEPENDENT, None))
    for kind, shares, possible in (
        (STRIBECK, FRICTION.speeds, curve.breakaway is None),
        (SATURATING, FRICTION.saturations, viscous and curve.saturation is None),
    ):
        if possible:
            kinds += [(kind, (share,) * dynamics.n) for share in shares]
    ranked = trials(*kinds)

    # 2. A speed that leads is refined: for all joints together, then for one after another, each
    # from the best so far.
    groups = [joints]
    if len(joints) > 1:
        groups += [[joint] for joint in joints]
    for group in groups:
        best = ranked[0] if ranked else None
        if best is None or not best.clear or not best.share:
            continue
        # Only the speeds of this group vary; others stay at the best so far.
        in_group = np.isin(np.arange(dynamics.n), group)
        finer = FRICTION.finer if best.kind == STRIBECK else FRICTION.wider
        speeds = np.where(in_group, np.array(finer)[:, None], 1.0) * best.share
        refined = trials(*((best.kind, tuple(row)) for row in speeds.tolist()))
        ranked = tuple(sorted((*ranked, *refined), key=lambda trial: -trial.better))
    return ranked


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
