"""``onepulse campaign PLAN.toml``: the other commands over the logs of many robots.

A plan names robots, each with a robot file and patterns of logs. ``do`` lists the commands to run:
check, identify, certify, report; each may have a table of options. Every log is a task,
``ROBOT/LOG``. With ``fleet``, the identifications go into the file of a `Fleet`, and onto its page.
Their robot is the plan's; their time is in the log's notes, or in its name, where the pattern
``notes`` finds it.
"""

import contextlib
import functools
import glob
import hashlib
import multiprocessing
import os
import threading
import tomllib
from argparse import Namespace
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from ctc.campaigns import Fleet, campaign, rows_of, seconds_of
from ctc.commandline.commands import COMMANDS
from ctc.commandline.inputs import Answer
from identification import Identification
from plant import read_robot
from plant.compiler import cores
from plant.logs import notes_of
from plant.parts import choice, instance

# The steps in the order in which one needs the file of another.
_DO = ("check", "identify", "certify", "report")
_KEYS = ("folder", "do", "robots", "executor", "fleet", "notes", *_DO)
_ROBOT_KEYS = ("robot", "logs")
# Options that the plan sets itself for every log.
_RESERVED = {
    "checkpoint",
    "certificate",
    "force",
    "found",
    "help",
    "json",
    "output",
    "quiet",
    "robot",
}
_EXECUTORS = "threads, processes or dask:ADDRESS, such as dask:tcp://10.0.0.5:8786"

Parse = Callable[[list[str]], Namespace]


def run_campaign(options: Namespace, parse: Parse) -> Answer:
    """Run the plan; `parse` reads the options of the other commands."""
    plan = _read(Path(options.plan))
    # Paths of a plan begin at its own folder, not at that of the call.
    folder = Path(options.plan).parent / plan["folder"]
    ledger = folder / "ledger.sqlite"
    logs = _tasks(plan, Path(options.plan), folder, parse)
    if options.status:
        return _status(ledger, logs)
    # A folder that holds another campaign is not continued by mistake.
    if ledger.exists() and not options.resume:
        raise ValueError(
            f"{folder} holds a campaign. Pass --resume to go on with it, or name another folder."
        )
    # Two logs of one name would write the same files.
    tasks: dict[str, Any] = {}
    for name, steps, stamp in logs:
        if name in tasks:
            raise ValueError(
                f"logs of a robot must differ in name; two are {name!r:.80}. Rename one of the"
                " files."
            )
        tasks[name] = _worked, (steps, stamp), {}
    if ledger.exists():
        # A campaign that is resumed must list its tasks in their old order, new ones behind them.
        numbers: dict[str, int] = dict(rows_of(ledger, "select name, number from tasks"))
        tasks = dict(sorted(tasks.items(), key=lambda task: numbers.get(task[0], len(numbers))))
    # A failed log is reported, and tried again by the next --resume.
    with _executor(options.executor or plan.get("executor", "threads")) as executor:
        done = campaign(
            tasks, executor=executor, folder=folder, retries=0, progress=not options.quiet
        )
    # Read the results once: each access opens the ledger.
    results = dict(done.results)
    # The fleet judges all robots together, so it follows when all logs are done.
    judged = _fleet(plan, Path(options.plan), tasks, results) if "fleet" in plan else {}
    negative = [
        name
        for name, result in results.items()
        if not all(answer["good"] for answer in result.values())
    ]
    # Text for people names the exceptions; JSON has every result.
    lines = [
        f"{name}: {command}: {answer['said']}"
        for name in negative
        for command, answer in results[name].items()
        if not answer["good"]
    ]
    lines += [f"{name}: failed: {error}" for name, error in done.errors.items()]
    lines += [f"{name}: {verdict}" for name, verdict in judged.items()]
    counts = (
        f"{len(results)} logs done, {len(negative)} with a negative verdict, {len(done.errors)}"
        " failed"
    )
    data = {
        "results": results,
        "errors": dict(done.errors),
        "negative": negative,
        "folder": str(folder),
    }
    if "fleet" in plan:
        data["fleet"] = judged
    return Answer("\n".join([counts, *lines, f"results are in {folder}"]), data, not lines)


def _read(path: Path) -> dict[str, Any]:
    """A plan, its keys checked."""
    try:
        plan = tomllib.loads(path.read_text(encoding="utf-8"))
    # Without a traceback: line breaks and places of the parser's message go.
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else " ".join(str(error).split())
        raise ValueError(f"{path} must be a plan in TOML; {reason}. Correct it.") from None
    # A misspelt key would be ignored in silence, and hours of work lost.
    for key, value in plan.items():
        choice(f"a key of {path}", key, _KEYS)
        if isinstance(value, dict) != (key in ("robots", *_DO)):
            raise ValueError(
                f"{key} of {path} must be {'no ' * isinstance(value, dict)}a table; got"
                f" {value!r:.60}."
            )
        if key == "executor":
            instance(key, value, str, f"Give {_EXECUTORS}.")
    # Options that the plan sets per log cannot be set for all logs.
    for command in _DO:
        for key in plan.get(command, {}):
            # The parser takes the first letters of an option for it.
            if any(name.startswith(key.replace("-", "_")) for name in _RESERVED):
                raise ValueError(
                    f"[{command}] of {path} must not have {key!r}, which the plan gives itself."
                    " Drop it."
                )
    robots = plan.get("robots")
    do = plan.get("do")
    # These three keys have no default.
    if not isinstance(plan.get("folder"), str) or not isinstance(robots, dict) or not robots:
        raise ValueError(
            f'{path} must have folder = "..." and a table [robots.NAME] for each robot. Add them.'
        )
    if not isinstance(do, list) or not do or [command for command in _DO if command in do] != do:
        raise ValueError(
            f"do of {path} must be some of {', '.join(_DO)}, in this order; got {do!r:.80}."
            " Correct it."
        )
    if "identify" not in do and do != ["check"]:
        raise ValueError(f"do of {path} must have identify before {do[-1]}; it has not. Add it.")
    # A fleet holds identifications, and notes are for a fleet alone.
    for key in ("fleet", "notes"):
        if key in plan and (
            not isinstance(plan[key], str) or "identify" not in do or "fleet" not in plan
        ):
            asked = 'fleet = "..." and "identify" in do' if isinstance(plan[key], str) else "text"
            raise ValueError(
                f"{key} of {path} must come with {asked}; got {plan[key]!r:.60}. Add what is"
                " missing."
            )
    # The page stands beside the fleet, and would take the place of a file of its own name.
    if Path(plan.get("fleet", "")).suffix == ".html":
        raise ValueError(
            f"fleet of {path} must be the file of a fleet, not its page; got {plan['fleet']!r:.60}."
            " Name it .sqlite."
        )
    # Every robot must have its file and at least one pattern of logs.
    for name, robot in robots.items():
        # A fleet has the robot's name from that of the task, and files are in a folder of it.
        if name in ("", ".", "..") or {"/", "\\"} & set(name):
            raise ValueError(
                f"robots of {path} must have names that can be a folder's; got {name!r:.60}. Rename"
                " it."
            )
        texts = list[Any]()
        if isinstance(robot, dict) and set(robot) == set(_ROBOT_KEYS):
            # One pattern may stand without a list.
            logs = robot["logs"] if isinstance(robot["logs"], list) else [robot["logs"]]
            texts = [robot["robot"], *logs]
        # A robot and a pattern at least; an empty pattern would be the folder of the plan.
        if len(texts) < 2 or not all(isinstance(text, str) and text for text in texts):
            raise ValueError(
                f"[robots.{name}] of {path} must have texts robot and logs; got {robot!r:.80}."
                " Correct it."
            )
    return plan


def _tasks(
    plan: dict[str, Any], path: Path, folder: Path, parse: Parse
) -> Iterator[tuple[str, Any, Any]]:
    """For each log: the name of its task, the options of its commands, the digest of its files."""
    for name, of_robot in plan["robots"].items():
        # A robot is a file beside the plan, or the name of one of the package.
        file = path.parent / of_robot["robot"]
        robot = str(file) if file.is_file() else of_robot["robot"]
        # A misspelt robot is found before anything runs.
        read_robot(robot)
        patterns = of_robot["logs"] if isinstance(of_robot["logs"], list) else [of_robot["logs"]]
        for pattern in patterns:
            # A log whose own name has brackets is no pattern, nor is a folder's with such a name.
            # Sorted: `glob` gives files in the order of the disk, a campaign must repeat its own.
            found = [pattern]
            if not (path.parent / pattern).exists():
                found = sorted(glob.glob(pattern, root_dir=path.parent))
            logs = [str(path.parent / log) for log in found]
            if not logs:
                raise ValueError(
                    f"logs of robot {name} must be there; {pattern!r} matches nothing. Correct it."
                )
            for log in logs:
                place = folder / name / Path(log).stem
                # A time that no fleet can read is refused now, not after the identification.
                # Without a time in the name that of the log's notes counts.
                if "notes" in plan:
                    seconds_of(notes_of(plan["notes"], log).get("time", 1e9))
                # The parser of the commands checks the plan's options, with the same messages.
                steps = [
                    vars(parse(typed_arguments(command, plan, robot, log, place)))
                    for command in plan["do"]
                ]
                # With a log or a robot file that has changed since, the task is another one, which
                # a resumed campaign refuses.
                digest = _digest([Path(log), file] if file.is_file() else [Path(log)])
                yield f"{name}/{Path(log).stem}", steps, digest


def _digest(paths: list[Path]) -> str:
    """SHA-256 of the contents of files, and of all files in folders, such as a rosbag2."""
    digest = hashlib.sha256()
    for path in paths:
        inside = [file for file in sorted(path.rglob("*")) if file.is_file()]
        for file in inside if path.is_dir() else [path]:
            with open(file, "rb") as content:
                hashlib.file_digest(content, lambda: digest)
    return digest.hexdigest()


def _fleet(
    plan: dict[str, Any], path: Path, tasks: dict[str, Any], results: dict[str, Any]
) -> dict[str, str]:
    """Add the identifications to the fleet; verdicts of changed robots, reasons of exclusions."""
    place = path.parent / plan["fleet"]
    excluded = {}
    fleet = Fleet(place)
    # A log that the fleet refuses (no intervals, another robot) does not end the campaign.
    for name in results:
        steps = tasks[name][1][0]
        step = next(step for step in steps if step["command"] == "identify")
        try:
            notes = notes_of(plan.get("notes", {}), step["logs"][0]) | {"robot": name.split("/")[0]}
            fleet.add(Identification.load(step["output"]), notes=notes)
        except ValueError as error:
            excluded[name] = f"not in the fleet: {error}"
    # An empty fleet has no page.
    if len(fleet):
        fleet.report(place.with_suffix(".html"), overwrite=True)
    changes = {judgement.robot: judgement.verdict for judgement in fleet if judgement.changes}
    return changes | excluded


def typed_arguments(
    command: str, plan: dict[str, Any], robot: str, log: str, place: Path
) -> list[str]:
    """One command as it would be typed."""
    # Fixed names in a folder for each log: later steps find the files of earlier ones.
    identification = str(place / "found.json")
    certificate = str(place / "certificate.json")
    arguments = {
        "check": [log, "--robot", robot],
        "identify": [log, "--robot", robot, "-o", identification, "--force"],
        "certify": [identification, "-o", certificate, "--force"],
        "report": [identification, "-o", str(place / "page.html"), "--force"],
    }[command]
    if command == "report" and "certify" in plan["do"]:
        arguments += ["--certificate", certificate]
    # The table of the command in the plan: true is a flag, false leaves it out.
    for key, value in plan.get(command, {}).items():
        if value is False:
            continue
        arguments.append(f"--{key.replace('_', '-')}")
        if value is not True:
            arguments += map(str, value if isinstance(value, list) else [value])
    return [command, *arguments, "--quiet"]


def _worked(steps: list[dict[str, Any]], stamp: Any) -> dict[str, Any]:
    """Run the commands of one log in a worker, and return their answers."""
    answers = {}
    for step in steps:
        # On the worker: its file system may be another machine's.
        if step.get("output"):
            Path(step["output"]).parent.mkdir(parents=True, exist_ok=True)
        answer = COMMANDS[step["command"]](Namespace(**step))
        # The first sentence says what is wrong; the rest is in the files.
        sentence = " ".join(answer.text.split()).partition(". ")[0]
        answers[step["command"]] = answer.data | {"good": bool(answer.good), "said": sentence}
    return answers


@contextlib.contextmanager
def _executor(where: str) -> Iterator[Any]:
    """The executor of a name."""
    if where == "threads":
        # Threads are the default of `campaign`.
        yield None
    elif where == "processes":
        methods = multiprocessing.get_all_start_methods()
        # A fork of a process with threads may hang; the server forks before there are any.
        context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
        # Imported once in the server, not in every worker.
        if hasattr(context, "set_forkserver_preload"):
            context.set_forkserver_preload(["ctc.commandline.plan"])
        yield functools.partial(
            ProcessPoolExecutor, cores(), mp_context=context, initializer=_ends_with_its_parent
        )
    elif where.startswith("dask:"):
        try:
            from distributed import Client
        except ImportError:
            raise ValueError(
                "executor dask needs distributed: pip install 'onepulse[dask]'."
            ) from None
        # A scheduler that does not answer must not hang the command.
        try:
            client = Client(where.removeprefix("dask:"), timeout=10)
        except (OSError, ValueError) as error:
            raise ValueError(
                f"executor must be a scheduler that runs; {where}: {error}. Start one."
            ) from None
        with client:
            yield client
    else:
        raise ValueError(f"executor must be {_EXECUTORS}; got {where!r:.60}. Correct it.")


def _ends_with_its_parent() -> None:
    """End this worker when its campaign is killed; by itself it would wait for tasks for ever."""
    parent: Any = multiprocessing.parent_process()
    # Daemon: the thread must not keep a worker alive that ends by itself.
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


def _status(ledger: Path, logs: Iterator[Any]) -> Answer:
    """Number of tasks in each state, from the ledger, and of logs."""
    # Read only: a question about a campaign must not begin one.
    if not ledger.is_file():
        raise ValueError(
            f"{ledger.parent} must hold a campaign; there is none. Run it without --status first."
        )
    states = dict(rows_of(ledger, "select state, count(*) from tasks group by state"))
    failed = dict(
        rows_of(ledger, "select name, error from tasks where state = 'failed' order by number")
    )
    # Logs that have come since the last call are not in the ledger yet.
    data = {state: states.get(state, 0) for state in ("done", "open", "failed")} | {
        "logs": sum(1 for _ in logs)
    }
    text = ", ".join(f"{count} {state}" for state, count in data.items()).replace(
        " failed, ", " failed, of "
    )
    return Answer(
        "\n".join([text, *(f"{name}: {error}" for name, error in failed.items())]),
        data | {"errors": failed},
    )
