"""Parts of the torque that the firmware adds: what is left, in Python and in C, and those parts
are the whole.
"""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

from ctc import ComputedTorque, FeedForward, PDGravity
from plant import PD, Guards, P, SteppedArm, everyday_motions, puma560

ARM, RIG = puma560.arm(), puma560.rig()
DT, LAW = RIG.period, ComputedTorque(ARM, RIG)
SIMPLE = PD(gain=(0.2, 0.1), derivative=(0.004, 0.002), filter=600, period=DT)
PARTS = ("gravity", "friction", "inertia")
needs_c = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc) here")


def parts(pulses, qd, qdd):
    """The parts by the arm's own numbers, not by the law: inverse dynamics less what each motion
    lacks.
    """
    q = np.asarray(RIG.cell_centre(np.asarray(pulses, float))).ravel()
    rest = np.zeros(2)
    gravity = ARM.inverse(q, rest, rest)
    drive = RIG.drive
    friction = drive.gear**2 * drive.viscous * qd + np.abs(drive.gear) * drive.coulomb * np.sign(qd)
    return {
        "gravity": gravity,
        "friction": friction,
        "inertia": ARM.inverse(q, rest, qdd) - gravity,
    }


@pytest.mark.parametrize(
    ("law", "without"),
    [*((LAW, (each,)) for each in PARTS), (LAW, PARTS), (PDGravity(ARM, RIG, feedback=SIMPLE), ("gravity",)),
     (FeedForward(ARM, RIG, feedback=SIMPLE), PARTS)],
)  # fmt: skip
def test_what_is_left_and_the_parts_are_the_whole(law, without):
    path = next(
        each for name, each in everyday_motions(ARM, RIG).items() if "there and back" in name
    )
    robot = SteppedArm(ARM, RIG, path([0.0]).q[0])
    whole, left = law.start(RIG, robot.pulses), law.start(RIG, robot.pulses, without=without)
    for k in range(400):
        q, qd, qdd = (each[0] for each in path([k * DT])[:3])
        torque = whole.step(robot.pulses, q, qd, qdd)
        of = parts(robot.pulses, qd, qdd)
        added = sum(of[each] for each in without)
        if "friction" not in without or (np.abs(qd) > 1e-3).all():
            np.testing.assert_allclose(
                left.step(robot.pulses, q, qd, qdd) + added, torque, rtol=0, atol=1e-12
            )
        else:  # the law's Coulomb friction does not jump
            left.step(robot.pulses, q, qd, qdd)
        np.testing.assert_array_equal(left.torque, whole.torque)  # the law knows the whole
        robot.step(torque)
    assert not whole.stopped


def test_in_a_stop_the_firmware_goes_on_with_what_it_adds():
    pulses = RIG.counts((0.3, -0.4))
    controller = LAW.start(RIG, pulses, without=("gravity", "inertia"), guards=Guards(patience=0))
    for _ in range(20):
        controller.step(pulses, (0.3, -0.4), (0, 0), (0, 0))
    for k in range(600):
        left = controller.step(pulses + (0 if k % 2 else 4000), (np.nan, 0), (5.0, 0), (9.0, 0))
    assert controller.stopped
    gravity = parts(controller.pulses, np.zeros(2), np.zeros(2))["gravity"]
    np.testing.assert_allclose(left + gravity, controller.torque, rtol=0, atol=1e-12)


@needs_c
@pytest.mark.parametrize("guards", [None, Guards()])
@pytest.mark.parametrize("output", ["torque", "dac"])
def test_in_c_it_is_that_of_python(tmp_path, guards, output):
    scale = {"counts_per_ampere": (800.0, -900.0)} if output == "dac" else {}
    LAW.to_c(
        tmp_path, name="arm", guards=guards, without=("friction", "gravity"), output=output, **scale
    )
    library = tmp_path / "arm.so"
    strict = ["-std=c99", "-O1", "-Wall", "-Wextra", "-pedantic", "-Werror", "-ffp-contract=off"]
    subprocess.run(  # noqa: S603
        ["cc", *strict, "-shared", "-fPIC", "-o", library, tmp_path / "arm.c", "-lm"],  # noqa: S607
        check=True,
    )
    c, state = ctypes.CDLL(str(library)), np.zeros(4000)
    pulses = RIG.counts((0.3, -0.4)).astype(np.int32)

    def at(values):
        return values.ctypes.data_as(ctypes.c_void_p)

    c.arm_init(*((at(state), at(pulses)) if guards else (at(state),)))
    python = LAW.start(RIG, pulses, guards=guards, without=("friction", "gravity"))
    given = np.zeros(2, float if output == "torque" else np.int32)
    for k in range(50):
        motion = [np.array(each) for each in ((0.3 + 1e-4 * k, -0.4), (0.1, 0.0), (0.5, -0.5))]
        inputs = [at(state), at(pulses), *map(at, motion)]
        assert c.arm_step(*inputs, *([ctypes.c_double(np.nan)] if guards else []), at(given)) == 0
        expected = python.step(pulses, *motion)
        if output == "dac":
            expected = np.floor(RIG.drive.current(expected) * scale["counts_per_ampere"] + 0.5)
        np.testing.assert_allclose(given, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("law", "without", "why"),
    [
        (
            LAW,
            ("weight",),
            r"sequence of parts of ComputedTorque \(gravity, friction, inertia\), each once",
        ),
        (LAW, "gravity", "each once; got 'gravity'"),
        (LAW, ("gravity", "gravity"), "each once"),
        (ComputedTorque(ARM, RIG, friction=False), ("friction",), r"\(gravity, inertia\)"),
        (PDGravity(ARM, RIG, feedback=SIMPLE), ("inertia",), r"\(gravity\)"),
        (P(gain=(0.2, 0.1)), ("gravity",), "none, since it has no model of the arm"),
        (LAW, None, "each once; got None"),
        (LAW, 5, "each once; got 5"),
        (LAW, [["gravity"]], r"each once; got \[\['gravity'\]\]"),
        (LAW, iter(("gravity",)), "each once; got <tuple_iterator"),
    ],
)
def test_a_part_that_the_law_does_not_have_is_refused(law, without, why, tmp_path):
    with pytest.raises(ValueError, match=why):
        law.start(RIG, (0, 0), without=without)
    with pytest.raises(ValueError, match=why):
        law.to_c(tmp_path / "c", RIG, without=without)
