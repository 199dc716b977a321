"""Copies and other processes: the same descriptions, the same arrays, and the same bits out of
what is made of them.
"""

import copy
import multiprocessing
import pickle

import numpy as np
import pytest

from ctc import ComputedTorque, FeedForward
from identification import identify
from plant import PD, puma560, read_robot, simulate

RIG, PATH, ARM = puma560.rig(), puma560.reference(), puma560.arm()
RECORD = simulate(ARM, RIG, puma560.p_law(), PATH, duration=0.4)
PD_LAW = PD(gain=(0.2, 0.15), derivative=(1e-3, 1e-3), filter=2000.0, period=RIG.period)
THINGS = {
    "arm": ARM,
    "dynamics": ARM.dynamics,
    "chain": read_robot("puma560").dynamics.chain,
    "rig": read_robot("tx40").rig,
    "reference": PATH,
    "scaled": PATH.slowed(1.5),
    "law": ComputedTorque(ARM, RIG),
    "law with a law": FeedForward(ARM, RIG, feedback=PD_LAW),
    "record": RECORD,
}


def by_pickle(thing):
    return pickle.loads(pickle.dumps(thing))  # noqa: S301 - our own bytes, never a file


@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy, by_pickle])
@pytest.mark.parametrize("thing", THINGS.values(), ids=THINGS)
def test_a_copy_is_equal_and_as_frozen(thing, way):
    twin = way(thing)
    assert twin == thing
    assert hash(twin) == hash(thing)
    assert repr(twin) == repr(thing)
    arrays = [(name, value) for name, value in vars(twin).items() if isinstance(value, np.ndarray)]
    assert not any(value.flags.writeable for _, value in arrays)
    if arrays and way is not copy.copy:
        name, value = arrays[0]
        assert value is not getattr(thing, name)


def test_things_that_differ_in_one_bit_are_not_equal():
    other = by_pickle(RECORD)
    changed = np.array(other.torque)
    changed[7, 1] = np.nextafter(changed[7, 1], np.inf)
    object.__setattr__(other, "torque", changed)
    assert other != RECORD
    assert (RECORD == 3) is False


def results(arm, rig, law, reference, record):
    """What another process makes of what it was sent."""
    run = simulate(arm, rig, law, reference, duration=0.05)
    q, qd = np.array([0.3, -0.4]), np.array([1.0, 0.5])
    return (
        arm.D(q).tobytes(),
        arm.h(q, qd).tobytes(),
        run.error_pulses.tobytes(),
        run.torque.tobytes(),
        record.t.tobytes(),
    )


def test_another_process_makes_the_same_bits():
    sent = (ARM, RIG, ComputedTorque(ARM, RIG), PATH, RECORD)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        there = pool.apply(results, sent)
    here = results(*sent)
    assert there == here


def test_an_identification_comes_back_bit_for_bit():
    found = identify(puma560.dynamics(), RECORD, seed=3, progress=False, method="equation_error")
    for way in (copy.deepcopy, by_pickle):
        twin = way(found)
        assert twin == found
        assert twin.f.tobytes() == found.f.tobytes()
        assert ComputedTorque(twin.arm, twin.rig) == ComputedTorque(found.arm, found.rig)
        assert str(twin) == str(found)


def test_symbols_and_functions_are_not_sent():
    ARM.D(np.zeros(2))
    assert set(ARM.dynamics.__getstate__()) == {"chain", "lumping", "ranges"}
    assert set(PATH.slowed(2.0).__getstate__()) == {
        "path", "times", "places", "speeds", "accelerations", "stays",
    }  # fmt: skip
