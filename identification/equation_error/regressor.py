"""Regressor and measured torque of a log, filtered alike: the two sides of the torque equation.

Behind elastic gears links and motors move apart: bodies feel the motion of the links, friction and
rotors that of the motors.

Velocity and acceleration come from positions alone (`filters`). Regressor and measured torque then
pass the same zero-phase filter (its band is where they are compared), and every k-th row is kept,
counted from the first sample.
"""

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error.filters import derivatives, low_pass
from plant import Dynamics, Rig
from plant.checkup import BRIDGED, short_gaps
from plant.motion import Motion
from plant.parts import Bools, Floats, Integers, array, evaluated, frozen, near

# Beginnings of the names of friction, in which the torque is linear, and of springs, in some of
# whose numbers it is linear.
LINEAR = (
    "drive.viscous",
    "drive.coulomb",
    "drive.curve.offset",
    "drive.curve.viscous_offset",
    "drive.load_friction",
)
SPRINGS = "springs"

# Ratio of the memory of a filter to the longest gap that it may pass over on a straight line;
# chosen by hand.
_WIDER = 8

# Samples whose regressors are made at once: casadi makes a map in a time that grows with them, and
# calls it in a time that does not. Of 64 to 4096, 128 and 256 were the quickest.
# Values that are filtered at once: so many stay in the processor's cache.
_AT_ONCE = 256
_TOGETHER = 2**18


@frozen
class System:
    """The torque equation of one log, and where in it each equation comes from.

    `regressor` (N', n, k). `torque` (N', n): measured [N m], less that of known numbers. `measured`
    (N', n): with that; None where nothing is known. `used` (N', n): which of these equations count.
    `sample` (N',): their rows in the log. `period`: of the log's rows [s]. `speed` (N', n): of each
    joint in the band [rad/s], a magnitude.
    """

    regressor: Floats
    torque: Floats
    used: Bools
    sample: Integers
    period: float
    speed: Floats
    measured: Floats | None = None


@frozen
class Places:
    """Where the equations that a fit uses come from, in its order of them.

    `record`, `joint`, `sample` (M,): number of the record, joint, and row in the record's log. `t`
    (M,): time since the log's first row [s].
    """

    record: Integers
    joint: Integers
    sample: Integers
    t: Floats

    @classmethod
    def of(cls, systems: Sequence[System]) -> Self:
        """Of the equations that count, of one system per record."""
        used = [np.nonzero(system.used) for system in systems]
        joint = np.concatenate([joints for _, joints in used])
        sample = np.concatenate(
            [system.sample[rows] for system, (rows, _) in zip(systems, used, strict=True)]
        )
        counts = [len(rows) for rows, _ in used]
        record = np.repeat(np.arange(len(systems)), counts)
        period = np.repeat([system.period for system in systems], counts)
        return cls(record=record, joint=joint, sample=sample, t=sample * period)

    def segments(self, seconds: Floats, least: int) -> tuple[Integers, int]:
        """Segment (M,) of each equation, and the number of all segments.

        Logs of these lengths (R,) are cut into equal parts, at least `least` together.
        """
        # Rounded up, and the same for each log whatever its length.
        per_log = -(-least // len(seconds))
        share = self.t / seconds[self.record]
        # The last row of a log lies at its end, and belongs to the last segment.
        in_log = np.minimum((per_log * share).astype(int), per_log - 1)
        return per_log * self.record + in_log, per_log * len(seconds)


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
    loading: Floats | None = None,
) -> System:
    """Regressor of the unknowns and measured torque less that of known numbers, both filtered.

    Rows whose filters feel the ends of the log, or a gap of samples without weight in `valid` (N,),
    do not count; of a short gap, which is bridged, its own rows alone do not. `loading` (p,): f by
    which the gears are loaded, as of `regressor_along`.
    """
    motion = derivatives(q, rig.period, filtering.cutoff)
    # The torque of known numbers moves to the side of the measurement, before both are filtered
    # alike.
    regressor, stated = regressor_along(dynamics, rig, unknown, motion, loading=loading)
    columns = [
        array(name, column(*motion), q.shape, advice="Give (N, n).")
        for name, column in extra.items()
    ]
    signals = [torque - stated, *np.moveaxis(regressor, 2, 0), *columns]
    return compared(signals, motion.qd, rig.period, filtering, valid)


def compared(
    signals: Sequence[Floats],
    qd: Floats,
    period: float,
    filtering: Filtering,
    valid: Floats | None = None,
) -> System:
    """The equations of a torque (N, n) and of columns (N, n), at the speeds qd (N, n).

    `signals`: the torque, then the columns.
    """
    cutoff, band, every, slowest = filtering

    # 1. Rows that are compared: no filter feels the ends of the log there. They are counted from
    # the first sample, so that logs of one motion have theirs at the same instants.
    margin = int(np.ceil(1 / (min(cutoff, band) * period)))
    rows = slice(-(-margin // every) * every, len(qd) - margin, every)

    # 2. All signals pass one filter: what it takes away is then the same on both sides.
    together = max(1, _TOGETHER // qd.size)
    n = qd.shape[1]
    inputs = [*signals, qd]
    groups = (np.hstack(inputs[i : i + together]) for i in range(0, len(inputs), together))
    filtered = np.hstack([low_pass(group, period, band)[rows] for group in groups])
    outputs = [filtered[:, i : i + n] for i in range(0, filtered.shape[1], n)]
    speed = np.abs(outputs[-1])

    # 3. Leave out slow joints, whose friction has an uncertain sign, and rows beside a gap.
    used = (speed > slowest) | (slowest == 0)
    if valid is not None:
        missing = valid == 0
        bridged = short_gaps(missing, int(np.clip(margin // _WIDER, 1, BRIDGED)))
        # Lost samples so far: a window without a lost one has the same number at both ends.
        lost = np.append(0, np.cumsum(missing & ~bridged))
        ends = np.clip(np.arange(len(qd))[:, None] + (-margin, margin + 1), 0, len(qd))
        used &= ((lost[ends[:, 1]] == lost[ends[:, 0]]) & ~bridged)[rows, None]
    return System(
        regressor=np.stack(outputs[1:-1], axis=-1),
        torque=np.ascontiguousarray(outputs[0]),
        used=used,
        sample=np.arange(len(qd))[rows],
        period=period,
        speed=speed,
    )


def regressor_along(
    dynamics: Dynamics,
    rig: Rig,
    unknown: Sequence[str],
    motion: Motion,
    motors: Motion | None = None,
    loading: Floats | None = None,
) -> tuple[Floats, Floats]:
    """Regressor of the unknowns (N, n, k), and the torque (N, n) of the known numbers.

    `motion`: of the links. `motors`: of the motors, as joints on rigid gears would have it, where
    gears are elastic. `loading` (p,): f by which the gears are loaded, where friction depends on
    that; none by default.
    """
    names, _ = balance(dynamics, rig, tuple(unknown), motors is not None)
    motions = (*motion, *(() if motors is None else motors[1:]))
    # With the unknowns at zero the torque of all numbers is that of the known ones: it is linear.
    values = np.concatenate([np.zeros(dynamics.p), rig.number_values()])
    values[[names.index(name) for name in unknown]] = 0.0
    numbers = [values]
    if rig.drive.load_friction is not None:
        numbers.append(np.zeros(dynamics.p) if loading is None else loading)
    n = dynamics.n
    k = len(unknown)
    regressor = np.empty((len(motion.q), n, k))
    stated = np.empty((len(motion.q), n))
    for begin in range(0, len(stated), _AT_ONCE):
        rows = slice(begin, begin + _AT_ONCE)
        # Block by block: a map over a whole log would need memory for all its intermediate results.
        # The last block has a length, and so a function, of its own.
        mapped = _mapped(dynamics, rig, tuple(unknown), motors is not None, len(stated[rows]))
        block, stated[rows] = evaluated(mapped, *(signal[rows] for signal in motions), *numbers)
        # casadi stores the columns of each sample one after another.
        regressor[rows] = block.reshape(-1, k, n).transpose(0, 2, 1)
    return regressor, stated


def linear(dynamics: Dynamics, rig: Rig, unknown: Iterable[str]) -> tuple[str, ...]:
    """The unknowns that enter the torque linearly together.

    Of several numbers of a spring that do not, the first.
    """
    unknown = tuple(unknown)
    springs = [name for name in rig.number_names() if name.startswith(SPRINGS)]
    numbers = ca.SX.sym("numbers", len(rig.number_names()))
    q = ca.SX.sym("q", rig.n)
    torque = rig.with_numbers(numbers).spring_torque(q)
    # One after another: stiffness and angle of a spring are each linear, but not both together.
    taken = list[int]()
    for name in unknown:
        if name in springs:
            places = [*taken, rig.number_names().index(name)]
            slopes = ca.jacobian(torque, numbers)[:, places]
            if not ca.depends_on(slopes, numbers[places]):
                taken = places
    of_springs = {rig.number_names()[place] for place in taken}
    return tuple(
        name
        for name in unknown
        if name in dynamics.names or name.startswith(LINEAR) or name in of_springs
    )


@functools.lru_cache(maxsize=16)
def _mapped(dynamics, rig, unknown, elastic, count):
    """The function of `balance`, of so many samples at once."""
    of_sample = balance(dynamics, rig, unknown, elastic)[1]
    # The numbers, its inputs after the motion of links and motors, are those of all samples.
    numbers = range(5 if elastic else 3, of_sample.n_in())
    return of_sample.map("balances", "serial", count, list(numbers), [])


@functools.lru_cache(maxsize=16)
def balance(
    dynamics: Dynamics, rig: Rig, unknown: tuple[str, ...], elastic: bool
) -> tuple[list[str], Any]:
    """Names of all numbers, and the casadi function of the torque equation.

    (q, qd, qdd, numbers) -> regressor of the unknowns, torque of these numbers.

    Of elastic gears speed and acceleration of the motors come before the numbers. Where friction
    depends on the load, f of the load comes after them: then the torque is linear in its share.
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
        fault = f"{missing[0]} is missing" if missing else f"{twice[0]} comes twice"
        raise ValueError(
            f"unknown must name all of f, each name once; {fault}. Write (*dynamics.names, ...)."
        )
    n = dynamics.n
    numbers = ca.SX.sym("numbers", len(names))
    q, qd, qdd = (ca.SX.sym(name, n) for name in ("q", "qd", "qdd"))
    rig = rig.with_numbers(numbers[dynamics.p :])
    drive = rig.drive
    motors = [ca.SX.sym(name, n) for name in ("qd_m", "qdd_m")] if elastic else []
    tau = dynamics.Y(q, qd, qdd) @ numbers[: dynamics.p] - rig.spring_torque(q)
    loading = []
    load = None
    if drive.load_friction is not None:
        loading = [ca.SX.sym("loading", dynamics.p)]
        load = dynamics.Y(q, qd, qdd) @ loading[0] - drive.rotor_torque(qdd)
    tau += drive.friction(motors[0] if elastic else qd, load)
    if elastic:
        # f holds the rotors, as if they turned with the links: they turn with the motors.
        tau += drive.rotor_torque(motors[1] - qdd)
    places = [names.index(name) for name in unknown]
    # The columns are derivatives by the unknowns: exact, since each must enter linearly, which is
    # checked below.
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
        "balance",
        [q, qd, qdd, *motors, numbers, *loading],
        [regressor, ca.densify(tau)],
    )
