"""Source text of a closed loop's kernels, for one individual with its log or W individuals side by side.

Quantity r of individual j is ``work[r * W + j]``, with W a constant of the file; time is the outer loop, the
individuals are the innermost, and the body has no branch, so that LLVM vectorises it. The loops are Python for numba;
what they repeat are intrinsics (`plant.compiler.intrinsics`).
"""

import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from plant.compiler.instructions import LANE, STATE, TIME, UNIFORM
from plant.compiler.intrinsics import head, intrinsic
from plant.compiler.splitting import cut
from plant.compiler.translate import Names, translate
from plant.simulation.closed_loop import ClosedLoop

VECTOR = 8
"""Individuals in one vector: the longest register that there is, or two or four shorter ones."""


PIECE, LONG_PIECE = 40, 1000
"""Instructions in one loop over them; and in one for a single individual, where there is nothing to overlap."""


ENOUGH, LONGEST = 500, 2000
"""Instructions from which on a step has by itself so many that do not wait for each other, as of three joints and more,
that loops over short pieces only cost memory; and those in one loop then, for the compiler's sake."""


def loop_source(
    loop: ClosedLoop, lanes: Sequence[int], uniform: Sequence[int], width: int, uneven: bool, *, logged: bool = False
) -> tuple[str, dict[str, dict[str, list[int]]]]:
    """Text of ``single`` and ``population``, or of ``logged``, and the columns that each reads of its tables.

    `lanes` and `uniform` are positions in ``loop.number_names``. The length of a sub-step is the last of the uniform
    numbers; with uneven time it is in the tables.
    """
    sizes = {"single": LONG_PIECE, "population": PIECE if width > 1 else LONG_PIECE}
    text, columns = head(), {}
    for name, size in ({"logged": PIECE} if logged else sizes).items():
        one, columns[name] = _loop(loop, lanes, uniform, uneven, name, 1 if name == "single" else width, size)
        text += one
    return text, columns


def _loop(
    loop: ClosedLoop, lanes: Sequence[int], uniform: Sequence[int], uneven: bool, name: str, width: int, size: int
) -> tuple[str, dict[str, list[int]]]:
    """Text of one loop, and the columns (law, sample, step, data) that it reads.

    ``single`` logs all that there is of its individual, ``logged`` the tracking errors of each.
    """
    states, vector = len(loop.state_names), math.gcd(width, VECTOR)
    rows = itertools.count(states + len(lanes))
    kept = {f"s{i}": i for i in range(states)} | {f"l{i}": states + i for i in range(len(lanes))}
    wanted = dict.fromkeys(_BLOCKS, None if name == "single" else states)
    if name == "logged":
        wanted["sample"] = states + loop.n
    programs = _programs(loop, lanes, uniform, uneven, lambda: next(rows), wanted)
    given = {number: kind for program in programs.values() for number, kind in program.used.items()}
    text: list[str] = []
    columns: dict[str, list[int]] = {"law": [], "sample": [], "step": [], "data": []}

    # Evaluated once, and once per individual.
    numbers = [number for number, kind in given.items() if kind == UNIFORM]
    once = ["u = e.view(kinds[0], u, 1, e.index(0, 0))", *(f"{number} = u[{number[1:]}]" for number in numbers)]
    of_lane = [f"work = e.view(kinds[0], work, {width}, j)", "uniform"]
    of_lane += [f"{number} = work[{kept[number]}]" for number, kind in given.items() if kind == LANE]
    for program in programs.values():
        once += map(str, program.lines[UNIFORM])
        numbers += _made(program.lines[UNIFORM])
        of_lane += map(str, program.lines[LANE])
        of_lane += [f"work[{row}] = {number}" for number, row in program.crossing.items()]
    of_lane[1] = _unpacked(numbers, "uniform")
    text.append(intrinsic(f"{name}_uniforms", ["u"], once, numbers))
    text.append(intrinsic(f"{name}_once", ["work", "j", "uniform"], of_lane))

    blocks = dict.fromkeys(_BLOCKS, "pass")
    for which, program in programs.items():
        # Evaluated once per step.
        read = [number for number, kind in program.used.items() if kind == TIME]
        for letter, table in (("t", which), ("d", "data")):
            columns[table] += [int(number[1:]) for number in read if number[0] == letter]
        lines = [
            f"t = e.view(kinds[0], t, 1, e.index(i, {len(columns[which])}))",
            f"d = e.view(kinds[1], d, 1, e.index(i, {len(columns['data'])}))",
            _unpacked(numbers, "uniform"),
            *(f"{t} = t[{i}]" for i, t in enumerate(number for number in read if number[0] == "t")),
            *(f"{d} = d[{i}]" for i, d in enumerate(number for number in read if number[0] == "d")),
            *map(str, program.lines[TIME]),
        ]
        times = read + _made(program.lines[TIME])
        text.append(intrinsic(f"{name}_{which}_times", ["t", "d", "i", "uniform"], lines, times))

        # Evaluated once per step and individual.
        table, index, log = _BLOCKS[which]
        results, logged = program.results, program.results[states:]
        stores: dict[int | str, str] = {i: result for i, result in enumerate(results[:states]) if result != f"s{i}"}
        stores |= {f"log[{i}]": result for i, result in enumerate(logged)}
        start = [f"work = e.view(kinds[0], work, {width}, j)", _unpacked(numbers, "uniform"), _unpacked(times, "times")]
        if logged:
            at = f"e.index(i, {len(logged)})"
            start += [f"log = e.view(kinds[4], log, {width}, {at if name == 'single' else 'i'})"]
        parameters = ["work", "j", "uniform", "times", *(["log", "i"] if logged else [])]
        arguments = f"numbers, {which}_times" + (f", {log}, {index}" if logged else "")
        block = [f"{which}_times = {name}_{which}_times_{{h}}({table}, data, {index}, numbers)"]
        if logged and name != "single":  # row by row, and beside each other in it
            arguments = f"numbers, {which}_times, {log}, {index} * {len(logged) * width} + {{j}}"
        many = width > 1 and sum(line.weight for line in program.lines[STATE]) >= ENOUGH
        longest = LONGEST if many else size
        pieces = cut(program.lines[STATE], stores, kept | program.crossing, lambda: next(rows), longest)
        for k, piece in enumerate(pieces):
            function, j = f"{name}_{which}_{k}", f"j_{which}_{k}"  # a name assigned once compiles faster
            lines = start + [re.sub(r"{(\d+)}", r"work[\1]", line) for line in piece]
            text.append(intrinsic(function, parameters, lines, width=vector))
            called = f"    {function}_{{h}}(work, {j}, {arguments.replace('{j}', j)})"
            block += [f"for {j} in range(0, {width}, {vector}):", called]
        blocks[which] = "\n            ".join(block)
    settings: dict[str, Any] = {"states": states, "lanes": len(lanes), "per_law": loop.steps_per_law or 1}
    settings |= {"per_sample": loop.steps_per_sample, "rows": next(rows), "W": width, "name": name}
    return "".join(text) + _LOOP.format(**settings, **blocks), columns


def _programs(
    loop: ClosedLoop,
    lanes: Sequence[int],
    uniform: Sequence[int],
    uneven: bool,
    fresh: Callable[[], int],
    wanted: Mapping[str, int | None],
) -> dict[str, Any]:
    """The translated law (if it has a period), log and sub-step; of each only what so many first outputs need."""
    names = Names()
    where = {number: (f"l{i}", LANE) for i, number in enumerate(lanes)}
    where |= {number: (f"u{i}", UNIFORM) for i, number in enumerate(uniform)}
    last = len(loop.time_names) - 1
    inputs = [
        [(f"s{i}", STATE) for i in range(len(loop.state_names))],
        [*((f"t{i}", TIME) for i in range(last)), (f"t{last}", TIME) if uneven else (f"u{len(uniform)}", UNIFORM)],
        [where[i] for i in range(len(where))],
        [(f"d{i}", TIME) for i in range(loop.n_data)],
    ]
    functions = {"law": loop.law_step, "sample": loop.sample, "step": loop.substep}
    return {
        which: translate(
            function, inputs[: function.n_in()], names, fresh, relaxed=which == "step", wanted=wanted[which]
        )
        for which, function in functions.items()
        if function is not None
    }


def _unpacked(names: Sequence[str], values: str) -> str:
    return f"{', '.join(names or ['_'])}, = e.unpack({values})"


def _made(lines: Sequence[Any]) -> list[str]:
    return [name for line in lines for name in line.names]


_BLOCKS = {
    "law": ("law_time", "i // PER_LAW", None),
    "sample": ("sample_time", "i // PER_SAMPLE", "sample_log"),
    "step": ("step_time", "i", "step_log"),
}
"""Of each block of the loop: its table, the row of it, and its log."""


_LOOP = """

@compiled
def {name}_{{h}}(initial, lanes, uniform, law_time, sample_time, step_time, data, sample_log, step_log, final):
    widest_{{h}}()
    W, PER_LAW, PER_SAMPLE = {W}, {per_law}, {per_sample}
    space = np.empty({rows} * W + 8)
    work = space[(-(space.ctypes.data // 8)) % 8 :]  # rows begin where cache lines do
    for r in range({states}):
        for j in range(W):
            work[r * W + j] = initial[r, j]
    for r in range({lanes}):
        for j in range(W):
            work[({states} + r) * W + j] = lanes[r, j]
    numbers = {name}_uniforms_{{h}}(uniform)
    for j in range(W):
        {name}_once_{{h}}(work, j, numbers)
    done = 0
    for i in range(step_time.shape[0]):
        if i % PER_LAW == 0:
            {law}
        if i % PER_SAMPLE == 0:
            {sample}
            alive = 0.0
            for j in range(W):
                alive += work[({states} - 1) * W + j]
            if not alive > 0.0:
                break
        if True:
            {step}
        done += 1
    for r in range({states}):
        for j in range(W):
            final[r, j] = work[r * W + j]
    return done
"""
