"""Old names work for one release, give what the new ones give, and say what to write instead."""

import numpy as np
import pytest

from plant import Law, P, part, puma560, simulate, to_control

ARM, RIG, LAW = puma560.arm(), puma560.rig(), puma560.p_law()
Q = np.array([0.4, -0.3])


@pytest.mark.parametrize(
    ("old", "new", "x"),
    [
        ("pulses", "counts", Q),
        ("read", "true_counts", Q),
        ("position", "position_in_pulses", Q),
        ("turned", "to_angle", 100 * Q),
        ("angle", "cell_centre", np.array([100.0, -7.0])),
    ],
)
@pytest.mark.parametrize("owner", [RIG, RIG.encoder])
def test_names_of_rig_and_encoder(owner, old, new, x):
    with pytest.warns(DeprecationWarning, match=rf"{old} will go .* Use {type(owner).__name__}\.{new}"):
        got = getattr(owner, old)(x)
    np.testing.assert_array_equal(got, getattr(owner, new)(x))


def test_names_that_became_one():
    with pytest.warns(DeprecationWarning, match="Encoder.count "):
        np.testing.assert_array_equal(RIG.encoder.count(np.array([2.7, -2.7])), [2, -2])
    with pytest.warns(DeprecationWarning, match="Rig.counted"):
        np.testing.assert_allclose(RIG.counted(np.array([2.0, -2.0])), [2.5, -2.5])


def test_methods_that_became_functions():
    with pytest.warns(DeprecationWarning, match=r"plant\.to_control\(arm, rig\)"):
        assert ARM.to_control(RIG).name == to_control(ARM, RIG).name
    with pytest.warns(DeprecationWarning, match=r"plant\.to_control\(rig\)"):
        assert RIG.to_control().name == "rig"
    with pytest.warns(DeprecationWarning, match=r"plant\.to_control\(law, rig\)"):
        assert LAW.to_control(RIG).name == "law"
    record = simulate(ARM, RIG, LAW, puma560.reference(), duration=0.01)
    with pytest.warns(DeprecationWarning, match=r"plant\.to_timeresponse\(record\)"):
        assert record.to_timeresponse().sysname == "record"


def test_a_law_of_equations_alone():
    with pytest.warns(DeprecationWarning, match="Stiff must give") as said:

        @part
        class Stiff(Law):
            def equations(self, rig, state, setpoint, pulses, torque, dt):
                return rig.drive.joint_torque(np.full(2, 0.2), setpoint.pulses - pulses), state

    assert [str(each.message).split(":")[0] for each in said] == [
        "Stiff must give period",
        "Stiff must give initial_state",
    ]
    path = puma560.reference()
    same = simulate(ARM, RIG, P(gain=(0.2, 0.2)), path, duration=0.05)
    np.testing.assert_array_equal(simulate(ARM, RIG, Stiff(), path, duration=0.05).torque, same.torque)


def test_a_law_without_equations_is_refused():
    with pytest.raises(ValueError, match=r"Empty must give all that Law declares; it lacks equations.*Define it"):

        @part
        class Empty(Law):
            period = None

            def initial_state(self, n):
                return np.empty(0)


def test_problems_of_a_checkup():
    record = simulate(ARM, RIG, LAW, puma560.reference(), duration=0.01)
    with pytest.warns(DeprecationWarning, match=r"Checkup\.troubles will go .* Use Checkup\.problems"):
        assert record.check().troubles == record.check().problems
