"""Laws that go on from a state, on the arm and along a log: against loops that were never
interrupted.
"""

import dataclasses

import numpy as np
import pytest

from ctc import ComputedTorque, FeedForward
from plant import PD, PID, Cascade, Resumed, puma560, replay, simulate
from plant.laws import AlongLog, difference, readings
from plant.simulation import run_law

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
T = RIG.period
GAINS = {"gain": (0.1, 0.075), "derivative": (4e-4, 3e-4), "filter": 3000.0, "period": T}
CASCADE = {"position": (60.0, 60.0), "speed": (1e-3, 8e-4), "integral": (0.05, 0.04), "period": T}
LAWS = {
    "PID": PID(integral=(0.5, 0.4), **GAINS),
    "cascade": Cascade(filter=3000.0, **CASCADE),
    "cascade, difference": Cascade(difference=3, **CASCADE),
    "computed torque": ComputedTorque(ARM, RIG, bandwidth=150),
    "feed-forward + PD": FeedForward(ARM, RIG, feedback=PD(**GAINS)),
}
WIDTH = np.ptp(puma560.PRINTED_RANGES, axis=1)


def along(record, state):
    return dataclasses.replace(
        record, law=AlongLog(law=record.law, state=state), torque=None, current=None
    )


@pytest.mark.parametrize("name", LAWS)
def test_a_law_along_its_log_gives_the_torque_that_was_logged(name):
    """To the last bit of a double, and from its state in the middle of the motion as well."""
    record = simulate(ARM, RIG, LAWS[name], PATH, duration=0.6)
    whole = run_law(along(record, LAWS[name].initial_state(2)))
    np.testing.assert_allclose(whole.given, record.torque, rtol=0, atol=1e-11)
    rest = record.cut(300 * T - 1e-9)
    again = run_law(along(rest, whole.states[299])).given
    # The first step does not know the torque before it: anti-windup and observers take it for a cut
    # of the amplifier.
    law = LAWS[name]
    if name == "feed-forward + PD":
        np.testing.assert_allclose(again, rest.torque, rtol=0, atol=1e-9)
    else:
        assert len(again) == len(rest)
        assert np.abs(again - rest.torque).max() < 0.7 * np.abs(rest.torque).max(), law


def test_whole_counts_of_the_reference_give_feed_forward_its_motion():
    """Friction apart, which turns where the path does: there a sample may have the other sign."""
    law = LAWS["feed-forward + PD"]
    record = simulate(ARM, RIG, law, PATH, duration=2.0).cut(0.3)
    given = run_law(along(dataclasses.replace(record, reference=None), law.initial_state(2))).given
    errors = np.abs(given - record.torque)[5:]
    assert np.median(errors) < 0.05
    assert (errors < 0.2).mean() > 0.995


def test_a_resumed_law_has_the_names_of_its_own_numbers():
    law = Resumed(law=LAWS["PID"], state=np.arange(7.0))
    names = law.number_names("law.")
    assert names == [*LAWS["PID"].number_names("law."), *(f"law.state[{j}]" for j in range(7))]
    other = law.filled({"law.gain[0]": 0.2, "law.state[6]": 9.0}, "law.")
    assert other.law.gain[0] == 0.2
    assert other.state[6] == 9.0
    again = replay(
        ARM, simulate(ARM, RIG, Resumed(law=LAWS["PID"], state=np.zeros(7)), PATH, duration=0.1)
    )
    np.testing.assert_array_equal(
        again.counts, simulate(ARM, RIG, LAWS["PID"], PATH, duration=0.1).counts
    )


def test_the_difference_over_samples_is_that_of_the_counts():
    import casadi as ca

    signal, memory = ca.SX.sym("signal", 2), ca.SX.sym("memory", 7)
    fields = readings(3)
    rate, following = difference(signal, fields.read(memory, 2), 3, ca.SX(0.5), 0.5)
    step = ca.Function("step", [signal, memory], [rate, fields.write(2, **following._asdict())])
    path, state, rates = np.cumsum(np.arange(12.0).reshape(6, 2), axis=0), np.zeros(7), []
    for row in path:
        rate, state = step(row, state)
        rates.append(rate.full().ravel())
    np.testing.assert_array_equal(rates[0], 0)
    np.testing.assert_allclose(rates[3:], (path[3:] - path[:-3]) / 1.5)
    np.testing.assert_allclose(rates[1], (path[1] - path[0]) / 1.5)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "one of filter and difference must be given"),
        ({"filter": 100.0, "difference": 2}, "one of filter and difference must be given"),
        ({"difference": 2, "period": None}, "difference needs a sampled cascade"),
        ({"difference": -1}, "difference must be a whole number"),
        ({"difference": 1.5}, "difference must be a whole number"),
    ],
)
def test_a_cascade_takes_its_speed_from_one_of_two(options, text):
    with pytest.raises(ValueError, match=text) as caught:
        Cascade(**CASCADE | options)
    assert "\n" not in str(caught.value)


def test_states_that_are_none_and_laws_that_are_no_controllers_are_refused():
    with pytest.raises(ValueError, match="must have 7 numbers; got 2"):
        Resumed(law=LAWS["PID"], state=(0, 0)).block(RIG)
    with pytest.raises(ValueError, match="law must be a controller"):
        Resumed(law=Resumed(law=LAWS["PID"], state=np.zeros(7)), state=np.zeros(7))
    record = simulate(ARM, RIG, LAWS["PID"], PATH, duration=0.1)
    with pytest.raises(ValueError, match="law must be AlongLog"):
        run_law(record)
    with pytest.raises(ValueError, match="begin and end must hold samples"):
        record.cut(5.0)


@pytest.mark.parametrize(
    ("name", "text"),
    [("PID", "integration='forward'"), ("computed torque", "friction=False")],
)
def test_a_variant_goes_on_from_what_both_laws_remember(name, text):
    """Each field of the same name and size keeps its numbers; any other one is as at a start."""
    law = LAWS[name]
    state = np.arange(1.0, 1.0 + len(law.initial_state(2)))
    variant = law.variants()[text]
    resumed = Resumed(law=law, state=state).around(variant, 2)
    assert resumed.law == variant
    before, after = (
        flat(one.fields.read(s, 2)) for one, s in ((law, state), (variant, resumed.state))
    )
    begins = flat(variant.fields.read(variant.initial_state(2), 2))
    assert set(before) & set(after)
    for field, value in after.items():
        np.testing.assert_array_equal(value, before.get(field, begins[field]))


def flat(record, group=""):
    """Fields of a record by name; those of a group stand behind its name."""
    fields = {}
    for name, value in record._asdict().items():
        within = isinstance(value, tuple)
        fields |= flat(value, f"{group}{name}.") if within else {f"{group}{name}": value}
    return fields
