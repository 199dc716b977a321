"""The torque equations of several logs, in any band and above any speeds."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.equation_error.filters import derivatives
from identification.equation_error.pulse_fit import BAND_MOST, CUTOFF, speed_noise, without_known
from identification.equation_error.regressor import LINEAR, Filtering, System, regressor_and_torque
from identification.equation_error.torque_logs import TorqueLog, dead_columns, thinned, torque_logs
from plant import Dynamics, Rig
from plant.parts.arguments import choice, instance, real
from plant.parts.fields import Floats

# Further columns by name: (q, qd, qdd) -> torque (N, n) per unit.
Columns = Mapping[str, Callable[..., ArrayLike]]


@dataclasses.dataclass(frozen=True, kw_only=True)
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
    """

    lowest: float = 0.5
    periods: float = 4.0
    motion: float = 10.0


SETTINGS = TorqueEquationSettings()


def cutoff_of(band: float, cutoff: float | None) -> float:
    """Cutoff of the low-pass before differentiation [Hz], as stated or by the band."""
    return CUTOFF * band if cutoff is None else cutoff


def every_of(band: float, period: float, every: int | None) -> int:
    """One row out of so many, as stated or two per period of the band."""
    return max(1, int(1 / (2 * band * period))) if every is None else every


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class TorqueEquations:
    """The checked arguments of `fit_torque`.

    `names`: of the columns, without the further ones: unknown or known. `extra`: further columns.
    `known`: values of some columns. `used` (R, n): of which logs and joints the torque is used.
    """

    dynamics: Dynamics
    logs: tuple[TorqueLog, ...]
    names: tuple[str, ...]
    extra: Columns
    known: Mapping[str, float]
    used: NDArray[np.bool_]

    def systems(
        self,
        band: float,
        cutoff: float | None,
        every: int | None,
        slowest: Floats,
        *,
        thin: bool = False,
    ) -> tuple[tuple[str, ...], list[System]]:
        """Names of the unknowns, and one system per log in these alone."""
        systems = []
        names = (*self.names, *self.extra)
        for whole, used in zip(self.logs, self.used, strict=True):
            log = thinned(whole, cutoff_of(band, cutoff)) if thin else whole
            step = every_of(band, log.rig.period, every)
            # A stated step counts rows of the whole log.
            if every is not None and log is not whole:
                step = max(1, round(every * whole.rig.period / log.rig.period))
            system = regressor_and_torque(
                self.dynamics,
                log.q,
                log.torque,
                log.rig,
                Filtering(cutoff_of(band, cutoff), band, step, slowest),
                self.names,
                self.extra,
                log.valid,
            )
            systems.append(dataclasses.replace(system, used=system.used & used))
        return without_known(names, self.known, systems)

    @property
    def seconds(self) -> Floats:
        """Length (R,) of each log."""
        return np.array([len(log.q) * log.rig.period for log in self.logs])

    def bands(self, cutoff: float | None) -> list[float]:
        """Pass bands to choose from [Hz]."""
        highest = cutoff
        if highest is None:
            highest = BAND_MOST / max(log.rig.period for log in self.logs)
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
        return np.asarray(np.sqrt(np.mean(np.concatenate(speeds) ** 2, axis=0)))

    def least(self, usual: Floats, share: float, band: float) -> Floats:
        """Least speeds (n,) [rad/s]: a share of the usual ones, and those that rounding makes."""
        # Positions that are no counts have no rounding that is known.
        noise = [speed_noise(log.rig, band) for log in self.logs if log.counted]
        return np.max([share * usual, *noise], axis=0)

    def left_out(self, stated: bool) -> dict[str, str]:
        """Joint -> reason for which its equations are not used; `stated`: joints were stated."""
        messages = dict[str, str]()
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
    known: Mapping[str, float] | None,
    joints: Iterable[int | str] | None,
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
        for name, value in (known or {}).items()
    }
    if unknown is None:
        unknown = [name for name in dynamics.names if name not in values]
    searched = tuple(unknown)
    for name, value in values.items():
        if name not in extra and not name.startswith(LINEAR):
            choice("a name in known", name, dynamics.names)
        values[name] = real(f"the known {name}", value, "Give its value in SI units.")
    missing = [name for name in dynamics.names if name not in searched and name not in values]
    if missing:
        raise ValueError(
            f"unknown must name all of f that is not known; {missing[0]} is missing. Write"
            " (*dynamics.names, ...), or give its value in known."
        )
    names = (*searched, *(name for name in values if name not in searched and name not in extra))
    if not set(names) | set(extra) > set(values):
        raise ValueError("a fit needs something unknown; all names are in known. Leave one out.")

    # 2. Logs, and the joints whose torque is used in each.
    logs = torque_logs(dynamics, q, torque, rig)
    used = np.ones((len(logs), dynamics.n), bool)
    # Log by log: a sensor may be missing in one alone.
    if joints is None:
        for k, log in enumerate(logs):
            used[k, list(dead_columns(log))] = False
    else:
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
        dynamics=dynamics, logs=tuple(logs), names=names, extra=extra, known=values, used=used
    )


def _joint(dynamics: Dynamics, joint: Any) -> int:
    """Place of a joint that is given by its place, from either end, or by its label."""
    labels = dynamics.chain.joint_labels
    # True is an int in Python, and no joint.
    number = isinstance(joint, (int, np.integer)) and not isinstance(joint, bool)
    if number and -dynamics.n <= joint < dynamics.n:
        return int(joint) % dynamics.n
    return labels.index(choice("a joint", joint, labels))
