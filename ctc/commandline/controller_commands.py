"""The commands of a controller from an identification: `certify`, `tune` and `report`."""

import dataclasses
from argparse import Namespace
from pathlib import Path
from typing import Any, cast

import numpy as np

from ctc.certification import Certificate, Certificates, Uncertainty, certify
from ctc.commandline.inputs import Answer, motions_asked, output_place, path_of, plain_number
from ctc.commandline.words import page_in_the_shell
from ctc.laws import ComputedTorque
from ctc.report import write_report
from ctc.tuning import tune
from ctc.verdict import evaluate
from identification import Identification
from identification.results import doubts
from plant import read_robot
from plant.parts import progress_bar, write_whole


def run_certify(options: Namespace) -> Answer:
    """Find the probability that the error under computed torque exceeds a limit in pulses."""
    place = output_place(options)
    identification = Identification.load(options.found)
    law = _law(identification, options)
    # The motions come from the log or a file; the uncertainty from covariance, --robot and options.
    motions = motions_asked(identification, options.path, options.everyday)
    certificate = certify(
        identification,
        identification.rig,
        law,
        motions,
        stated_uncertainty(options, identification),
        **_run(options),
    )
    # After a hold, static friction may start at any value between its limits.
    if options.hold:
        certificate = certificate.from_hold(samples=options.samples)
    messages = [str(certificate), f"computed torque with a bandwidth of {law.bandwidth:g} rad/s"]
    return _certified(identification, certificate, messages, {"bandwidth": law.bandwidth}, place)


def run_tune(options: Namespace) -> Answer:
    """The controller of least chatter that stays within the limit over the uncertainty."""
    place = output_place(options)
    identification = Identification.load(options.found)
    motions = motions_asked(identification, options.path, options.everyday)
    tuning = tune(
        identification,
        identification.rig,
        motions,
        stated_uncertainty(options, identification),
        vary=options.vary,
        **_run(options),
    )
    # The law of the result is that of the best trial, whose numbers the answer lists.
    best = min(tuning.trials, key=lambda trial: trial.rank)
    kind = type(tuning.law).__name__
    messages = [
        str(tuning),
        f"the controller: {kind} ({best.tuned}); in Python, Certificate.load(FILE).law",
    ]
    of_law = {"law": kind, "numbers": best.numbers, "interrupted": tuning.interrupted}
    answer = _certified(identification, tuning.certificate, messages, of_law, place)
    # The certificate may have too few samples to show a failure that the search found.
    return dataclasses.replace(answer, good=answer.good and tuning.holds)


def stated_uncertainty(options: Namespace, identification: Identification) -> Uncertainty:
    """The uncertainty of the robot file; options replace its fields."""
    stated = None if options.robot is None else read_robot(options.robot).uncertainty
    if options.robot is not None and stated is None:
        raise ValueError(
            f"{options.robot} must have a table [uncertainty]; it has none. Add it, or leave out"
            " --robot."
        )
    # Options have the names of the fields, so that a new field needs no code here.
    fields = {
        field.name: getattr(options, field.name, None) for field in dataclasses.fields(Uncertainty)
    }
    # An option that was not given leaves the value of the robot file.
    named: Any = {name: value for name, value in fields.items() if value is not None}
    uncertainty = dataclasses.replace(cast(Uncertainty, stated or Uncertainty()), **named)
    # Without a covariance, samples can be drawn only from a stated range of gear resonances.
    if identification.covariance is None and uncertainty.resonance is None:
        why = (
            identification.fit.fallback_reason
            or f"--method {identification.search.method} gives none"
        )
        raise ValueError(
            f"{options.found} must have intervals; it has none: {why}. Identify with --method"
            " seeded."
        )
    return uncertainty


def _run(options: Namespace) -> dict[str, Any]:
    """Arguments of `certify` and `tune` that say how to simulate."""
    names = ["samples", "seed", "within", "checkpoint"]
    # Without --after the library's own default applies.
    if options.after is not None:
        names.append("after")
    return {name: getattr(options, name) for name in names} | {"progress": not options.quiet}


def _certified(
    identification: Identification,
    certificate: Certificate | Certificates,
    messages: list[str],
    of_law: dict[str, Any],
    place: Path | None,
) -> Answer:
    """Save a certificate and answer with it; good if it holds and the fit raises no doubts."""
    doubtful = doubts(identification)
    if doubtful:
        count = "a warning" if len(doubtful) == 1 else f"{len(doubtful)} warnings"
        doubt = f"The identification is unreliable ({count} of identify)"
        messages = [f"{doubt}; what follows takes it for right.", *messages]
    if place is not None:
        certificate.save(place)
    # One motion and several motions share most keys.
    data = _data(certificate) | {"verdict": certificate.verdict, "doubts": doubtful, **of_law}
    if isinstance(certificate, Certificates):
        data |= {
            "worst": certificate.worst,
            "motions": {name: _data(motion) for name, motion in certificate.items()},
        }
    else:
        data["lowest_resonance"] = plain_number(certificate.lowest_resonance)
    if place is not None:
        messages = [*messages, f"\nwrote {place}"]
    return Answer("\n".join(messages), data, certificate.holds and not doubtful)


def _data(certificate: Certificate | Certificates) -> dict[str, Any]:
    names = "failures", "failures_before", "failures_with_start", "probability", "upper", "within"
    data: dict[str, Any] = {name: getattr(certificate, name) for name in names} | {
        "samples": len(certificate.plants),
        "interval": [*certificate.interval],
        "after": certificate.settings["after"],
        # The largest median of a joint over the samples: one that diverges must not decide.
        "chatter": plain_number(np.median(certificate.runs.chatter, axis=0).max()),
    }
    if isinstance(certificate, Certificates):
        return data
    # Only a single motion has a start and a comparison with the log.
    seen = certificate.seen
    rest = certificate.from_rest
    data["from_rest"] = None if rest is None else str(rest)
    data["log_shows_below"] = None if seen is None else plain_number(seen.resonance)
    return data | {"beyond_log": [] if seen is None else list(seen.beyond)}


def _law(identification: Identification, options: Namespace) -> ComputedTorque:
    # A bandwidth of None is the default that the identification allows.
    return ComputedTorque(identification, bandwidth=options.bandwidth)


def run_report(options: Namespace) -> Answer:
    """One page of an identification, and of its controller where a path can be followed."""
    if not options.output.lower().endswith((".html", ".htm")):
        raise ValueError(f"the page must be an .html file; got {options.output}. Name it so.")
    place = output_place(options)
    with progress_bar(1.0, "report", "share", not options.quiet) as bar:
        with bar.part(0.3, "controller"):
            identification, results = _to_report(options)
        with bar.part(0.7, "page"):
            title = {} if options.title is None else {"title": options.title}
            write_report(identification, *results, path=place, overwrite=options.force, **title)
    # The page speaks of options, not of Python's keyword arguments.
    write_whole(place, [page_in_the_shell(place.read_text(encoding="utf-8"))])
    return Answer(f"wrote {place}", {"file": str(place), "doubts": doubts(identification)})


def _to_report(options: Namespace) -> tuple[Identification, list[Any]]:
    """The identification, its controller's evaluation if there is a path, and the certificate."""
    identification = Identification.load(options.found)
    certificate: Any = (
        None if options.certificate is None else Certificate.load(options.certificate)
    )
    # The certificate fixes the controller; a bandwidth beside it could contradict it.
    if certificate is not None and options.bandwidth is not None:
        raise ValueError(
            "the controller must be the certificate's; got --bandwidth beside it. Leave it out."
        )
    law = _law(identification, options) if certificate is None else certificate.law
    # A log without a path gives a page without a controller; a wrong --path is an error.
    evaluation = None
    try:
        if certificate is not None and options.path is None:
            # A page shows one path of several motions: the worst.
            several = isinstance(certificate, Certificates)
            path = (certificate[certificate.worst] if several else certificate).reference
        else:
            path = path_of(identification, options.path)
    except ValueError:
        # A bandwidth is of a controller, which needs a path.
        if options.path is not None or options.bandwidth is not None:
            raise
    else:
        # Nominal arm and rig: what the certificate adds is their uncertainty.
        evaluation = evaluate(identification.arm, identification.rig, law, path)
    return identification, [x for x in (evaluation, certificate) if x is not None]
