"""Texts of a certificate: its verdict, its advice, and the lists of sampled effects."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ctc.certification.imperfections import IMPERFECTIONS
from ctc.verdict import LOWEST, in_play, slow_profiles
from plant.motion import slowing
from plant.parts import (
    Aside,
    Floats,
    Piece,
    Table,
    Verdict,
    by_joint,
    frozen_settings,
    heading,
    largest_cell,
    significant,
    with_units,
)


@frozen_settings
class AdviceSettings:
    """Thresholds of the advice that a certificate gives, all chosen by hand.

    Parameters
    ----------
    f_share : float
        Part of the explained variance above which uncertain f decides.
    f_share_of_all : float
        Part of the whole variance that f must explain besides.
    friction_remaining : float
        Friction decides if less than this part of the failures remains with friction identified.
    nominal_failures : float
        Probability of failure above which the nominal arm on gears is not reported, and friction
        may decide whatever the order of the sensitivities.
    tolerances : float
        The advice is to state tolerances if they cause more than this part of a value's variance.
    influences : int
        Rows of the table of sensitivities.
    """

    f_share: float = 0.5
    f_share_of_all: float = 0.25
    friction_remaining: float = 0.5
    nominal_failures: float = 0.5
    tolerances: float = 0.5
    influences: int = 5


SETTINGS = AdviceSettings()

# Words that a verdict adds if its motion starts from a hold.
_FROM_HOLD = " from a hold, static friction anywhere inside its cone"

# Advice that `tune` leaves out: it has just searched.
SEARCH = (
    "another controller may hold: tune searches for it along this path, under the same uncertainty"
)


def _exceeding(certificate: Any, failing: str, holding: str) -> str:
    """Say how many samples exceed the limit, without and with the start, and state the bound.

    `failing` follows the limit where samples exceed it, `holding` where none does.
    """
    # 1. The phrases.
    samples = f"{len(certificate.plants):,} Monte Carlo samples"
    within = certificate.within
    limit = f"±{within:g} pulse{'s' * (within != 1)}"
    confidence = f"with {100 * certificate.confidence:g} % confidence"
    bound = percent(certificate.upper, up=True)
    cell = certificate.worst_cell
    # Where resonances are stated the bound is that of their worst cell.
    population = "of all would" if cell is None else f"would at the worst resonance ({cell})"
    # 2. What was counted, and the bound of the whole distribution.
    if certificate.failures:
        count = f"{percent(certificate.probability)} of {samples} exceed {limit} {failing}"
        bounded = f"; {confidence}, at most {bound} {population}"
    else:
        count = f"None of {samples} exceeds {limit}{holding}"
        bounded = f"; {confidence}, fewer than {bound} {population}"
    if bound == percent(1.0):  # 100 % is no bound
        bounded = _worst(cell)
    sentence = f"{count}{bounded}."
    # 3. What `after` hides.
    if certificate.failures_before:
        early = percent(certificate.failures_before / len(certificate.plants))
        with_start = percent(certificate.failures_with_start / len(certificate.plants))
        start = f"In the first {certificate.settings['after']:g} s, which do not count"
        sentence = f"{sentence} {start}, {early} exceed it; then or later, {with_start}."
    return sentence


def verdict_of_set(certificates: Any) -> str:
    """Verdict of `Certificates`: the motions in which samples exceed the limit, and the worst."""
    count = len(certificates)
    worst = certificates.worst
    held = _FROM_HOLD * certificates.settings.get("held", False)
    sentence = _exceeding(
        certificates, f"in some of {count} motions{held}", f" in any of {count} motions{held}"
    )
    # Failures of the set do not tell whether one motion or all cause them.
    failing = sum(certificate.failures > 0 for certificate in certificates.values())
    if failing:
        share = percent(certificates[worst].probability)
        sentence = f"{sentence} It happens in {failing} of them, most often in {worst!r} ({share})."
    return sentence


def verdict(certificate: Any) -> str:
    """Verdict of a `Certificate`, with the gears on which it holds."""
    # 1. The samples; then the nominal arm, if it fails from rest.
    held = _FROM_HOLD * certificate.settings.get("held", False)
    sentence = _exceeding(certificate, f"at some sampling instant{held}", held)
    if certificate.from_rest is not None:
        from_rest = str(certificate.from_rest)
        sentence = f"{sentence} {from_rest[:1].upper()}{from_rest[1:]}."
    # `_against_the_log` names the joints.
    if certificate.seen is not None and certificate.seen.beyond:
        sentence = f"{sentence} The path exceeds angles or speeds of the log."
    # 2. The gears, which no sample had where they are rigid.
    gears = certificate.on_gears
    if gears is None:
        return sentence
    # Of a controller that fails on most samples the nominal arm says little.
    if certificate.probability > SETTINGS.nominal_failures:
        return f"{sentence} Rigid gears assumed."
    # The nominal arm was simulated with the stated imperfections at their worse ends.
    stated = certificate.plants.uncertainty.imperfections
    # Of a range about zero, the end with the larger magnitude.
    ends = {name: max(stated.get(name, (0.0,)), key=abs) for name in IMPERFECTIONS}
    rows = [(IMPERFECTIONS[name], value) for name, value in ends.items() if value]
    imperfections = [f"{row.words} {value:g} {row.unit}" for row, value in rows]
    beside = f", with {', '.join(imperfections)}," if imperfections else ""
    return (
        f"{sentence} Rigid gears assumed; the nominal arm{beside}"
        f" {gears}.{_unseen(certificate, gears.hz)}"
    )


def _unseen(certificate: Any, hz: float) -> str:
    """Whether the log would show gears, below a resonance [Hz], on which the limit is exceeded."""
    shown = None if certificate.seen is None else certificate.seen.resonance
    # A loop that holds at every resonance tested has no such gears; of NaN nothing is known.
    if shown is None or not hz > LOWEST:
        return ""
    # The log excludes all gears on which the limit is exceeded.
    if hz <= shown:
        return f" Gears that resonate below {shown:.3g} Hz would have shown in the log."
    # An infinite resonance leaves no finite range to state.
    unseen = f"above {shown:.3g} Hz"
    stated = "resonance= as it was measured"
    if np.isfinite(hz):
        unseen = f"from {shown:.3g} to {hz:.3g} Hz"
        stated = f"resonance=({shown:.3g}, {hz:.3g})"
    return (
        f" The log shows gears that resonate below {shown:.3g} Hz, not those {unseen}: certify with"
        f" {stated}."
    )


def shown(certificate: Any) -> Iterator[Piece]:
    """A `Certificate` as it is printed, the verdict first."""
    # 1. Rows of single numbers.
    worst = certificate.worst
    runs = certificate.runs
    rows = [("share of sampling instants beyond the limit", percent(certificate.share_outside))]
    start = certificate.settings["after"]
    if start:
        count = f"of {len(certificate.plants)}"
        early = f"{certificate.failures_before} {count}"
        with_start = f"{certificate.failures_with_start} {count}"
        rows.append((f"samples that exceed it before {start:g} s", early))
        rows.append(("samples that exceed it at any time", with_start))
    # Where all samples hold there is no violation, and where all diverge no time of one.
    if np.isfinite(runs.first).any():
        rows.append(("time of the first violation, median [s]", f"{np.nanmedian(runs.first):.3f}"))
    peak = f"peak {worst.peak:.0f} pulses" if np.isfinite(worst.peak) else "diverges"
    rows.append(("worst sample", f"number {worst.index}, {peak}"))
    # 2. Rows with a number for each joint.
    # "higher" takes the error of one sample; it does not interpolate to an infinite neighbour.
    high_quantile = np.quantile(runs.unrounded, 0.99, axis=0, method="higher")
    pulses = "{:.2f}".format
    unrounded = runs.unrounded
    chain = certificate.plants.arm.dynamics.chain
    efforts = chain.effort_units
    chatter = with_units(map(significant, np.median(runs.chatter, axis=0)), efforts)
    quantities: list[tuple[str, Floats, Callable[[float], str]]] = [
        ("encoder error, worst peak [pulses]", runs.peak.max(axis=0), "{:.0f}".format),
        ("error before rounding, median peak [pulses]", np.median(unrounded, axis=0), pulses),
        ("error before rounding, 99 % below [pulses]", high_quantile, pulses),
        ("by rounding alone, f exact, peak [pulses]", certificate.by_counts, pulses),
    ]
    texts = [(title, *map(form, values)) for title, values, form in quantities]
    texts += [
        (heading("torque chatter per sample, median", efforts), *chatter),
        ("motor current, median peak / limit", *map("{:.0%}".format, certificate.current_share)),
        ("samples that reach the torque limit", *map(percent, certificate.saturation)),
    ]
    # The verdict first, then what it rests on, then what to do.
    yield Verdict(f"{type(certificate.law).__name__}: {certificate.verdict}", certificate.holds)
    yield Table((), rows)
    if certificate.rare is not None:
        yield str(certificate.rare)
    yield by_joint(chain.joint_labels, texts)
    yield from _of_servos(certificate)
    yield from _explained(certificate)
    if certificate.seen is not None:
        yield from _against_the_log(certificate)
    yield "for this path alone: everyday_motions(arm, rig) gives others"


def _of_servos(certificate: Any) -> Iterator[Piece]:
    """What the inner loops of servos cannot do on this path."""
    labels = certificate.plants.arm.dynamics.chain.joint_labels
    worst = certificate.worst
    peak = certificate.runs.peak[worst.index]
    times = np.arange(0.0, certificate.settings["duration"], worst.rig.period)
    yield from in_play(worst.rig, labels, peak, certificate.within)
    yield from slow_profiles(worst.rig, labels, certificate.reference(times).qd)


def shown_set(certificates: Any) -> Iterator[Piece]:
    """`Certificates` as they are printed: one row per motion."""
    # Columns about the start only where a start was left out.
    start = certificates.settings["after"]
    efforts = certificates.plants.arm.dynamics.chain.effort_units
    from_start = f" after {start:g} s" if start else ""
    head = [
        "motion",
        f"exceed{from_start}, of {len(certificates.plants)}",
        "at most",
        "peak [pulses]",
        heading("chatter", efforts),
    ]
    if start:
        head += [f"exceed before {start:g} s", "exceed at any time"]
    rows = []
    for name, certificate in certificates.items():
        row = [
            name,
            f"{certificate.failures}",
            percent(certificate.upper, up=True),
            f"{certificate.runs.peak.max():.0f}",
            largest_cell(np.median(certificate.runs.chatter, axis=0), efforts),
        ]
        if start:
            row += [f"{certificate.failures_before}", f"{certificate.failures_with_start}"]
        rows.append(row)
    yield Verdict(f"{type(certificates.law).__name__}: {certificates.verdict}", certificates.holds)
    yield Table(head, rows)
    if certificates.rare is not None:
        yield str(certificates.rare)
    yield from _explained(certificates)
    # The certificate of each motion has the ranges.
    beyond = [
        name
        for name, certificate in certificates.items()
        if certificate.seen is not None and certificate.seen.beyond
    ]
    if beyond:
        yield f"motions that exceed angles or speeds of the log: {', '.join(beyond)}"
    # The run from rest is one of each path.
    for name, certificate in certificates.items():
        yield from (f"{name}: {line}" for line in _of_servos(certificate))
        if certificate.from_rest is not None:
            yield f"{name}: {certificate.from_rest}"
    # Of a controller that fails on most samples the nominal arm says little.
    if certificates.probability > SETTINGS.nominal_failures:
        return
    on_gears = [certificate for certificate in certificates.values() if certificate.on_gears]
    if on_gears:
        # All motions must hold: the one that needs the stiffest gears decides. Only a failure on
        # rigid gears decides before one that is unknown.
        unknown = np.finfo(float).max
        hardest = max(
            on_gears, key=lambda x: np.nan_to_num(x.on_gears.hz, nan=unknown, posinf=np.inf)
        )
        unseen = _unseen(hardest, hardest.on_gears.hz)
        yield f"rigid gears assumed; the nominal arm, in all motions, {hardest.on_gears}.{unseen}"


def _explained(certificate: Any) -> Iterator[Piece]:
    """Sensitivities, advice, and the effects that were sampled and those that were not."""
    influences = certificate.sensitivities
    plants = certificate.plants
    dynamics = plants.arm.dynamics
    short = dict(zip(dynamics.names, dynamics.short_names, strict=True))
    # Short names of f, and words for offsets; all other names are printed as they are.
    zeros = {name: name.replace("encoder.phase.shift", "encoder zero") for name in plants.names}
    labels = {**zeros, **short}
    rows = influences[: SETTINGS.influences]
    table = [(labels.get(x.name, x.name), f"{x.share:.0%}", x.sense) for x in rows]
    yield Table(("sensitivity to", "share of variance", "direction"), table, words=(2,))
    meanings = [f"{short[x.name]} = {x.name}" for x in rows if short.get(x.name, x.name) != x.name]
    yield Aside("What the parameters mean", meanings)
    if certificate.failures:
        yield from _advice(certificate)
    if plants.redrawn:
        yield f"{plants.redrawn} samples were no arm, and were replaced"
    # Both are exceptions from the stated distribution, so they are reported.
    share = plants.projected / len(plants)
    if share:
        yield (
            f"{percent(share)} of the samples were moved towards the identified arm, until they are"
            " arms"
        )
    for title, names in zip(("sampled", "not sampled"), plants.said, strict=True):
        yield f"{title}: {', '.join(names)}"


def _advice(certificate: Any) -> Iterator[str]:
    """What to do where samples exceed the limit: about torque, else friction, else f and search."""
    # 1. Beyond the motors' torque neither knowledge nor control helps.
    beyond = _beyond_motors(certificate)
    if beyond:
        yield f"no controller can hold it: {beyond}"
        return
    # 2. Friction is identified from the log that is there already.
    remaining = _friction(certificate)
    if remaining is not None:
        advice = (
            f"{percent(remaining)} of the first samples exceed the limit. Call identify(...,"
            ' unknown="friction")'
        )
        yield f"uncertain friction decides: with friction identified from this log, {advice}"
        return
    # 3. If f decides, advise how to narrow it. 4. In any case, advise a search for a controller.
    # f decides if it explains both most of the explained variance and enough of the whole.
    influences = certificate.sensitivities
    names = certificate.plants.arm.dynamics.names
    of_f = sum(x.share for x in influences if x.name in names)
    explained = sum(x.share for x in influences)
    if of_f > max(SETTINGS.f_share * explained, SETTINGS.f_share_of_all):
        largest = next(x.name for x in influences if x.name in names)
        yield f"the uncertainty of f decides: {_narrower(certificate, largest)}"
    yield SEARCH


def _narrower(certificate: Any, name: str) -> str:
    """How the interval of a value becomes narrower."""
    seen = certificate.seen
    share = 0.0 if seen is None else seen.by_tolerances.get(name, 0.0)
    # More records do not tell a gear from a mass: only a better statement does.
    if share > SETTINGS.tolerances:
        return (
            f"{share:.0%} of the variance of {name} comes from tolerances of the rig"
            f" ({seen.tolerances}), which no further record narrows. State those of your data"
            " sheet: identify(..., tolerances=Tolerances(gear=...))"
        )
    return "identify from more records, or along a motion of design_motion"


def _beyond_motors(certificate: Any) -> str:
    """Reason why the drives cannot follow the path of a certificate, or empty.

    A set has no single path; `certify` has refused its motions beyond the torque already.
    """
    arm = certificate.plants.arm
    rig = certificate.plants.rig
    path = getattr(certificate, "reference", None)
    try:
        factor = 1.0 if path is None else slowing(arm, rig, path)
    except ValueError as error:
        return str(error)
    if factor == 1:
        return ""
    # Rounded up, else the slower path would still exceed the torque.
    slower = f".slowed({math.ceil(1000 * factor) / 1000:g})"
    return f"the path asks for more torque than the amplifiers give. Slow it down by {slower}"


def _friction(certificate: Any) -> float | None:
    """Share of failures in the worst motion with friction identified, if friction decides."""
    influences = certificate.sensitivities
    largest = influences[0].name if influences else ""
    decides = largest.startswith(("drive.viscous", "drive.coulomb"))
    # Where most samples exceed the limit, the order of the sensitivities says little.
    if not decides and certificate.probability <= SETTINGS.nominal_failures:
        return None
    # `friction_known` runs 400 samples again, so it is read only where friction may decide.
    remaining: float | None = certificate.friction_known
    if remaining is None:
        return None
    return remaining if remaining < SETTINGS.friction_remaining * certificate.probability else None


def _against_the_log(certificate: Any) -> Iterator[str]:
    """Statements about a path that exceeds the log, and about gears that the log excludes."""
    seen = certificate.seen
    if seen.beyond:
        ranges = "; ".join(seen.beyond)
        yield (
            f"the path exceeds the log: {ranges}. Effects that only appear there (friction, cables,"
            " stops) are not sampled"
        )
    # Samples on gears that the log excludes are of another arm.
    lowest = min((cell.hz[0] for cell in certificate.cells), default=np.inf)
    if seen.resonance is not None and lowest < seen.resonance:
        yield (
            f"gears that resonate below {seen.resonance:.3g} Hz would have shown in the log, and"
            f" did not: those sampled from {lowest:.3g} Hz on are not this arm's, nor is f as it"
            " was fitted on them"
        )


def _worst(cell: Any) -> str:
    """Failures in the worst cell of the resonances, where there is no bound."""
    if cell is None:
        return ""
    failures = f"{cell.failures} of {cell.count} do"
    if not cell.count:
        failures = "there is no sample, so nothing is said of it"
    return f"; at the worst resonance ({cell}) {failures}"


def percent(share: float, up: bool = False) -> str:
    """A probability as text, with two significant digits, or three; a bound is rounded `up`."""
    percent = 100 * share
    if percent > 0:
        # From 10 % on the step stays 0.1 %. The 1e-9 keeps a rounding error from raising a bound.
        step = 10.0 ** min(math.floor(math.log10(percent)) - 1, -1)
        percent = step * (math.ceil(percent / step - 1e-9) if up else round(percent / step))
    return f"{percent:.3g} %"
