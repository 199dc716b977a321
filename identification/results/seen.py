"""Coverage of the logs: detectable resonances, range of motion, combinations of f from a prior."""

from collections.abc import Iterator
from dataclasses import field
from typing import Any, NamedTuple

import numpy as np

from identification.equation_error import unexcited
from plant import Record, Reference
from plant.checkup import on_lines
from plant.parts import Floats, Frozen, Piece, Table, frozen, frozen_settings, kept, several

APART = 20  # samples from one position to the next for a speed


@frozen_settings
class CoverageSettings:
    """Limits of what a log covers, and of what it leaves to a prior; chosen by hand.

    Parameters
    ----------
    beyond : float
        Share of a log's range, or of its largest speed, by which a path may leave it.
    points : int
        Instants of a path at which it is compared with the log.
    from_log : float
        Share of its prior standard deviation below which a combination of f comes from the log.
    terms : int
        Parameters that name a combination, at most.
    coefficient : float
        Coefficient of a parameter, relative to the largest, below which it is not named.
    by_chance : float
        Probability with which a log contradicts a prior that is right.
    deciding : float
        Share of the variance of a value, due to tolerances, from which on its name is printed.
    named : int
        Such values whose names are printed, at most.
    least_pull : float
        Relative variance that even a narrow prior loses to the log, at least.
    """

    beyond: float = 0.1
    points: int = 1000
    from_log: float = 0.5
    terms: int = 3
    coefficient: float = 0.2
    by_chance: float = 1e-4
    deciding: float = 0.3
    named: int = 5
    least_pull: float = 1e-3


SETTINGS = CoverageSettings()


@kept
@frozen
class Seen(Frozen):
    """Coverage of a path by the logs of an identification.

    Attributes
    ----------
    resonance : float or None
        Locked-rotor resonance [Hz] below which the gear of any joint would have contradicted the
        log; None where that was not tested, or gears are elastic already.
    beyond : tuple of str
        Joints whose angles or speeds on the path leave those of the logs, with both.
    friction : dict
        Standard deviation with which the log would identify friction that was not unknown, by the
        number's name.
    by_tolerances : dict
        Share of the variance of each identified value that comes from the tolerances of the rig, by
        the value's name.
    tolerances : str
        These tolerances.
    """

    resonance: float | None
    beyond: tuple[str, ...]
    friction: dict[str, float] = field(default_factory=dict)
    by_tolerances: dict[str, float] = field(default_factory=dict)
    tolerances: str = ""


def seen(identification: Any, reference: Reference, duration: float) -> Seen:
    """Coverage of a path of this duration [s] by the logs of an `Identification`."""
    # By the names that a user would add to the unknowns.
    friction = {
        f"drive.{name}": std for name, std in identification.diagnostics.detection.friction.items()
    }
    return Seen(
        resonance=_resonance(identification),
        beyond=tuple(_beyond(identification, reference, duration)),
        friction=friction,
        by_tolerances=by_tolerances(identification),
        tolerances=identification.search.tolerances.within,
    )


def by_tolerances(identification: Any) -> dict[str, float]:
    """Share of the variance of each value that comes from the tolerances of the rig."""
    fit = identification.fit
    doubt = identification.diagnostics.detection.doubt
    # Only a covariance that was widened has a part by tolerances.
    if fit.noise_covariance is None or doubt is None:
        return {}
    return {
        name: float(min(added / std**2, 1.0))
        for name, added, std in zip(fit.unknown, np.diag(doubt), fit.std, strict=True)
        if std > 0
    }


def drifting(identification: Any) -> str:
    """What the difference from a simulation means where a log replays its torque; else empty."""
    laws = [record.law for record in identification.records]
    replaying = [type(law).__name__ for law in laws if law is not None and law.replays]
    if not replaying:
        return ""
    return (
        f"{replaying[0]} drives the simulated arm in open loop, where small errors of the torque"
        " add up to a drift; the RMS innovation says how closely the model follows"
    )


def counted(identification: Any) -> str:
    """What the intervals count, and the share of it that tolerances are."""
    if identification.fit.finds_gears:
        return "intervals count noise alone, no tolerance of the rig: its gears are unknown"
    tolerances = identification.search.tolerances
    text = f"intervals count noise and {tolerances}"
    shares = by_tolerances(identification)
    if not shares or not tolerances.within:
        return text
    names = dict(zip(identification.fit.unknown, identification.short_names, strict=True))
    # Those that decide about a value, and the largest share of all others.
    large = [name for name in shares if shares[name] > SETTINGS.deciding]
    large.sort(key=lambda name: -shares[name])
    parts = [several([f"{shares[name]:.0%} of {names[name]}" for name in large], SETTINGS.named)]
    others = [share for name, share in shares.items() if name not in large]
    if others:
        parts.append(f"at most {max(others):.0%} of any {'other' * bool(large) or 'value'}")
    default = " (defaults, which nobody stated)" if type(tolerances)() == tolerances else ""
    return (
        f"{text}; shares of the variance that these tolerances{default} make up:"
        f" {', '.join(filter(None, parts))}; tolerances=Tolerances(gear=...) states yours"
    )


def _resonance(identification):
    """Lowest of the detectable resonances of the joints [Hz]; None where it was not tested."""
    detection = identification.diagnostics.detection
    visible = [
        sign.visible
        for sign in detection.signs
        if sign.name == "compliance" and not sign.significant
    ]
    # Compliance was not tested: the test failed, or the gears are elastic already.
    if detection.reason is not None or not visible or not visible[0]:
        return None
    return float(min(compliance**-0.5 for compliance in visible[0].values()))


def _beyond(identification, reference, duration):
    """A text for each joint whose path leaves the range or the speeds of the logs."""
    logged = [motion_of(record) for record in identification.records]
    # The range of all logs together.
    low = np.min([q.min(axis=0) for q, _ in logged], axis=0)
    high = np.max([q.max(axis=0) for q, _ in logged], axis=0)
    fastest = np.max([np.abs(qd).max(axis=0) for _, qd in logged], axis=0)
    path = reference(np.linspace(0.0, duration, SETTINGS.points))
    lines = []
    # A little beyond the range, the model still holds.
    room = SETTINGS.beyond * (high - low)
    chain = identification.arm.dynamics.chain
    for i, (unit, label) in enumerate(zip(chain.joint_units, chain.joint_labels, strict=True)):
        # Angles by the range, speeds by the largest one: their sign does not matter.
        lowest = path.q[:, i].min()
        highest = path.q[:, i].max()
        speed = np.abs(path.qd[:, i]).max()
        texts = []
        if lowest < low[i] - room[i] or highest > high[i] + room[i]:
            texts.append(
                f"{lowest:z.2f} to {highest:z.2f} {unit.position}"
                f" (log: {low[i]:z.2f} to {high[i]:z.2f})"
            )
        if speed > (1 + SETTINGS.beyond) * fastest[i]:
            texts.append(f"{speed:.2g} {unit.speed} (log: {fastest[i]:.2g})")
        if texts:
            lines.append(f"{label} {' and '.join(texts)}")
    return lines


def motion_of(record: Record) -> tuple[Floats, Floats]:
    """Positions (N, n) and speeds (M, n) of a log, from its counts."""
    # Rows without weight may hold anything.
    q = record.rig.to_angle(on_lines(record, record.valid == 0).counts)
    # Over several samples, so that rounding makes no speed.
    stride = slice(None, None, min(APART, len(q) - 1))
    return q, np.diff(q[stride], axis=0) / np.diff(record.t[stride])[:, None]


class Combinations(NamedTuple):
    """Independent combinations of f under a prior, those best known from the log first.

    `names`: of f. `axes` (p, p): coefficients of f, a combination per column, so that the prior has
    a standard deviation of 1. `shares` (p,): standard deviations after the log. `off` (p,):
    distances from the mean of the prior, in its standard deviations.
    """

    names: tuple[str, ...]
    axes: Floats
    shares: Floats
    off: Floats


def combinations_of(identification: Any) -> Combinations | None:
    """Combinations of f of an `Identification`; None without a prior, or without a covariance."""
    fit = identification.fit
    prior = fit.prior
    if prior is None or fit.covariance is None or fit.fallback_reason is not None:
        return None
    # In whitened coordinates the prior is a sphere: the axes of the covariance are independent in
    # both.
    covariance = prior.whitening @ fit.covariance_of(prior.names) @ prior.whitening.T
    # Small eigenvalues first: the combinations that the log determines best.
    squares, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    axes = prior.whitening.T @ axes
    off = axes.T @ (identification.f - prior.mean)
    return Combinations(
        identification.arm.dynamics.short_names, axes, np.sqrt(np.clip(squares, 0.0, 1.0)), off
    )


def of_prior(identification: Any) -> list[str]:
    """Parameters of f that the log leaves to the prior, each by itself; none without a prior."""
    if combinations_of(identification) is None:
        return []
    # Of each parameter by itself, whatever the combinations.
    prior = identification.fit.prior
    shares = np.sqrt(
        np.diag(identification.fit.covariance_of(prior.names)) / np.diag(prior.covariance)
    )
    return [
        name
        for name, share in zip(identification.arm.dynamics.short_names, shares, strict=True)
        if share > SETTINGS.from_log
    ]


def origins(identification: Any, full: bool) -> Iterator[Piece]:
    """Origin of f: which combinations come from the log, and which from the prior; full: all."""
    combinations = combinations_of(identification)
    if combinations is None:
        return
    prior = identification.fit.prior
    std = np.sqrt(np.diag(prior.covariance))
    from_prior = np.flatnonzero(combinations.shares >= SETTINGS.from_log)
    count = len(std)
    if idle := unexcited(identification.arm.dynamics, identification.records):
        yield f"the log does not excite all: {', '.join(idle)}"
    yield (
        f"from the prior ({100 * prior.spread:.3g} %), of whose standard deviation the log leaves"
        f" more than {100 * SETTINGS.from_log:.0f} %:"
        f" {', '.join(of_prior(identification)) or 'no parameter alone'}; of {count} independent"
        f" combinations of f {count - len(from_prior)} come from the log, {len(from_prior)} from"
        " the prior"
    )
    # One row per combination; short, those that the log determines least come first.
    rows = dict[str, tuple[str, str]]()  # combinations that print alike count once
    for i in from_prior if full else from_prior[::-1]:
        # Coefficients in units of the prior's standard deviations, the largest one 1.
        parts = combinations.axes[:, i] * std
        order = np.argsort(-np.abs(parts))[: SETTINGS.terms]
        parts = parts / parts[order[0]]
        # Small coefficients are left out of the name.
        terms = [
            f"{parts[k]:+.2g} {combinations.names[k]}"
            for k in order
            if abs(parts[k]) > SETTINGS.coefficient
        ]
        # The standard deviation after the log, and the distance from the prior.
        numbers = (f"{combinations.shares[i]:.0%}", f"{combinations.off[i]:+.1f}")
        rows.setdefault(", ".join(terms).lstrip("+"), numbers)
    if rows:
        cells = [(name, *values) for name, values in rows.items()]
        head = "from the prior"
        if not full:
            cells = cells[: SETTINGS.terms]
            head = f"from the prior, least told first, {len(cells)} of {len(from_prior)}"
        yield Table((f"{head} (f in its standard deviations)", "left", "off"), cells, words=(0,))


def contradicted(identification: Any) -> Iterator[str]:
    """A line where the log contradicts the prior by more than its spread."""
    from scipy.special import chdtrc

    combinations = combinations_of(identification)
    if combinations is None:
        return
    # The variance of a combination's distance is that which the prior loses to the log.
    pulled = combinations.shares < SETTINGS.from_log
    room = 1 - combinations.shares**2
    if not pulled.any():  # of a narrow prior, every small pull from the log counts
        pulled = np.ones(len(room), bool)
        room = np.maximum(room, SETTINGS.least_pull)
    chi_square = float((combinations.off[pulled] ** 2 / room[pulled]).sum())
    if chdtrc(pulled.sum(), chi_square) < SETTINGS.by_chance:
        prior = identification.fit.prior
        # The message names single parameters, which a user can look up.
        off = (identification.f - prior.mean) / np.sqrt(np.diag(prior.covariance))
        farthest = np.argsort(-np.abs(off))[: SETTINGS.terms]
        names = ", ".join(f"{combinations.names[k]} by {off[k]:+.1f}" for k in farthest)
        yield (
            f"the log contradicts the prior: {names} of its standard deviations (chi-square"
            f" {chi_square:.0f} of {pulled.sum()}); what comes from the prior may be as wrong."
            " Check its bodies, or widen the spread."
        )
