"""The logs of the corpus of `verdicts.py`: each has a key, law/arm/cause/number, and a draw.

Causes of `causes.py` in MuJoCo under three laws, the mistakes of `silent_mistakes.py`, seven joints, real bags of
CTC_DATA, and right logs of fine encoders, slow clocks, creeping and resting joints and fast starts.
"""

import dataclasses
import functools

import causes
import mujoco_odd

from plant import Dynamics

mujoco_odd.STEPS = 72
"""Steps of MuJoCo in a sample: finer than those of the benchmark, for logs that are kept."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A log, what its owner has of the arm, and which labels name its mistakes."""

    records: list
    dynamics: object
    right: list
    """Labels that name it, mistake by mistake; [[""]] of a right log."""
    reading: str = ""


def of_cause(name, arm, seed, law):
    """A log of `causes.py`."""
    given, cause = causes.drawn(name, arm, seed, law), causes.CAUSES[name]
    mistakes = [causes.CAUSES[each] for each in given.names] or [cause]
    right = [list(each.right + (each.sampled if law != "P" else ())) for each in mistakes]
    return Case(given.records, Dynamics.from_chain(given.chain), right, cause.reading)


def entries(logs, laws):
    """Yield key and draw of every log, the numbers 0 to `logs` - 1 of each cause."""
    for law in laws:
        for arm in causes.ARMS:
            for seed in range(logs):
                # one right log serves all causes that need no other machine
                for name in sorted(causes.CAUSES, key=lambda x: causes.CAUSES[x].other_machine):
                    yield (
                        f"{law}/{arm}/{name.replace('/', ' for ')}/{seed}",
                        functools.partial(of_cause, name, arm, seed, law),
                    )
