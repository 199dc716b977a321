"""The stage in the loop: the law itself without a swap, swaps without a bump, the watch, and its
C.
"""

import ctypes
import dataclasses
import shutil
import subprocess

import numpy as np
import pytest

from ctc import ComputedTorque, ComputedTorquePID
from ctc.payload import PayloadLaw
from plant import PD, Body, Fields, JointSpring, SteppedArm, puma560
from plant.parts import TORQUE_ERROR
from plant.simulation import run

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
ONE = Body(mass=1.0, com=(0.0, -0.4, 0.0)).standard_parameters
LAWS = {
    "observer": ComputedTorque(ARM, RIG, bandwidth=150),
    "delayed": ComputedTorque(ARM, RIG, bandwidth=150, delay=1),
    "PID": ComputedTorquePID(
        ARM, RIG, bandwidth=179, ratio=1.44, integral=66.4, roll_off=1085, roll_off_damping=0.99
    ),
}


def watched(law, stiffened=True):
    return PayloadLaw(law=law, per_kg=ONE, noise=(0.8, 0.4), stiffened=stiffened)


def state_of(running, law):
    """The part of the controller's memory that is the law's state, to be written to."""
    assert len(running.state) == len(law.initial_state(2))
    return running.core.law_state(2)


def test_without_a_swap_it_is_the_law():
    """To the last bit by casadi; compiled kernels fuse other products with sums."""
    plain, same = (
        run(ARM, RIG, law, PATH, 0.5, 4, None, "casadi").record
        for law in (LAWS["observer"], watched(LAWS["observer"]))
    )
    np.testing.assert_array_equal(plain.error_pulses, same.error_pulses)
    np.testing.assert_array_equal(plain.torque, same.torque)


@pytest.mark.slow
def test_springs_that_the_rig_has_are_no_disturbance():
    """The watch's disturbance is as small on an arm with springs as without; of unknown ones it
    is theirs.
    """
    springs = JointSpring(stiffness=(80.0, 30.0), angle=(0.3, -0.5))
    sprung, largest = dataclasses.replace(RIG, springs=springs), []
    motion = PATH(np.arange(700) * RIG.period)
    for own, rig in ((RIG, RIG), (sprung, sprung), (RIG, sprung)):
        law = watched(ComputedTorque(ARM, own, bandwidth=150))
        stepped = SteppedArm(ARM, rig, motion.q[0], motion.qd[0])
        control, seen = law.start(RIG, stepped.pulses, guards=None), []
        pulses, where, state = stepped.pulses, law.places(2)["observer"], state_of(control, law)
        for each in zip(*motion, strict=True):
            pulses = stepped.step(control.step(pulses, *each))
            seen.append(ARM.D(each[0]) @ state[where.stop - 2 : where.stop])
        largest.append(np.abs(np.mean(seen[400:], axis=0)).max())
    assert largest[1] < largest[0] + 0.5  # [N m]
    assert largest[2] > 10


@pytest.mark.parametrize(
    ("name", "stiffened"),
    [(name, kept) for name in LAWS for kept in (True, False) if kept or name != "delayed"],
)
def test_a_swap_has_no_bump(name, stiffened):
    """5 kg come, the law holds them by its feedback, then the model is told: the torque does not
    jump by their weight.

    Without the re-basing it would, which the last line makes sure of.
    """
    law = watched(LAWS[name], stiffened)
    motion = PATH(np.arange(700, 1800) * RIG.period)
    stepped = SteppedArm(ARM, RIG, motion.q[0], motion.qd[0])
    running = law.start(RIG, stepped.pulses, guards=None)
    twin = law.start(RIG, stepped.pulses, guards=None)
    where, pulses, swap = law.places(2), stepped.pulses, 750
    for k in range(swap):
        if k == 300:
            stepped.carry(Body(mass=5.0, com=(0.0, -0.4, 0.0)))
        pulses = stepped.step(running.step(pulses, motion.q[k], motion.qd[k], motion.qdd[k]))
    twin.core.memory[:] = running.core.memory
    state_of(running, law)[where["wanted"].start : where["wanted"].stop] = 5.0 * ONE
    moved = motion.q[swap], motion.qd[swap], motion.qdd[swap]
    jump = running.step(pulses, *moved) - twin.step(pulses, *moved)
    if not stiffened:
        assert np.linalg.norm(jump) < 0.3
    whole = ARM.dynamics.Y(*moved).full() @ ARM.dynamics.load_matrix() @ (5.0 * ONE)
    assert np.linalg.norm(whole) > 20
    assert np.linalg.norm(jump) < 0.3 * np.linalg.norm(
        whole
    )  # what is left: the new inertia times the error's feedback
    errors, pulses = [], stepped.step(running.torque)
    for k in range(swap + 1, len(motion.q)):
        errors.append(RIG.counts(motion.q[k]) - pulses)
        pulses = stepped.step(running.step(pulses, motion.q[k], motion.qd[k], motion.qdd[k]))
    assert np.abs(errors[100:]).max() <= 1
    law_state = running.state[where["law"]]
    assert np.isfinite(law_state).all()


def test_a_law_that_says_nothing_of_its_errors_would_jump(monkeypatch):
    places = Fields.places
    roles = lambda self, n, role: () if role == TORQUE_ERROR else places(self, n, role)  # noqa: E731
    monkeypatch.setattr(Fields, "places", roles)
    with pytest.raises(AssertionError):
        test_a_swap_has_no_bump("observer", True)


def test_the_watch_sees_which_way():
    law = watched(LAWS["observer"])
    motion = PATH(np.arange(2500) * RIG.period)
    stepped = SteppedArm(ARM, RIG, motion.q[0], motion.qd[0])
    running, pulses, seen = law.start(RIG, stepped.pulses), stepped.pulses, []
    where = law.places(2)["wanted"]
    for k in range(2500):
        if k in (1000, 1900):
            stepped.carry(Body(mass=2.0, com=(0.0, -0.4, 0.0)) if k == 1000 else None)
        if k == 1300:
            state_of(running, law)[where.start : where.stop] = 2.0 * ONE
        pulses = stepped.step(running.step(pulses, motion.q[k], motion.qd[k], motion.qdd[k]))
        seen.append(running.state[-1])
    quiet, taken, dropped = (
        np.array(seen[150:1000]),
        np.array(seen[1000:1086]),
        np.array(seen[1900:1986]),
    )
    assert np.abs(quiet).max() < 1.5
    assert taken.max() > 5
    assert dropped.min() < -5


def test_what_cannot_carry():
    with pytest.raises(ValueError, match="law of PayloadLaw must be of type ModelLaw"):
        watched(PD(gain=(0.1, 0.1), derivative=(0.004, 0.004), filter=3000.0, period=RIG.period))
    with pytest.raises(ValueError, match="delay"):
        watched(LAWS["delayed"], stiffened=False)
    with pytest.raises(ValueError, match="noise"):
        dataclasses.replace(watched(LAWS["observer"]), noise=(0.0, 1.0))


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_its_c_swaps_likewise(tmp_path):
    """The exported stage, step by step beside the running controller, with a swap on the way."""
    law = watched(LAWS["observer"])
    law.to_c(tmp_path, name="stage", guards=None)
    command = [
        "cc",
        "-std=c99",
        "-O1",
        "-shared",
        "-fPIC",
        "-o",
        tmp_path / "stage.so",
        tmp_path / "stage.c",
        "-lm",
    ]
    # the compiler of this machine
    subprocess.run([str(part) for part in command], check=True)  # noqa: S603
    library = ctypes.CDLL(str(tmp_path / "stage.so"))
    states, where = len(law.initial_state(2)), law.places(2)
    memory = (ctypes.c_double * (2 + states + 64))()
    library.stage_init(memory)
    offset = next(
        i
        for i in range(64)
        if list(memory[i : i + states]) == law.initial_state(2).tolist() and i >= 2
    )
    motion = PATH(np.arange(600) * RIG.period)
    stepped = SteppedArm(ARM, RIG, motion.q[0], motion.qd[0])
    running, pulses = law.start(RIG, stepped.pulses, guards=None), stepped.pulses
    vector, counts, out = ctypes.c_double * 2, ctypes.c_int32 * 2, (ctypes.c_double * 2)()
    for k in range(600):
        if k == 300:
            for i, value in zip(where["wanted"], 3.0 * ONE, strict=True):
                memory[offset + i] = value
                state_of(running, law)[i] = value
        state = [x[k] for x in motion]
        torque = running.step(pulses, *state)
        assert (
            library.stage_step(memory, counts(*map(int, pulses)), *(vector(*x) for x in state), out)
            == 0
        )
        np.testing.assert_allclose(list(out), torque, rtol=1e-9, atol=1e-7)
        pulses = stepped.step(torque)
