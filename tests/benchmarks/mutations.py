"""Which changes of the code no test notices: one comparison, sign, number or index at a time.

    python tests/benchmarks/mutations.py --guards [--every 8]
    python tests/benchmarks/mutations.py --seeded 60 [--tree FOLDER] [--longest 600] [--jobs 2]
    COVERAGE_FILE=ran python -m pytest -n 2 --cov=plant --cov=identification --cov=ctc \
        --cov-context=test --cov-report= && \
        python tests/benchmarks/mutations.py --seeded 60 --coverage ran

The first changes every eighth comparison and sign of what guards and stops a running controller
(plant/realtime). The second draws changes from all three packages, from each file as many as it has
places on average; with --tree of another checkout. Each is made in a copy, and the tests of its
room run until one fails, which must pass on the tree as it is: those are named by their file. With
--coverage, which pytest-cov writes, only the tests run that ran the changed line, wherever they
are. A change of a kernel changes its text, and by that its name in the cache. Tests that do not end
within `--longest` seconds show nothing: such changes are listed as "not ended", and do not count as
noticed.
"""

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
GUARDS = ("first_motion", "guards", "running", "safety", "status", "stopping", "watching")
GUARDED = ("tests/plant/realtime", "tests/ctc/laws/test_guards.py", "tests/ctc/laws/test_faults.py",
           "tests/ctc/laws/test_spoilt_loops.py")  # fmt: skip
OTHER = {
    "<": ">=",
    ">=": "<",
    ">": "<=",
    "<=": ">",
    "==": "!=",
    "!=": "==",
    "is": "is not",
    "is not": "is",
    "in": "not in",
    "not in": "in",
    "+": "-",
    "-": "+",
    "*": "/",
    "/": "*",
}
NOT_ENDED = "not ended"
"""What is said of tests that took too long."""


def changes(file, kinds):
    """(line, what, new text) of each place of a file: comparisons, signs, numbers and indices."""
    text = file.read_text(encoding="utf-8")
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line.encode()))
    raw = text.encode()

    def at(line, column):
        return starts[line - 1] + column

    def between(left, right):
        """The operator between two nodes, and another."""
        low, high = at(left.end_lineno, left.end_col_offset), at(right.lineno, right.col_offset)
        found = re.search(rb"is\s+not\b|not\s+in\b|\bis\b|\bin\b|[<>=!]=|[<>*/+-]", raw[low:high])
        word = b" ".join(found.group().split()).decode() if found else ""
        return (low + found.start(), low + found.end(), OTHER[word]) if word in OTHER else None

    def replacement(node):
        if isinstance(node, ast.Compare) and "comparison" in kinds:
            return between(node.left, node.comparators[0])
        if (
            isinstance(node, ast.BinOp)
            and isinstance(node.op, (ast.Add, ast.Sub))
            and "sign" in kinds
        ):
            return between(node.left, node.right)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and "sign" in kinds:
            return at(node.lineno, node.col_offset), at(node.lineno, node.col_offset) + 1, "+"
        if (
            isinstance(node, ast.Subscript)
            and isinstance(node.slice, ast.Constant)
            and "index" in kinds
        ):
            return number(node.slice) if isinstance(node.slice.value, int) else None
        if isinstance(node, ast.Constant) and "number" in kinds:
            return number(node)
        return None

    def number(node):
        if isinstance(node.value, bool) or not isinstance(node.value, (int, float)):
            return None
        new = node.value + 1 if isinstance(node.value, int) else 2 * node.value or 1.0
        return at(node.lineno, node.col_offset), at(node.end_lineno, node.end_col_offset), repr(new)

    found = {}
    for node in ast.walk(ast.parse(text)):
        place = replacement(node)
        if place is not None:
            low, high, new = place
            found[low] = (
                node.lineno,
                f"{raw[low:high].decode()} -> {new}",
                (raw[:low] + new.encode() + raw[high:]).decode(),
            )
    return [found[low] for low in sorted(found)]


def rooms_of(tree, file):
    """Test files of a file's room, else of its package; those first that have its name, then
    those that mention it.
    """
    package, *room = file.relative_to(tree).parts[:-1]
    own = tree.joinpath("tests", package, *room)
    tests = sorted((own if own.is_dir() else tree / "tests" / package).rglob("test_*.py"))
    tests.sort(
        key=lambda test: (
            file.stem not in test.stem,
            not re.search(rf"\b{file.stem}\b", test.read_text()),
        )
    )
    return [str(test.relative_to(tree)) for test in tests]


def first_line(node):
    """That of a statement, with its decorators."""
    return min([node.lineno, *(word.lineno for word in getattr(node, "decorator_list", ()))])


def ran_by(tree, file, line, contexts):
    """Tests that ran the statement of a line, those of its room first; of a statement that runs on
    import all tests that ran anything of the file.
    """
    statements = [
        node
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.stmt) and first_line(node) <= line <= node.end_lineno
    ]
    innermost = max(statements, key=lambda node: node.lineno)
    # A header ends where its body begins, which other tests may run.
    body = getattr(innermost, "body", None)
    end = body[0].lineno - 1 if body else innermost.end_lineno
    lines = range(first_line(innermost), end + 1)
    by_line = contexts(file.relative_to(tree).as_posix())
    tests = {test for line in lines for test in by_line.get(line, ())} - {""}
    if not tests:
        tests = {test for found in by_line.values() for test in found} - {""}
    files = {place: i for i, place in enumerate(rooms_of(tree, file))}
    tests = {test.rpartition("|")[0] for test in tests}
    return sorted(tests, key=lambda test: (files.get(test.partition("::")[0], len(files)), test))


def contexts_of(coverage_file):
    """A function that gives the tests that ran each line of a file, by its place in the tree; its
    `tests` are all that ran.
    """
    from coverage import CoverageData

    data = CoverageData(basename=coverage_file)
    data.read()
    measured = data.measured_files()

    def contexts(place):
        # Measured in a checkout of the same commit, which may be elsewhere.
        names = [name for name in measured if name.endswith(f"/{place}")]
        return data.contexts_by_lineno(names[0]) if names else {}

    contexts.tests = data.measured_contexts()
    return contexts


def failing(copy, tests, longest):
    """The first of the tests that fails, "" if none does within so many seconds."""
    environment = {**os.environ, "PYTHONPATH": str(copy), "MPLBACKEND": "Agg"}
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-x",
        "-q",
        "-p",
        "no:cacheprovider",
        "--no-header",
        *tests,
    ]
    try:
        ran = subprocess.run(  # noqa: S603
            command, cwd=copy, env=environment, capture_output=True, text=True, timeout=longest
        )
    except subprocess.TimeoutExpired:
        return NOT_ENDED
    if ran.returncode == 0:
        return ""
    failed = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", ran.stdout, re.MULTILINE)
    return failed.group(1) if failed else f"ended with {ran.returncode}"


def noticed(copy, file, text, tests, anyway, longest):
    """Name of the test that fails by the change of a file, "" if none does; what fails anyway is
    left out.
    """
    path = copy / file
    before = path.read_text(encoding="utf-8")
    while True:
        path.write_text(text, encoding="utf-8")
        known = (f"--deselect={one}" for one in anyway if anyway[one])
        by = failing(copy, [*tests, *known], longest)
        path.write_text(before, encoding="utf-8")
        if "::" not in by:
            return by
        if by not in anyway:
            anyway[by] = bool(failing(copy, [by], longest))
        if not anyway[by]:
            return by


def main():
    """Make the changes, some at a time, and print what became of each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--guards", action="store_true")
    parser.add_argument("--every", type=int, default=8)
    parser.add_argument("--only", nargs="*", help="places, as file.py:line")
    parser.add_argument("--seeded", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tree", type=Path, default=ROOT)
    parser.add_argument("--longest", type=int, default=600, help="of the tests of a room [s]")
    parser.add_argument("--coverage", help="file of pytest-cov with contexts of tests")
    parser.add_argument("--jobs", type=int, default=2, help="changes at a time")
    chosen = parser.parse_args()
    tree = chosen.tree.resolve()
    if chosen.guards:
        files = [tree / "plant/realtime" / f"{name}.py" for name in GUARDS]
        every = [
            (file, *change) for file in files for change in changes(file, ("comparison", "sign"))
        ]
        picked = [(*change, GUARDED) for change in every[:: chosen.every]]
        picked = [
            change
            for change in picked
            if not chosen.only or f"{change[0].name}:{change[1]}" in chosen.only
        ]
    else:
        files = [
            file
            for package in ("plant", "identification", "ctc")
            for file in sorted((tree / package).rglob("*.py"))
        ]
        every = [
            (file, *change)
            for file in files
            for change in changes(file, ("comparison", "sign", "number", "index"))
        ]
        picked = random.Random(chosen.seed).sample(every, chosen.seeded)  # noqa: S311
        contexts = contexts_of(chosen.coverage) if chosen.coverage else None

        def noticing(file, line):
            rooms = rooms_of(tree, file)
            if contexts is None:
                return rooms
            ran = ran_by(tree, file, line, contexts)
            # Files of the room that the measured run left out may notice it as well.
            measured = {test.partition("::")[0] for test in contexts.tests}
            return ran + [place for place in rooms if place not in measured]

        picked = [(*change, noticing(*change[:2])) for change in picked]
    print(f"{len(picked)} of {len(every)} places in {len(files)} files", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        copies = [Path(folder) / str(i) for i in range(chosen.jobs)]
        for copy in copies:
            shutil.copytree(
                tree,
                copy,
                ignore=shutil.ignore_patterns(".git", "__pycache__", "_build", "*.egg-info"),
            )
        free, results, anyway = list(copies), Counter(), {}

        def one(change):
            file, line, what, text, tests = change
            copy, begun = free.pop(), time.monotonic()
            by = noticed(copy, file.relative_to(tree), text, tests, anyway, chosen.longest)
            free.append(copy)
            return f"{file.relative_to(tree)}:{line}  {what}", by, time.monotonic() - begun

        with ThreadPoolExecutor(chosen.jobs) as pool:
            for what, by, seconds in pool.map(one, picked):
                results[by.partition("::")[0] or "none"] += 1
                verdict = by if by == NOT_ENDED else f"noticed by {by}" if by else "NOT NOTICED"
                print(f"{verdict:60.60}  {what}  ({seconds:.0f} s)", flush=True)
    unseen = results["none"] + results[NOT_ENDED]
    print(f"{len(picked) - unseen} of {len(picked)} noticed, {results[NOT_ENDED]} not ended")
    for name, count in results.most_common():
        print(f"  {count:3} {name}")


if __name__ == "__main__":
    main()
