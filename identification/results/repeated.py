"""The first record of an identification once more, as the model repeats it."""

import dataclasses
from typing import Any

from identification.search.memory import as_repeated
from plant import Record, Resumed, replay
from plant.simulation.logged_run import DivergenceError


def repeated(found: Any) -> Record | None:
    """The first record of an `Identification`, simulated with what was found; None where that diverges.

    It begins as the record does, its law with the memory that was found: the run that `Diagnostics.difference` is of.
    """
    record, law = as_repeated(found.records[:1], found.fit.resumptions[:1])[0], found.law
    if isinstance(record.law, Resumed):
        law = dataclasses.replace(record.law, law=law)
    try:
        return replay(found.arm, record, rig=found.rig, law=law)
    except DivergenceError:
        return None
