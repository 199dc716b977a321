"""The commands of ``onepulse``: options in, an `Answer` out; `main` parses and prints."""

import dataclasses
import shutil
from argparse import Namespace
from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

import numpy as np

from ctc.certification.certificate import Certificate
from ctc.certification.certificates import Certificates
from ctc.certification.certify import certify
from ctc.certification.uncertainty import Uncertainty
from ctc.commandline.demo import demo
from ctc.commandline.inputs import (
    Answer,
    described,
    motions_asked,
    new_place,
    path_of,
    plain_number,
    records_of,
)
from ctc.commandline.words import page_in_the_shell
from ctc.laws.computed_torque import ComputedTorque
from ctc.report.report import write_report
from ctc.tuning.tune import tune
from ctc.verdict.evaluations import evaluate
from identification import Identification, fit_torque, identify
from identification.replay.experiment import as_records
from identification.results.summary import doubts
from plant import Dynamics
from plant.checkup.hypothesis import Cause
from plant.models.new_robot import MISSING, new_dh_file, new_robot_file
from plant.models.robot_file import FOLDER, read_robot
from plant.parts.files import write_whole
from plant.parts.messages import progress_bar

# The table [log] of a robot file, for its owner to complete.
MOST_JOINTS = 50
"""Joints of a new robot file; chosen by hand, beyond any arm."""

_COLUMNS = Path(__file__).with_name("columns.toml")
# Attributes of a finding that the JSON output holds.
_OF_FINDINGS = ("check", "joint", "value", "unit", "verdict", "advice")

# The same of a cause in the ranked list.
_OF_CAUSES = ("name", "joints", "size", "unit", "log_odds", "sentence", "remedy")


def run_demo(options: Namespace) -> Answer:
    """The paper from end to end."""
    # Before the minutes of work, not after them.
    if options.figures.exists() and not options.figures.is_dir():
        raise ValueError(
            f"{options.figures} must be a folder for figures; it is a file. Name another with"
            " --figures."
        )
    good = demo(options.seed, options.figures)
    return Answer("", {"within one pulse": good}, good)


def run_robots(options: Namespace) -> Answer:
    """List the robot files of the package, print one, or begin one."""
    # 1. What is asked for: a list, a file of the package, or a new one.
    # From the folder itself, so that a new robot file needs no second list.
    names = sorted(path.stem for path in FOLDER.glob("*.toml"))
    new = options.name == "new"
    if new and (options.model is None) == (options.dh is None):
        got = "none" if options.model is None else "both"
        raise ValueError(
            f"a new robot file must be of a URDF file, or of a number of joints; got {got}. Write:"
            " onepulse robots new ROBOT.urdf, or: onepulse robots new --dh 6."
        )
    if not new and (options.model or options.base or options.tip or options.dh):
        raise ValueError(
            "a model file, --dh, --base and --tip go with new: onepulse robots new ROBOT.urdf."
            " Write so."
        )
    if options.dh is not None and not 0 < options.dh <= MOST_JOINTS:
        raise ValueError(f"--dh must be the number of joints; got {options.dh}. Write --dh 6.")
    if options.name is None:
        # Each file is read: a broken one shows here, not when somebody needs it.
        titles = {name: read_robot(name).name for name in names}
        width = max(map(len, names))
        return Answer(
            "\n".join(f"{name:{width}}  {title}" for name, title in titles.items()),
            {"robots": titles},
        )
    if not new and options.name not in names:
        raise ValueError(
            f"a robot of the package is one of {', '.join(names)}; got {options.name!r}. Choose"
            " one."
        )
    # 2. The text of the file. The path is checked first, a model may take a while to read.
    model = None
    place = None
    if options.output is not None:
        place = new_place(options.output, options.force, [options.model] if options.model else ())
    if options.dh is not None:
        text = new_dh_file(options.dh)
    elif new:
        text = new_robot_file(options.model, place or Path("robot.toml"), options.base, options.tip)
    else:
        # A copy of the robot file alone would name a model that is not beside it.
        model = read_robot(options.name).model
        text = (FOLDER / f"{options.name}.toml").read_text(encoding="utf-8")
    # Every robot file ends with the columns of its logs, which nobody else can know.
    text += _COLUMNS.read_text(encoding="utf-8")
    # 3. Print it, or write it.
    if place is None:
        return Answer(text.rstrip(), {"robot": options.name, "toml": text})
    places = [place]
    if model is not None:  # stands beside its robot file
        places.append(new_place(str(place.with_name(model.name)), options.force))
        shutil.copyfile(model, places[1])
    write_whole(place, [text])
    # Scripts read the list of files; people read the sentence.
    message = f"wrote {', '.join(map(str, places))}"
    if new:
        message += f'; replace each "{MISSING}" in it'
    return Answer(message, {"robot": options.name, "files": [*map(str, places)]})


def run_check(options: Namespace) -> Answer:
    """Logs examined before anything is identified."""
    # Without a robot file the records hold their own rig.
    robot = None if options.robot is None else read_robot(options.robot)
    data = {}
    causes = {}
    good = True
    logs, contents = described(options.logs, robot)
    # Logs without a mapping are described in place of a check: the mapping is what is needed next.
    texts = [description.toml() for description in contents]
    for record in records_of(logs, robot, options.cut) if logs else ():
        checkup = record.check()
        texts.append(f"{record}\n{checkup}")
        findings = [
            {name: getattr(finding, name) for name in _OF_FINDINGS} for finding in checkup.findings
        ]
        # A value that is not finite becomes null.
        data[record.name] = [
            finding | {"value": plain_number(finding["value"])} for finding in findings
        ]
        causes[record.name] = _ranked(checkup.causes)
        # One bad log makes the answer negative.
        good &= checkup.ok
    answer: dict[str, Any] = {"good": good if logs else None, "logs": data, "causes": causes}
    if contents:
        texts.append("Nothing was checked of a log without a mapping.")
        answer["contents"] = {
            description.path: {
                "samples": description.samples,
                "time": description.rate,
                "likely": {name: str(role) for name, role in description.roles.items()},
                "columns": dict(description.columns),
                "units": dict(description.units),
            }
            for description in contents
        }
    return Answer("\n\n".join(texts), answer, good)


def run_identify(options: Namespace) -> Answer:
    """Identify the parameters with intervals, and save them for `certify` and `report`."""
    # Check the output path before a search of minutes.
    place = _place(options)
    robot = read_robot(options.robot)
    records = records_of(options.logs, robot, options.cut)
    # Without the option the last of several logs is held out, with an empty one none is.
    held_out: Any = options.held_out
    if held_out:
        held_out = records_of(held_out, robot, options.cut)
    identification = identify(
        cast(Dynamics, robot.dynamics),
        # One record alone is identified as one, several jointly.
        records if len(records) > 1 else records[0],
        seed=options.seed,
        method=options.method,
        unknown=options.unknown,
        held_out=held_out,
        elasticity=options.elasticity,
        prior=options.prior,
        checkpoint=options.checkpoint,
        progress=not options.quiet,
    )
    # Saved before anything is printed: a search of minutes is not lost to a closed terminal.
    identification.save(place)
    # Doubts give exit code 1, as a script would not read the warnings.
    good = not doubts(identification)
    return Answer(
        f"{identification.summary()}\n\nwrote {place}",
        _identified(identification) | {"file": str(place)},
        good,
    )


def run_fit_torque(options: Namespace) -> Answer:
    """Fit f and friction to logged torques, and predict those of logs that were held out."""
    robot = read_robot(options.robot)
    records = records_of(options.logs, robot, options.cut)
    held_out = records_of(options.held_out, robot, options.cut) if options.held_out else ()
    dynamics = cast(Dynamics, robot.dynamics)
    # The command names numbers beside f, or words for several; the function wants all names.
    unknown = options.unknown and as_records(dynamics, records, options.unknown)[1]
    fit = fit_torque(dynamics, records, unknown=unknown, prior=options.prior)
    # The error of the fit's own logs comes before that of others: the two are compared.
    errors = {record.name: fit.error_on(record, band=options.band) for record in records}
    errors |= {
        f"{record.name} (held out)": fit.error_on(record, band=options.band) for record in held_out
    }
    # The fit first: the errors are read beside its warnings.
    texts = [str(fit), *(f"{name}: {error}" for name, error in errors.items())]
    data = {
        "causes": _ranked(fit.causes),
        "warnings": fit.warnings,
        "values": {
            name: {"value": float(value), "std": plain_number(std)}
            for name, value, std in zip(fit.names, fit.values, fit.std, strict=True)
        },
        "errors": {
            name: {
                "relative": error.total,
                "band": error.band,
                "rows": error.rows,
                "joints": {
                    joint: {"relative": plain_number(relative), "rms": plain_number(rms)}
                    for joint, relative, rms in zip(
                        error.joints, error.relative, error.rms, strict=True
                    )
                },
            }
            for name, error in errors.items()
        },
    }
    return Answer("\n\n".join(texts), data, not fit.warnings)


def _ranked(causes: Iterable[Cause]) -> list[dict[str, Any]]:
    """The causes of a list, the likeliest first, as JSON."""
    fields = [{name: getattr(cause, name) for name in _OF_CAUSES} for cause in causes]
    return [
        field | {name: plain_number(field[name]) for name in ("size", "log_odds")}
        for field in fields
    ]


def _identified(identification: Identification) -> dict[str, Any]:
    std = (
        [None] * len(identification.fit.values)
        if identification.covariance is None
        else identification.fit.std
    )
    return {
        "method": identification.search.method,
        "seed": identification.search.seed,
        "doubts": doubts(identification),
        "causes": _ranked(identification.causes),
        "warnings": list(identification.warnings),
        "values": {
            name: {"value": float(value), "std": plain_number(s)}
            for name, value, s in zip(
                identification.fit.unknown, identification.fit.values, std, strict=True
            )
        },
    }


def run_certify(options: Namespace) -> Answer:
    """Probability that computed torque from an identification exceeds a pulse limit."""
    place = _place(options)
    identification = Identification.load(options.found)
    law = _law(identification, options)
    # The uncertainty comes from covariance and options, the motions from the log or a file.
    motions = motions_asked(identification, options.path, options.everyday)
    certificate = certify(
        identification,
        identification.rig,
        law,
        motions,
        _uncertainty(options, identification),
        **_run(options),
    )
    # From a hold, static friction may be anywhere inside its cone at the start.
    if options.hold:
        certificate = certificate.from_hold(samples=options.samples)
    messages = [str(certificate), f"computed torque with a bandwidth of {law.bandwidth:g} rad/s"]
    return _certified(identification, certificate, messages, {"bandwidth": law.bandwidth}, place)


def run_tune(options: Namespace) -> Answer:
    """The controller of least chatter that stays within the limit over the uncertainty."""
    place = _place(options)
    identification = Identification.load(options.found)
    motions = motions_asked(identification, options.path, options.everyday)
    tuning = tune(
        identification,
        identification.rig,
        motions,
        _uncertainty(options, identification),
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
    # Few samples of the certificate may all keep a limit that samples of the search exceed.
    return dataclasses.replace(answer, good=answer.good and tuning.holds)


def _place(options: Namespace) -> Any:
    """Path of the output file, never a file that the command reads; None to print alone."""
    if options.output is None:
        return None
    # Any file that this command reads, whatever its option is called.
    inputs: list[str] = []
    for name in ("logs", "held_out", "robot", "found", "certificate", "path"):
        value = vars(options).get(name)
        if value is not None:
            inputs += value if isinstance(value, list) else [value]
    return new_place(options.output, options.force, inputs)


def _uncertainty(options: Namespace, identification: Identification) -> Uncertainty:
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
    # Without a covariance there is nothing to draw samples from, except gears of a range.
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
    """Save a certificate and answer with it; negative if the identification is doubtful."""
    doubtful = doubts(identification)
    if doubtful:
        count = "a warning" if len(doubtful) == 1 else f"{len(doubtful)} warnings"
        doubt = f"The identification is unreliable ({count} of identify)"
        messages = [f"{doubt}; what follows takes it for right.", *messages]
    if place is not None:
        certificate.save(place)
    # The same keys for one motion and for several.
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
        # The loudest joint, of the median sample: one sample that diverges must not decide.
        "chatter": plain_number(np.median(certificate.runs.chatter, axis=0).max()),
    }
    if isinstance(certificate, Certificates):
        return data
    # Each motion of a set has its own start, and its own comparison with the log.
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
    if not options.output.endswith((".html", ".htm")):
        raise ValueError(f"the page must be an .html file; got {options.output}. Name it so.")
    place = _place(options)
    with progress_bar(1.0, "report", "share", not options.quiet) as bar:
        with bar.part(0.3, "controller"):
            identification, results = _to_report(options)
        with bar.part(0.7, "page"):
            write_report(identification, *results, path=place, overwrite=options.force)
    # The page speaks of options, not of Python's keyword arguments.
    write_whole(place, [page_in_the_shell(place.read_text(encoding="utf-8"))])
    return Answer(f"wrote {place}", {"file": str(place), "doubts": doubts(identification)})


def _to_report(options: Namespace) -> tuple[Identification, list[Any]]:
    """The identification, its controller's evaluation if there is a path, and the certificate."""
    identification = Identification.load(options.found)
    certificate: Any = (
        None if options.certificate is None else Certificate.load(options.certificate)
    )
    # Two statements about one controller could contradict each other.
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
        if options.path is not None:
            raise
    else:
        # Nominal arm and rig: what the certificate adds is their uncertainty.
        evaluation = evaluate(identification.arm, identification.rig, law, path)
    return identification, [x for x in (evaluation, certificate) if x is not None]


# Name of each command -> its function.
COMMANDS = {
    "demo": run_demo,
    "robots": run_robots,
    "check": run_check,
    "identify": run_identify,
    "fit-torque": run_fit_torque,
    "certify": run_certify,
    "tune": run_tune,
    "report": run_report,
}
