"""Source text of a closed loop's kernels, for one individual or for W individuals side by side.

Quantity r of individual j is ``work[r, j]``, with W a constant of the file; time is the outer loop,
the vectors of individuals are the inner one, and its body has no branch. One intrinsic
(`plant.compiler.intrinsics`) emits it all; numba sees the call of it alone.
"""

import dataclasses
import itertools
import math
import re
from collections.abc import Callable, Sequence

from plant.compiler import LANE, STATE, TIME, UNIFORM, Names, cut, head, translate
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
) -> tuple[str, dict[str, list[int]], int]:
    """Text of one loop, the columns (law, sample, step, data) that it reads, and its rows of work.

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
    text, numbers, once = emitter.once(programs.values())
    columns: dict[str, list[int]] = {"law": [], "sample": [], "step": [], "data": []}
    calls = {}
    for block, program in programs.items():
        of_step, times, call = emitter.of_step(block, program, numbers, columns)
        of_individual, calls[block] = emitter.of_individual(block, program, numbers + times)
        text += of_step + of_individual
        calls[block].insert(0, call)

    # 4. The loop: each block at its steps; a sample may end it.
    calls["sample"] += [
        f"ok = View(wide, memory, {width}, LONG({(states - 1) * width}))",
        f"with builder.if_then(wide.none_positive(ok, {width})):",
        "    builder.store(loop.index, done)",
        "    loop.do_break()",
    ]
    # Sub-steps from one run of a block to the next.
    periods = {"law": loop.steps_per_law, "sample": loop.steps_per_sample, "step": 1}
    body = [
        line
        for block in calls
        for line in (
            f"with e.every({periods[block]}, loop.index) as i:",
            *(f"    {line}" for line in calls[block]),
        )
    ]
    text += _LOOP.format(
        name=name,
        vector=emitter.vector,
        once=_indented(once, 2),
        body=_indented(body, 3),
    )
    return head() + text, columns, next(rows)


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

    @property
    def vector(self):
        """Individuals of one vector: a divisor of both numbers, so that any width works."""
        return math.gcd(self.width, VECTOR)

    def once(self, programs):
        """Functions of values that do not change in time, names of the shared ones, and the calls.

        The first is evaluated once, the second once per individual.
        """
        # The three functions share numbers: each is loaded once for all of them.
        used = {number: kind for program in programs for number, kind in program.used.items()}
        numbers = [number for number, kind in used.items() if kind == UNIFORM]
        uniform = [f"{number} = u[{number[1:]}]" for number in numbers]
        lane = [
            f"{number} = work[{self.places[number]}]"
            for number, kind in used.items()
            if kind == LANE
        ]
        # What does not depend on time is computed here, and passes to the steps in rows or by name.
        for program in programs:
            uniform += map(str, program.lines[UNIFORM])
            numbers += _assigned(program.lines[UNIFORM])
            lane += map(str, program.lines[LANE])
            lane += [f"work[{row}] = {number}" for number, row in program.crossing.items()]
        text = _function(
            f"{self.name}_uniforms", "e, u", [*uniform, f"return ({_listed(numbers)})"]
        )
        calls = [
            f"({_listed(numbers)}) = {self.name}_uniforms_{{h}}(e, View(e, uniform, 1, LONG(0)))"
        ]
        function, call = self._per_vector(f"{self.name}_once", lane, numbers)
        return text + function, numbers, calls + call

    def of_step(self, block, program, numbers, columns):
        """The function of a step that all individuals share, names of its results, and its call.

        The inputs that it reads are added to the `columns` of the tables.
        """
        inputs = [number for number, kind in program.used.items() if kind == TIME]
        of_table = {letter: [number for number in inputs if number[0] == letter] for letter in "td"}
        # Of wide tables a kernel reads few columns; the tables are narrowed to them.
        for letter, table in (("t", block), ("d", "data")):
            # A number of a table is named by its column: t7 is column 7.
            columns[table] += [int(number[1:]) for number in of_table[letter]]
        lines = [
            f"{number} = {letter}[{i}]"
            for letter, names in of_table.items()
            for i, number in enumerate(names)
        ]
        # Later functions get what was read, and what was computed of it.
        lines += map(str, program.lines[TIME])
        times = inputs + _assigned(program.lines[TIME])
        shared = _read(lines, numbers)
        name = f"{self.name}_{block}_times"
        function = _function(
            name, f"e, t, d, {_listed(shared)}", [*lines, f"return ({_listed(times)})"]
        )
        call = (
            f"({_listed(times)}) = {name}_{{h}}("
            f"e, View(e, {block}_time, 1, e.index(i, {len(columns[block])})),"
            f" View(e, data, 1, e.index(i, {len(columns['data'])})), {_listed(shared)})"
        )
        return function, times, call

    def of_individual(self, block, program, shared):
        """Functions of a step of each individual, and the lines of the loop that call them.

        `shared` are names of numbers and times of all individuals.
        """
        # 1. The results: states that change, to their rows of `work`, and the log.
        results = program.results[: self.states]
        logged = program.results[self.states :]
        # A state that does not change stays in its row.
        stores = {i: result for i, result in enumerate(results) if result != f"s{i}"}
        stores |= {f"log[{i}]": result for i, result in enumerate(logged)}
        log = None
        if logged:
            # A single log has its rows one after the other; those of several individuals stand side
            # by side in each row.
            count = len(logged) * self.width
            log = f"View(wide, {block}_log, {self.width}, builder.add(e.index(i, {count}), j))"

        # 2. One function per piece, called for all individuals before the next piece.
        instructions = sum(line.weight for line in program.lines[STATE])
        longest = LONGEST if self.width > 1 and instructions >= ENOUGH else self.size
        pieces = cut(
            program.lines[STATE], stores, self.places | program.crossing, self.fresh, longest
        )
        # Placeholders of rows become elements of the view that the piece gets.
        text, calls = "", []
        for k, piece in enumerate(pieces):
            lines = [re.sub(r"{(\d+)}", r"work[\1]", line) for line in piece]
            function, call = self._per_vector(f"{self.name}_{block}_{k}", lines, shared, log)
            text += function
            calls += call
        return text, calls

    def _per_vector(self, name, lines, shared, log=None):
        """A function of a vector of individuals, and the lines that call it for all of them."""
        # Each number that is passed becomes a vector, so only those that are read are passed.
        shared = _read(lines, shared)
        log_name, log_view = ("log, ", f"{log}, ") if log else ("", "")
        function = _function(name, f"e, work, {log_name}{_listed(shared)}", lines)
        return function, [
            f"with wide.individuals({self.width}) as j:",
            f"    work = View(wide, memory, {self.width}, j)",
            f"    {name}_{{h}}(wide, work, {log_view}*wide.shared({_listed(shared)}))",
        ]


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


def _function(name, parameters, lines):
    """A function of the generated text."""
    return f"\n\ndef {name}_{{h}}({parameters}):\n" + _indented(lines or ["pass"], 1)


def _indented(lines, depth):
    """Lines of a block, `depth` times four columns to the right."""
    return "".join(f"{'    ' * depth}{line}\n" for line in lines)


def _listed(names):
    return "".join(f"{name}, " for name in names)


def _read(lines, names):
    """Those of the names that the lines read."""
    # A name is a whole word of the text: v1 is no part of v12.
    words = set(re.findall(r"\w+", "\n".join(lines)))
    return [name for name in names if name in words]


def _assigned(lines):
    return [name for line in lines for name in line.names]


# What a loop consists of.
_BLOCKS = ("law", "sample", "step")

# The last state is ``ok``: a loop ends early once it is 0 in all individuals.
_LOOP = """

@intrinsic
def {name}_run_{{h}}(
    typing, memory, uniform, law_time, sample_time, step_time, data, sample_log, step_log, steps
):
    def codegen(context, builder, signature, arguments):
        e = Emitter(context, builder)
        wide = Emitter(context, builder, {vector})
        e.widest()
        *arrays, steps = arguments
        memory, uniform, law_time, sample_time, step_time, data, sample_log, step_log = (
            e.elements(kind, array) for kind, array in zip(signature.args, arrays)
        )
{once}
        done = cgutils.alloca_once_value(builder, steps)
        with cgutils.for_range(builder, steps) as loop:
{body}
        return builder.load(done)

    signature = int64(
        memory, uniform, law_time, sample_time, step_time, data, sample_log, step_log, steps
    )
    return signature, codegen


@compiled
def {name}_{{h}}(
    memory, uniform, law_time, sample_time, step_time, data, sample_log, step_log, steps
):
    return {name}_run_{{h}}(
        memory, uniform, law_time, sample_time, step_time, data, sample_log, step_log, steps
    )
"""
