"""The torque equations of logs: what a fit of logged torques takes, checked, and its systems."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error.filters import BAND_MOST, CUTOFF, derivatives
from identification.equation_error.prior import Prior
from identification.equation_error.pulse_fit import speed_noise, without_known
from identification.equation_error.regressor import (
    LINEAR,
    Filtering,
    System,
    compared,
    regressor_and_torque,
)
from identification.equation_error.torque_fit import TorqueFit, weighted
from identification.equation_error.torque_logs import TorqueLog, dead_columns, thinned, torque_logs
from plant import Dynamics, FrictionCurve, Rig
from plant.motion import Motion
from plant.parts import Bools, Floats, choice, frozen, frozen_settings, instance, real

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
    better, errors : float
        Share of the squared error on blocks kept aside, and standard errors, by which the model's
        own bodies must help to be the prior: the rule of one standard error (Breiman). On halves of
        the logs of a UR10, a Panda and a TIAGo, fitted in turn, the error of the torque on the
        other half fell by 1 to 17 % wherever that was so, and by 1 % where it was not.
    """

    lowest: float = 0.5
    periods: float = 4.0
    motion: float = 10.0
    loads: int = 3
    better: float = 0.05
    errors: float = 1.0


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

    def with_rise(self, speeds: Floats) -> Self:
        """The same with Coulomb levels that rise to half at these speeds (n,) of the motors."""
        logs = []
        for log in self.logs:
            drive = log.rig.drive
            curve = drive.curve or FrictionCurve(offset=0 * speeds)
            curve = replace(curve, rise=speeds)
            logs.append(replace(log, rig=replace(log.rig, drive=replace(drive, curve=curve))))
        return replace(self, logs=tuple(logs))

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
    if unknown is not None and (isinstance(unknown, str) or not np.iterable(unknown)):
        raise ValueError(
            f"unknown must be a sequence of names; got {unknown!r:.60}. Write (*dynamics.names,"
            " 'drive.viscous[0]')."
        )
    extra = dict(instance("extra", extra or {}, Mapping, "Give columns by name."))
    known_values = instance("known", known_values or {}, Mapping, "Give {'f1': 0.3}.")
    # A further column may have the name of a short one: it goes before.
    long = dict(zip(dynamics.short_names, dynamics.names, strict=True))
    values = {
        name if name in extra else long.get(name, name): value
        for name, value in known_values.items()
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
        labels = joints if np.iterable(joints) and not isinstance(joints, str) else (joints,)
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
