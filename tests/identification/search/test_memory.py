"""Logs of laws with a memory, from the tracking error alone: cut in the middle of a motion, and
from the start.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest

from ctc import ComputedTorque
from identification import identify
from identification.equation_error import along_log, at_work, reading
from plant import PD, PID, Cascade, Record, Resumed, puma560, simulate
from plant.laws import AlongLog
from plant.simulation import run_law

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
T, WIDTH = RIG.period, np.ptp(puma560.PRINTED_RANGES, axis=1)
GAINS = {"gain": (0.1, 0.075), "derivative": (4e-4, 3e-4), "filter": 3000.0, "period": T}
PID_LAW = PID(integral=(0.5, 0.4), **GAINS)
LAWS = {
    "PID": PID_LAW,
    "cascade": Cascade(
        position=(60.0, 60.0), speed=(1e-3, 8e-4), integral=(0.05, 0.04), difference=2, period=T
    ),
    "computed torque": ComputedTorque(ARM, RIG, bandwidth=150),
}  # fmt: skip


@cache
def log(name, duration=2.2):
    """Without torque and current."""
    record = simulate(ARM, RIG, LAWS[name], PATH, duration=duration)
    return dataclasses.replace(record, torque=None, current=None, true_q=None, true_qd=None)


def error(found):
    return (np.abs(found.f - ARM.f) / WIDTH).max()


@pytest.mark.parametrize(
    ("name", "duration"),
    [
        ("PID", 1.5),
        *(pytest.param(name, 2.2, marks=pytest.mark.slow) for name in LAWS if name != "PID"),
    ],
)
def test_f_from_the_tracking_error_of_a_log_that_was_cut(name, duration):
    """The law's state at the first sample is unknown: an integral, the disturbance of an
    observer.
    """
    found = identify(ARM.dynamics, log(name, duration).cut(0.437), progress=False)
    assert error(found) < 0.03
    assert found.fit.rms_innovation < 0.31
    assert found.law == LAWS[name]
    assert found.records[0].law == LAWS[name]
    (place,) = found.fit.resumptions
    assert place.state.shape == LAWS[name].initial_state(2).shape
    assert found.diagnostics.detection.names == ()


@pytest.mark.parametrize("order", [1, pytest.param(-1, marks=pytest.mark.slow)])
def test_logs_of_two_controllers_are_identified_together(order):
    """One has gains that may be wrong, and the other a state: neither has the other's numbers."""
    p_log = simulate(ARM, RIG, puma560.p_law(), PATH, duration=1.5)
    p_log = dataclasses.replace(p_log.cut(0.437), torque=None, current=None, reference=None)
    found = identify(
        ARM.dynamics, [p_log, log("PID", 1.5).cut(0.437)][::order], held_out=(), progress=False
    )
    assert error(found) < 0.03
    assert found.doubts == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["PID", "cascade"])
def test_a_torque_injected_beside_a_law_with_a_memory_is_no_part_of_it(name):
    """Cut in the middle, without a torque column: the law's run gives its own part, the record
    the other.
    """

    def pushed(t):
        return np.column_stack([20 * np.sin(2 * np.pi * 3.1 * t), 10 * np.cos(2 * np.pi * 5.3 * t)])

    record = simulate(ARM, RIG, LAWS[name], PATH, duration=2.2, injected=pushed)
    record = dataclasses.replace(record, torque=None, current=None, true_q=None, true_qd=None).cut(
        0.437
    )
    found = identify(ARM.dynamics, record, progress=False)
    without = dataclasses.replace(record, injected=None)
    left = identify(ARM.dynamics, without, method="equation_error", progress=False)
    assert error(found) < 0.05
    assert error(left) > 5 * error(found)


def test_a_p_log_without_reference_that_was_cut_begins_at_the_speed_of_its_counts():
    record = simulate(ARM, RIG, puma560.p_law((0.1, 0.08)), PATH, duration=2.2).cut(0.437)
    found = identify(ARM.dynamics, dataclasses.replace(record, reference=None), progress=False)
    assert (np.abs(found.f - ARM.f) < 4 * found.fit.std).all()
    assert (np.sqrt(np.diag(found.fit.noise_covariance)) / WIDTH).max() < 0.1


@pytest.mark.slow
def test_a_log_that_began_with_its_law_needs_no_state():
    found = identify(ARM.dynamics, log("PID"), progress=False)
    assert found.fit.resumptions == ()
    assert error(found) < 0.005


def test_a_state_that_is_stated_is_taken():
    record, begin = log("PID"), 624
    states = run_law(
        dataclasses.replace(record, law=AlongLog(law=PID_LAW, state=PID_LAW.initial_state(2)))
    ).states
    rest = record.cut((begin - 0.5) * T)
    known = dataclasses.replace(rest, law=Resumed(law=PID_LAW, state=states[begin - 1]))
    found = identify(ARM.dynamics, known, progress=False)
    assert found.fit.resumptions == ()
    assert found.fit.rms_innovation < 0.31
    assert error(found) < 0.03


@pytest.mark.slow
def test_unknown_gains_are_found_beside_f():
    stated = dataclasses.replace(PID_LAW, gain=(0.11, 0.07))
    record = dataclasses.replace(log("PID"), law=stated)
    found = identify(
        ARM.dynamics,
        record,
        unknown=(*ARM.dynamics.names, "law.gain[0]", "law.gain[1]"),
        progress=False,
    )
    np.testing.assert_allclose(found.fit.values[-2:], PID_LAW.gain, rtol=0.02)
    np.testing.assert_allclose(found.law.gain, PID_LAW.gain, rtol=0.02)


def test_a_law_that_multiplies_what_rounding_hides_is_refused():
    record = dataclasses.replace(log("computed torque"), reference=None)
    with pytest.raises(
        ValueError, match=r"whole counts of the reference leave .* of it open"
    ) as caught:
        identify(ARM.dynamics, record, progress=False)
    assert "\n" not in str(caught.value)


def test_a_fast_law_with_a_memory_is_refused_without_its_reference():
    """It differentiates what the rounding of the reference leaves between samples: f would be
    off by a quarter.
    """
    fast = PD(gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=3000.0)
    record = dataclasses.replace(simulate(ARM, RIG, fast, PATH, duration=0.3), reference=None)
    with pytest.raises(
        ValueError, match="reference of a fast PD must be known between samples"
    ) as caught:
        identify(ARM.dynamics, record, progress=False)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("goals", "exact"),
    [
        (((100, 200), (100, 200)), True),
        (((100, 200), (110, 200)), False),
        (((100, 0.5), (110, 0.7)), False),
    ],
)
def test_whole_counts_of_a_reference_are_exact_where_a_joint_stands(goals, exact):
    """Each joint by itself: another joint's goal says nothing of it."""
    record = Record(
        t=0.01 * np.arange(10),
        reference_pulses=np.repeat(goals, 5, axis=0),
        error_pulses=np.zeros((10, 2)),
        rig=dataclasses.replace(RIG, period=0.01),
        law=PD(gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=3000.0),
    )
    if exact:
        assert isinstance(along_log(record).law, Resumed)
        return
    with pytest.raises(ValueError, match="must be known between samples"):
        along_log(record)


@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_a_filter_that_was_at_work_remembers_the_motion_before_the_log(rate):
    """As it was left by the run that the log is cut from, at 5 ms, slowly and fast."""
    law = PD(gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=400.0, period=5e-3)
    t = 5e-3 * np.arange(400)
    q = np.column_stack([np.sin(rate * np.pi * t), 0.5 * np.cos(rate * np.pi * t)])
    reference, counts = RIG.counts(q), RIG.counts(0.9 * q)
    whole = Record(
        t=t,
        reference_pulses=reference,
        error_pulses=reference - counts,
        rig=dataclasses.replace(RIG, period=5e-3),
        law=law,
    )
    states = run_law(reading(whole, Resumed(law=law, state=law.initial_state(2)))).states
    for row in (100, 137, 171):
        cut = whole.cut(t[row])
        at_start, _ = at_work(cut, Resumed(law=law, state=law.initial_state(2)))
        # States are those after each sample.
        off = np.abs(at_start.law.state - states[row - 1])
        assert off.max() < 0.005 * np.abs(states).max()
        # Rows that were lost at the start say nothing of the motion before it.
        valid = np.ones(len(cut))
        valid[:4] = 0
        lost = dataclasses.replace(cut, valid=valid)
        after_lost, _ = at_work(lost, Resumed(law=law, state=law.initial_state(2)))
        off = np.abs(after_lost.law.state - states[row - 1])
        # The parabola of a fast motion leads further back with less certainty.
        assert off.max() < {1.0: 0.005, 4.0: 0.03}[rate] * np.abs(states).max()
