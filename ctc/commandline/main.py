"""The command ``onepulse``: options, exit codes, and one line for whatever was wrong."""

import argparse
import json
import os
import re
import sys
import traceback
import warnings
from pathlib import Path
from typing import Any, NoReturn

from ctc.certification.imperfections import IMPERFECTIONS
from ctc.commandline.commands import COMMANDS
from identification.results.summary import IdentificationWarning
from plant.version import __version__

_CODES = """exit codes: 0 fine; 1 the verdict says no: a finding of the checkup, an identification in doubt, a plant
that exceeds the limit, a path that begins in motion; 2 bad input, said in one line; 3 a defect of the library;
130 interrupted"""


_PLACES = {"command", "found", "logs", "name"}
"""Arguments that are no options."""


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        print(f"onepulse: {message}. See: {self.prog} --help", file=sys.stderr)
        raise SystemExit(2)


def main(arguments: list[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : list of str, optional
        By default those of the process.

    Returns
    -------
    int
        0 fine; 1 the verdict says no; 2 bad input; 3 a defect; 130 interrupted.
    """
    given = _parser().parse_args(arguments)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", IdentificationWarning)  # they are part of the answer
            warnings.simplefilter("ignore", RuntimeWarning)  # numpy's, of numbers whose finiteness is checked
            warnings.showwarning = _said
            answer = COMMANDS[given.command](given)
    except KeyboardInterrupt:
        kept = f" What was finished is in {given.checkpoint}: call again." if getattr(given, "checkpoint", None) else ""
        return _failed(f"interrupted.{kept}", 130)
    except (ValueError, OSError, ImportError, MemoryError) as error:
        return _failed(_as_options(" ".join(str(error).split()), given) or type(error).__name__, 2)
    except Exception:
        traceback.print_exc()
        return _failed("this is a defect of the library; please report the lines above", 3)
    text = json.dumps(answer.data, indent=1, allow_nan=False) if given.json else answer.text
    try:
        _print(_as_options(text, given))
    except BrokenPipeError:  # whoever read it has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        return _failed(f"the answer must be printed; {error.strerror}. Make room, or print it elsewhere.", 2)
    return 0 if answer.good else 1


def _as_options(text: str, given: argparse.Namespace) -> str:
    """A text with the options of the command in place of the keyword arguments that have their names."""
    names = "|".join(set(vars(given)) - _PLACES)
    text = re.sub(rf"\b({names})=\(([^,()]+), ([^,()]+)\)", r"\1=\2 \3", text)
    text = re.sub(rf"\b({names})=(?=[\d.-])", r"\1= ", text)
    found = rf"^({names})(?= (?:must|cannot|needs) )|\b({names})="
    return re.sub(found, lambda each: "--" + (each[1] or each[2]).replace("_", "-"), text)


def _print(text: str) -> None:
    """Print, with what the output's encoding does not have as "?"."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    if text:
        print(text.replace("±", "+-").encode(encoding, "replace").decode(encoding) if encoding != "utf-8" else text)
    sys.stdout.flush()


def _failed(text: str, code: int) -> int:
    print(f"onepulse: {text}", file=sys.stderr)
    return code


def _said(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"onepulse: warning: {' '.join(str(message).split())}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    about = "From logged encoder pulses to an arm's inertial parameters, and to computed torque within one pulse."
    parser = _Parser(prog="onepulse", description=about, epilog=_CODES)
    parser.add_argument("--version", action="version", version=f"onepulse {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)

    demo = _command(commands, "demo", "the paper from end to end: measure, identify, control")
    demo.add_argument("--figures", type=Path, default=Path("figures"), help="folder for the figures")

    robots = _command(commands, "robots", "robot files of the package, to start from")
    robots.add_argument("name", nargs="?", help="one of them; without a name, a list")
    _output(robots, "write it there (default: print it)", required=False)

    check = _command(commands, "check", "examine logs before anything is identified")
    _logs(check)
    check.add_argument("--robot", metavar="TOML", help="robot file, or the name of one of the package")

    identify = _command(commands, "identify", "find the parameters, with intervals, from logs")
    _logs(identify)
    identify.add_argument("--robot", metavar="TOML", required=True, help="robot file, or the name of one")
    identify.add_argument("--method", default="seeded", help="seeded (default), paper, genetic, prediction_error, ...")
    identify.add_argument(
        "--unknown",
        nargs="+",
        metavar="NAME",
        help="beside f (default: f alone): friction, gains, or such as drive.viscous[0]",
    )
    identify.add_argument("--elasticity", action="store_true", help="stiffness and damping of the gears, too")
    identify.add_argument("--held-out", nargs="+", metavar="LOG", help="logs that are only repeated")
    _output(identify, "file for certify and report")
    _long(identify)

    certify = _command(commands, "certify", "the probability that computed torque exceeds the pulse limit")
    _uncertain(certify)
    _law(certify)

    tune = _command(
        commands, "tune", "the controller of least chatter that stays within the pulse limit, and its certificate"
    )
    _uncertain(tune)
    _path(tune)

    report = _command(commands, "report", "one page of an identification and its controller (HTML)")
    report.add_argument("found", help="file of identify -o")
    report.add_argument("--certificate", metavar="FILE", help="file of certify -o or tune -o")
    _law(report)
    _output(report, "the page, such as page.html")
    return parser


def _command(commands: Any, name: str, about: str) -> argparse.ArgumentParser:
    command: argparse.ArgumentParser = commands.add_parser(name, help=about, description=about.capitalize() + ".")
    command.add_argument("--json", action="store_true", help="answer in JSON, for programs")
    command.add_argument("--quiet", action="store_true", help="no progress bars (they are drawn on terminals alone)")
    if name in ("demo", "identify", "certify", "tune"):
        command.add_argument("--seed", type=_seed, default=1 if name == "demo" else 0, help="same seed, same result")
    return command


def _logs(command: argparse.ArgumentParser) -> None:
    command.add_argument("logs", nargs="+", metavar="LOG", help="CSV, NPZ, MAT, HDF5, Parquet, MCAP, rosbag2")
    command.add_argument("--cut", nargs=2, type=float, metavar=("BEGIN", "END"), help="this part alone [s]")


def _uncertain(command: argparse.ArgumentParser) -> None:
    command.add_argument("found", help="file of identify -o")
    command.add_argument("--robot", metavar="TOML", help="robot file with a table [uncertainty]; options go before it")
    command.add_argument("--friction", type=float, metavar="SHARE", help="by which it may differ (default 0.1)")
    command.add_argument("--resonance", nargs=2, type=float, metavar=("LOW", "HIGH"), help="of the gears [Hz]")
    ends: dict[str, Any] = {"nargs": "+", "type": float, "action": _Ends, "metavar": "X"}
    command.add_argument("--damping-ratio", **ends, help="of that resonance, as all below one number or two ends")
    command.add_argument("--load", **ends, help="in the gripper [kg]")
    place = "its centre in the last link's frame [m]"
    command.add_argument("--load-position", nargs=3, type=float, metavar=("X", "Y", "Z"), help=place)
    command.add_argument("--delay", **ends, help="of the torque [s]")
    for name, row in IMPERFECTIONS.items():
        command.add_argument(f"--{name.replace('_', '-')}", **ends, help=f"{row.words} [{row.unit}]")
    command.add_argument("--dropped", type=float, metavar="SHARE", help="of the samples whose counts are lost")
    command.add_argument("--within", type=_positive, default=1.0, help="limit [pulses] (default 1)")
    command.add_argument("--after", type=float, metavar="SECONDS", help="instants before it are left out, and reported")
    command.add_argument("--everyday", action="store_true", help="everyday motions, with --path one more; a row each")
    command.add_argument("--samples", type=int, default=10_000, help="Monte Carlo samples (default 10000)")
    _output(command, "file for report", required=False)
    _long(command)


class _Ends(argparse.Action):
    """One number, or the two ends of a range."""

    def __call__(self, parser: Any, given: Any, values: Any, option: Any = None) -> None:
        if len(values) > 2:
            parser.error(f"argument {option}: expected one number, or the two ends of a range; got {len(values)}")
        setattr(given, self.dest, values[0] if len(values) == 1 else tuple(values))


def _law(command: argparse.ArgumentParser) -> None:
    command.add_argument("--bandwidth", type=float, help="of computed torque [rad/s] (default: the law's own)")
    _path(command)


def _path(command: argparse.ArgumentParser) -> None:
    command.add_argument("--path", metavar="FILE", help="to follow: t [s], q_1, ... [rad] (default: the log's)")


def _output(command: argparse.ArgumentParser, about: str, *, required: bool = True) -> None:
    command.add_argument("-o", "--output", metavar="FILE", required=required, help=about)
    command.add_argument("--force", action="store_true", help="overwrite output files")


def _long(command: argparse.ArgumentParser) -> None:
    command.add_argument("--checkpoint", metavar="FILE", help="keep finished work there: called again, it goes on")


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"a limit is a number above 0; got {text!r}")
    return value


def _seed(text: str) -> int:
    if not (text.isascii() and text.isdecimal()):
        raise argparse.ArgumentTypeError(f"a seed is a whole number from 0; got {text!r}")
    return int(text)
