"""What the house weighs, and the change against a commit: ``python tests/benchmarks/house.py
[COMMIT]``.

Lines of code are those that hold a token which is neither a comment nor part of a docstring; public
names are the elements of the three ``__all__``. A walk is the way of one argument through the calls
that it is given to, in a small run: the `files` whose functions receive it, `stays` (distinct calls
that hand it into another file), `climbs` (those of them into a room above the caller's, by the
layers of pyproject.toml). Its own methods are no stays. Import times are medians of fresh processes
in turn: compare them within one run.
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
import tokenize
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("plant", "identification", "ctc")
AIMS = {"lines of code": 24_000, "lines of docstrings": 9_500, "files": 320, "public names": 120}
SILENT = {
    getattr(tokenize, name)
    for name in ("COMMENT", "NL", "NEWLINE", "INDENT", "DEDENT", "ENDMARKER")
}
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def lines_of(text):
    """Numbers of the lines of code of a file, those of docstrings, and its syntax tree."""
    tree, code, told = ast.parse(text), set(), set()
    for node in ast.walk(tree):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node) is not None:
            told |= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in SILENT:
            code |= set(range(token.start[0], token.end[0] + 1))
    return code - told, told, tree


def weight(root):
    """Row -> number, of a checkout."""
    found = dict.fromkeys((*AIMS, "longest function"), 0)
    longest = ""
    for path in sorted(path for package in PACKAGES for path in (root / package).rglob("*.py")):
        code, told, tree = lines_of(path.read_text(encoding="utf-8"))
        found["lines of code"] += len(code)
        found["lines of docstrings"] += len(told)
        found["files"] += 1
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                length = len(code & set(range(node.lineno, node.end_lineno + 1)))
                if length > found["longest function"]:
                    found["longest function"], longest = (
                        length,
                        f"{path.relative_to(root).as_posix()}: {node.name}",
                    )
        if path.parent.parent == root and path.name == "__init__.py":
            lists = [each for each in tree.body if isinstance(each, ast.Assign)]
            lists = [each.value.elts for each in lists if ast.unparse(each.targets[0]) == "__all__"]
            found["public names"] += sum(map(len, lists))
    return found, longest


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


def report(commit, minutes):
    with tempfile.TemporaryDirectory() as folder:
        roots = [root for root in (checkout(commit, folder), ROOT) if root]
        if len(roots) == 1:
            print(f"no commit {commit} in this history: only what is here")
        weights = [weight(root) for root in roots]
        rows = [
            (name, [f"{found[name]:,}" for found, _ in weights], AIMS.get(name, ""))
            for name in weights[0][0]
        ]
        ways = [json.loads(own_process(root, __file__, "--walks", str(root))) for root in roots]
        for name in ways[0]:
            rows.append(
                (
                    f"{name}: files, stays, climbs",
                    [", ".join(map(str, way[name])) for way in ways],
                    "",
                )
            )
        times = import_times(roots)
        rows += [
            (f"import {name} [s]", [f"{times[root][name]:.2f}" for root in roots], "")
            for name in PACKAGES
        ]
        rows += [
            (f"{name} [min]", [""] * (len(roots) - 1) + [value], aim)
            for name, value, aim in minutes
        ]
    heads = [*([commit] if len(roots) == 2 else []), "now"]
    print(f"{'':42}" + "".join(f"{head:>12}" for head in heads) + f"{'aim':>12}")
    for name, values, aim in rows:
        aim = f"{aim:,}" if isinstance(aim, int) else aim
        print(f"{name:42}" + "".join(f"{value:>12}" for value in values) + f"{aim:>12}")
    for head, (_, longest) in zip(heads, weights, strict=True):
        print(f"longest function, {head}: {longest}")


def minute(text):
    name, _, value = text.partition("=")
    return name, value, {"tests": 10, "CI": 20}.get(name, "")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commit", nargs="?", default="552e096", help="to compare with")
    parser.add_argument(
        "--minutes", nargs="*", type=minute, default=[], metavar="NAME=M", help="measured elsewhere"
    )
    parser.add_argument("--walks", type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.walks:
        print(json.dumps(walks(chosen.walks.resolve())))
    else:
        report(chosen.commit, chosen.minutes)
