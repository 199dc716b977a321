"""How the house reads and what it weighs: ``python tests/benchmarks/house.py [COMMIT]``.

The first table stands beside four libraries that are read with pleasure (`PEERS`, counted by the
same `reads.py`; their figures are committed, since their sources are no part of this project). Each
row has a target. The ratchet: a value that is worse than the one in ``house.toml`` and beyond its
target ends the script with status 1. ``--update`` writes the values of this tree there.

The second table compares the structure with that of a commit. A walk is the way of one argument
through the calls that it is given to, in a small run: the `files` whose functions receive it,
`stays` (distinct calls that hand it into another file), `climbs` (those of them into a room above
the caller's, by the layers of pyproject.toml). Its own methods are no stays. Import times are
medians of fresh processes in turn: compare them within one run.
"""

import argparse
import ast
import io
import json
import os
import statistics
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from reads import Reading, read

ROOT = Path(__file__).resolve().parents[2]
RATCHET = Path(__file__).with_name("house.toml")
PACKAGES = ("plant", "identification", "ctc")
PEERS = ("diffrax", "python-control", "brax", "pycma")


@dataclass(frozen=True)
class Row:
    """A figure of the first table: its target, and the same figure of the four peers."""

    name: str
    of: Callable[[Reading], float]
    target: float
    peers: tuple[str, str, str, str]
    decimals: int = 0
    at_least: bool = False

    def worse(self, value: float, committed: float) -> bool:
        """Whether a value is worse than the committed one and beyond the target."""
        sign = -1 if self.at_least else 1
        value = round(value, self.decimals)
        return sign * value > sign * committed and sign * value > sign * self.target


ROWS = (
    Row("tokens", lambda r: r.tokens, 370_000, ("64k", "117k", "86k", "118k")),
    Row("tokens per code line", lambda r: r.tokens_per_line, 9.5, ("6.0", "8.8", "7.9", "8.9"), 2),
    Row("mean length of a line", lambda r: r.line_length, 46, ("41", "44", "41", "48"), 1),
    Row(
        "comments per 100 code lines",
        lambda r: r.comments_per_100,
        12,
        ("13", "36", "18", "24"),
        1,
        at_least=True,
    ),
    Row("private number constants", lambda r: r.constants, 250, ("0", "1", "0", "0")),
    Row("filler bindings [%]", lambda r: r.filler_percent, 1.5, ("0.6", "1.4", "0.2", "0.2"), 2),
    Row("fmt: skip", lambda r: r.format_skips, 20, ("0", "0", "0", "0")),
    Row("starred targets", lambda r: r.starred_targets, 3, ("2", "0", "3", "0")),
    Row("longest function", lambda r: r.longest_function, 80, ("", "", "", "")),
)


def public_names(root):
    """Elements of the three ``__all__``."""
    total = 0
    for package in PACKAGES:
        tree = ast.parse((root / package / "__init__.py").read_text(encoding="utf-8"))
        for statement in tree.body:
            if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "__all__":
                total += len(statement.value.elts)
    return total


def reading_table(reading):
    """Print the first table; the names of the rows that the ratchet refuses."""
    committed = tomllib.loads(RATCHET.read_text(encoding="utf-8"))
    heads = ("here", "committed", "target", *PEERS)
    print(f"{'':30}" + "".join(f"{head:>15}" for head in heads))
    refused = []
    for row in ROWS:
        value = row.of(reading)
        limit = f"{'>=' if row.at_least else '<='} {row.target:,}"
        numbers = (f"{x:,.{row.decimals}f}" for x in (value, committed[row.name]))
        print(f"{row.name:30}" + "".join(f"{x:>15}" for x in (*numbers, limit, *row.peers)))
        if row.worse(value, committed[row.name]):
            refused.append(row.name)
    print(f"longest function: {reading.longest_name}")
    for name in refused:
        print(f"the ratchet: '{name}' has moved away from its target. Move it back.")
    return refused


def update(reading):
    """Commit the values of this tree."""
    lines = [f'"{row.name}" = {round(row.of(reading), row.decimals)}' for row in ROWS]
    head = "# What `python tests/benchmarks/house.py --update` counted last: the ratchet of CI.\n"
    RATCHET.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")


def layers(root):
    """Room -> its height, the three packages one upon another."""
    settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    height, found = 0, {}
    for package in PACKAGES:
        (rows,) = [each["layers"] for each in contracts if each.get("containers") == [package]]
        for row in reversed(rows):
            height += 1
            found |= {f"{package}/{room.strip()}": height for room in row.split("|")}
    return found


def walk(root, call, given):
    """Files, stays and climbs of the object `given` while `call()` runs."""
    heights, calls, files = layers(root), set(), set()

    def home(code):
        path = Path(code.co_filename)
        # a decorator of many rooms: looked through
        if path.name == "arguments.py" and code.co_name == "wrapper":
            return None
        return (
            path.relative_to(root).as_posix().removesuffix(".py") if root in path.parents else None
        )

    def height(file):
        return heights.get("/".join(file.split("/")[:2]), 0)

    def watch(frame, event, _):
        code = frame.f_code
        if event != "call" or (here := home(code)) is None or here.split("/")[0] not in PACKAGES:
            return
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        if (
            not any(frame.f_locals.get(name) is given for name in names)
            or frame.f_locals.get("self") is given
        ):
            return
        files.add(here)
        caller = frame.f_back
        while caller is not None and home(caller.f_code) is None:
            caller = caller.f_back
        before = home(caller.f_code) if caller is not None else None
        before = before if before and before.split("/")[0] in PACKAGES else None
        if before != here:
            calls.add((before, caller.f_code.co_name if before else "", here, code.co_name))

    sys.setprofile(watch)
    try:
        call()
    finally:
        sys.setprofile(None)
    climbs = [each for each in calls if each[0] and height(each[2]) > height(each[0])]
    return [len(files), len(calls), len(climbs)]


def walks(root):
    """Of the record of `identify`, and of the first argument of `certify`; run in a process of
    the checkout `root`.
    """
    from ctc import ComputedTorque, certify
    from identification import identify
    from plant import puma560, simulate

    path = puma560.reference()
    record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), path)
    found, answer = {}, []
    found["identify(record)"] = walk(
        root, lambda: answer.append(identify(puma560.dynamics(), record, progress=False)), record
    )
    law = ComputedTorque(answer[0])
    found["certify(found)"] = walk(
        root,
        lambda: certify(answer[0], answer[0].rig, law, path, samples=64, progress=False),
        answer[0],
    )
    return found


def own_process(root, *arguments):
    """Standard output of Python with the packages of a checkout."""
    environment = {**os.environ, "PYTHONPATH": str(root)}
    command = [sys.executable, *arguments]
    return subprocess.run(  # noqa: S603
        command, cwd=root, env=environment, capture_output=True, text=True, check=True
    ).stdout


def import_times(roots, runs=5):
    """Root -> package -> median time of its import [s]."""
    times = {root: {package: [] for package in PACKAGES} for root in roots}
    for package in PACKAGES:
        for _ in range(runs):
            for root in roots:
                begun = time.perf_counter()
                own_process(root, "-c", f"import {package}")
                times[root][package].append(time.perf_counter() - begun)
    return {
        root: {name: statistics.median(each) for name, each in of.items()}
        for root, of in times.items()
    }


def checkout(commit, folder):
    """The three packages and pyproject.toml as they were at a commit; None where there is no
    such history.
    """
    command = ["git", "-C", str(ROOT), "archive", commit, *PACKAGES, "pyproject.toml"]
    answer = subprocess.run(command, capture_output=True, check=False)  # noqa: S603
    if answer.returncode:
        return None
    with tarfile.open(fileobj=io.BytesIO(answer.stdout)) as archive:
        # git's own
        archive.extractall(  # noqa: S202
            folder, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {})
        )
    return Path(folder).resolve()


def structure_table(commit, minutes):
    """Print the second table: this tree beside that of a commit."""
    with tempfile.TemporaryDirectory() as folder:
        roots = [root for root in (checkout(commit, folder), ROOT) if root]
        if len(roots) == 1:
            print(f"no commit {commit} in this history: only what is here")
        readings = [read(root, PACKAGES) for root in roots]
        rows = [
            ("lines of code", [f"{x.code_lines:,}" for x in readings]),
            ("lines of docstrings", [f"{x.docstring_lines:,}" for x in readings]),
            ("files", [str(x.files) for x in readings]),
            ("public names", [str(public_names(root)) for root in roots]),
        ]
        ways = [json.loads(own_process(root, __file__, "--walks", str(root))) for root in roots]
        for name in ways[0]:
            cells = [", ".join(map(str, way[name])) for way in ways]
            rows.append((f"{name}: files, stays, climbs", cells))
        times = import_times(roots)
        for package in PACKAGES:
            rows.append(
                (f"import {package} [s]", [f"{times[root][package]:.2f}" for root in roots])
            )
        for name, value, aim in minutes:
            rows.append((f"{name} [min], at most {aim}", [""] * (len(roots) - 1) + [value]))
    heads = [*([commit] if len(roots) == 2 else []), "now"]
    print(f"{'':42}" + "".join(f"{head:>12}" for head in heads))
    for name, values in rows:
        print(f"{name:42}" + "".join(f"{value:>12}" for value in values))


def minute(text):
    """A time that was measured elsewhere, such as ``tests=9.9``: name, minutes, aim."""
    name, _, value = text.partition("=")
    return name, value, {"tests": 10, "CI": 20}.get(name, "")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commit", nargs="?", default="c4bc7f33", help="to compare with")
    parser.add_argument("--update", action="store_true", help="commit the values of this tree")
    parser.add_argument("--quick", action="store_true", help="the first table alone")
    parser.add_argument("--minutes", nargs="*", type=minute, default=[], metavar="NAME=M")
    parser.add_argument("--walks", type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.walks:
        print(json.dumps(walks(chosen.walks.resolve())))
        return 0
    reading = read(ROOT, PACKAGES)
    if chosen.update:
        update(reading)
    refused = reading_table(reading)
    if not chosen.quick:
        print()
        structure_table(chosen.commit, chosen.minutes)
    return int(bool(refused))


if __name__ == "__main__":
    sys.exit(main())
