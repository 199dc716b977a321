"""What each command does with its options; `ctc.commandline.main` reads them and prints the
answers.
"""

import dataclasses
import shutil
from argparse import Namespace
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
from identification import Identification, identify
from identification.results.summary import doubts
from plant import Dynamics
from plant.models.new_robot import MISSING, new_robot_file
from plant.models.robot_file import FOLDER, read_robot
from plant.parts.files import write_whole

# what a robot file says of the logs' columns, to be filled in
_COLUMNS = Path(__file__).with_name("columns.toml")
# What the JSON has of each finding of a checkup.
_OF_FINDINGS = ("check", "joint", "value", "unit", "verdict", "advice")


def run_demo(given: Namespace) -> Answer:
    """The paper from end to end."""
    if given.figures.exists() and not given.figures.is_dir():
        raise ValueError(
            f"{given.figures} must be a folder for figures; it is a file. Name another with"
            " --figures."
        )
    good = demo(given.seed, given.figures)
    return Answer("", {"within one pulse": good}, good)


def run_robots(given: Namespace) -> Answer:
    """Robot files: a list of the package's, one of them to start from, or a new one of a URDF
    file, to complete.
    """
    names = sorted(path.stem for path in FOLDER.glob("*.toml"))
    new = given.name == "new"
    if new and given.model is None:
        raise ValueError(
            "a new robot file must be of a URDF file; got none. Write: onepulse robots new"
            " ROBOT.urdf."
        )
    if not new and (given.model or given.base or given.tip):
        raise ValueError(
            "a model file, --base and --tip go with new: onepulse robots new ROBOT.urdf. Write so."
        )
    if given.name is None:
        titles = {name: read_robot(name).name for name in names}
        width = max(map(len, names))
        return Answer(
            "\n".join(f"{name:{width}}  {title}" for name, title in titles.items()),
            {"robots": titles},
        )
    if not new and given.name not in names:
        raise ValueError(
            f"a robot of the package is one of {', '.join(names)}; got {given.name!r}. Choose one."
        )
    inputs, model = ([given.model], None) if new else ([], read_robot(given.name).model)
    place = None if given.output is None else new_place(given.output, given.force, inputs)
    if new:
        text = new_robot_file(given.model, place or Path("robot.toml"), given.base, given.tip)
    else:
        text = (FOLDER / f"{given.name}.toml").read_text(encoding="utf-8")
    text += _COLUMNS.read_text(encoding="utf-8")
    if place is None:
        return Answer(text.rstrip(), {"robot": given.name, "toml": text})
    places = [place]
    if model is not None:  # stands beside its robot file
        places.append(new_place(str(place.with_name(model.name)), given.force))
        shutil.copyfile(model, places[1])
    write_whole(place, [text])
    said = f"wrote {', '.join(map(str, places))}" + f'; replace each "{MISSING}" in it' * new
    return Answer(said, {"robot": given.name, "files": [*map(str, places)]})


def run_check(given: Namespace) -> Answer:
    """Logs examined before anything is identified."""
    robot = None if given.robot is None else read_robot(given.robot)
    texts = []
    data = {}
    good = True
    for record in records_of(given.logs, robot, given.cut):
        checkup = record.check()
        texts.append(f"{record}\n{checkup}")
        findings = [
            {name: getattr(each, name) for name in _OF_FINDINGS} for each in checkup.findings
        ]
        data[record.name] = [each | {"value": plain_number(each["value"])} for each in findings]
        good &= checkup.ok
    return Answer("\n\n".join(texts), {"good": good, "logs": data}, good)


def run_identify(given: Namespace) -> Answer:
    """The parameters that reproduce the logs, with their intervals, in a file for `certify` and
    `report`.
    """
    place = _place(given)
    robot = read_robot(given.robot)
    records = records_of(given.logs, robot, given.cut)
    held_out = records_of(given.held_out, robot, given.cut) if given.held_out else None
    found = identify(
        cast(Dynamics, robot.dynamics),
        records if len(records) > 1 else records[0],
        seed=given.seed,
        method=given.method,
        unknown=given.unknown and ("f", *given.unknown),
        held_out=held_out,
        elasticity=given.elasticity,
        prior=given.prior,
        checkpoint=given.checkpoint,
        progress=not given.quiet,
    )
    found.save(place)
    good = not doubts(found)
    return Answer(
        f"{found.summary()}\n\nwrote {place}", _identified(found) | {"file": str(place)}, good
    )


def _identified(found: Identification) -> dict[str, Any]:
    std = [None] * len(found.fit.values) if found.covariance is None else found.fit.std
    return {
        "method": found.search.method,
        "seed": found.search.seed,
        "doubts": doubts(found),
        "warnings": list(found.warnings),
        "values": {
            name: {"value": float(value), "std": plain_number(s)}
            for name, value, s in zip(found.fit.unknown, found.fit.values, std, strict=True)
        },
    }


def run_certify(given: Namespace) -> Answer:
    """The probability that computed torque on what was found exceeds a pulse limit."""
    place = _place(given)
    found = Identification.load(given.found)
    law = _law(found, given)
    motions = motions_asked(found, given.path, given.everyday)
    certificate = certify(found, found.rig, law, motions, _uncertainty(given, found), **_run(given))
    if given.hold:
        certificate = certificate.from_hold(samples=given.samples)
    said = [str(certificate), f"computed torque with a bandwidth of {law.bandwidth:g} rad/s"]
    return _certified(found, certificate, said, {"bandwidth": law.bandwidth}, place)


def run_tune(given: Namespace) -> Answer:
    """The controller of least chatter that stays within the limit on what was found."""
    place = _place(given)
    found = Identification.load(given.found)
    motions = motions_asked(found, given.path, given.everyday)
    tuning = tune(found, found.rig, motions, _uncertainty(given, found), **_run(given))
    best = min(tuning.trials, key=lambda trial: trial.rank)
    kind = type(tuning.law).__name__
    said = [
        str(tuning),
        f"the controller: {kind} ({best.tuned}); in Python, Certificate.load(FILE).law",
    ]
    return _certified(
        found, tuning.certificate, said, {"law": kind, "numbers": best.numbers}, place
    )


def _place(given: Namespace) -> Any:
    """Where the answer is to be written, none of the files that the command reads; None to print
    it alone.
    """
    every = [
        vars(given).get(name)
        for name in ("logs", "held_out", "robot", "found", "certificate", "path")
    ]
    read = [path for each in every if each for path in (each if isinstance(each, list) else [each])]
    return None if given.output is None else new_place(given.output, given.force, read)


def _uncertainty(given: Namespace, found: Identification) -> Uncertainty:
    """What the robot file states, with what the options state in its place."""
    stated = None if given.robot is None else read_robot(given.robot).uncertainty
    if given.robot is not None and stated is None:
        raise ValueError(
            f"{given.robot} must have a table [uncertainty]; it has none. Add it, or leave out"
            " --robot."
        )
    fields = {
        field.name: getattr(given, field.name, None) for field in dataclasses.fields(Uncertainty)
    }
    named: Any = {name: value for name, value in fields.items() if value is not None}
    uncertainty = dataclasses.replace(cast(Uncertainty, stated or Uncertainty()), **named)
    if found.covariance is None and uncertainty.resonance is None:
        why = found.fit.fallback_reason or f"--method {found.search.method} gives none"
        raise ValueError(
            f"{given.found} must have intervals; it has none: {why}. Identify with --method seeded."
        )
    return uncertainty


def _run(given: Namespace) -> dict[str, Any]:
    """How it is simulated, as the options of `certify` and `tune`."""
    names = (
        "samples",
        "seed",
        "within",
        "checkpoint",
        *(["after"] if given.after is not None else []),
    )
    return {name: getattr(given, name) for name in names} | {"progress": not given.quiet}


def _certified(
    found: Identification,
    certificate: Certificate | Certificates,
    said: list[str],
    of_law: dict[str, Any],
    place: Path | None,
) -> Answer:
    """The answer that a certificate gives, kept in its file; no good one where what was found is
    unreliable.
    """
    doubtful = doubts(found)
    if doubtful:
        count = "a warning" if len(doubtful) == 1 else f"{len(doubtful)} warnings"
        said = [
            (
                f"The identification is unreliable ({count} of identify); what follows takes it for"
                " right."
            ),
            *said,
        ]
    if place is not None:
        certificate.save(place)
    data = _data(certificate) | {"verdict": certificate.verdict, "doubts": doubtful, **of_law}
    if isinstance(certificate, Certificates):
        data |= {
            "worst": certificate.worst,
            "motions": {name: _data(each) for name, each in certificate.items()},
        }
    else:
        data["lowest_resonance"] = plain_number(certificate.lowest_resonance)
    text = "\n".join([*said, *([] if place is None else [f"\nwrote {place}"])])
    return Answer(text, data, certificate.holds and not doubtful)


def _data(certificate: Certificate | Certificates) -> dict[str, Any]:
    names = "failures", "failures_before", "failures_with_start", "probability", "upper", "within"
    data: dict[str, Any] = {name: getattr(certificate, name) for name in names} | {
        "samples": len(certificate.plants),
        "interval": [*certificate.interval],
        "after": certificate.settings["after"],
        "chatter": plain_number(np.median(certificate.runs.chatter, axis=0).max()),
    }
    if isinstance(certificate, Certificates):
        return data
    seen = certificate.seen
    rest = certificate.from_rest
    data["from_rest"] = None if rest is None else str(rest)
    data["log_shows_below"] = None if seen is None else plain_number(seen.resonance)
    return data | {"beyond_log": [] if seen is None else list(seen.beyond)}


def _law(found: Identification, given: Namespace) -> ComputedTorque:
    return ComputedTorque(
        found, **({} if given.bandwidth is None else {"bandwidth": given.bandwidth})
    )


def run_report(given: Namespace) -> Answer:
    """One page of an identification, and of computed torque on it where there is a path to
    follow.
    """
    if not given.output.endswith((".html", ".htm")):
        raise ValueError(f"the page must be an .html file; got {given.output}. Name it so.")
    place = _place(given)
    found = Identification.load(given.found)
    certificate: Any = None if given.certificate is None else Certificate.load(given.certificate)
    if isinstance(certificate, Certificates):  # a page is of one path
        certificate = certificate[certificate.worst]
    if certificate is not None and given.bandwidth is not None:
        raise ValueError(
            "the controller must be the certificate's; got --bandwidth beside it. Leave it out."
        )
    law = _law(found, given) if certificate is None else certificate.law
    evaluation = None
    try:
        own = certificate is not None and given.path is None
        path = certificate.reference if own else path_of(found, given.path)
    except ValueError:
        if given.path is not None:
            raise
    else:
        evaluation = evaluate(found.arm, found.rig, law, path)
    results = [each for each in (evaluation, certificate) if each is not None]
    write_report(found, *results, path=place, overwrite=given.force)
    write_whole(place, [page_in_the_shell(place.read_text(encoding="utf-8"))])
    return Answer(f"wrote {place}", {"file": str(place), "doubts": doubts(found)})


# Name of each command -> what it does.
COMMANDS = {
    "demo": run_demo,
    "robots": run_robots,
    "check": run_check,
    "identify": run_identify,
    "certify": run_certify,
    "tune": run_tune,
    "report": run_report,
}
