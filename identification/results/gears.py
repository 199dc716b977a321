"""`find_gears`: stiffness and damping of gears that have an encoder on either side."""

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Self

import numpy as np

from identification.equation_error import (
    BetweenRuns,
    Deflections,
    Known,
    Prior,
    Wound,
    each_named,
    evened,
    fit_systems,
    fit_wound,
    pass_band,
    path_in,
    record_label,
    wrong_statements,
)
from identification.replay import as_records
from identification.results.identification import Identification, covariance_of_f
from plant import Arm, Dynamics, Elasticity, Record
from plant.checkup import bridged
from plant.parts import (
    Floats,
    Frozen,
    JointUnits,
    Piece,
    Shown,
    Table,
    Verdict,
    frozen,
    heading,
    instance,
    known_options,
    real,
    warn,
    with_units,
)

# Share of the logged torques that an arm and its friction may leave before stiffness is doubted,
# because it is off by about as much. Chosen by hand.
_POOR = 0.2

_ORDER = "Pass an arm, an identification or dynamics first, then records."


@frozen
class Gears(Shown, Frozen):
    """Gears between two encoders, with 95 % intervals; NaN of joints that lack one.

    Attributes
    ----------
    joints : tuple of str
        Name of each joint.
    units : tuple of JointUnits
        Of each joint.
    stiffness, low, high : (n,) numpy.ndarray
        [N m/rad; of slides N/m], as of `Elasticity`. Without an upper end, low is a bound: the
        gear is stiffer.
    damping, damping_low, damping_high : (n,) numpy.ndarray
        [N m s/rad; of slides N s/m]; NaN where stiffness has a bound alone.
    runs : tuple of Gears
        Result of each record alone; the uncertainty of f, which they share, is in each.
    between : BetweenRuns or None
        Agreement of two records or more, and what their differences add to the intervals; its
        values are compliance and damping / stiffness^2.
    stated : Elasticity or None
        Of the first record's rig.
    """

    joints: tuple[str, ...]
    units: tuple[JointUnits, ...]
    stiffness: Floats
    low: Floats
    high: Floats
    damping: Floats
    damping_low: Floats
    damping_high: Floats
    stated: Elasticity | None
    runs: tuple[Self, ...] = ()
    between: BetweenRuns | None = None

    @classmethod
    def of(
        cls,
        wound: Wound,
        joints: tuple[str, ...],
        stated: Elasticity | None,
        **options: Any,
    ) -> Self:
        """Gears with these compliances [rad/(N m)] and their intervals."""
        # Values, then half-widths of intervals: each compliance, and damping / stiffness^2.
        (c, slope), (half, slope_half) = wound
        with np.errstate(divide="ignore", invalid="ignore"):
            # A compliance that may be zero gives a lower bound of the stiffness, and no damping.
            certain = np.where(c > half, c, np.nan)
            # The deflection follows the torque by 1 / stiffness, its rate by damping / stiffness^2.
            damping = slope / certain**2
            # To first order, from the half-widths of both numbers.
            wide = np.hypot(slope_half / certain**2, 2 * damping * half / certain)
            # A compliance that is not positive is infinite stiffness: no upper end.
            stiffness, low, high = (
                np.where(x > 0, 1 / x, np.where(np.isnan(x), x, np.inf))
                for x in (c, c + half, c - half)
            )
        return cls(
            joints=joints,
            stiffness=stiffness,
            low=low,
            high=high,
            damping=damping,
            damping_low=damping - wide,
            damping_high=damping + wide,
            stated=stated,
            **options,
        )

    @property
    def elasticity(self) -> Elasticity:
        """All gears, with the stated ones where they are not identified; damping at least 0."""
        identified = np.isfinite(self.stiffness) & np.isfinite(self.damping)
        # A gear without an estimate needs a stated one.
        if self.stated is None and not identified.all():
            label = self.joints[int(np.argmin(identified))]
            raise ValueError(
                f"every gear must be known; that of {label} is not. State it in the Elasticity of"
                " the rig."
            )
        # Noise can make the damping of a gear negative.
        damping = np.maximum(self.damping, 0)
        stated = self.stated or Elasticity(stiffness=self.stiffness, damping=damping)
        return dataclasses.replace(
            stated,
            stiffness=np.where(identified, self.stiffness, stated.stiffness),
            damping=np.where(identified, damping, stated.damping),
        )

    def _short(self) -> str:
        return f"stiffness of {np.isfinite(self.low).sum()} of {len(self.joints)} gears"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(f"{self._short()}, with 95 % intervals")
        # Joints without a second encoder have NaN, and no row.
        rows = []
        seen = np.flatnonzero(~np.isnan(self.low)).tolist()
        units = self.units
        stiffnesses = with_units(
            [f"{value:.4g}" for value in self.stiffness], [unit.stiffness for unit in units]
        )
        dampings = with_units(
            [f"{value:.3g}" for value in self.damping], [unit.damping for unit in units]
        )
        for i in seen:
            damping = ""
            interval = ""
            if not np.isinf(self.high[i]):  # otherwise stiffness has a bound alone
                damping = dampings[i]
                interval = f"[{self.damping_low[i]:.3g}, {self.damping_high[i]:.3g}]"
            rows.append((self.joints[i], stiffnesses[i], self._interval(i), damping, interval))
        stiffness_head = heading("", [unit.stiffness for unit in units]).strip() or "stiffness"
        damping_head = heading("damping", [unit.damping for unit in units])
        yield Table(("", stiffness_head, "interval", damping_head, "interval"), rows, words=(2, 4))
        if self.between is not None:
            yield (
                f"{self.between.agree.sum()} of {self.between.compared.sum()} intervals agree"
                " between runs:"
            )
            # Each record alone, so that a user sees the agreement.
            alone = [(self.joints[i], *(run._interval(i) for run in self.runs)) for i in seen]
            yield Table(("", *(f"run {k}" for k in range(len(self.runs)))), alone)

    def _interval(self, i: int) -> str:
        """Interval of the stiffness of a joint, or its bound."""
        low = self.low[i]
        high = self.high[i]
        return f"stiffer than {low:.4g}" if np.isinf(high) else f"[{low:.4g}, {high:.4g}]"


@known_options
def find_gears(
    arm: Arm | Dynamics | Identification,
    records: Record | Sequence[Record],
    *,
    prior: Any = None,
    unknown: Iterable[str] | None = None,
    band: float | None = None,
) -> Gears:
    """Find stiffness and damping of the gears that have an encoder on either side.

    Their deflection is compared with the torque of their links, which follows from f and the motion
    of the links; no motor torque is read, unless f is unknown. Links without an encoder are taken
    to turn with their motors.

    Parameters
    ----------
    arm : Arm, Identification or Dynamics
        An arm is known exactly; an identification, with its covariance; of dynamics f is unknown,
        and is found from the torques of the motors, or it has a `prior`.
    records : Record or sequence of Record
        With `link_counts`, of the same joints each; NaN in the columns of others.
    prior : float, or tuple of bodies or f and a float, optional
        Data sheet of f, as for `identify`: the relative standard deviation of the chain's own
        bodies (of each number of f, if an `Arm` is given), such as 0.05; or ``(bodies, 0.05)``, or
        ``(f, 0.05)``.
    unknown : sequence of str, optional
        Where f is unknown: all its names, and friction to find beside it; by default f.
    band : float, optional
        In which deflections and torques are compared [Hz]; by default as far as the motion stands
        out of its rounding.

    Returns
    -------
    Gears

    Raises
    ------
    ValueError
        Bad input; records without link encoders; deflections against the torque; a gear that no
        torque winds up.

    See Also
    --------
    plant.Encoder, plant.Elasticity, identification.identify

    Examples
    --------
    >>> import dataclasses
    >>> from identification import find_gears
    >>> from plant import Elasticity, puma560, simulate
    >>> arm, rig = puma560.literature_arm(1.5), puma560.rig()
    >>> gears = Elasticity.from_resonance(arm, 25, 0.02, drive=rig.drive)
    >>> rig = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=gears),
    ...                           encoder=dataclasses.replace(rig.encoder, side=("both", "motor")))
    >>> found = find_gears(arm, simulate(arm, rig, puma560.p_law((0.1, 0.08)), puma560.reference()))
    >>> print(abs(found.stiffness[0] / gears.stiffness[0] - 1) < 0.1, found.stiffness[1])
    True nan
    """
    # 1. The arm, or its dynamics alone.
    # An identification has a covariance of f, an arm has none.
    uncertain = arm if isinstance(arm, Identification) else None
    exact = arm.arm if isinstance(arm, Identification) else arm
    alone = isinstance(exact, Dynamics)
    dynamics = (
        exact if isinstance(exact, Dynamics) else instance("arm", exact, Arm, _ORDER).dynamics
    )
    seen = _seen(dynamics, records, band)
    rig = seen[0].record.rig
    labels = tuple(dynamics.chain.joint_labels)
    units = tuple(dynamics.chain.joint_units)
    # Friction is found beside f only, as the torque of the links does not show it.
    if unknown is not None and (prior is not None or not alone):
        raise ValueError(
            "unknown must be left out where f is known; got both. Give dynamics alone to find f"
            " too."
        )

    # 2. f and its covariance: from a prior, from the torques of the motors, or from the arm.
    if prior is not None:
        if uncertain is not None:
            raise ValueError(
                "prior must be left out beside an identification, which has its own. Pass"
                " found.arm, or no prior."
            )
        if isinstance(exact, Arm) and np.ndim(prior) == 0:
            # A single number is the relative deviation of each number of this f.
            prior = (exact, prior)
        of_f = Prior.of(dynamics, rig, prior)
        f = of_f.mean
        covariance = of_f.covariance
    elif isinstance(exact, Dynamics):
        names = tuple(dynamics.names if unknown is None else unknown)
        f, covariance = _from_torques(dynamics, seen, band, names)
    else:
        f = exact.f
        covariance = covariance_of_f(uncertain, exact)
    # Only logs with torques can contradict f.
    _require_torques(dynamics, seen, f)

    # 3. Deflections against torques.
    common, runs, fit = fit_wound(dynamics, seen, f, covariance)
    # Negative beyond its interval: no noise.
    against = np.flatnonzero(common.values[0] + common.half[0] < 0)
    if len(against):
        raise ValueError(
            f"a gear must give way to its torque; that of {labels[against[0]]} turns against it."
            f" Check signs of its two encoders, their order, and gravity.{_likely(dynamics, seen)}"
        )
    stated = rig.drive.elasticity
    gears = tuple(Gears.of(run, labels, stated, units=units) for run in runs)
    return Gears.of(common, labels, stated, units=units, runs=gears, between=fit.between)


def _seen(
    dynamics: Dynamics, records: Record | Sequence[Record], band: float | None
) -> list[Deflections]:
    """Deflections of the gears in records that have encoders on both sides of the same joints."""
    records, _ = as_records(dynamics, records, None)
    if band is not None:
        real("band", band, "Give Hz.", positive=True)
    seen = []
    for k, (record, about) in enumerate(each_named(records)):
        with about:
            record.rig.require_fit(dynamics.chain)
            if record.link_counts is None:
                raise ValueError(
                    "the record must hold link_counts; it has none. Map link_position, or simulate"
                    ' with Encoder(side="both").'
                )
            # Filters need samples in even steps.
            even = evened(bridged(record))
            seen.append(Deflections.of(even, path_in(even) if band is None else band))
            # The fit has one compliance per gear, from all records.
            different = np.flatnonzero(seen[k].seen != seen[0].seen)
            if different.size:
                label = dynamics.chain.joint_labels[different[0]]
                raise ValueError(
                    f"link_counts must be of the joints that {record_label(records, 0)} has;"
                    f" {label} differs. Take them apart."
                )
    return seen


def _require_torques(dynamics: Dynamics, seen: Sequence[Deflections], f: Floats) -> None:
    """Warn if f does not give the logged torques; friction is fitted beside it."""
    logged = [
        deflections
        for deflections in seen
        if deflections.record.torque is not None or deflections.record.current is not None
    ]
    if not logged:
        return
    # Motors need their friction too, which the torque of the links does not have.
    friction = [f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(dynamics.n)]
    names = (*dynamics.names, *friction)
    stated = Known(dict(zip(dynamics.names, f.tolist(), strict=True)))
    try:
        systems = [deflections.balance(dynamics, names) for deflections in logged]
        error = fit_systems(dynamics, names, stated, systems).relative_error
    except ValueError:  # too few equations
        return
    if error > _POOR:
        warn(
            f"find_gears: f and friction leave {error:.0%} of the logged torques, and stiffness is"
            " off by as much. Pass the arm of these logs, or dynamics alone, which finds it."
            f"{_likely(dynamics, logged)}"
        )


def _likely(dynamics: Dynamics, seen: Sequence[Deflections]) -> str:
    """The first wrong statement of the records, as the end of a message; or none."""
    lines = (wrong_statements(dynamics, deflections.record) for deflections in seen)
    return "".join(f" {line}" for line in itertools.islice(itertools.chain.from_iterable(lines), 1))


def _from_torques(
    dynamics: Dynamics, seen: Sequence[Deflections], band: float | None, names: tuple[str, ...]
) -> tuple[Floats, Floats]:
    """Identified f and its covariance (p, p), from torques along the motion of both sides."""
    records = [deflections.record for deflections in seen]
    # The equation of motion has a pass band of its own, not that of the deflections.
    if band is None:
        seen = [Deflections.of(record, pass_band(record)) for record in records]
    seconds = np.array([len(record) * record.rig.period for record in records])
    systems = [deflections.balance(dynamics, names) for deflections in seen]
    fit = fit_systems(dynamics, names, Known(), systems, seconds)
    places = [fit.names.index(name) for name in dynamics.names]
    return fit.f, fit.covariance[np.ix_(places, places)]
