"""The commands of ``onepulse``: options in, an `Answer` out; `main` parses and prints."""

import shutil
from argparse import Namespace
from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

from ctc.commandline.controller_commands import run_certify, run_report, run_tune
from ctc.commandline.demo import demo
from ctc.commandline.inputs import (
    Answer,
    described,
    new_place,
    output_place,
    plain_number,
    records_of,
)
from identification import Identification, fit_torque, identify
from identification.replay import as_records
from identification.results import doubts
from plant import Dynamics, read_robot
from plant.checkup import Cause
from plant.models import FOLDER, MISSING, new_dh_file, new_robot_file
from plant.parts import write_whole

# The table [log] of a robot file, for its owner to complete.
MOST_JOINTS = 50
"""Joints of a new robot file; chosen by hand, beyond any arm."""

_COLUMNS = Path(__file__).with_name("columns.toml")
# Attributes of a finding that the JSON output holds.
_OF_FINDINGS = ("check", "joint", "value", "unit", "verdict", "advice")

# The same of a cause in the ranked list.
_OF_CAUSES = ("name", "joints", "size", "unit", "log_odds", "sentence", "remedy", "behind")


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
    place = output_place(options)
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
