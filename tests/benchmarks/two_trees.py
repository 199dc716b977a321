"""Two checkouts of this project in one run: are their numbers the same bits, how are they built, how fast are they?

    python tests/benchmarks/two_trees.py OLD NEW [--quick] [--only numbers,kernels,imports,structure,speed]

OLD and NEW are folders that hold plant/, identification/ and ctc/; they are copied before anything runs, and each copy
has its own kernel cache. Exit status 1 if a number differs.

`kernels`: the generated text of the kernels of closed loops, whose equations are the same where the text is. The
emitter of instructions at its head is a source file, whose layout may differ.

`structure`: an ``__init__.py`` is a face, no file; what is imported through one is followed to the file that holds it,
late imports included. A line of code is a non-empty line of the syntax tree written out again, without what does not
run: imports, ``__all__``, docstrings, annotations.
"""

import argparse
import ast
import functools
import hashlib
import json
import os
import platform
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import textwrap
import time
import tomllib
from collections import Counter
from importlib import import_module
from itertools import zip_longest
from pathlib import Path

PACKAGES = ("plant", "identification", "ctc")


def table(rows):
    """Print rows of cells, the first one of each to the left."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for first, *others in rows:
        print(
            "  ".join(
                [
                    f"{first:<{widths[0]}}",
                    *(f"{x:>{w}}" for x, w in zip(others, widths[1:], strict=True)),
                ]
            )
        )


def environment(tree):
    """Variables of a process that imports from this tree."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | {"PYTHONPATH": str(tree), "ONEPULSE_CACHE": str(tree / "kernels")}


def child(tree, part, quick):
    """This script as a process of that tree."""
    command = [sys.executable, "-P", __file__, "--child", part, "quick" if quick else "full"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    return subprocess.Popen(command, cwd=tree, env=environment(tree), text=True, **pipes)  # noqa: S603


# -- numbers -------------------------------------------------------------------------------------
def answers(quick):
    """What must not change, (name, values), by the public names of the tree that this process
    imports.
    """
    import plant
    from ctc import ComputedTorque, certify, compare, evaluate
    from identification import identify
    from plant import Harmonics, p_gains, puma560, simulate

    seeds, samples, duration = (3, 64, 0.5) if quick else (20, 400, None)
    robot, rig, law, path = puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference()
    log, loaded = (simulate(arm, rig, law, path) for arm in (robot, puma560.literature_arm(1.5)))
    yield (
        "simulate: errors, torques",
        [log.error_pulses, log.torque, loaded.error_pulses, loaded.torque],
    )
    ways = {
        "paper": (log, {"method": "paper"}),
        "default, 1.5 kg": (loaded, {}),
        "default": (log, {}),
    }
    for name, (record, options) in ways.items():
        runs = [
            identify(puma560.dynamics(), record, seed=s, progress=False, **options)
            for s in range(seeds)
        ]
        yield f"identify, {name}, {seeds} seeds: f", [run.f for run in runs]
        yield f"identify, {name}, {seeds} seeds: objective", [run.objective for run in runs]
    yield f"identify, {name}, {seeds} seeds: covariance", [run.covariance for run in runs]
    found = runs[1]

    design, given = (
        ComputedTorque(found.arm, found.rig),
        {"rig": rig, "reference": path, "duration": duration},
    )
    for backend in ("casadi", "numba"):
        report = evaluate(arm=robot, law=design, backend=backend, **given)
        yield (
            f"evaluate, {backend}: errors, torques",
            [report.record.error_pulses, report.record.torque],
        )
        yield f"evaluate, {backend}: max_true_error_pulses", [report.max_true_error_pulses]
    both = compare(
        arm=robot, laws={"P": law, "computed torque": design}, **given
    ).evaluations.values()
    yield (
        "compare, two laws: errors, torques",
        [x for e in both for x in (e.record.error_pulses, e.record.torque)],
    )
    certificate = certify(found=found, law=design, samples=samples, **given)
    runs, drawn = certificate.runs, certificate.plants
    yield f"certify, {samples} plants: drawn", [drawn.f, drawn.values]
    yield f"certify, {samples} plants: peaks, currents", [runs.peak, runs.unrounded, runs.current]
    yield (
        f"certify, {samples} plants: outside",
        [runs.outside, certificate.probability, certificate.interval],
    )

    if hasattr(plant, "write_replay"):
        write_replay = plant.write_replay
    else:  # not yet public
        write_replay = import_module("plant.c.export").write_replay
    for name, each, record in (("P", law, log), ("computed torque", design, report.record)):
        yield exported(each, rig, functools.partial(write_replay, record), name)

    whole, rig = whole_puma560()
    path = Harmonics(
        period=4.0, offset=(0.0,) * 6,
        cosine=((0.5, 0.2), (-0.4, 0.2), (0.3, -0.3), (0.5, 0.1), (-0.4, 0.3), (0.2, 0.5)),
        sine=((0.3, 0.1), (0.2, -0.1), (-0.3, 0.2), (0.4, 0.2), (0.3, 0.3), (0.6, -0.2)),
    )  # fmt: skip
    law = p_gains(whole.arm(whole.f()), rig, path, 12.0)
    log = simulate(whole.arm(whole.f()), rig, law, path, duration=duration)
    yield (
        "p_gains, simulate, six joints",
        [law.gain, log.error_pulses, log.torque, log.true_q, log.true_qd],
    )


def whole_puma560():
    """Dynamics and rig of six joints, from where this tree has them."""
    import plant

    if hasattr(plant, "catalogue"):
        return plant.Dynamics.from_chain(plant.catalogue.puma560()), plant.catalogue.puma560_rig()
    if hasattr(plant, "read_robot"):
        robot = plant.read_robot("puma560")
        return robot.dynamics, robot.rig
    arms = import_module("plant.arms")
    return plant.Dynamics.from_chain(arms.puma560()), arms.puma560_rig()


def exported(law, rig, write, name):
    """What the C of a law answers to a record; without a compiler, its text."""
    with tempfile.TemporaryDirectory() as folder:
        law.to_c(folder, rig)
        write(Path(folder, "record.csv"))
        if not (compiler := shutil.which("cc")):
            return f"exported C, {name}: text (no cc here)", Path(folder, "controller.c").read_text(
                "ascii"
            )
        command = [compiler, "-std=c99", "-O2", "-o", "replay", "main.c", "controller.c", "-lm"]
        subprocess.run(command, cwd=folder, check=True)  # noqa: S603
        said = subprocess.check_output([f"{folder}/replay", "record.csv"], cwd=folder, text=True)  # noqa: S603
        return f"exported C, {name}: torques of its replay", [
            float(x) for x in said.replace(",", " ").split()
        ]


def sources(_):
    """Text of the kernels of closed loops, (name, text)."""
    import dataclasses

    from ctc import ComputedTorque
    from plant import Elasticity, Encoder, Phase, Transport, puma560

    loop_of = import_module("plant.simulation.closed_loop").ClosedLoop
    text_of = import_module("plant.simulation.loop_source").loop_source
    arm, rig, replace = puma560.literature_arm(1.5), puma560.rig(), dataclasses.replace
    elastic = Elasticity.from_resonance(arm, 60, 0.02, drive=rig.drive, backlash=(1e-4, 1e-4))
    phase = Encoder(resolution=rig.encoder.resolution, phase=Phase(shift=(0.1, 0.2)))
    rigs = {
        "rigid": rig,
        "rigid, late and shifted": replace(
            rig, encoder=phase, transport=Transport(delay=2e-4, lost=(3,))
        ),
        "elastic": replace(rig, drive=replace(rig.drive, elasticity=elastic)),
        "elastic, lagging": replace(
            rig, drive=replace(rig.drive, elasticity=elastic, current_lag=1e-4)
        ),
    }
    laws = {"P": puma560.p_law(), "computed torque": ComputedTorque(arm, rig)}
    for name, each in rigs.items():
        for called, law in laws.items():
            for smooth in (False, True):
                if each.transport is None or law.period is not None:
                    loop = loop_of(
                        dynamics=arm.dynamics, rig=each, law=law, steps_per_sample=4, smooth=smooth
                    )
                    numbers = range(len(loop.number_names))
                    text, *_ = text_of(loop, numbers[:9], numbers[9:], False, "population", 8)
                    # Before it stands the emitter of instructions, a source file of the tree.
                    body = text[text.index("\nimport numba\n") :]
                    yield f"{name}, {called}{', smooth' * smooth}: text", body


def answer(quick, answers=answers):
    """Print the answers bit for bit; before a failure, those that there are."""
    import numpy as np

    said = {}
    try:
        for name, values in answers(quick):
            if isinstance(values, str):  # the text of C, whose comments do not count
                code = re.sub(r"/\*.*?\*/|\s+", " ", values, flags=re.DOTALL)
                said[name] = ["sha256 " + hashlib.sha256(code.encode()).hexdigest()]
            else:
                said[name] = [float(x).hex() for each in values for x in np.ravel(each)]
    finally:
        print(json.dumps(said))


def numbers(trees, quick, part="numbers"):
    """Compare the answers; whether any differs, or is missing."""
    running = {name: child(tree, part, quick) for name, tree in trees.items()}
    answered = {name: json.loads(run.communicate()[0] or "{}") for name, run in running.items()}
    rows, said = (
        [("", "numbers", "")],
        [f"{name} tree: failed" for name, run in running.items() if run.returncode],
    )
    for what in answered["old"] | answered["new"]:
        old, new = (answered[name].get(what) for name in trees)
        if old is None or new is None:
            rows.append((what, f"{len(old or new):,}", f"only in {'old' if old else 'new'}"))
            continue
        wrong = [
            i
            for i, pair in enumerate(zip_longest(old, new, fillvalue="missing"))
            if pair[0] != pair[1]
        ]
        rows.append(
            (what, f"{max(len(old), len(new)):,}", f"{len(wrong):,} differ" if wrong else "equal")
        )
        for i in wrong[:1]:
            pair = [
                f"{float.fromhex(x):.17g} ({x})" if "0x" in x else x
                for x in (*old[i : i + 1], *new[i : i + 1])
            ]
            said.append(f"{what}: first at {i}, {' -> '.join(pair)}")
    table(rows)
    print(*said, sep="\n", end="\n" if said else "")
    return any(verdict != "equal" for *_, verdict in rows[1:]) or any(
        run.returncode for run in running.values()
    )


# -- imports -------------------------------------------------------------------------------------
def imports(trees, quick):
    """Processes that only import, old and new in turns; the first of each warms the bytecode."""
    codes = {"bare interpreter": "pass"} | {f"import {name}": f"import {name}" for name in PACKAGES}
    spent = {(what, name): [] for what in codes for name in trees}
    for _ in range(4 if quick else 10):
        for (what, name), times in spent.items():
            command, started = [sys.executable, "-c", codes[what]], time.perf_counter()
            subprocess.run(command, cwd=trees[name], env=environment(trees[name]), check=True)  # noqa: S603
            times.append(time.perf_counter() - started)
    rows = [("", "old, median [s]", "least", "new, median [s]", "least", "new / old")]
    for what in codes:
        old, new = (spent[what, name][1:] for name in trees)
        medians = statistics.median(old), statistics.median(new)
        values = (medians[0], min(old), medians[1], min(new), medians[1] / medians[0])
        rows.append((what, *(f"{value:.3f}" for value in values)))
    table(rows)
    print(f"{len(old)} whole processes each, in turns")


# -- structure -----------------------------------------------------------------------------------
class Running(ast.NodeTransformer):
    """Leaves what runs."""

    def visit(self, node):
        match node:
            case ast.Import() | ast.ImportFrom() | ast.Expr(value=ast.Constant(value=str())):
                return None
            case (
                ast.Assign(targets=[ast.Name(id="__all__")])
                | ast.If(test=ast.Name(id="TYPE_CHECKING"))
            ):
                return None
            case ast.FunctionDef(decorator_list=[ast.Name(id="overload"), *_]):
                return None
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                node.returns = None
            case ast.arg():
                node.annotation = None
            case ast.AnnAssign():
                return (
                    ast.copy_location(ast.Assign([node.target], node.value), node)
                    if node.value
                    else None
                )
            case ast.ClassDef():
                # a field stays, as its name
                bare = [isinstance(x, ast.AnnAssign) and not x.value for x in node.body]
                node.body = [
                    ast.Expr(x.target) if b else x for x, b in zip(node.body, bare, strict=True)
                ]
        return self.generic_visit(node)


def imported(node, late=False):
    """(module, name or None, its name here, whether late) of each import that runs."""
    for each in ast.iter_child_nodes(node):
        if isinstance(each, ast.Import):
            yield from ((alias.name, None, None, late) for alias in each.names)
        elif isinstance(each, ast.ImportFrom):
            yield from (
                (each.module, alias.name, alias.asname or alias.name, late) for alias in each.names
            )
        elif not (isinstance(each, ast.If) and ast.unparse(each.test) == "TYPE_CHECKING"):
            yield from imported(
                each, late or isinstance(each, (ast.FunctionDef, ast.AsyncFunctionDef))
            )


def circles(graph):
    """Groups of nodes that reach each other; a node in no circle is a group of its own."""
    reached = {}
    for start in graph:
        reached[start], todo = set(), [start]
        while todo:
            new = graph[todo.pop()] - reached[start]
            reached[start] |= new
            todo += new
    return {frozenset({a} | {b for b in reached[a] if a in reached[b]}) for a in graph}


def depth(graph, circle):
    """Nodes of the longest chain, a circle counted as one or as all its nodes."""
    group = {node: each for each in circles(graph) for node in each}

    @functools.cache
    def floors(each):
        return circle(each) + max(
            (floors(group[b]) for a in each for b in graph[a] if group[b] != each), default=0
        )

    return max(map(floors, group.values()))


def levels(tree):
    """Room -> (package, level, counted from above), of the layers that import-linter is told of
    inside packages.
    """
    told = tomllib.loads((tree / "pyproject.toml").read_text("utf-8"))["tool"].get(
        "importlinter", {}
    )
    return {
        f"{package}.{name.strip('() ')}": (package, level)
        for contract in told.get("contracts", ())
        for package in contract.get("containers", ())
        for level, names in enumerate(contract.get("layers", ()))
        for name in re.split("[|:]", names)
    }


def anatomy(tree):
    """Counts of one tree, and lists of what they count."""
    texts = {
        p.relative_to(tree): p.read_text("utf-8")
        for name in PACKAGES
        for p in (tree / name).rglob("*.py")
    }
    parsed = {".".join(path.with_suffix("").parts): ast.parse(text) for path, text in texts.items()}
    names = [
        x
        for p in PACKAGES
        for x in parsed[f"{p}.__init__"].body
        if ast.unparse(x).startswith("__all__ =")
    ]
    found = {name: list(imported(x)) for name, x in parsed.items()}
    files, level = [name for name in parsed if not name.endswith(".__init__")], levels(tree)

    def home(module, name):
        """File that holds what `from module import name` gives."""
        shown = {
            here: (source, what)
            for source, what, here, _ in found.get(f"{module}.__init__", ())
            if what
        }
        written = [file for file in (f"{module}.{name}", module) if file in files]
        return written[0] if written else home(*shown[name]) if name in shown else None

    graph = {a: {home(*each[:2]) for each in found[a]} - {None, a} for a in files}
    room = {
        a: next((x for x in level if f"{a}.".startswith(f"{x}.")), a.rpartition(".")[0])
        for a in files
    }
    arrows = [(room[a], room[b]) for a in graph for b in graph[a] if room[a] != room[b]]
    ranked = [(level[x], level[y]) for x, y in arrows if x in level and y in level]
    rooms = {x: {b for a, b in arrows if a == x} for x in room.values()}
    sizes = [
        sorted((len(x) for x in circles(each) if len(x) > 1), reverse=True)
        for each in (graph, rooms)
    ]
    folders = Counter(a.rpartition(".")[0].replace(".", "/") for a in files)
    late = [module for a in found for module, *_, is_late in found[a] if is_late]
    late = Counter(x.split(".")[0] if x.startswith(PACKAGES) else x for x in late)
    length, longest = max((len(text.splitlines()), path.as_posix()) for path, text in texts.items())
    code = [ast.unparse(Running().visit(x)) for name, x in parsed.items()]
    counts = {
        "files": len(files),
        "folders that hold files": len(folders),
        "most files in one folder": max(folders.values()),
        "longest chain of imports, a circle as one file": depth(graph, lambda circle: 1),
        "longest chain of imports, a circle as all its files": depth(graph, len),
        "circles between files: their sizes": " + ".join(map(str, sizes[0])) or "none",
        "circles between rooms: their sizes": " + ".join(map(str, sizes[1])) or "none",
        "arrows upward between rooms": (
            sum(x == y and j <= i for (x, i), (y, j) in ranked) if level else "n/a"
        ),
        "late imports": late.total(),
        "public names": sum(isinstance(x, ast.Constant) for each in names for x in ast.walk(each)),
        "lines of the longest file": length,
        "lines of code": sum(bool(line.strip()) for text in code for line in text.splitlines()),
        "lines as they stand": sum(len(text.splitlines()) for text in texts.values()),
    }
    lists = {"files in": folders, "late imports of": late, "longest file": {longest: length}}
    return {what: f"{x:,}" if isinstance(x, int) else x for what, x in counts.items()}, lists


def structure(trees, _):
    """Both trees beside each other, then what was counted."""
    seen = {name: anatomy(tree) for name, tree in trees.items()}
    old, new = (counts for counts, _ in seen.values())
    table([("", *trees), *((what, old[what], new[what]) for what in old)])
    for what in seen["old"][1]:
        for name, (_, lists) in seen.items():
            counted = ", ".join(f"{x} {count}" for x, count in sorted(lists[what].items()))
            print(textwrap.fill(f"{name}, {what}: {counted}", 120, subsequent_indent="    "))


# -- speed ---------------------------------------------------------------------------------------
def clock(_):
    """Read which of two things to do, line by line; print how long it takes per simulation [ms]."""
    import numpy as np

    from identification import Objective
    from plant import puma560, simulate

    arm = puma560.arm()
    record = simulate(arm, puma560.rig(), puma560.p_law(), puma560.reference())
    population = arm.f * (1 + 0.05 * np.random.default_rng(0).normal(size=(3200, 9)))
    one, two = (Objective(puma560.dynamics(), record, threads=threads) for threads in (1, 2))
    calls = {
        "one": lambda: [one(population[:80]) for _ in range(10)],
        "two": lambda: two(population),
    }
    for call in calls.values():
        call()
    print("ready", flush=True)
    for line in sys.stdin:
        started = time.perf_counter()
        calls[line.strip()]()
        seconds = time.perf_counter() - started
        print(1e3 * seconds / (800 if line.strip() == "one" else 3200), flush=True)


def speed(trees, quick):
    """Objective (4) in two long-lived processes in turns, each first in every other pair."""
    running = {name: child(tree, "speed", quick) for name, tree in trees.items()}
    for run in running.values():
        run.stdout.readline()
    pairs = 5 if quick else 25
    rows = [
        ("ms per simulation", "old, median", "new, median", "new / old", "middle half", "range")
    ]
    for what, task in {
        "80 candidates, one thread": "one",
        "3,200 candidates, two threads": "two",
    }.items():
        spent = {name: [] for name in trees}
        for i in range(pairs):
            for name in list(trees)[:: 1 if i % 2 else -1]:
                print(task, file=running[name].stdin, flush=True)
                spent[name].append(float(running[name].stdout.readline()))
        old, new = map(statistics.median, spent.values())
        ratios = [b / a for a, b in zip(*spent.values(), strict=True)]
        low, middle, high = statistics.quantiles(ratios, n=4, method="inclusive")
        texts = (
            f"{middle:.3f}",
            f"{low:.3f} to {high:.3f}",
            f"{min(ratios):.3f} to {max(ratios):.3f}",
        )
        rows.append((what, f"{old:.4f}", f"{new:.4f}", *texts))
    for run in running.values():
        run.communicate()
    table(rows)
    print(f"{pairs} pairs")


def kernels(trees, quick):
    """Compare the texts of kernels; whether any differs, or is missing."""
    return numbers(trees, quick, "kernels")


PARTS = {
    "numbers": numbers,
    "kernels": kernels,
    "imports": imports,
    "structure": structure,
    "speed": speed,
}


def main():
    """Copy both trees and run the parts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--quick", action="store_true", help="fewer seeds, samples and rounds")
    parser.add_argument("--only", default=",".join(PARTS), help="some of " + ",".join(PARTS))
    options = parser.parse_args()
    chosen, different = options.only.split(","), False
    if not set(chosen) <= set(PARTS):
        parser.error(
            f"--only must be some of {','.join(PARTS)}; got {options.only}. Leave it out for all."
        )
    with tempfile.TemporaryDirectory() as folder:
        trees = {name: Path(folder, name).resolve() for name in ("old", "new")}
        for name, tree in trees.items():
            origin = getattr(options, name)
            for package in PACKAGES:
                shutil.copytree(
                    origin / package, tree / package, ignore=shutil.ignore_patterns("__pycache__")
                )
            shutil.copy(origin / "pyproject.toml", tree)
            command = ["git", "-C", str(origin), "describe", "--always", "--dirty"]
            commit = (
                shutil.which("git")
                and subprocess.run(command, capture_output=True, text=True, check=False).stdout  # noqa: S603
            )
            print(f"{name}: {(commit or str(origin)).strip()}")
        print(f"Python {platform.python_version()}, {platform.machine()}, {os.cpu_count()} cores")
        for part in chosen:
            print(f"\n## {part}\n", flush=True)
            different |= PARTS[part](trees, options.quick) is True
    sys.exit(different)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        if not Path(import_module("plant").__file__).resolve().is_relative_to(Path.cwd()):
            sys.exit(
                f"plant must be that of {Path.cwd()}; another one comes first on the path."
                " Uninstall it."
            )
        tasks = {"numbers": answer, "kernels": lambda quick: answer(quick, sources), "speed": clock}
        tasks[sys.argv[2]](sys.argv[3] == "quick")
    else:
        main()
