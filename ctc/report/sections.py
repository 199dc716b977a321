"""Sections of a report: verdict, parameters, fit, logs, assumptions, controller, provenance."""

import math
import textwrap
from collections.abc import Iterator
from typing import Any

import numpy as np

from ctc.certification import Certificates
from ctc.report.page import figure, section
from identification.equation_error import units as units_of
from identification.results import (
    counted,
    doubts,
    drifting,
    explained_torque,
    notes,
    seen,
    verdict_of,
)
from plant.parts import body, details, items, preformatted, table, text

_UNRELIABLE = ", of an unreliable identification"

# Uses of a log.
_IDENTIFICATION = "identification"
_VALIDATION = "validation"


def sections(identification: Any, evaluation: Any, certificate: Any) -> Iterator[str]:
    """All sections, the verdict first."""
    yield _verdict(identification, evaluation, certificate)
    yield from (part(identification) for part in (_values, _fit, _logs, _assumptions))
    if evaluation is not None:
        yield _controller(identification, evaluation, certificate)
    if certificate is not None:
        yield _certificate(certificate)
    yield _origin(identification, certificate)


def _verdict(identification: Any, evaluation: Any, certificate: Any) -> str:
    """One line for each result, good or bad, for a reader of nothing else; then the warnings."""
    # 1. The identification. All later lines rest on it, and none is good where it is doubtful.
    lines = []
    doubtful = doubts(identification)
    if doubtful:
        title = "The identification is unreliable"
        reason = "The warnings below give the reasons."
    else:
        title = verdict_of(identification).sentence.removesuffix(".")
        reason = "What was tested, and what would have been seen, stands under Assumptions."
    lines.append((bool(verdict_of(identification).good), title, reason))

    # 2. The controller on the arm as identified.
    if evaluation is not None:
        law = type(evaluation.record.law).__name__
        reason = (
            f"{evaluation.share_within(1)} of {len(evaluation.record)} samples within ±1 pulse,"
            f" simulated on the arm that was found"
            f"{_along(certificate, evaluation.record.reference)}."
        )
        # A certificate has gears of its own: its verdict speaks of them.
        conditions = evaluation.conditions if certificate is None else evaluation.reasons
        reason += "".join(f" {_sentence(line)}." for line in conditions)
        title = f"{law} on the nominal arm"
        if doubtful:
            title += _UNRELIABLE
        lines.append((evaluation.holds and not doubtful, title, reason))

    # 3. The controller on arms as uncertain as stated.
    if certificate is not None:
        title = f"{type(certificate.law).__name__} on {len(certificate.plants):,} sampled arms"
        # A set has a motion of each name; its verdict is that of all of them.
        if isinstance(certificate, Certificates):
            title += f", in {len(certificate)} motions"
        if doubtful:
            title += _UNRELIABLE
        reason = certificate.verdict
        # A cross because of a rare event needs its reason on the same line.
        rare = certificate.rare
        if rare is not None and not rare.met:
            reason += f" {_sentence(str(rare))}."
        lines.append((certificate.holds and not doubtful, title, reason))

    rows = "\n".join(
        f'<li class="{"good" if good else "bad"}"><b>{"✓" if good else "✗"}'
        f" {text(title)}</b>{text(reason)}</li>"
        for good, title, reason in lines
    )
    parts = [f'<ul class="verdict">\n{rows}\n</ul>']
    for head, listed in (("Warnings", doubtful), ("Notes", notes(identification))):
        if listed:
            parts += [f"<h3>{head}</h3>", items(listed)]
    return section("Verdict", *parts)


def _along(certificate: Any, path: Any) -> str:
    """The worst motion of a set, as an end of a sentence; empty if the path is another one."""
    if not isinstance(certificate, Certificates) or _worst(certificate).reference != path:
        return ""
    return f", in {certificate.worst!r}, the worst of the motions"


def _worst(certificate: Any) -> Any:
    """The certificate of one path that a page shows."""
    return certificate[certificate.worst] if isinstance(certificate, Certificates) else certificate


def _sentence(phrase: str) -> str:
    """A phrase with a capital letter; `str.capitalize` would make small letters of all others."""
    return phrase[:1].upper() + phrase[1:]


def _values(identification: Any) -> str:
    names = identification.short_names
    units = units_of(identification.arm.dynamics, identification.fit.unknown)
    # 1. A method without intervals: the values alone, and the reason.
    if identification.covariance is None:
        why = identification.fit.fallback_reason or "this method gives no intervals"
        rows = [
            (name, f"{value:.5g}", unit)
            for name, value, unit in zip(names, identification.fit.values, units, strict=True)
        ]
        reason = f"<p>Without intervals: {text(why)}.</p>"
        return section(
            "Parameters", reason, table(("", "value", "unit"), rows), _legend(identification)
        )

    # 2. Values as precise as their intervals; an assumed one has none.
    lines = []
    for name, value, std, unit in zip(
        names, identification.fit.values, identification.fit.std, units, strict=True
    ):
        if std > 0:
            # Two digits of the standard deviation; further ones are noise.
            digits = max(0, 1 - math.floor(math.log10(std)))
            middle, low, high = (
                f"{number:.{digits}f}" for number in (value, value - 1.96 * std, value + 1.96 * std)
            )
            # A value of zero has no share.
            share = 196 * std / abs(value) if value else math.inf
            half_width = f"{share:.2g} %" if share < 10 else f"{share:.0f} %"
            lines.append((name, middle, half_width, unit, f"{std:.2g}", low, high))
        else:
            lines.append((name, f"{value:.5g}", "assumed", unit, "", "", ""))
    head = ("", "value", "95 % half-width", "unit", "standard deviation", "95 % from", "to")
    intervals = f"<p>{text(_sentence(counted(identification)))}.</p>"
    return section("Parameters", table(head, lines), intervals, _legend(identification))


def _legend(identification: Any) -> str:
    legend = "\n".join(identification.arm.dynamics.legend.splitlines())
    return details("What the parameters mean", preformatted(legend)) if legend else ""


def _fit(identification: Any) -> str:
    # 1. How far measurement and simulation differ, in the logs used and in those held out.
    difference = identification.diagnostics.difference
    validation = identification.diagnostics.held_out_difference
    amount = "an amount that is not known"
    if np.isfinite(difference):
        amount = f"{difference:.2f} pulses (rms)"
    held_out = "No record was held out for validation."
    if validation is not None:
        names = ", ".join(name for use, name, _ in _named(identification) if use == _VALIDATION)
        held_out = f"In the validation data, {names}, they differ by {validation:.2f} pulses."
    # The limit that rounding sets is given beside it: alone the number has no scale.
    scale = drifting(identification) or "two roundings alone give 0.58"
    summary = f"Errors measured and simulated with these values differ by {amount}; {scale}."

    # 2. The torque, joint by joint, of the logs that have one: the same metric for every fit.
    torques = [f"<p>{text(_sentence(line))}.</p>" for line in explained_torque(identification)]
    for use, name, record in _named(identification):
        if record.torque is not None or record.current is not None:
            error = identification.error_on(record)
            torques.append(f"<h3>{text(f'{name}, {use}')}</h3>{body(error)}")

    # 3. The curves behind it.
    caption = (
        "Tracking error of the first record, all of it and a segment; innovations, the counts less"
        " their prediction from one sample to the next; spectrum of both; half-widths of the 95 %"
        " intervals: right of the dashed line the sign is not known."
    )
    return section(
        "Fit",
        f"<p>{text(f'{summary} {held_out} {identification.message}')}</p>",
        *torques,
        figure(identification.plot(), "fit", caption),
    )


def _logs(identification: Any) -> str:
    rows = []
    parts = []
    for use, name, record in _named(identification):
        law = type(record.law).__name__ if record.law is not None else "none"
        seconds = f"{record.t[-1] - record.t[0]:.3g}"
        rows.append((name, use, law, f"{len(record)}", seconds, f"{1e3 * record.rig.period:g}"))
        # Problems in sight; all checks behind a line to unfold.
        checkup = record.check()
        # A cause is one line, whatever the number of its findings.
        causes = [cause.line for cause in checkup.causes]
        problems = causes + [
            f"{problem.check}: {problem.verdict}. {problem.advice}"
            for problem in checkup.problems
            if problem.advice not in causes
        ]
        if problems:
            parts += [f"<h3>Checkup of {text(name)}</h3>", items(problems)]
        parts.append(details(f"All checks of {name}", body(checkup)))
    head = ("log", "use", "controller", "samples", "duration [s]", "period [ms]")
    return section("Logs", table(head, rows, words=range(3)), *parts)


def _assumptions(identification: Any) -> str:
    # 1. Errors of the stated rig that the log would have revealed.
    tested = f"{identification.diagnostics.detection}."
    parts = ["<h3>Tested against this log</h3>", f"<p>{text(_sentence(tested))}</p>"]

    # 2. Those that no log of this kind reveals, by the values that they would move.
    if identification.covariance is not None and identification.diagnostics.detection.assumed:
        assumed = identification.assumed()
        # A twentieth of a standard deviation is invisible beside the noise; an assumed value has
        # no standard deviation, and no move of it counts.
        strong = np.abs(assumed.moves) > 0.05 * np.where(assumed.std > 0, assumed.std, np.inf)
        rows = []
        for name, moves, mark in zip(assumed.names, assumed.moves, strong, strict=True):
            moved = [f"{assumed.unknown[i]} {moves[i]:+.2g}" for i in np.flatnonzero(mark)]
            rows.append((name, ", ".join(moved)))
        meaning = (
            "What no log of this kind reveals: how values move if an assumed number is 1 % larger,"
            " from 0.05 standard deviations on."
        )
        parts += [
            "<h3>Assumed values</h3>",
            f"<p>{text(meaning)}</p>",
            table(("sensitivity to 1 % of", "moves"), rows, words=range(2)),
        ]

    # 3. All numbers of rig and controller that were not identified.
    stated = identification.rig.numbers() | identification.law.numbers("law.")
    rows = [
        (name, f"{value:.6g}")
        for name, value in stated.items()
        if name not in identification.fit.unknown
    ]
    numbers = table(("motor side, SI", "value"), rows)
    parts.append(details("Assumed numbers of rig and controller", numbers))
    if identification.fit.resonance is not None:
        parts += ["<h3>Gears</h3>", body(identification.fit.resonance)]
    return section("Assumptions", *parts)


def _controller(identification: Any, evaluation: Any, certificate: Any) -> str:
    law = evaluation.record.law
    name = type(law).__name__
    # 1. The curves.
    caption = (
        f"Quantised tracking error and torque of {name} along the path, simulated on the arm that"
        f" was found{_along(certificate, evaluation.record.reference)}."
    )
    drawing = figure(evaluation.plot(), "controller", caption)

    # 2. The path that the verdict holds for: its speeds say how demanding it is.
    path = evaluation.record.reference
    t = evaluation.record.t
    fastest = np.abs(path(t).qd).max(axis=0)
    units = evaluation.arm.dynamics.chain.joint_units
    joints = zip(evaluation.joint_labels, fastest, units, strict=True)
    speeds = ", ".join(f"{label} {speed:.2g} {unit.speed}" for label, speed, unit in joints)
    # Not every law is designed by a bandwidth.
    bandwidth = getattr(law, "bandwidth", None)
    summary = ""
    if bandwidth is not None:
        summary = f"{name} with a bandwidth of {bandwidth:g} rad/s. "
    summary += (
        f"The path of this verdict ({type(path).__name__}), {t[-1]:.3g} s; greatest speeds:"
        f" {speeds}."
    )

    # 3. Where the path goes beyond the logs the verdict is an extrapolation.
    record = evaluation.record
    beyond = ""
    places = seen(identification, path, len(record) * record.rig.period).beyond
    if places:
        warning = (
            f"The path leaves the log: {'; '.join(places)}. What only shows there (friction,"
            " cables, stops) is not in the model."
        )
        beyond = f"<p>{text(warning)}</p>"
    return section("Controller", f"<p>{text(summary)}</p>", drawing, body(evaluation), beyond)


def _named(identification: Any) -> Iterator[tuple[str, str, Any]]:
    """Use, name and record of each log; the name is that of its file, or its place in the list."""
    records = [*identification.records, *identification.held_out]
    names = [record.name for record in records]
    for number, record in enumerate(records, 1):
        use = _IDENTIFICATION if number <= len(identification.records) else _VALIDATION
        # Files of two folders may have one name: the number keeps them apart.
        parts = [record.name] if record.name else []
        if not record.name or names.count(record.name) > 1:
            parts.append(f"record {number}")
        yield use, ", ".join(parts), record


def _certificate(certificate: Any) -> str:
    sampled, missing = certificate.plants.said
    one = _worst(certificate)
    caption = (
        "Peak errors of all arms, errors of some and of the worst, and the numbers that decide them"
    )
    return section(
        "Certificate",
        figure(one.plot(), "certificate", f"{caption}{_along(certificate, one.reference)}."),
        # A probability holds for the sampled numbers alone: both lists stand beside it.
        f"<p><b>Sampled</b>: {text(', '.join(sampled))}.</p>",
        f"<p><b>Not sampled, and so not covered</b>: {text(', '.join(missing))}.</p>",
        details("Table", body(certificate)),
    )


def _origin(identification: Any, certificate: Any) -> str:
    # 1. Versions, seeds and logs that the results follow from.
    provenance = identification.provenance()
    rows = [(name, str(value)) for name, value in provenance["versions"].items()]
    rows += [
        ("method", identification.search.method),
        ("seed", str(identification.search.seed)),
        ("evaluations", f"{identification.evaluations}"),
    ]
    digests = (*provenance["records"], *provenance["held_out"])
    for (_, name, _), digest in zip(_named(identification), digests, strict=True):
        rows.append((f"SHA-256 of {name}, as it was read", digest))
    if certificate is not None:
        rows.append(("seed of the certificate", str(certificate.provenance()["seed"])))

    # 2. The code that gives them again.
    settings = f"method={identification.search.method!r}, seed={identification.search.seed}"
    names = ", ".join(repr(name) for name in identification.short_names)
    unknown = textwrap.indent(textwrap.fill(names, 80), " " * 20)
    code = f"""from identification import Identification, identify

found = Identification.load("found.json")            # where it was saved
again = identify(found.arm.dynamics, list(found.records), held_out=list(found.held_out),
                 {settings}, unknown=[
{unknown}
                 ])
assert (again.fit.values == found.fit.values).all()           # the same versions, the same bits"""
    parts = [table(("", ""), rows, words=range(2)), "<h3>Once more</h3>", preformatted(code)]
    return section("Where it comes from", *parts)
