"""The changes of torque that another law would make along the counts of a log.

A law with memory that reads its log (`AlongLog`) runs along the log once more: as another variant,
with another gain or with a derivative. The difference between the two torques, per unit of the
change, is the effect. A law without memory needs no second run: each sample determines its torque.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from identification.equation_error import SMALL, own_numbers, with_numbers
from identification.replay import Optimum
from identification.results.assumed import smoothed
from plant import Record
from plant.laws import AlongLog, commanded_torque
from plant.parts import Floats
from plant.simulation import run_law

# Derivative that is tried, per unit of the proportional gain [s]. Its effect is linear.
_LEAD = 1e-3

# Shares of the largest commanded torque at which a limit is tried; chosen by hand. Far lower ones
# leave no fit that follows the log: `identification.equation_error.restated` finds these.
_SHARES = (0.6, 0.75, 0.9)

# A function of the stated law and the number of joints. It yields the name of each other law, that
# law and the size of its change; `_changes` divides the change of torque by this size.
_Others: TypeAlias = Callable[[AlongLog, int], Iterator[tuple[str, AlongLog, float]]]


def lead(at: Optimum) -> dict[str, list[Floats]]:
    """Torques (N, n) [N m] along each record that a derivative adds, per second of lead.

    ``lead[i]``: the lead is the derivative gain of joint i, divided by its proportional gain.
    """
    if all(map(_reads_its_log, at.model.records)):
        return _changes(at, _with_derivatives)
    rates = []
    for record in at.model.records:
        # A derivative adds the rate of the commanded torque, and zero where that is unknown.
        commanded = commanded_torque(record)
        rates.append(0 * record.counts if commanded is None else smoothed(record, commanded).qd)
    return {
        f"lead[{i}]": [rate * joint for rate in rates]
        for i, joint in enumerate(np.eye(at.model.dynamics.n))
    }


def other_variants(at: Optimum) -> dict[str, list[Floats]]:
    """Torques (N, n) [N m] along each record by which each variant of its law differs.

    The coefficient of ``variant.integration='forward'`` is 1 where that variant made the log. The
    result is empty unless every law reads its log.
    """
    return _changes(at, _with_variants)


def other_gains(at: Optimum) -> dict[str, list[Floats]]:
    """Torques (N, n) [N m] along each record per relative change of each gain of its law.

    ``controller.derivative[0]``. None of laws that do not read their log.
    """
    return _changes(at, _with_gains)


def cut_off(at: Optimum) -> dict[str, list[Floats]]:
    """Torques (N, n) [N m] along each record by which a limit changes what its law commands.

    ``limit.0.75[i]``: at three quarters of the largest torque that joint i is commanded.
    """
    given = [_commanded(record) for record in at.model.records]
    commanded = [torque for torque in given if torque is not None]
    if len(commanded) < len(given):
        return {}
    largest = np.abs(np.concatenate(commanded)).max(axis=0)
    torques = {}
    for share in _SHARES:
        limit = share * largest
        changes = [np.clip(torque, -limit, limit) - torque for torque in commanded]
        for i, joint in enumerate(np.eye(at.model.dynamics.n)):
            torques[f"limit.{share:g}[{i}]"] = [change * joint for change in changes]
    return torques


def _commanded(record: Record) -> Floats | None:
    """Torque (N, n) [N m] that the law of a record commands; None where it does not follow."""
    return run_law(record).given if _reads_its_log(record) else commanded_torque(record)


def _reads_its_log(record: Record) -> bool:
    """Whether the law of a record reads its log, sample by sample."""
    return isinstance(record.law, AlongLog) and record.law.period == record.rig.period


def _changes(at: Optimum, others: _Others) -> dict[str, list[Floats]]:
    """Torques (N, n) along each record by which other laws differ from the stated one, by name."""
    records = at.model.records
    if not all(map(_reads_its_log, records)):
        return {}
    torques: dict[str, list[Floats]] = {}
    for record in records:
        stated: Any = record.law
        # The torque of the stated law itself, from the same counts.
        given = run_law(record).given
        for name, law, size in others(stated, record.n):
            change = (run_law(replace(record, law=law)).given - given) / size
            torques.setdefault(name, []).append(change)
    # Records of different laws have no common change.
    return {name: changes for name, changes in torques.items() if len(changes) == len(records)}


def _with_variants(law, n):
    """The variants of a law."""
    for text, variant in law.law.variants().items():
        # Variants share most of their memory: an integral, a filter, the last error.
        yield f"variant.{text}", law.around(variant, n), 1.0


def _with_gains(law, n):
    """A law with another gain of one joint, for each gain."""
    # Numbers without a joint, those of filters and observers, are left out, since they would
    # explain effects of other causes: drifting friction once looked like a bandwidth that was 31 %
    # lower.
    for place in itertools.chain(*own_numbers(law).values()):
        if "[" in place:
            yield f"controller.{place}", with_numbers(law, 1 + SMALL, [place]), SMALL


def _with_derivatives(law, n):
    """The law with a derivative added at one joint, for each joint whose derivative is zero."""
    numbers = law.law.numbers()
    for joint in (f"[{i}]" for i in range(n)):
        # A derivative that is stated is a gain like others.
        if numbers.get(f"derivative{joint}") == 0 and numbers.get(f"gain{joint}"):
            derivative = _LEAD * numbers[f"gain{joint}"]
            yield f"lead{joint}", _with_number(law, f"derivative{joint}", derivative), _LEAD


def _with_number(law, name, value):
    """A law with another value of one of its numbers."""
    numbers = {**law.law.numbers(), name: value}
    return replace(law, law=law.law.with_numbers(list(numbers.values())))
