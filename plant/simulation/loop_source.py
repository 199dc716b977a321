"""Source text of a closed loop's kernels, for one individual or for W individuals side by side.

Quantity r of individual j is ``work[r * W + j]``, with W a constant of the file; time is the outer
loop, the individuals are the innermost, and the body has no branch, so that LLVM vectorises it. The
loops are Python for numba; the functions that they call are intrinsics
(`plant.compiler.intrinsics`).
"""

import dataclasses
import itertools
import math
import re
from collections.abc import Callable, Sequence

from plant.compiler.instructions import LANE, STATE, TIME, UNIFORM
from plant.compiler.intrinsics import head, intrinsic
from plant.compiler.translate import Names, cut, translate
from plant.simulation.closed_loop import ClosedLoop

# Individuals in one vector: the longest register that there is, or two or four shorter ones.
VECTOR = 8

# Instructions in one loop over the individuals, short enough for the processor to overlap several
# of them; a single individual has nothing to overlap.
PIECE = 40
LONG_PIECE = 1000

# From this number of instructions on, as of three joints and more, a step has enough that do not
# wait for each other, and short pieces only cost memory. Pieces then have LONGEST instructions at
# most, to spare the compiler.
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

    ``single`` logs all quantities of its individual, ``logged`` the tracking errors of each,
    ``population`` nothing. `lanes` and `uniform` are positions in ``loop.number_names``. The length
    of a sub-step is the last of the uniform numbers; with uneven time it is in the tables.
    """
    # 1. Rows of `work`: the state, the numbers that differ, then those that the emitter takes.
    states = len(loop.state_names)
    rows = itertools.count(states + len(lanes))
    places = {f"s{i}": i for i in range(states)} | {f"l{i}": states + i for i in range(len(lanes))}

    # 2. Of each function the outputs that the loop uses: the state, then a part of the log.
    outputs = dict.fromkeys(_BLOCKS, None if name == "single" else states)
    if name == "logged":
        outputs["sample"] = states + loop.log_fields.at(loop.n)["error"].stop
    # Only what the kernel needs is translated: logs of a population are never computed.
    programs = _programs(loop, lanes, uniform, uneven, rows.__next__, outputs)

    # 3. What is evaluated once, once per step, and once per step and individual.
    # Short pieces serve several individuals alone; see the constants.
    size = PIECE if width > 1 else LONG_PIECE
    emitter = _Emitter(name, width, size, states, places, rows.__next__)
    text, numbers = emitter.once(programs.values())
    blocks = dict.fromkeys(_BLOCKS, "pass")
    columns: dict[str, list[int]] = {"law": [], "sample": [], "step": [], "data": []}
    for block, program in programs.items():
        of_step, times = emitter.of_step(block, program, numbers, columns)
        of_individual, blocks[block] = emitter.of_individual(block, program, numbers, times)
        text += of_step + of_individual
    settings = {
        "states": states,
        "lanes": len(lanes),
        "per_law": loop.steps_per_law or 1,
        "per_sample": loop.steps_per_sample,
        "rows": next(rows),
        "W": width,
        "name": name,
        "arguments": _ARGUMENTS,
    }
    return head() + text + _LOOP.format(**settings, **blocks), columns


@dataclasses.dataclass(frozen=True)
class _Emitter:
    """Text of the functions that one loop calls.

    `places` are the rows of `work` of states and lanes; `fresh` gives a new row.
    """

    name: str
    width: int
    size: int
    states: int
    places: dict[str, int]
    fresh: Callable[[], int]

    def once(self, programs):
        """Functions of values that do not change in time, and names of those that all share.

        The first is evaluated once, the second once per individual.
        """
        # The three functions share numbers: each is loaded once for all of them.
        used = {number: kind for program in programs for number, kind in program.used.items()}
        numbers = [number for number, kind in used.items() if kind == UNIFORM]
        uniform = ["u = e.view(kinds[0], u, 1, e.index(0, 0))"]
        uniform += [f"{number} = u[{number[1:]}]" for number in numbers]
        lane = [
            f"{number} = work[{self.places[number]}]"
            for number, kind in used.items()
            if kind == LANE
        ]
        for program in programs:
            uniform += map(str, program.lines[UNIFORM])
            numbers += _assigned(program.lines[UNIFORM])
            lane += map(str, program.lines[LANE])
            lane += [f"work[{row}] = {number}" for number, row in program.crossing.items()]
        # Unpacked last, since the programs have added to the numbers.
        lane = [
            f"work = e.view(kinds[0], work, {self.width}, j)",
            _unpacked(numbers, "uniform"),
            *lane,
        ]
        text = intrinsic(f"{self.name}_uniforms", ["u"], uniform, numbers)
        return text + intrinsic(f"{self.name}_once", ["work", "j", "uniform"], lane), numbers

    def of_step(self, block, program, numbers, columns):
        """The function of a step that all individuals share, and the names of its results.

        The inputs that it reads are added to the `columns` of the tables.
        """
        inputs = [number for number, kind in program.used.items() if kind == TIME]
        of_table = {letter: [number for number in inputs if number[0] == letter] for letter in "td"}
        # Of wide tables a kernel reads few columns; the tables are narrowed to them.
        for letter, table in (("t", block), ("d", "data")):
            # A number of a table is named by its column: t7 is column 7.
            columns[table] += [int(number[1:]) for number in of_table[letter]]
        lines = [
            f"t = e.view(kinds[0], t, 1, e.index(i, {len(columns[block])}))",
            f"d = e.view(kinds[1], d, 1, e.index(i, {len(columns['data'])}))",
            _unpacked(numbers, "uniform"),
        ]
        for letter, names in of_table.items():
            lines += [f"{number} = {letter}[{i}]" for i, number in enumerate(names)]
        lines += map(str, program.lines[TIME])
        times = inputs + _assigned(program.lines[TIME])
        function = f"{self.name}_{block}_times"
        return intrinsic(function, ["t", "d", "i", "uniform"], lines, times), times

    def of_individual(self, block, program, numbers, times):
        """Functions of a step of each individual, and the lines of the loop that call them."""
        name = f"{self.name}_{block}"
        width = self.width
        # A divisor of both, so that any width works.
        vector = math.gcd(self.width, VECTOR)
        table, index, log = _BLOCKS[block]

        # 1. The results: states that change, to their rows of `work`, and the log.
        results = program.results[: self.states]
        logged = program.results[self.states :]
        # A state that does not change stays in its row.
        stores = {i: result for i, result in enumerate(results) if result != f"s{i}"}
        stores |= {f"log[{i}]": result for i, result in enumerate(logged)}
        start = [
            f"work = e.view(kinds[0], work, {width}, j)",
            _unpacked(numbers, "uniform"),
            _unpacked(times, "times"),
        ]
        parameters = ["work", "j", "uniform", "times"]
        arguments = f"numbers, {block}_times"
        if logged:
            # A single log has its rows one after the other; those of several individuals stand side
            # by side in each row.
            if self.name == "single":
                row = f"e.index(i, {len(logged)})"
                arguments += f", {log}, {index}"
            else:
                row = "i"
                arguments += f", {log}, {index} * {len(logged) * width} + {{j}}"
            start.append(f"log = e.view(kinds[4], log, {width}, {row})")
            parameters += ["log", "i"]

        # 2. One function per piece, called for all individuals before the next piece.
        instructions = sum(line.weight for line in program.lines[STATE])
        longest = LONGEST if width > 1 and instructions >= ENOUGH else self.size
        pieces = cut(
            program.lines[STATE], stores, self.places | program.crossing, self.fresh, longest
        )
        text = ""
        calls = [f"{block}_times = {name}_times_{{h}}({table}, data, {index}, numbers)"]
        for k, piece in enumerate(pieces):
            j = f"j_{block}_{k}"  # a name assigned once compiles faster
            lines = start + [re.sub(r"{(\d+)}", r"work[\1]", line) for line in piece]
            text += intrinsic(f"{name}_{k}", parameters, lines, width=vector)
            calls.append(f"for {j} in range(0, {width}, {vector}):")
            calls.append(f"    {name}_{k}_{{h}}(work, {j}, {arguments.replace('{j}', j)})")
        return text, "\n            ".join(calls)


def _programs(
    loop,
    lanes,
    uniform,
    uneven,
    fresh,
    outputs,
):
    """The translated law (if it has a period), log and sub-step.

    Of each only the instructions that its leading `outputs` need.
    """
    # Names are unique over the three functions, which share one text.
    names = Names()
    numbers = {number: (f"l{i}", LANE) for i, number in enumerate(lanes)}
    numbers |= {number: (f"u{i}", UNIFORM) for i, number in enumerate(uniform)}
    times = [(f"t{i}", TIME) for i in range(len(loop.time_names))]
    if not uneven:
        # The length of a sub-step is behind the uniform numbers.
        times[loop.time_fields.at(loop.n)["h"].start] = (f"u{len(uniform)}", UNIFORM)
    inputs = [
        [(f"s{i}", STATE) for i in range(len(loop.state_names))],
        times,
        [numbers[i] for i in range(len(numbers))],
        [(f"d{i}", TIME) for i in range(loop.n_data)],
    ]
    functions = {"law": loop.law_step, "sample": loop.sample, "step": loop.substep}
    return {
        block: translate(
            function,
            inputs[: function.n_in()],
            names,
            fresh,
            relaxed=block == "step",
            wanted=outputs[block],
        )
        for block, function in functions.items()
        if function is not None
    }


def _unpacked(names, values):
    return f"{', '.join(names or ['_'])}, = e.unpack({values})"


def _assigned(lines):
    return [name for line in lines for name in line.names]


# Each block of the loop: its table, the row of the table, and its log.
_BLOCKS = {
    "law": ("law_time", "i // PER_LAW", None),
    "sample": ("sample_time", "i // PER_SAMPLE", "sample_log"),
    "step": ("step_time", "i", "step_log"),
}

_ARGUMENTS = (
    "initial, lanes, uniform, law_time, sample_time, step_time, data, sample_log, step_log, final"
)

# The last state is ``ok``: a loop ends early once it is 0 in all individuals.
_LOOP = """

@compiled
def {name}_{{h}}({arguments}):
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
