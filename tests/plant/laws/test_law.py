"""Laws: the symbolic block, and the running controller of a control script against the simulated
loop.
"""

import casadi as ca
import numpy as np
import pytest
from closed_loops import Filtered, NoTorque

from plant import Fields, Law, Resumed, StatelessLaw, part, per_joint, puma560, scalars, simulate
from plant.parts import TORQUE_ERROR

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
LAW = Filtered(gain=(8.0, 6.0), rate=40.0, period=RIG.period)


def test_block_holds_the_law_s_numbers_then_the_rig_s():
    block = LAW.block(RIG)
    assert block.names[:3] == ["law.gain[0]", "law.gain[1]", "law.rate"]
    assert block.names[3:] == RIG.number_names()
    np.testing.assert_array_equal(block.values, [8.0, 6.0, 40.0, *RIG.number_values()])
    np.testing.assert_array_equal(block.initial, LAW.initial_state(2))
    assert block.period == RIG.period


def test_running_controller_asks_for_the_torque_of_the_simulated_one():
    """Fed with the counts of a simulation, one sample at a time."""
    record = simulate(ARM, RIG, LAW, PATH, duration=0.2)
    motion = PATH(record.t)
    counts = record.reference_pulses - record.error_pulses
    controller = LAW.start(RIG, counts[0])
    torque = [controller.step(*row) for row in zip(counts, *motion, strict=True)]
    # The same equations in two kernels: rounding, carried on by a filter that forgets in 25 ms.
    np.testing.assert_allclose(torque, record.torque, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(controller.pulses, counts[-1])


def test_refused_reading_changes_nothing():
    """Without guards; with them a reference that is not finite is bridged (test_running.py)."""
    controller = LAW.start(RIG, (0, 0), guards=None)
    controller.step((1, 2), (0, 0), (0, 0), (0, 0))
    before = controller.state.copy(), controller.torque.copy(), controller.pulses.copy()
    for pulses, q, message in (
        ((1.5, 0), (0, 0), "pulses must be whole encoder counts"),
        ((np.nan, 0), (0, 0), "pulses must be finite; got nan at index 0"),
        ((1,), (0, 0), r"pulses must have shape \(2,\)"),
        ((1, 2), (0, np.inf), "q_r must be finite; got inf at index 1"),
    ):
        with pytest.raises(ValueError, match=message):
            controller.step(pulses, q, (0, 0), (0, 0))
    for was, now in zip(
        before, (controller.state, controller.torque, controller.pulses), strict=True
    ):
        np.testing.assert_array_equal(was, now)


def test_running_controller_stays_within_the_amplifier():
    torque = LAW.start(RIG, (0, 0), guards=None).step((0, 0), (1.0, -1.0), (0, 0), (0, 0))
    np.testing.assert_allclose(np.abs(torque), RIG.drive.torque_limit(), rtol=1e-15)


def test_law_of_the_wrong_size_is_refused():
    class Short(NoTorque):
        def equations(self, rig, state, setpoint, pulses, torque, dt):
            return ca.SX.zeros(1), state

    with pytest.raises(
        ValueError, match=r"Short must give torque \(2, 1\) and state \(0, 1\); got \(1, 1\)"
    ):
        Short().block(RIG)


def test_a_law_that_is_written_wrongly_says_how():
    """Its commonest mistakes: no state returned, an argument forgotten, no @part."""

    @part
    class OneResult(StatelessLaw):
        def equations(self, rig, state, setpoint, pulses, torque, dt):
            return ca.SX.zeros(rig.n)

    @part
    class NoTime(StatelessLaw):
        def equations(self, rig, state, setpoint, pulses, torque):
            return ca.SX.zeros(rig.n), state

    class Bare(StatelessLaw):
        def equations(self, rig, state, setpoint, pulses, torque, dt):
            return ca.SX.zeros(rig.n), state

    with pytest.raises(
        ValueError, match=r"equations of OneResult must return \(torque, state\); got a SX"
    ):
        OneResult().block(RIG)
    with pytest.raises(
        ValueError,
        match=r"equations of NoTime must take \(self, rig, .*, dt\); got \(self, rig.*Correct",
    ):
        NoTime().block(RIG)
    with pytest.raises(
        ValueError,
        match=r"Bare must be a dataclass of named fields; it is none\. Put @part above it",
    ):
        Bare(gain=1.0)


@pytest.mark.parametrize(
    ("result", "cause"),
    [
        (lambda state: (0.0, state), "got a float as torque"),
        (lambda state: (ca.SX.zeros(2), []), "got a list as state"),
        (lambda state: (ca.SX.zeros(2), state, 1), "got 3 values"),
    ],
)
def test_what_equations_return_is_torque_and_state(result, cause):
    class Wrong(NoTorque):
        def equations(self, rig, state, setpoint, pulses, torque, dt):
            return result(state)

    with pytest.raises(ValueError, match=rf"Wrong must return \(torque, state\).*{cause}"):
        Wrong().block(RIG)


@part
class Counted(Law):
    """A torque that grows by one each sample; `after` is what its equations write."""

    period: float | None = None
    fields = Fields(level=per_joint(start=2.0, role=TORQUE_ERROR), samples=scalars())
    after: tuple = ("level", "samples")

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        now = self.fields.read(state, rig.n)
        values = {"level": now.level + 1, "samples": now.samples + 1, "other": 0}
        following = self.fields.write(rig.n, **{name: values[name] for name in self.after})
        return now.level, following


def test_a_law_reads_and_writes_its_state_by_name():
    block = Counted().block(RIG)
    np.testing.assert_array_equal(block.initial, (2, 2, 0))
    torque, state = block.step(block.initial, *np.zeros((6, 2)), 0.1, RIG.number_values())
    np.testing.assert_array_equal(torque, [[2], [2]])
    np.testing.assert_array_equal(state, [[3], [3], [1]])
    resumed = Resumed(law=Counted(), state=(5, 6, 7))
    assert resumed.fields.places(2, TORQUE_ERROR) == (range(2),)
    np.testing.assert_array_equal(resumed.initial_state(2), (0, 0, 0, 1))


@pytest.mark.parametrize(
    ("after", "name"), [(("level",), "samples"), (("level", "samples", "other"), "other")]
)
def test_a_law_whose_fields_clash_is_refused_by_the_field_s_name(after, name):
    with pytest.raises(ValueError, match=f"'{name}'") as refusal:
        Counted(after=after).block(RIG)
    assert "\n" not in str(refusal.value)


def test_a_law_without_a_state_says_so():
    @part
    class Forgotten(Law):
        period: float | None = None

        def equations(self, rig, state, setpoint, pulses, torque, dt):
            return ca.SX.zeros(rig.n), state

    with pytest.raises(ValueError, match=r"Forgotten must give all .*; it lacks fields\. Define"):
        Forgotten()
