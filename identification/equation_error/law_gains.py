"""The main gain of a law, and the torque that another value of it would make along a log."""

from dataclasses import replace
from typing import Any

from identification.equation_error.law_memory import torque_along_log
from identification.equation_error.torque_logs import is_faster
from plant import Record, Resumed
from plant.machine import InnerLoop
from plant.parts import Floats, frozen

# Relative change of a gain: so small that the torque changes almost linearly, but for the few
# samples that enter or leave saturation.
SMALL = 0.01


@frozen
class MainGain:
    """The first number of a law that is not zero: its proportional gain, or its bandwidth.

    `name`: of the number, without its joint. `by_joint`: whether each joint has one of its own.
    `effect` (N, n): change of the joint torques along a log [N m] per relative change.
    """

    name: str
    by_joint: bool
    effect: Floats


def own_numbers(law: Any) -> dict[str, list[str]]:
    """Names of the numbers of a law that are not zero, by their name without the joint.

    Numbers of an arm or a rig in the law, such as ``arm.f[0]``, are left out, and so is the state
    of a law that resumes.
    """
    names: dict[str, list[str]] = {}
    stated = law.law if isinstance(law, Resumed) else law
    for name, value in stated.numbers().items():
        if value and "." not in name:
            names.setdefault(name.partition("[")[0], []).append(name)
    return names


def with_numbers(law: Any, factor: float, names: list[str]) -> Any:
    """The law with some of its numbers multiplied by a factor."""
    if isinstance(law, Resumed):
        return replace(law, law=with_numbers(law.law, factor, names))
    numbers = law.numbers()
    scaled = {name: factor * numbers[name] for name in names}
    return law.with_numbers([*(numbers | scaled).values()])


def main_gain(record: Record, under_way: bool) -> MainGain | None:
    """The main gain of the law of a record; None if the law has no number that is not zero.

    Only of a law with memory whose torque was not logged. None of a law that acts between the rows
    of its log, or through an inner loop: the torques along the rows are not those that it gave.
    `under_way`: whether the law was at work before its log.
    """
    law: Any = record.law
    numbers = own_numbers(law)
    if not numbers or is_faster(record) or isinstance(law.innermost, InnerLoop):
        return None
    # The same number whatever is corrected in the counts: different numbers would absorb different
    # mistakes, and the corrections could not be compared.
    name, places = next(iter(numbers.items()))
    other = replace(record, law=with_numbers(law, 1 + SMALL, places))
    change = torque_along_log(other, under_way) - torque_along_log(record, under_way)
    return MainGain(name=name, by_joint="[" in places[0], effect=change / SMALL)
