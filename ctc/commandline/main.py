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

from ctc.certification import IMPERFECTIONS
from ctc.commandline.commands import COMMANDS
from ctc.commandline.plan import run_campaign
from ctc.commandline.words import in_the_shell
from identification import IdentificationWarning
from plant.version import __version__

# The last lines of the help of `onepulse`: a script decides by these codes.
_CODES = (
    "exit codes: 0 fine; 1 the verdict is negative: a finding of the checkup, an unreliable"
    " identification, a plant that exceeds the limit, a path that begins in motion; 2 bad input,"
    " reported in one line; 3 a defect of the library; 130 interrupted"
)


# Positional arguments. A message writes the name of an option as `--option`, but leaves the names
# of these as they are.
_ARGUMENTS = {"command", "found", "logs", "name", "model", "plan"}


class _Parser(argparse.ArgumentParser):
    """A parser that reports a wrong option in one line and exits with code 2."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Refuse an unknown argument, with a hint at the option whose help mentions it."""
        options, unknown = super().parse_known_args(args, namespace)
        if not unknown:
            return options, unknown
        # The help of an option may use the word that the user took for its name.
        word = unknown[0].lstrip("-")
        hint = ""
        for action in self._actions:
            if action.option_strings and word in re.findall(r"\w+", action.help or ""):
                hint = f"; {action.option_strings[-1]} is: {action.help}"
                break
        self.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")

    def error(self, message: str) -> NoReturn:
        # The usage that argparse would print before the message hides it on a small terminal.
        print(f"onepulse: {message}. See: {self.prog} --help", file=sys.stderr)
        raise SystemExit(2)


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code (`_CODES`).

    Without `arguments`, the command is that of `sys.argv`. A wrong option, ``--help`` and
    ``--version`` raise SystemExit.
    """
    options = command_parser().parse_args(arguments)
    # Every way in which a command may end has its own exit code (`_CODES`).
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", IdentificationWarning)  # printed in the answer
            # numpy warns of overflow in runs that diverge; the library checks its results itself.
            warnings.simplefilter("ignore", RuntimeWarning)
            # A warning of the library is one line on standard error; standard output is the
            # answer's alone.
            warnings.showwarning = _said
            if options.command == "campaign":
                # A campaign gives its plan's options to the parser of the other commands.
                answer = run_campaign(options, command_parser().parse_args)
            else:
                answer = COMMANDS[options.command](options)
        text = _as_json(answer.data) if options.json else answer.text
    except KeyboardInterrupt:
        # Whoever interrupts learns how to go on.
        advice = ""
        if options.command == "campaign":
            advice = " What was finished is kept: go on with --resume."
        elif getattr(options, "checkpoint", None):
            advice = f" What was finished is in {options.checkpoint}: call again."
        return _failed(f"interrupted.{advice}", 130)
    # Bad input, or a machine that lacks something: one line, and no traceback.
    except (ValueError, OSError, ImportError, MemoryError) as error:
        message = in_the_shell(" ".join(str(error).split()), set(vars(options)) - _ARGUMENTS)
        return _failed(message or type(error).__name__, 2)
    # Any other error is a defect of the library: whoever mends it needs the traceback.
    except Exception:
        traceback.print_exc()
        return _failed("this is a defect of the library; please report the lines above", 3)
    try:
        _print(in_the_shell(text, set(vars(options)) - _ARGUMENTS))
    except OSError as error:
        # A full disk, or a closed pipe.
        # Python flushes standard output once more at its end, which would fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):  # `| head` closes the pipe early
            return _failed(
                f"the answer must be printed; {error.strerror}. Make room, or print it elsewhere.",
                2,
            )
    return 0 if answer.good else 1


def _as_json(data: Any) -> str:
    """The data of an answer as JSON."""
    # JSON has no NaN: a number that is not finite must have become null before.
    try:
        return json.dumps(data, indent=1, allow_nan=False)
    except ValueError as error:
        raise RuntimeError("an answer must have finite numbers") from error


def _print(text: str) -> None:
    """Print a text; characters that the output's encoding lacks become "?"."""
    # Without standard output, as under a service, there is nowhere to print.
    if sys.stdout is None:
        return
    # A stream that replaces standard output, as in tests, may have no encoding.
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    if encoding != "utf-8":
        text = text.replace("±", "+-")
    if text:
        # A file name may hold bytes that are no characters, in any encoding.
        print(text.encode(encoding, "replace").decode(encoding))
    # The flush raises the error of a full disk now, while `main` can still report it.
    sys.stdout.flush()


def _failed(text: str, code: int) -> int:
    print(f"onepulse: {text}", file=sys.stderr)
    return code


def _said(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"onepulse: warning: {' '.join(str(message).split())}", file=sys.stderr)


def command_parser() -> argparse.ArgumentParser:
    """The parser of all commands and their options."""
    about = (
        "From logged encoder pulses to an arm's inertial parameters, and to computed torque within"
        " one pulse."
    )
    parser = _Parser(prog="onepulse", description=about, epilog=_CODES)
    parser.add_argument("--version", action="version", version=f"onepulse {__version__}")
    commands = parser.add_subparsers(
        dest="command", required=True, metavar="COMMAND", parser_class=_Parser
    )
    # Options of every command stand first, so that all helps begin alike.
    for name, (message, options) in _COMMANDS.items():
        command = commands.add_parser(
            name, help=message, description=message[0].upper() + message[1:] + "."
        )
        for names, settings in (*_EVERY, *options):
            command.add_argument(*names, **settings)
    return parser


def _option(names: str, about: str, **settings: Any) -> tuple[list[str], dict[str, Any]]:
    """One argument of a command, as `add_argument` takes it."""
    return names.split(), {"help": about, **settings}


def _flag(name: str, about: str) -> tuple[list[str], dict[str, Any]]:
    """An option without a value."""
    return _option(name, about, action="store_true")


def _output(about: str, *, required: bool = True) -> Any:
    # Whatever writes a file has the same two options.
    force = _flag("--force", "overwrite output files")
    return _option("-o --output", about, metavar="FILE", required=required), force


# argparse has no type that takes one number or two.
class _Ends(argparse.Action):
    """One number, or the two ends of a range."""

    def __call__(self, parser: Any, options: Any, values: Any, option: Any = None) -> None:
        # `nargs="+"` takes any number of values.
        if len(values) > 2:
            parser.error(
                f"argument {option}: expected one number, or the two ends of a range; got"
                f" {len(values)}"
            )
        setattr(options, self.dest, values[0] if len(values) == 1 else tuple(values))


def _seed(text: str) -> int:
    # `int` would take "-1", "1_000" and digits of other scripts.
    if not (text.isascii() and text.isdecimal()):
        raise argparse.ArgumentTypeError(f"a seed is a whole number from 0; got {text!r}")
    return int(text)


# Options of every command.
_EVERY = (
    _flag("--json", "answer in JSON, for programs"),
    _flag("--quiet", "no progress bars (they are drawn on terminals alone)"),
)
# Arguments that several commands share.
_LOGS = (
    _option("logs", "CSV, NPZ, MAT, HDF5, Parquet, MCAP, rosbag2", nargs="+", metavar="LOG"),
    _option("--cut", "this part alone [s]", nargs=2, type=float, metavar=("BEGIN", "END")),
)
# A result that is drawn at random must be repeatable by default.
_SEED = _option("--seed", "same seed, same result", type=_seed, default=0)
_FOUND = _option("found", "file of identify -o")
_PATH = _option("--path", "to follow: t [s], q_1, ... [rad] (default: the log's)", metavar="FILE")
_BANDWIDTH = _option(
    "--bandwidth", "of computed torque [rad/s] (default: the controller's own)", type=float
)
_CHECKPOINT = _option(
    "--checkpoint", "keep finished work there: called again, it goes on", metavar="FILE"
)
# A model is needed here. Its robot file also says which columns of the logs to read.
_MODEL = _option("--robot", "robot file, or the name of one", metavar="TOML", required=True)
_PRIOR = _option(
    "--prior",
    "relative standard deviation of the model's bodies, such as 0.3, for what the log leaves open",
    type=float,
    metavar="SHARE",
)
# Settings by kind of value: a robot file, one number or a range, a position.
_ROBOT: Any = {"metavar": "TOML"}
_ENDS: Any = {"nargs": "+", "type": float, "action": _Ends, "metavar": "X"}
_PLACE: Any = {"nargs": 3, "type": float, "metavar": ("X", "Y", "Z")}
# What `certify` and `tune` share: the uncertainty, the limit, the samples.
_UNCERTAIN = (
    _SEED,
    _FOUND,
    _option("--robot", "robot file with a table [uncertainty]; options overrule it", **_ROBOT),
    _option("--friction", "by which it may differ (default 0.1)", type=float, metavar="SHARE"),
    _option("--resonance", "of the gears [Hz]", nargs=2, type=float, metavar=("LOW", "HIGH")),
    _option("--damping-ratio", "of it: one number, or two ends, as all that follow", **_ENDS),
    _option("--load", "in the gripper [kg]", **_ENDS),
    _option("--load-position", "its centre in the last link's frame [m]", **_PLACE),
    _option("--delay", "of the torque [s]", **_ENDS),
    # Each row of the table of imperfections becomes an option.
    *(
        _option(f"--{name.replace('_', '-')}", f"{row.words} [{row.unit}]", **_ENDS)
        for name, row in IMPERFECTIONS.items()
    ),
    # How the samples are simulated and judged.
    _option("--dropped", "share of samples whose counts are lost", type=float, metavar="SHARE"),
    _option("--within", "limit [pulses] (default 1)", type=float, default=1.0),
    _option(
        "--after", "instants before it are left out, and reported", type=float, metavar="SECONDS"
    ),
    _flag("--everyday", "a row for each of some everyday motions, and for --path"),
    _option("--samples", "Monte Carlo samples (default 10000)", type=int, default=10_000),
    # Output and checkpoint come last of the shared arguments.
    *_output("file for report", required=False),
    _CHECKPOINT,
)

# Name of each command -> what it is for, and its arguments.
_COMMANDS: dict[str, tuple[str, Any]] = {
    "demo": (
        "the paper from end to end: measure, identify, control",
        (
            # The default seed of the demo differs from that of the other commands.
            _option("--seed", "same seed, same result", type=_seed, default=1),
            _option("--figures", "folder for the figures", type=Path, default=Path("figures")),
        ),
    ),
    "robots": (
        "robot files of the package, to start from",
        (
            _option(
                "name",
                "one of them, or new: a file to complete; without a name, a list",
                nargs="?",
            ),
            _option("model", "of new: the arm's model", nargs="?", metavar="URDF"),
            _option(
                "--dh",
                "of new: joints of an arm without a model, by Denavit-Hartenberg rows",
                type=int,
                metavar="JOINTS",
            ),
            _option(
                "--base", "of new: where the arm begins (default: the file's root)", metavar="LINK"
            ),
            _option("--tip", "of new: where it ends", metavar="LINK"),
            *_output("write it there (default: print it)", required=False),
        ),
    ),
    "check": (
        "examine logs before anything is identified",
        (
            *_LOGS,
            # Without a robot file the log must be one that the library wrote.
            _option("--robot", "robot file, or the name of one of the package", **_ROBOT),
        ),
    ),
    "identify": (
        "find the parameters, with intervals, from logs",
        (
            _SEED,
            *_LOGS,
            _MODEL,
            _option("--method", "seeded (default), paper, prediction_error, ...", default="seeded"),
            # Further unknowns make the intervals wider: none is added without being asked for.
            _option(
                "--unknown",
                "beside f (default: f alone): friction, gains, or such as drive.viscous[0]",
                nargs="+",
                metavar="NAME",
            ),
            _PRIOR,
            _flag("--elasticity", "stiffness and damping of the gears, too"),
            _option(
                "--held-out",
                "logs for validation, only simulated (default: the last of several; without a LOG:"
                " none)",
                nargs="*",
                metavar="LOG",
            ),
            *_output("file for certify and report"),
            _CHECKPOINT,
        ),
    ),
    "fit-torque": (
        "fit f and friction to logged torques, with the error on other logs",
        (
            *_LOGS,
            _MODEL,
            _option(
                "--unknown",
                "beside f (default: what the robot file leaves open): such as drive.coulomb[0]",
                nargs="+",
                metavar="NAME",
            ),
            _PRIOR,
            _option(
                "--held-out", "logs whose torques are only predicted", nargs="+", metavar="LOG"
            ),
            _option("--band", "in which errors are compared [Hz] (default 10)", type=float),
        ),
    ),
    "certify": (
        "the probability that computed torque exceeds the pulse limit",
        (
            *_UNCERTAIN,
            # `certify` is given its controller; `tune` searches for one and has no --bandwidth.
            _BANDWIDTH,
            _PATH,
            _flag("--hold", "from a hold, static friction anywhere inside its cone"),
        ),
    ),
    "tune": (
        "the controller of least activity within the pulse limit, and its certificate",
        (
            *_UNCERTAIN,
            _PATH,
            _option(
                "--vary",
                "further numbers of computed torque to search, as dead_zone",
                nargs="+",
                default=(),
                metavar="NAME",
            ),
        ),
    ),
    "campaign": (
        "the commands above over the logs of many robots, as a plan says",
        (
            _option(
                "plan", "robots, logs, what to do, and where results are kept", metavar="PLAN.toml"
            ),
            # The plan does not say where a campaign runs: one plan may run on several machines.
            _option("--executor", "threads (default), processes, or dask:ADDRESS", metavar="WHERE"),
            _flag("--resume", "go on with what the folder of the plan holds"),
            _flag("--status", "how far it is; runs nothing"),
        ),
    ),
    "report": (
        "one page of an identification and its controller (HTML)",
        (
            _FOUND,
            # A certificate has its own controller; --bandwidth is for a page without a certificate.
            _option("--certificate", "file of certify -o or tune -o", metavar="FILE"),
            _option("--title", "title of the page", metavar="TEXT"),
            _BANDWIDTH,
            _PATH,
            *_output("the page, such as page.html"),
        ),
    ),
}
