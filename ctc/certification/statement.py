"""What a certificate says in words: its verdict, what was sampled, and what was not."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from ctc.certification.imperfections import IMPERFECTIONS
from ctc.verdict.on_gears import LOWEST
from plant.motion.everyday import slowing
from plant.parts.shown import Aside, Piece, Verdict
from plant.parts.tables import Table, by_joint

# shares of what is explained, and of all that varies, above which f decides
_DECIDES = 0.5
_AT_ALL = 0.25

_SHOWN = 5  # sensitivities in the table

_HELD = " from a hold, static friction anywhere inside its cone"

# What `tune` does not say of what it found.
SEARCH = (
    "another controller may hold: tune searches for it, along this path and over what is sampled"
    " here"
)

# share of the samples beyond the limit that may be left where friction is known, if it decides
_LESS = 0.5
# share of samples that exceed the limit beyond which nothing is said of the nominal one
_MOST = 0.5


def _exceeding(certificate: Any, where: str, anywhere: str) -> str:
    """How many samples exceed the limit, after the start and with it, and the bound."""
    count = f"{len(certificate.plants):,} Monte Carlo samples"
    within = certificate.within
    limit = f"±{within:g} pulse{'s' * (within != 1)}"
    sure = f"with {100 * certificate.confidence:g} % confidence"
    bound = percent(certificate.upper, up=True)
    cell = certificate.worst_cell
    of = "of all would" if cell is None else f"would at the worst resonance ({cell})"
    some = f"{percent(certificate.probability)} of {count} exceed {limit} {where}"
    rest = f"; {sure}, at most {bound} {of}"
    if not certificate.failures:
        some = f"None of {count} exceeds {limit}{anywhere}"
        rest = f"; {sure}, fewer than {bound} {of}"
    sentence = f"{some}{_worst(cell) if bound == percent(1.0) else rest}."  # 100 % is no bound
    if certificate.failures_before:
        exceeding = certificate.failures_before, certificate.failures_with_start
        before, all_ = (each / len(certificate.plants) for each in exceeding)
        first = f"In the first {certificate.settings['after']:g} s, which do not count"
        sentence = (
            f"{sentence} {first}, {percent(before)} exceed it; then or later, {percent(all_)}."
        )
    return sentence


def verdict_of_set(certificates: Any) -> str:
    """What `Certificates` found: in how many motions the limit is exceeded, and in which most."""
    count = len(certificates)
    worst = certificates.worst
    held = _HELD * certificates.settings.get("held", False)
    sentence = _exceeding(
        certificates, f"in some of {count} motions{held}", f" in any of {count} motions{held}"
    )
    failing = sum(each.failures > 0 for each in certificates.values())
    if failing:
        most = percent(certificates[worst].probability)
        sentence = f"{sentence} It happens in {failing} of them, most often in {worst!r} ({most})."
    return sentence


def verdict(certificate: Any) -> str:
    """What a `Certificate` found, and on which gears it holds."""
    gears = certificate.on_gears
    held = _HELD * certificate.settings.get("held", False)
    sentence = _exceeding(certificate, f"at some sampling instant{held}", held)
    if certificate.from_rest is not None:
        said = str(certificate.from_rest)
        sentence = f"{sentence} {said[:1].upper()}{said[1:]}."
    if certificate.seen is not None and certificate.seen.beyond:
        sentence = f"{sentence} The path exceeds what the log shows."
    if gears is None:
        return sentence
    if certificate.probability > _MOST:
        return f"{sentence} Rigid gears assumed."
    stated = certificate.plants.uncertainty.imperfections
    worst = {name: max(stated.get(name, (0.0,)), key=abs) for name in IMPERFECTIONS}
    rows = [(IMPERFECTIONS[name], value) for name, value in worst.items() if value]
    there = [f"{row.words} {value:g} {row.unit}" for row, value in rows]
    beside = f", with {', '.join(there)}," if there else ""
    return (
        f"{sentence} Rigid gears assumed; the nominal arm{beside}"
        f" {gears}.{_unseen(certificate, gears.hz)}"
    )


def _unseen(certificate: Any, hz: float) -> str:
    """What the log says of gears on which the loop exceeds its limit, below a resonance [Hz]."""
    shown = None if certificate.seen is None else certificate.seen.resonance
    if shown is None or not hz > LOWEST:
        return ""
    if hz <= shown:
        return f" Gears that resonate below {shown:.3g} Hz would have shown in the log."
    upto = f"above {shown:.3g} Hz"
    stated = "resonance= as it was measured"
    if np.isfinite(hz):
        upto = f"from {shown:.3g} to {hz:.3g} Hz"
        stated = f"resonance=({shown:.3g}, {hz:.3g})"
    return (
        f" The log shows gears that resonate below {shown:.3g} Hz, not those {upto}: certify with"
        f" {stated}."
    )


def shown(certificate: Any) -> Iterator[Piece]:
    """A `Certificate` as it is printed, the verdict first."""
    worst = certificate.worst
    runs = certificate.runs
    rows = [("share of sampling instants beyond the limit", percent(certificate.share_outside))]
    if after := certificate.settings["after"]:
        of = f"of {len(certificate.plants)}"
        rows.append(
            (f"samples that exceed it before {after:g} s", f"{certificate.failures_before} {of}")
        )
        rows.append(
            ("samples that exceed it at any time", f"{certificate.failures_with_start} {of}")
        )
    if np.isfinite(runs.first).any():  # not where all diverge
        rows.append(("time of the first violation, median [s]", f"{np.nanmedian(runs.first):.3f}"))
    peak = f"peak {worst.peak:.0f} pulses" if np.isfinite(worst.peak) else "diverges"
    rows.append(("worst sample", f"number {worst.index}, {peak}"))
    high_quantile = np.quantile(runs.unrounded, 0.99, axis=0, method="higher")
    quantities = [
        ("encoder error, worst peak [pulses]", *(f"{peak:.0f}" for peak in runs.peak.max(axis=0))),
        (
            "error before rounding, median peak [pulses]",
            *(f"{x:.2f}" for x in np.median(runs.unrounded, axis=0)),
        ),
        ("error before rounding, 99 % below [pulses]", *(f"{x:.2f}" for x in high_quantile)),
        ("by rounding alone, f exact, peak [pulses]", *(f"{x:.2f}" for x in certificate.by_counts)),
        (
            "torque chatter per sample, median [N m]",
            *(f"{x:.1f}" for x in np.median(runs.chatter, axis=0)),
        ),
        (
            "motor current, median peak / limit",
            *(f"{share:.0%}" for share in certificate.current_share),
        ),
        ("samples that reach the torque limit", *map(percent, certificate.saturation)),
    ]
    yield Verdict(f"{type(certificate.law).__name__}: {certificate.verdict}", certificate.holds)
    yield Table((), rows)
    if certificate.rare is not None:
        yield str(certificate.rare)
    yield by_joint(certificate.plants.arm.dynamics.chain.joint_labels, quantities)
    yield from _explained(certificate)
    if certificate.seen is not None:
        yield from _against_the_log(certificate)
    yield "for this path alone: everyday_motions(arm, rig) gives others"


def shown_set(certificates: Any) -> Iterator[Piece]:
    """`Certificates` as they are printed: one row per motion."""
    count = len(certificates.plants)
    after = certificates.settings["after"]
    head = [
        "motion",
        f"exceed{f' after {after:g} s' * bool(after)}, of {count}",
        "at most",
        "peak [pulses]",
        "chatter [N m]",
    ]
    rows = [
        [
            name,
            f"{each.failures}",
            percent(each.upper, up=True),
            f"{each.runs.peak.max():.0f}",
            f"{np.median(each.runs.chatter, axis=0).max():.2g}",
            *([f"{each.failures_before}", f"{each.failures_with_start}"] if after else []),
        ]
        for name, each in certificates.items()
    ]
    head += [f"exceed before {after:g} s", "exceed at any time"] if after else []
    yield Verdict(f"{type(certificates.law).__name__}: {certificates.verdict}", certificates.holds)
    yield Table(head, rows)
    if certificates.rare is not None:
        yield str(certificates.rare)
    yield from _explained(certificates)
    beyond = [
        name for name, each in certificates.items() if each.seen is not None and each.seen.beyond
    ]
    if beyond:
        yield f"motions that exceed angles or speeds of the log: {', '.join(beyond)}"
    yield from (
        f"{name}: {each.from_rest}"
        for name, each in certificates.items()
        if each.from_rest is not None
    )
    if certificates.probability <= _MOST and (
        on_gears := [each for each in certificates.values() if each.on_gears]
    ):
        hardest = max(on_gears, key=lambda each: each.on_gears.hz)
        unseen = _unseen(hardest, hardest.on_gears.hz)
        yield f"rigid gears assumed; the nominal arm, in all motions, {hardest.on_gears}.{unseen}"


def _explained(certificate: Any) -> Iterator[Piece]:
    """What the peak errors depend on, and what was sampled."""
    influences = certificate.sensitivities
    dynamics = certificate.plants.arm.dynamics
    shown = influences[:_SHOWN]
    of_f = sum(x.share for x in influences if x.name in dynamics.names)
    short = dict(zip(dynamics.names, dynamics.short_names, strict=True))
    zeros = {
        name: name.replace("encoder.phase.shift", "encoder zero")
        for name in certificate.plants.names
    }
    explained = [({**zeros, **short}.get(x.name, x.name), f"{x.share:.0%}", x.sense) for x in shown]
    yield Table(("sensitivity to", "share of variance", "direction"), explained, words=(2,))
    long = [f"{short[x.name]} = {x.name}" for x in shown if short.get(x.name, x.name) != x.name]
    yield Aside("What the parameters mean", long)
    if certificate.failures and (beyond := _beyond_motors(certificate)):
        yield f"no controller can hold it: {beyond}"
    elif certificate.failures and (known := _friction(certificate)) is not None:
        some = (
            f"{percent(known)} of the first samples exceed the limit. Call identify(...,"
            ' unknown="friction")'
        )
        yield f"uncertain friction decides: known as this log would identify it, {some}"
    elif certificate.failures and of_f > max(_DECIDES * sum(x.share for x in influences), _AT_ALL):
        yield (
            "how well f is known decides: identify from more records, or from a motion of"
            " design_motion"
        )
        yield SEARCH
    elif certificate.failures:
        yield SEARCH
    if certificate.plants.redrawn:
        yield f"{certificate.plants.redrawn} samples were no arm, and were replaced"
    if share := certificate.plants.projected / len(certificate.plants):
        yield (
            f"{share:.0%} of the samples were moved towards the identified arm, until they are arms"
        )
    for what, names in zip(("sampled", "not sampled"), certificate.plants.said, strict=True):
        yield f"{what}: {', '.join(names)}"


def _beyond_motors(certificate: Any) -> str:
    """Why the drives cannot make the path of a certificate, if so; of a set it was asked before."""
    arm = certificate.plants.arm
    rig = certificate.plants.rig
    path = getattr(certificate, "reference", None)
    try:
        factor = 1.0 if path is None else slowing(arm, rig, path)
    except ValueError as error:
        return str(error)
    if factor == 1:
        return ""
    slower = f".slowed({math.ceil(1000 * factor) / 1000:g})"
    return f"the path asks for more torque than the amplifiers give. Slow it down by {slower}"


def _friction(certificate: Any) -> float | None:
    """Share that exceeds the limit where friction is identified, in the worst motion, if that is
    what decides.

    Where most exceed it, the order of the sensitivities says little.
    """
    first = certificate.sensitivities[0].name if certificate.sensitivities else ""
    if certificate.probability <= _MOST and not first.startswith(
        ("drive.viscous", "drive.coulomb")
    ):
        return None
    known = certificate.friction_known
    return known if known is not None and known < _LESS * certificate.probability else None


def _against_the_log(certificate: Any) -> Iterator[str]:
    """Where the path of a certificate exceeds what was logged, and the gears that the log would
    have shown.
    """
    seen = certificate.seen
    cells = certificate.cells
    if seen.beyond:
        places = "; ".join(seen.beyond)
        yield (
            f"the path exceeds the log: {places}. What only shows there (friction, cables, stops)"
            " is not sampled"
        )
    lowest = min((cell.hz[0] for cell in cells), default=np.inf)
    if seen.resonance is not None and lowest < seen.resonance:
        those = (
            f"those sampled from {lowest:.3g} Hz on are not this arm's, nor is f as it was fitted"
            " on them"
        )
        yield (
            f"gears that resonate below {seen.resonance:.3g} Hz would have shown in the log, and"
            f" did not: {those}"
        )


def _worst(cell: Any) -> str:
    """What is said of the worst part of the resonances where there is no bound."""
    if cell is None:
        return ""
    do = (
        f"{cell.failures} of {cell.count} do"
        if cell.count
        else "there is no sample, so nothing is said of it"
    )
    return f"; at the worst resonance ({cell}) {do}"


def percent(share: float, up: bool = False) -> str:
    """A probability as text, with two digits that count, or three; a bound is rounded up."""
    percent = 100 * share
    if percent > 0:
        step = 10.0 ** min(math.floor(math.log10(percent)) - 1, -1)
        percent = step * (math.ceil(percent / step - 1e-9) if up else round(percent / step))
    return f"{percent:.3g} %"
