"""A bound of the tracking error for every arm of a box and whatever encoders and torque steps round
to: no sampling.

About a nominal run each period of the loop is x_k+1 = M_k x_k + U_k u + N_k v_k + r_k, with numbers
of the arm |u| <= 1, which stay, and rounding |v| <= 1, new in every period; what is not linear is
in |r_k| <= R_k as long as |x_k| is within stated sizes (`ctc.certification.sliding`). What x_k can
be is then a zonotope. The sizes are raised until they hold it at all instants; where they never do,
there is no bound. Equations: docs/background/computed_torque.md.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any

import casadi as ca
import numpy as np

from ctc.certification.sliding import Linear, Period, linearised
from ctc.laws.computed_torque import ComputedTorque
from ctc.laws.computed_torque_pid import ComputedTorquePID
from ctc.laws.feed_forward import FeedForward, PDGravity
from ctc.laws.turning_back import switched
from plant import Law, Reference
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece
from plant.parts.tables import Table
from plant.simulation.followed_path import Path

# In which the sizes are raised, the factor by which they are beyond what was reached, and with
# which they begin.
_ROUNDS = 8
_MORE = 1.1
_BEGIN = 1e-9

_MOST = 50.0  # pulses of error beyond which it is given up
_SHARES = 1.0, 0.25, 0.0625  # of the ranges of f and friction, of which a bound is tried
# generators of rounding at most, and what is left when the old are put in a box
_COLUMNS = 3200
_RECENT = 2200
# periods whose remainders are put in one box, unless they are this share of a size
_BOXED = 16
_LARGE = 1e-4
_APART = 1e-12  # by which states have to move others to be boxed with them


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Proved(Frozen):
    """Bound of the error before rounding [pulses]; infinite where there is none.

    `rounding` (n,): by rounding of counts and torques alone: of the identified arm, whatever the
    encoders' zeros. `error` (n,): of every arm whose numbers are within a `share` of the box about
    the samples, along their principal axes. `share`: the largest of 1, 1/4 and 1/16 for which there
    is a bound, or 0. `sliding`: share of the instants at which the bound itself implies that all
    joints slide as assumed. `assumed`: what the bound takes for granted. `reason`: why there is
    none, or empty.
    """

    rounding: Floats
    error: Floats
    share: float = 0.0
    sliding: float = 0.0
    assumed: tuple[str, ...] = ()
    reason: str = ""

    def beside(self, by_counts: Floats, sampled: Floats) -> Iterator[Piece]:
        """What is proved beside what was sampled (n,) [pulses]: of f exact, and the largest
        error of the samples.
        """
        arms = (
            "all arms"
            if self.share == 1
            else f"arms within {self.share:g} of the ranges (sampled: all)"
        )
        rows = [
            ("by rounding alone, f exact", self.rounding, by_counts),
            (arms, self.error, sampled),
        ]
        if not self.reason:
            head = "largest error before rounding [pulses]", "proved", "sampled"
            each = [
                (name, *(" / ".join(f"{x:.2f}" for x in of) for of in both)) for name, *both in rows
            ]
            yield Table(head, each if self.share else each[:1])
        yield str(self)

    def __str__(self) -> str:
        if self.reason:
            return f"no bound is proved: {self.reason}"
        implied = f"which the bound implies at {100 * self.sliding:.0f} % of the instants"
        return (
            "proved for any rounding, assuming that"
            f" {', '.join((f'{_SLIDES} ({implied})', *self.assumed))}"
        )


_GROWS = "what is not linear, such as the amplifier's limit under a boost, grows without end"
_LAWS = ComputedTorque, ComputedTorquePID, FeedForward, PDGravity
_SLIDES = "joints slide the way the reference goes"


def _boxed(columns: Floats, M: Floats | None = None) -> Floats:
    """Generators that hold what these (m, c) do: a box, in their principal axes where M (m, m)
    mixes the states.
    """
    off = np.zeros((len(columns),) * 2) if M is None else np.abs(M - np.diag(np.diag(M)))
    mixes = np.asarray((off > _APART).any(axis=0))
    size = np.abs(columns).sum(axis=1)
    parts = []
    for rows in (np.flatnonzero(mixes & (size > 0)), np.flatnonzero(~mixes & (size > 0))):
        scaled = columns[rows] / size[rows, None]
        axes = (
            np.linalg.svd(scaled, full_matrices=False)[0]
            if mixes[rows].any()
            else np.eye(len(rows))
        )
        box = np.zeros((len(columns), axes.shape[1]))
        box[rows] = size[rows, None] * axes * np.abs(axes.T @ scaled).sum(axis=1)
        parts.append(box)
    return np.hstack(parts)


def _reached(linear: Linear, pulses: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Sizes (N + 1, m) of the zonotope; its centre (N + 1, m), slopes along u (N + 1, m, K), and
    how far rounding moves the joints (N + 1, n) [pulses].
    """
    count, m, K = linear.U.shape
    sizes = np.zeros((count + 1, m))
    centres = np.zeros((count + 1, m))
    slopes = np.zeros((count + 1, m, K))
    rounding = np.zeros((count + 1, len(pulses)))
    old = np.zeros((m, 0))
    rests = np.zeros((m, 0))
    for k, (M, U, N, R, off) in enumerate(
        zip(linear.M, linear.U, linear.N, linear.R, linear.off, strict=True)
    ):
        centres[k + 1], slopes[k + 1] = M @ centres[k] + off, M @ slopes[k] + U
        large = _LARGE * sizes[k] < R
        box = np.diag(R)
        old = np.hstack([M @ old, N[:, N.any(axis=0)], box[:, large]])
        rests = np.hstack([M @ rests, box[:, ~large & (R > 0)]])
        if k % _BOXED == _BOXED - 1:
            old = np.hstack([old, _boxed(rests)])
            rests = rests[:, :0]
        if old.shape[1] > _COLUMNS:
            old = np.hstack([_boxed(old[:, :-_RECENT], M), old[:, -_RECENT:]])
        rounding[k + 1] = sum(
            np.abs(pulses @ each[: len(pulses)]).sum(axis=1) for each in (old, rests)
        )
        moved = np.abs(old).sum(axis=1) + np.abs(rests).sum(axis=1)
        sizes[k + 1] = np.abs(centres[k + 1]) + np.abs(slopes[k + 1]).sum(axis=1) + moved
        if not rounding[k + 1].max() < _MOST:
            raise ValueError(_GROWS)
    return sizes, centres, slopes, rounding


def _box(names: tuple[str, ...], values: Floats) -> tuple[Floats, Floats]:
    """Centre (K,) and generators (K, r) of the smallest box about values (P, K), along their
    principal axes.

    Of the encoders' zeros, which are uniform, along each.
    """
    middle = values.mean(axis=0)
    spread = values.std(axis=0)
    own = [i for i, name in enumerate(names) if name.startswith("encoder") and spread[i] > 0]
    others = [i for i in range(len(names)) if i not in own and spread[i] > 0]
    scaled = (values - middle) / np.where(spread > 0, spread, 1.0)
    axes = np.zeros((len(names), len(own) + len(others)))
    axes[own, : len(own)] = np.eye(len(own))
    axes[others, len(own) :] = (
        np.linalg.svd(scaled[:, others], full_matrices=True)[2].T if others else 0
    )
    along = scaled @ axes
    low = along.min(axis=0)
    high = along.max(axis=0)
    return middle + spread * (axes @ (low + high) / 2), spread[:, None] * axes * (high - low) / 2


def proved(plants: Any, law: Law, reference: Reference, settings: dict[str, Any]) -> Proved:
    """Bound for the arms about some `Plants` under a law on a reference, with the settings of a
    certificate.
    """
    none = np.full(plants.rig.n, np.inf)
    bound = None
    try:
        _require(plants, law)
        task = _Task(plants, law, reference, settings)
        rounding, sliding = task.bound(0.0)
    except ValueError as why:
        return Proved(rounding=none, error=none, reason=str(why))
    for share in _SHARES:
        try:
            bound = share, *task.bound(share)
            break
        except ValueError:  # too wide
            pass
    share, error, sliding = bound or (0.0, rounding, sliding)
    return Proved(
        rounding=rounding, error=error, share=share, sliding=sliding, assumed=task.assumed
    )


def _require(plants: Any, law: Law) -> None:
    """Refuse what no bound is known of."""
    rig = plants.rig
    drive = plants.rig.drive
    effects = (
        "elasticity",
        "current_lag",
        "presliding",
        "load_friction",
        "friction_drift",
        "ripple",
        "curve",
    )
    there = {name: getattr(drive, name) for name in effects} | {
        "transport": rig.transport,
        "jitter": rig.jitter,
    }
    there |= {"quadrature": rig.encoder.quadrature, "load": plants.uncertainty.load[1] or None}
    there["a phase that is not sampled"] = None if plants.uncertainty.phase else rig.encoder.phase
    if others := [name for name, given in there.items() if given is not None]:
        raise ValueError(f"it knows rigid gears and plain friction; here is {others[0]}")
    if law.period is None or abs(law.period - rig.period) > 1e-9 * rig.period:
        raise ValueError(f"it knows laws that run once per sample; {type(law).__name__} does not")
    if not isinstance(law, _LAWS) and law.model_parts(*(ca.SX.zeros(rig.n),) * 3):
        known = ", ".join(each.__name__ for each in _LAWS)
        raise ValueError(
            f"it knows {known} and laws without a model; {type(law).__name__} is another"
        )


class _Task:
    """The nominal loop, and the box of what is sampled."""

    def __init__(
        self, plants: Any, law: Law, reference: Reference, settings: dict[str, Any]
    ) -> None:
        rig = plants.nominal
        sliding = law.sliding()
        names, values = plants.numbers()
        known = dict(zip(rig.number_names(), rig.number_values().tolist(), strict=True))
        known |= dict(zip(plants.arm.dynamics.names, plants.arm.f.tolist(), strict=True))
        self._zeros = np.array([name.startswith("encoder.phase") for name in names])
        self._nominal = np.array([known.get(name, 0.0) for name in names])
        self._centre, self._basis = _box(names, values)
        samples = int(np.ceil(settings["duration"] / rig.period - 1e-9))
        steps = settings["steps_per_sample"]
        own = [name for name, zero in zip(names, self._zeros, strict=True) if not zero]
        self._period = Period(plants.arm, rig, law, Path(reference, rig), samples, steps, own)
        self._counted = np.arange(samples) * rig.period >= settings["after"] - 1e-9 * rig.period
        boosts = False
        learns = getattr(law, "learn_friction", False)
        self._held = list[int]()
        if isinstance(law, ComputedTorque) and law.gear_gains is None:
            boosts = law.start_boost != 1
            self._held = [*switched(sliding, rig.n)]
        said = (
            ("no friction is learnt", learns),
            ("boosts are those of the reference, none of counts", boosts),
        )
        self.assumed = tuple(text for text, there in said if there)

    def bound(self, share: float) -> tuple[Floats, float]:
        """Largest error (n,) [pulses] for a share of the ranges, and how often sliding is
        implied; or ValueError.
        """
        period = self._period
        n = self._period.n
        shares = np.where(self._zeros, 1.0, share)
        centre = self._nominal + shares * (self._centre - self._nominal)
        basis = shares[:, None] * self._basis
        zeros = self._zeros
        shift = (
            (centre[zeros], basis[zeros])
            if zeros.any()
            else (np.zeros(n), np.zeros((n, basis.shape[1])))
        )
        run = period.nominal(centre[~zeros], shift[0])
        sizes = np.full(run.shape, _BEGIN)
        last = np.inf
        grown = np.inf
        sizes[0] = 0
        for tried in range(_ROUNDS):
            with np.errstate(all="ignore"):  # what is infinite is no bound
                loop = linearised(
                    period, run, sizes, centre[~zeros], basis[~zeros], shift, self._held
                )
                reached, centres, slopes, rounding = _reached(loop, period.pulses)
            if (reached <= sizes).all():
                break
            last, grown, before = float(rounding.max()), rounding.max() - last, grown
            if tried > 2 and grown > before > 0:
                raise ValueError(_GROWS)
            sizes = np.where(reached > 0, np.maximum(_MORE * reached, sizes), 0.0)
        else:
            raise ValueError(_GROWS)
        error = (period.given[:, :n] - run[:-1, :n] - centres[:-1, :n]) @ period.pulses.T - shift[0]
        by_numbers = np.abs(period.pulses @ slopes[:-1, :n] + shift[1]).sum(axis=2)
        largest = (np.abs(error) + by_numbers + rounding[:-1])[self._counted].max(axis=0)
        speed = period.given[:, n : 2 * n]
        off = np.abs(period.given[:, n : 2 * n] - run[:-1, n : 2 * n])
        slides = (np.abs(speed) > off + reached[:-1, n : 2 * n])[self._counted].all(axis=1)
        return largest, float(slides.mean())
