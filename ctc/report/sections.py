"""What a report says, section by section."""

import math
import textwrap
from collections.abc import Iterator
from typing import Any

import numpy as np

from ctc.report.page import figure, section
from identification.equation_error.naming import units as units_of
from identification.results.seen import seen
from identification.results.summary import doubts
from plant.parts.shown import body, details, items, preformatted, table, text

_SEARCHED = "identification"
_ASIDE = "validation"


def sections(found: Any, evaluation: Any, certificate: Any) -> Iterator[str]:
    """All sections, the verdict first."""
    yield _verdict(found, evaluation, certificate)
    yield from (part(found) for part in (_values, _fit, _logs, _assumptions))
    if evaluation is not None:
        yield _controller(found, evaluation)
    if certificate is not None:
        yield _certificate(certificate)
    yield _origin(found, certificate)


def _verdict(found: Any, evaluation: Any, certificate: Any) -> str:
    """What somebody reads who reads nothing else."""
    lines = []
    doubtful = doubts(found)
    if doubtful:
        said = (
            "One line under it says"
            if len(doubtful) == 1
            else f"{len(doubtful)} lines under it say"
        )
        lines.append((False, "The identification is unreliable", f"{said} why, below: Warnings."))
    else:
        lines.append(
            (
                True,
                "Nothing in the log contradicts what was stated",
                "What was tested, and what would have been seen, stands under Assumptions.",
            )
        )
    if evaluation is not None:
        law = type(evaluation.record.law).__name__
        share = evaluation.share_within(1)
        said = (
            f"{share} of {len(evaluation.record)} samples within ±1 pulse, simulated on the arm"
            " that was found."
        )
        # of gears a certificate's verdict speaks
        why = evaluation.conditions if certificate is None else evaluation.reasons
        said += "".join(f" {line[:1].upper()}{line[1:]}." for line in why)
        nominal = "the nominal arm" + ", which is unreliable" * bool(doubtful)
        lines.append((evaluation.holds and not doubtful, f"{law} on {nominal}", said))
    if certificate is not None:
        title = f"{type(certificate.law).__name__} on {len(certificate.plants)} sampled arms"
        title += ", of what is unreliable" * bool(doubtful)
        rare = certificate.rare
        missed = "" if rare is None or rare.met else f" {str(rare)[:1].upper()}{str(rare)[1:]}."
        lines.append((certificate.holds and not doubtful, title, certificate.verdict + missed))
    rows = "\n".join(
        f'<li class="{"good" if good else "bad"}"><b>{"✓" if good else "✗"}'
        f" {text(title)}</b>{text(said)}</li>"
        for good, title, said in lines
    )
    parts = [f'<ul class="verdict">\n{rows}\n</ul>']
    if found.warnings:
        parts += ["<h3>Warnings</h3>", items(found.warnings)]
    return section("Verdict", *parts)


def _values(found: Any) -> str:
    names = found.short_names
    units = units_of(found.arm.dynamics, found.fit.unknown)
    if found.covariance is None:
        why = found.fit.fallback_reason or "this method gives no intervals"
        own = [
            (name, f"{value:.5g}", unit)
            for name, value, unit in zip(names, found.fit.values, units, strict=True)
        ]
        said = f"<p>Without intervals: {text(why)}.</p>"
        return section("Parameters", said, table(("", "value", "unit"), own), _legend(found))
    rows = []
    for name, value, s, unit in zip(names, found.fit.values, found.fit.std, units, strict=True):
        if s > 0:
            digits = max(0, 1 - math.floor(math.log10(s)))  # two of the standard deviation
            middle, low, high = (
                f"{each:.{digits}f}" for each in (value, value - 1.96 * s, value + 1.96 * s)
            )
            share = 196 * s / abs(value) if value else math.inf
            said = f"{share:.2g} %" if share < 10 else f"{share:.0f} %"
            rows.append((name, middle, said, unit, f"{s:.2g}", low, high))
        else:
            rows.append((name, f"{value:.5g}", "assumed", unit, "", "", ""))
    head = ("", "value", "95 % half-width", "unit", "standard deviation", "95 % from", "to")
    counted = f"<p>{text(f'The intervals count noise and {found.search.tolerances}.')}</p>"
    return section("Parameters", table(head, rows), counted, _legend(found))


def _legend(found: Any) -> str:
    legend = "\n".join(found.arm.dynamics.legend.splitlines())
    return details("What the parameters mean", preformatted(legend)) if legend else ""


def _fit(found: Any) -> str:
    apart = found.diagnostics.difference
    aside = found.diagnostics.held_out_difference
    known = f"{apart:.2f} pulses (rms)" if np.isfinite(apart) else "an amount that is not known"
    names = ", ".join(name for use, name, _ in _named(found) if use == _ASIDE)
    kept = "No record was held out for validation."
    if aside is not None:
        kept = f"In the validation data, {names}, they differ by {aside:.2f} pulses."
    said = (
        f"Errors measured and simulated with these values differ by {known}; two roundings alone"
        " give 0.58."
    )
    caption = (
        "Tracking error of the first record, all of it and a segment; innovations, the counts less"
        " their prediction from one sample to the next; spectrum of both; half-widths of the 95 %"
        " intervals: right of the dashed line the sign is not known."
    )
    return section(
        "Fit",
        f"<p>{text(f'{said} {kept} {found.message}')}</p>",
        figure(found.plot(), "fit", caption),
    )


def _logs(found: Any) -> str:
    rows = []
    parts = []
    for use, name, record in _named(found):
        law = type(record.law).__name__ if record.law is not None else "none"
        seconds = f"{record.t[-1] - record.t[0]:.3g}"
        rows.append((name, use, law, f"{len(record)}", seconds, f"{1e3 * record.rig.period:g}"))
        checkup = record.check()
        if problems := [
            f"{each.check}: {each.verdict}. {each.advice}" for each in checkup.problems
        ]:
            parts += [f"<h3>Checkup of {text(name)}</h3>", items(problems)]
        parts.append(details(f"All checks of {name}", body(checkup)))
    head = ("log", "use", "controller", "samples", "duration [s]", "period [ms]")
    return section("Logs", table(head, rows, words=range(3)), *parts)


def _assumptions(found: Any) -> str:
    tested = f"{found.diagnostics.detection}."
    parts = ["<h3>Tested against this log</h3>", f"<p>{text(tested[:1].upper() + tested[1:])}</p>"]
    if found.covariance is not None and found.diagnostics.detection.assumed:
        assumed = found.assumed()
        strong = np.abs(assumed.moves) > 0.05 * np.where(assumed.std > 0, assumed.std, np.inf)
        rows = [
            (name, ", ".join(f"{assumed.unknown[i]} {row[i]:+.2g}" for i in np.flatnonzero(mark)))
            for name, row, mark in zip(assumed.names, assumed.moves, strong, strict=True)
        ]
        larger = (
            "how values move if an assumed number is 1 % larger, from 0.05 standard deviations on."
        )
        told = f"What no log of this kind reveals: {larger}"
        head = ("sensitivity to 1 % of", "moves")
        parts += [
            "<h3>Assumed values</h3>",
            f"<p>{text(told)}</p>",
            table(head, rows, words=range(2)),
        ]
    stated = [*zip(found.rig.number_names(), found.rig.number_values(), strict=True)]
    stated += [*zip(found.law.number_names("law."), found.law.number_values(), strict=True)]
    shown_numbers = [
        (name, f"{value:.6g}") for name, value in stated if name not in found.fit.unknown
    ]
    parts.append(
        details(
            "Assumed numbers of rig and controller",
            table(("motor side, SI", "value"), shown_numbers),
        )
    )
    if found.fit.resonance is not None:
        parts += ["<h3>Gears</h3>", body(found.fit.resonance)]
    return section("Assumptions", *parts)


def _controller(found: Any, evaluation: Any) -> str:
    law = type(evaluation.record.law).__name__
    caption = (
        f"Quantised tracking error and torque of {law} along the path, simulated on the arm that"
        " was found."
    )
    drawn = figure(evaluation.plot(), "controller", caption)
    path = evaluation.record.reference
    t = evaluation.record.t
    fastest = np.abs(path(t).qd).max(axis=0)
    units = ["m" if link.prismatic else "rad" for link in evaluation.arm.dynamics.chain.links]
    joints = zip(evaluation.joint_labels, fastest, units, strict=True)
    speeds = ", ".join(f"{label} {speed:.2g} {unit}/s" for label, speed, unit in joints)
    bandwidth = getattr(evaluation.record.law, "bandwidth", None)
    said = "" if bandwidth is None else f"{law} with a bandwidth of {bandwidth:g} rad/s. "
    said += (
        f"The path of this verdict ({type(path).__name__}), {t[-1]:.3g} s; greatest speeds:"
        f" {speeds}."
    )
    return section(
        "Controller", f"<p>{text(said)}</p>", drawn, body(evaluation), _beyond(found, evaluation)
    )


def _beyond(found: Any, evaluation: Any) -> str:
    """Where the path of an evaluation leaves the logs."""
    record = evaluation.record
    places = seen(found, record.reference, len(record) * record.rig.period).beyond
    only = "What only shows there (friction, cables, stops) is not in the model."
    said = f"The path leaves the log: {'; '.join(places)}. {only}"
    return f"<p>{text(said)}</p>" if places else ""


def _named(found: Any) -> Iterator[tuple[str, str, Any]]:
    """Use of each record, what to call it (its file, or its place among those given), and it
    itself.
    """
    used = [
        *((_SEARCHED, record) for record in found.records),
        *((_ASIDE, record) for record in found.held_out),
    ]
    names = [record.name for _, record in used]
    for place, (use, record) in enumerate(used, 1):
        numbered = f"record {place}" if names.count(record.name) > 1 or not record.name else ""
        yield use, ", ".join(filter(None, (record.name, numbered))), record


def _certificate(certificate: Any) -> str:
    drawn, missing = certificate.plants.said
    caption = "Peak errors of all arms, the worst of them, and what they follow from."
    return section(
        "Certificate",
        figure(certificate.plot(), "certificate", caption),
        f"<p><b>Sampled</b>: {text(', '.join(drawn))}.</p>",
        f"<p><b>Not sampled, and so not covered</b>: {text(', '.join(missing))}.</p>",
        details("Table", body(certificate)),
    )


def _origin(found: Any, certificate: Any) -> str:
    provenance = found.provenance()
    rows = [(name, str(value)) for name, value in provenance["versions"].items()]
    rows += [
        ("method", found.search.method),
        ("seed", str(found.search.seed)),
        ("evaluations", f"{found.evaluations}"),
    ]
    digests = zip(_named(found), (*provenance["records"], *provenance["held_out"]), strict=True)
    rows += [(f"SHA-256 of {name}, as it was read", digest) for (_, name, _), digest in digests]
    if certificate is not None:
        rows.append(("seed of the certificate", str(certificate.provenance()["seed"])))
    settings = f"method={found.search.method!r}, seed={found.search.seed}"
    names = ", ".join(repr(name) for name in found.short_names)
    listed = textwrap.indent(textwrap.fill(names, 80), " " * 20)
    code = (
        "from identification import Identification, identify\n\nfound ="
        ' Identification.load("found.json")            # where it was saved\nagain ='
        " identify(found.arm.dynamics, list(found.records), held_out=list(found.held_out),\n      "
        f"           {settings}, unknown=[\n{listed}\n                 ])\nassert (again.fit.values"
        " == found.fit.values).all()           # the same versions, the same bits"
    )
    again = "<h3>Once more</h3>", preformatted(code)
    return section("Where it comes from", table(("", ""), rows, words=range(2)), *again)
