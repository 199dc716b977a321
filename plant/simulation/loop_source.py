"""Source text of a closed loop's kernels, for one individual with its log or W individuals side by
side.

Quantity r of individual j is ``work[r * W + j]``, with W a constant of the file; time is the outer
loop, the individuals are the innermost, and the body has no branch, so that LLVM vectorises it. The
loops are Python for numba; what they repeat are intrinsics (`plant.compiler.intrinsics`).
"""

import dataclasses
import itertools
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from plant.compiler.instructions import LANE, STATE, TIME, UNIFORM
from plant.compiler.intrinsics import head, intrinsic
from plant.compiler.translate import Names, cut, translate
from plant.simulation.closed_loop import ClosedLoop

# individuals in one vector: the longest register that there is, or two or four shorter ones
VECTOR = 8


# Instructions in one loop over them; and in one for a single individual, where there is nothing to
# overlap.
PIECE = 40
LONG_PIECE = 1000


# Instructions from which on a step has by itself so many that do not wait for each other, as of
# three joints and more, that loops over short pieces only cost memory; and those in one loop then,
# for the compiler's sake.
ENOUGH = 500
LONGEST = 2000


def loop_source(
    loop: ClosedLoop,
    lanes: Sequence[int],
    uniform: Sequence[int],
    uneven: bool,
    name: str,
    width: int,
) -> tuple[str, dict[str, list[int]]]:
    """Text of one loop, and the columns (law, sample, step, data) that it reads of its tables.

    ``single`` logs all that there is of its individual, ``logged`` the tracking errors of each,
    ``population`` nothing. `lanes` and `uniform` are positions in ``loop.number_names``. The length
    of a sub-step is the last of the uniform numbers; with uneven time it is in the tables.
    """
    states = len(loop.state_names)
    rows = itertools.count(len(loop.state_names) + len(lanes))
    kept = {f"s{i}": i for i in range(states)} | {f"l{i}": states + i for i in range(len(lanes))}
    wanted = dict.fromkeys(_BLOCKS, None if name == "single" else states)
    if name == "logged":
        wanted["sample"] = states + loop.log_fields.at(loop.n)["error"].stop
    programs = _programs(loop, lanes, uniform, uneven, rows.__next__, wanted)
    emitter = _Emitter(name, width, PIECE if width > 1 else LONG_PIECE, states, kept, rows.__next__)
    text, numbers = emitter.once(programs.values())
    blocks = dict.fromkeys(_BLOCKS, "pass")
    columns: dict[str, list[int]] = {"law": [], "sample": [], "step": [], "data": []}
    for which, program in programs.items():
        of_step, times = emitter.of_step(which, program, numbers, columns)
        of_each, blocks[which] = emitter.of_each(which, program, numbers, times)
        text += of_step + of_each
    settings: dict[str, Any] = {
        "states": states,
        "lanes": len(lanes),
        "per_law": loop.steps_per_law or 1,
    }
    settings |= {"per_sample": loop.steps_per_sample, "rows": next(rows), "W": width, "name": name}
    return head() + text + _LOOP.format(**settings, **blocks), columns


@dataclasses.dataclass(frozen=True)
class _Emitter:
    """Text of the functions that one loop calls; rows of `work` are `kept` for states and lanes,
    others are `fresh`.
    """

    name: str
    width: int
    size: int
    states: int
    kept: dict[str, int]
    fresh: Callable[[], int]

    def once(self, programs: Collection[Any]) -> tuple[str, list[str]]:
        """What is evaluated once, and once per individual; and the numbers that are the same for
        all.
        """
        given = {number: kind for program in programs for number, kind in program.used.items()}
        numbers = [number for number, kind in given.items() if kind == UNIFORM]
        once = [
            "u = e.view(kinds[0], u, 1, e.index(0, 0))",
            *(f"{number} = u[{number[1:]}]" for number in numbers),
        ]
        of_lane = [
            f"{number} = work[{self.kept[number]}]"
            for number, kind in given.items()
            if kind == LANE
        ]
        for program in programs:
            once += map(str, program.lines[UNIFORM])
            numbers += _made(program.lines[UNIFORM])
            of_lane += map(str, program.lines[LANE])
            of_lane += [f"work[{row}] = {number}" for number, row in program.crossing.items()]
        of_lane = [
            f"work = e.view(kinds[0], work, {self.width}, j)",
            _unpacked(numbers, "uniform"),
            *of_lane,
        ]
        text = intrinsic(f"{self.name}_uniforms", ["u"], once, numbers)
        return text + intrinsic(f"{self.name}_once", ["work", "j", "uniform"], of_lane), numbers

    def of_step(
        self, which: str, program: Any, numbers: list[str], columns: dict[str, list[int]]
    ) -> tuple[str, list[str]]:
        """What is evaluated once per step, and the names of what that gives; what it reads joins
        the `columns`.
        """
        read = [number for number, kind in program.used.items() if kind == TIME]
        of_table = {letter: [number for number in read if number[0] == letter] for letter in "td"}
        for letter, table in (("t", which), ("d", "data")):
            columns[table] += [int(number[1:]) for number in of_table[letter]]
        lines = [
            f"t = e.view(kinds[0], t, 1, e.index(i, {len(columns[which])}))",
            f"d = e.view(kinds[1], d, 1, e.index(i, {len(columns['data'])}))",
            _unpacked(numbers, "uniform"),
            *(
                f"{number} = {letter}[{i}]"
                for letter, some in of_table.items()
                for i, number in enumerate(some)
            ),
            *map(str, program.lines[TIME]),
        ]
        times = read + _made(program.lines[TIME])
        return (
            intrinsic(f"{self.name}_{which}_times", ["t", "d", "i", "uniform"], lines, times),
            times,
        )

    def of_each(
        self, which: str, program: Any, numbers: list[str], times: list[str]
    ) -> tuple[str, str]:
        """What is evaluated once per step and individual, and the lines of the loop that call
        it.
        """
        name = f"{self.name}_{which}"
        width = self.width
        vector = math.gcd(self.width, VECTOR)
        table, index, log = _BLOCKS[which]
        results = program.results[: self.states]
        logged = program.results[self.states :]
        stores: dict[int | str, str] = {
            i: result for i, result in enumerate(results) if result != f"s{i}"
        }
        stores |= {f"log[{i}]": result for i, result in enumerate(logged)}
        start = [
            f"work = e.view(kinds[0], work, {width}, j)",
            _unpacked(numbers, "uniform"),
            _unpacked(times, "times"),
        ]
        parameters = ["work", "j", "uniform", "times"]
        arguments = f"numbers, {which}_times"
        if logged:
            single = self.name == "single"  # else row by row, and beside each other in it
            start += [
                f"log = e.view(kinds[4], log, {width},"
                f" {f'e.index(i, {len(logged)})' if single else 'i'})"
            ]
            parameters += ["log", "i"]
            arguments += (
                f", {log}, {index}"
                if single
                else f", {log}, {index} * {len(logged) * width} + {{j}}"
            )
        many = width > 1 and sum(line.weight for line in program.lines[STATE]) >= ENOUGH
        longest = LONGEST if many else self.size
        pieces = cut(
            program.lines[STATE], stores, self.kept | program.crossing, self.fresh, longest
        )
        text = ""
        block = [f"{which}_times = {name}_times_{{h}}({table}, data, {index}, numbers)"]
        for k, piece in enumerate(pieces):
            j = f"j_{which}_{k}"  # a name assigned once compiles faster
            lines = start + [re.sub(r"{(\d+)}", r"work[\1]", line) for line in piece]
            text += intrinsic(f"{name}_{k}", parameters, lines, width=vector)
            called = f"    {name}_{k}_{{h}}(work, {j}, {arguments.replace('{j}', j)})"
            block += [f"for {j} in range(0, {width}, {vector}):", called]
        return text, "\n            ".join(block)


def _programs(
    loop: ClosedLoop,
    lanes: Sequence[int],
    uniform: Sequence[int],
    uneven: bool,
    fresh: Callable[[], int],
    wanted: Mapping[str, int | None],
) -> dict[str, Any]:
    """The translated law (if it has a period), log and sub-step; of each only what so many first
    outputs need.
    """
    names = Names()
    where = {number: (f"l{i}", LANE) for i, number in enumerate(lanes)}
    where |= {number: (f"u{i}", UNIFORM) for i, number in enumerate(uniform)}
    times = [(f"t{i}", TIME) for i in range(len(loop.time_names))]
    if not uneven:
        # The length of a sub-step is behind the uniform numbers.
        times[loop.time_fields.at(loop.n)["h"].start] = (f"u{len(uniform)}", UNIFORM)
    inputs = [
        [(f"s{i}", STATE) for i in range(len(loop.state_names))],
        times,
        [where[i] for i in range(len(where))],
        [(f"d{i}", TIME) for i in range(loop.n_data)],
    ]
    functions = {"law": loop.law_step, "sample": loop.sample, "step": loop.substep}
    return {
        which: translate(
            function,
            inputs[: function.n_in()],
            names,
            fresh,
            relaxed=which == "step",
            wanted=wanted[which],
        )
        for which, function in functions.items()
        if function is not None
    }


def _unpacked(names: Sequence[str], values: str) -> str:
    return f"{', '.join(names or ['_'])}, = e.unpack({values})"


def _made(lines: Sequence[Any]) -> list[str]:
    return [name for line in lines for name in line.names]


# Of each block of the loop: its table, the row of it, and its log.
_BLOCKS = {
    "law": ("law_time", "i // PER_LAW", None),
    "sample": ("sample_time", "i // PER_SAMPLE", "sample_log"),
    "step": ("step_time", "i", "step_log"),
}


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
