"""What the logs of an identification show, what they leave to a prior, and where a path leaves
them.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from identification.equation_error.excitation import unexcited
from plant import Record, Reference
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece
from plant.parts.tables import Table

_BEYOND = 0.1  # share of a log's range, or of its largest speed, by which a path may leave it

_POINTS = 1000  # instants of a path at which it is looked at

APART = 20  # samples from one position to the next for a speed


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Seen(Frozen):
    """What the searched logs show, beside a path.

    Attributes
    ----------
    resonance : float or None
        Gears of any joint that resonate below this would have contradicted the log [Hz]; None where
        that was not tested, or gears are elastic already.
    beyond : tuple of str
        Where the path leaves angles and speeds of the logs, a joint each.
    friction : dict
        Standard deviation with which the log would identify friction that was not unknown, by the
        number's name.
    """

    resonance: float | None
    beyond: tuple[str, ...]
    friction: dict[str, float] = dataclasses.field(default_factory=dict)


def seen(found: Any, reference: Reference, duration: float) -> Seen:
    """What the logs of an `Identification` show, beside so many seconds of a path."""
    friction = {f"drive.{name}": std for name, std in found.diagnostics.detection.friction.items()}
    return Seen(
        resonance=_resonance(found),
        beyond=tuple(_beyond(found, reference, duration)),
        friction=friction,
    )


def _resonance(found: Any) -> float | None:
    """Lowest of the joints' resonances below which compliance would have been seen."""
    detection = found.diagnostics.detection
    visible = [
        sign.visible
        for sign in detection.signs
        if sign.name == "compliance" and not sign.significant
    ]
    if detection.reason is not None or not visible or not visible[0]:
        return None
    return float(min(value**-0.5 for value in visible[0].values()))


def _beyond(found: Any, reference: Reference, duration: float) -> list[str]:
    logged = [motion_of(record) for record in found.records]
    low = np.min([q.min(axis=0) for q, _ in logged], axis=0)
    high = np.max([q.max(axis=0) for q, _ in logged], axis=0)
    fastest = np.max([np.abs(qd).max(axis=0) for _, qd in logged], axis=0)
    path = reference(np.linspace(0.0, duration, _POINTS))
    lines = []
    room = _BEYOND * (high - low)
    chain = found.arm.dynamics.chain
    for i, (link, label) in enumerate(zip(chain.links, chain.joint_labels, strict=True)):
        unit = "m" if link.prismatic else "rad"
        first = path.q[:, i].min()
        last = path.q[:, i].max()
        speed = np.abs(path.qd[:, i]).max()
        said = []
        if first < low[i] - room[i] or last > high[i] + room[i]:
            said.append(
                f"{first:z.2f} to {last:z.2f} {unit} (log: {low[i]:z.2f} to {high[i]:z.2f})"
            )
        if speed > (1 + _BEYOND) * fastest[i]:
            said.append(f"{speed:.2g} {unit}/s (log: {fastest[i]:.2g})")
        if said:
            lines.append(f"{label} {' and '.join(said)}")
    return lines


def motion_of(record: Record) -> tuple[Floats, Floats]:
    """Positions (N, n) and speeds (M, n) of a log, from its counts."""
    q = record.rig.to_angle(record.counts)
    every = slice(None, None, min(APART, len(q) - 1))
    return q, np.diff(q[every], axis=0) / np.diff(record.t[every])[:, None]


# share of its prior standard deviation below which a combination of f comes from the log
_TOLD = 0.5

# parameters that name a combination, at most, and the least coefficient of one
_TERMS = 3
_SMALL = 0.2

# Probability with which a log contradicts a prior that is right; least variance of what it moves a
# narrow one by.
_CHANCE = 1e-4
_PULL = 1e-3


class Told(NamedTuple):
    """Independent combinations of f under a prior, best told first: `names` of f; `axes` (p, p):
    their coefficients of f, in columns, so that the prior has a standard deviation of 1; `shares`
    (p,): standard deviations that are left; `off` (p,): from the mean of the prior, in its standard
    deviations.
    """

    names: tuple[str, ...]
    axes: Floats
    shares: Floats
    off: Floats


def told(found: Any) -> Told | None:
    """What the log of an `Identification` tells beside its prior; None without one, or without a
    covariance.
    """
    prior = found.fit.prior
    fit = found.fit
    if prior is None or fit.covariance is None or fit.fallback_reason is not None:
        return None
    left = prior.whitening @ fit.covariance_of(prior.names) @ prior.whitening.T
    squares, axes = np.linalg.eigh((left + left.T) / 2)
    axes = prior.whitening.T @ axes
    off = axes.T @ (found.f - prior.mean)
    return Told(found.arm.dynamics.short_names, axes, np.sqrt(np.clip(squares, 0.0, 1.0)), off)


def of_prior(found: Any) -> list[str]:
    """Which parameters of f the log leaves to the prior, each by itself; none where nothing of
    that is known.
    """
    if told(found) is None:
        return []
    prior = found.fit.prior
    shares = np.sqrt(np.diag(found.fit.covariance_of(prior.names)) / np.diag(prior.covariance))
    return [
        name
        for name, share in zip(found.arm.dynamics.short_names, shares, strict=True)
        if share > _TOLD
    ]


def origins(found: Any, full: bool) -> Iterator[Piece]:
    """Which combinations of f come from the log, and which from the prior, best told first;
    full: all of these.
    """
    if (told_of := told(found)) is None:
        return
    std = np.sqrt(np.diag(found.fit.prior.covariance))
    those = np.flatnonzero(told_of.shares >= _TOLD)
    count = len(std)
    spread = 100 * found.fit.prior.spread
    if idle := unexcited(found.arm.dynamics, found.records):
        yield f"the log does not excite all: {', '.join(idle)}"
    yield (
        f"from the prior ({spread:.3g} %), of whose standard deviation the log leaves more than"
        f" {100 * _TOLD:.0f} %: {', '.join(of_prior(found)) or 'no parameter alone'}; of {count}"
        f" independent combinations of f {count - len(those)} come from the log, {len(those)} from"
        " the prior"
    )
    rows = dict[str, tuple[str, str]]()  # combinations that print alike count once
    for i in those if full else those[::-1]:
        parts = told_of.axes[:, i] * std
        order = np.argsort(-np.abs(parts))[:_TERMS]
        parts = parts / parts[order[0]]
        terms = [f"{parts[k]:+.2g} {told_of.names[k]}" for k in order if abs(parts[k]) > _SMALL]
        rows.setdefault(
            ", ".join(terms).lstrip("+"), (f"{told_of.shares[i]:.0%}", f"{told_of.off[i]:+.1f}")
        )
    if rows:
        cells = [(name, *values) for name, values in rows.items()][: None if full else _TERMS]
        head = (
            "from the prior"
            if full
            else f"from the prior, least told first, {len(cells)} of {len(those)}"
        )
        yield Table((f"{head} (f in its standard deviations)", "left", "off"), cells, words=(0,))


def contradicted(found: Any) -> Iterator[str]:
    """A line where the log contradicts the prior by more than its spread."""
    from scipy.special import chdtrc

    if (told_of := told(found)) is None:
        return
    seen_ones = told_of.shares < _TOLD
    room = 1 - told_of.shares**2
    if not seen_ones.any():  # then little pull from the log is much
        seen_ones = np.ones(len(room), bool)
        room = np.maximum(room, _PULL)
    chi_square = float((told_of.off[seen_ones] ** 2 / room[seen_ones]).sum())
    if chdtrc(seen_ones.sum(), chi_square) < _CHANCE:
        off = (found.f - found.fit.prior.mean) / np.sqrt(np.diag(found.fit.prior.covariance))
        most = ", ".join(
            f"{told_of.names[k]} by {off[k]:+.1f}" for k in np.argsort(-np.abs(off))[:_TERMS]
        )
        yield (
            f"the log contradicts the prior: {most} of its standard deviations (chi-square"
            f" {chi_square:.0f} of {seen_ones.sum()}); what comes from the prior may be as wrong."
            " Check its bodies, or widen the spread."
        )
