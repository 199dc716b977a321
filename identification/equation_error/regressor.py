"""Regressor and measured torque of a log, filtered alike: the two sides of the torque equation.

Behind elastic gears links and motors move apart: bodies feel the motion of the links, friction and
rotors that of the motors.

Velocity and acceleration come from positions alone (`filters`). Regressor and measured torque then
pass the same zero-phase filter (its band is where they are compared), and every k-th row is kept,
counted from the first sample.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.equation_error.filters import derivatives, low_pass
from plant import Dynamics, Rig
from plant.checkup.lost_rows import BRIDGED, short_gaps
from plant.motion.reference import Motion
from plant.parts.arguments import array, near
from plant.parts.checked_function import evaluated
from plant.parts.fields import Floats

# What the names of friction in which the torque is linear begin with; and of springs, in some of
# which it is.
LINEAR = ("drive.viscous", "drive.coulomb", "drive.curve.offset")
SPRINGS = "springs"

_WIDER = 8  # how much longer than a bridged gap the memory of a filter is

# samples whose regressors are worked out in one go; values that are filtered in one
_AT_ONCE = 4096
_TOGETHER = 2**18


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class System:
    """The torque equation of one log, and where in it each equation comes from.

    `regressor` (N', n, k). `torque` (N', n): measured [N m], less that of what is known. `measured`
    (N', n): with that; None where nothing is. `used` (N', n): which of these equations count.
    `sample` (N',): their rows in the log. `period`: of the log's rows [s]. `speed` (N', n): of each
    joint in the band [rad/s], a magnitude.
    """

    regressor: Floats
    torque: Floats
    used: NDArray[np.bool_]
    sample: NDArray[np.intp]
    period: float
    speed: Floats
    measured: Floats | None = None


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Places:
    """Where the equations that a fit uses come from, in its order of them.

    `record`, `joint`, `sample` (M,): number of the record, joint, and row in the record's log. `t`
    (M,): time since the log's first row [s].
    """

    record: NDArray[np.intp]
    joint: NDArray[np.intp]
    sample: NDArray[np.intp]
    t: Floats

    @classmethod
    def of(cls, systems: Sequence[System]) -> Self:
        """Of the equations that count, of one system per record."""
        rows, joint = (
            np.concatenate(each)
            for each in zip(*(np.nonzero(each.used) for each in systems), strict=True)
        )
        counts = [int(each.used.sum()) for each in systems]
        record = np.repeat(np.arange(len(systems)), counts)
        sample = np.concatenate([each.sample for each in systems])
        first = np.cumsum([0, *(len(each.sample) for each in systems)])[record]
        period = np.repeat([each.period for each in systems], counts)
        sample = sample[first + rows]
        return cls(record=record, joint=joint, sample=sample, t=sample * period)

    def segments(self, seconds: Floats, least: int) -> tuple[NDArray[np.intp], int]:
        """Segment (M,) of each equation, and the number of all: logs of these lengths (R,) in equal
        parts, at least so many together.
        """
        each = -(-least // len(seconds))
        share = self.t / seconds[self.record]
        return each * self.record + np.minimum((each * share).astype(int), each - 1), each * len(
            seconds
        )


class Filtering(NamedTuple):
    """Which equations of a log are compared, and in which band.

    `cutoff`: of the low-pass before differentiation [Hz]. `band`: in which torques are compared
    [Hz]. `every`: rows of the log from one equation to the next. `slowest` (n,): speeds [rad/s]
    below which equations of a joint do not count.
    """

    cutoff: float
    band: float
    every: int
    slowest: Floats


def regressor_and_torque(
    dynamics: Dynamics,
    q: Floats,
    torque: Floats,
    rig: Rig,
    filtering: Filtering,
    unknown: Sequence[str],
    extra: Mapping[str, Callable[..., ArrayLike]],
    valid: Floats | None = None,
) -> System:
    """Regressor of the unknowns and measured torque less that of what is known, both filtered.

    Rows whose filters feel the ends of the log, or a gap of samples without weight in `valid` (N,),
    do not count; short gaps are bridged, and only they do not.
    """
    motion = derivatives(q, rig.period, filtering.cutoff)
    regressor, given = regressor_along(dynamics, rig, unknown, motion)
    more = [
        array(name, column(*motion), q.shape, advice="Give (N, n).")
        for name, column in extra.items()
    ]
    signals = [torque - given, *np.moveaxis(regressor, 2, 0), *more]
    return compared(signals, motion.qd, rig.period, filtering, valid)


def compared(
    signals: Sequence[Floats],
    qd: Floats,
    period: float,
    filtering: Filtering,
    valid: Floats | None = None,
) -> System:
    """Torque and columns, each (N, n), in the band in which they are compared, at the speeds qd
    (N, n).
    """
    cutoff, band, every, slowest = filtering
    # where the filters still feel the ends of the log
    margin = int(np.ceil(1 / (min(cutoff, band) * period)))
    rows = slice(-(-margin // every) * every, len(qd) - margin, every)
    together = max(1, _TOGETHER // qd.size)
    n = qd.shape[1]
    left = [*signals, qd]
    groups = (np.hstack(left[i : i + together]) for i in range(0, len(left), together))
    filtered = np.hstack([low_pass(group, period, band)[rows] for group in groups])
    measured, *columns, speed = (filtered[:, i : i + n] for i in range(0, filtered.shape[1], n))
    speed = np.abs(speed)
    used = (speed > slowest) | (slowest == 0)
    if valid is not None:
        missing = valid == 0
        bridged = short_gaps(missing, int(np.clip(margin // _WIDER, 1, BRIDGED)))
        lost = np.append(0, np.cumsum(missing & ~bridged))
        near = np.clip(np.arange(len(qd))[:, None] + (-margin, margin + 1), 0, len(qd))
        used &= ((lost[near[:, 1]] == lost[near[:, 0]]) & ~bridged)[rows, None]
    regressor = np.stack(columns, axis=-1)
    torque = np.ascontiguousarray(measured)
    sample = np.arange(len(qd))[rows]
    return System(
        regressor=regressor, torque=torque, used=used, sample=sample, period=period, speed=speed
    )


def regressor_along(
    dynamics: Dynamics,
    rig: Rig,
    unknown: Sequence[str],
    motion: Motion,
    motors: Motion | None = None,
) -> tuple[Floats, Floats]:
    """Regressor of the unknowns (N, n, k), and the torque of what is known (N, n).

    `motion`: of the links. `motors`: of the motors, as joints on rigid gears would have it, where
    gears are elastic.
    """
    names, _ = balance(dynamics, rig, tuple(unknown), motors is not None)
    motions = (*motion, *(() if motors is None else motors[1:]))
    values = np.concatenate([np.zeros(dynamics.p), rig.number_values()])
    values[[names.index(name) for name in unknown]] = 0.0
    n = dynamics.n
    k = len(unknown)
    regressor = np.empty((len(motion.q), n, k))
    given = np.empty((len(motion.q), n))
    for start in range(0, len(given), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        mapped = _mapped(dynamics, rig, tuple(unknown), motors is not None, len(given[some]))
        block, given[some] = evaluated(mapped, *(part[some] for part in motions), values)
        regressor[some] = block.reshape(-1, k, n).transpose(0, 2, 1)
    return regressor, given


def linear(dynamics: Dynamics, rig: Rig, unknown: Iterable[str]) -> tuple[str, ...]:
    """Those of the unknowns that enter the torque linearly, together; of springs the first of
    several that do not.
    """
    unknown = tuple(unknown)
    springs = [name for name in rig.number_names() if name.startswith(SPRINGS)]
    numbers = ca.SX.sym("numbers", len(rig.number_names()))
    q = ca.SX.sym("q", rig.n)
    torque = rig.with_numbers(numbers).spring_torque(q)
    taken = list[int]()
    for name in unknown:
        if name in springs:
            place = rig.number_names().index(name)
            slopes = ca.jacobian(torque, numbers)[:, [*taken, place]]
            own = numbers[[*taken, place]]
            taken += [] if ca.depends_on(slopes, own) else [place]
    some = {rig.number_names()[place] for place in taken}
    return tuple(
        name
        for name in unknown
        if name in dynamics.names or name.startswith(LINEAR) or name in some
    )


@functools.lru_cache(maxsize=16)
def _mapped(
    dynamics: Dynamics, rig: Rig, unknown: tuple[str, ...], elastic: bool, count: int
) -> Any:
    """The function of `balance`, of so many samples at once."""
    one = balance(dynamics, rig, unknown, elastic)[1]
    return one.map("balances", "serial", count, [one.n_in() - 1], [])


@functools.lru_cache(maxsize=16)
def balance(
    dynamics: Dynamics, rig: Rig, unknown: tuple[str, ...], elastic: bool
) -> tuple[list[str], Any]:
    """Names of all numbers, and (q, qd, qdd, numbers) -> regressor of the unknowns, torque of these
    numbers.

    Of elastic gears speed and acceleration of the motors come before the numbers.
    """
    names = [*dynamics.names, *rig.number_names()]
    of_drive = [name for name in names if name.startswith((*LINEAR, SPRINGS))]
    for name in unknown:
        if name not in names:
            raise ValueError(
                "unknown must be names of f, friction and springs, with the joint's index; got"
                f" {name!r}. {near(name, [*dynamics.names, *of_drive])} Of the rig:"
                f" {', '.join(of_drive)}."
            )
    missing = [name for name in dynamics.names if name not in unknown]
    twice = [name for i, name in enumerate(unknown) if name in unknown[:i]]
    if missing or twice:
        what = f"{missing[0]} is missing" if missing else f"{twice[0]} comes twice"
        raise ValueError(
            f"unknown must name all of f, each name once; {what}. Write (*dynamics.names, ...)."
        )
    n = dynamics.n
    numbers = ca.SX.sym("numbers", len(names))
    q, qd, qdd = (ca.SX.sym(name, n) for name in ("q", "qd", "qdd"))
    rig = rig.with_numbers(numbers[dynamics.p :])
    drive = rig.drive
    motors = [ca.SX.sym(name, n) for name in ("qd_m", "qdd_m")] if elastic else []
    tau = dynamics.Y(q, qd, qdd) @ numbers[: dynamics.p] - rig.spring_torque(q)
    tau += drive.friction(motors[0] if elastic else qd)
    if elastic:
        # f holds the rotors, as if they turned with the links
        tau += drive.rotor_torque(motors[1] - qdd)
    places = [names.index(name) for name in unknown]
    regressor = ca.densify(ca.jacobian(tau, numbers)[:, places])
    for name, place in zip(unknown, places, strict=True):
        if ca.depends_on(regressor, numbers[place]):
            raise ValueError(
                f"unknown must enter the torque linearly; {name} does not, or not with others. "
                "Take f, friction levels, and of a spring its stiffness or its preload."
            )
        if regressor[:, unknown.index(name)].is_zero():
            raise ValueError(f"unknown must act on the torque; {name} does not. Leave it out.")
    return names, ca.Function(
        "balance", [q, qd, qdd, *motors, numbers], [regressor, ca.densify(tau)]
    )
