"""Records without what their rigs left out or stated wrongly, as an identification found it."""

from dataclasses import replace

import numpy as np

from identification.replay import Number, kind_of, without_delay
from identification.results.alternatives import Sign
from identification.results.with_arm import BY_NAME
from plant import FrictionCurve, Record


def corrected(record: Record, sign: Sign) -> Record:
    """The record without the cause of a sign, as far as that is a number of its rig, or a delay.

    Unchanged where the unknowns can produce the same effect: that correction would move them.
    """
    if sign.absorbing:
        return record
    if "delay" in sign.values:
        return without_delay(record, sign.values["delay"])
    numbers = {number.name: number for number in BY_NAME[sign.name].numbers}
    values = {name: value for name, value in sign.values.items() if kind_of(name) in numbers}
    if not values or any(numbers[kind_of(name)].gives for name in values):
        return record
    drive = record.rig.drive
    # A rig has these numbers only where it states them.
    if sign.name == "offset" and drive.curve is None:
        drive = replace(drive, curve=FrictionCurve(offset=np.zeros(record.n)))
    if sign.name == "lag" and drive.current_lag is None:
        drive = replace(drive, current_lag=values["lag"])
        return replace(record, rig=replace(record.rig, drive=drive))
    rig = replace(record.rig, drive=drive)
    stated = dict(zip(rig.number_names(), rig.number_values().tolist(), strict=True))
    named = {}
    for name, value in values.items():
        number: Number = numbers[kind_of(name)]
        place = number.place + name.removeprefix(number.name)
        named[place] = stated[place] * (1 + value) if number.relative else stated[place] + value
    rig = rig.filled(named)
    # Counts per joint angle changed: the reference no longer is that of its counts.
    reference = None if sign.name == "gear" else record.reference
    return replace(record, rig=rig, reference=reference)
