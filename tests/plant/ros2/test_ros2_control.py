"""The exported controller of ros2_control: compiled, taken through its lifecycle, and the
torques of `.step`.
"""

import dataclasses
import os
import shutil
import xml.etree.ElementTree as ElementTree
from functools import cache

import numpy as np
import pytest
import servos
from ros_controller import ACTIVE, FINALIZED, INACTIVE, UNCONFIGURED, Controller, array
from scipy.interpolate import BPoly

from ctc import ComputedTorque
from plant import (
    Harmonics,
    LoggedTorque,
    MitDrive,
    P,
    SteppedArm,
    everyday_motions,
    puma560,
    to_ros2_control,
)
from plant.realtime import memory

ARM, RIG, JOINTS = puma560.arm(), puma560.rig(), ("joint2", "joint3")
LAW, DT = ComputedTorque(ARM, RIG), RIG.period
CXX = shutil.which("g++")
needs_cxx = pytest.mark.skipif(CXX is None and "CI_CXX" not in os.environ, reason="no g++ here")


def assert_equal(torques, share=1e-12):
    """Torques of both to a share of the largest: sines of C's library are not those of the
    kernel.
    """
    ours, theirs = torques[:, 0], torques[:, 1]
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=share * np.abs(ours).max())


@cache
def motions():
    return everyday_motions(ARM, RIG)


@pytest.fixture(scope="module")
def controller(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ros2") / "arm_controller"
    to_ros2_control(LAW, folder)
    return Controller(folder)


def angle(counts):
    """Position as a driver makes it of counts."""
    return np.asarray(RIG.to_angle(np.asarray(counts, float))).ravel()


def followed(controller, path, samples, spoil=lambda k, at: at, start=0.0):
    """Run Python's controller on an arm, and the plugin on what that one reads: states of
    `update`, both torques.
    """
    robot = SteppedArm(ARM, RIG, path([start]).q[0])
    running = LAW.start(RIG, robot.pulses)
    codes, torques, now = [], [], 0.0
    for k in range(samples):
        motion = [each[0] for each in path([start + k * DT])[:3]]
        now += 700_000 / 1e9
        at = spoil(k, angle(robot.pulses))
        seen = np.where(np.isfinite(at), np.round(RIG.position_in_pulses(at)), np.nan)
        ours = running.step(seen, *motion, now=now)
        yield motion
        code, theirs = controller.update(at)
        codes.append(code)
        torques.append((ours, theirs))
        robot.step(ours)
    controller.result = np.array(codes), np.array(torques), running


def in_chain(controller, path, samples, **options):
    for motion in followed(controller, path, samples, **options):
        assert controller.c.give_reference(array(np.concatenate(motion))) == 0
    return controller.result


@needs_cxx
@pytest.mark.parametrize(
    "which", [pytest.param("far and fast", marks=pytest.mark.slow), "there and back", "ten pulses"]
)
def test_in_a_chain_it_gives_the_torques_of_step_and_allocates_nothing(controller, which):
    path = next(each for name, each in motions().items() if which in name)
    begin = angle(RIG.counts(path([0.0]).q[0]))
    assert controller.begin(begin, chained=True) == [0, INACTIVE, ACTIVE]
    names = [controller.c.reference_name(i).decode() for i in range(controller.c.reference_count())]
    assert names == [
        f"arm_controller/{j}/{p}" for p in ("position", "velocity", "acceleration") for j in JOINTS
    ]
    before = controller.c.allocations()
    codes, torques, running = in_chain(controller, path, 700)
    assert controller.c.allocations() == before
    assert not codes.any()
    assert not running.stopped
    assert np.abs(torques[:, 0]).max() > 10
    assert_equal(torques)


@needs_cxx
def test_a_trajectory_with_its_joints_in_another_order_gives_the_same_torques(controller):
    path = next(each for name, each in motions().items() if "there and back" in name)
    samples = round(path.duration / DT) + 1
    begin = angle(RIG.counts(path([0.0]).q[0]))
    controller.begin(begin)
    times = DT * np.arange(samples)
    rows = np.stack([each[:, ::-1] for each in path(times)[:3]], axis=1)
    rows[-1, 1:] = 0.0
    assert controller.send(JOINTS[::-1], times, rows) == ""
    for _ in followed(controller, path, min(samples, 700)):
        pass
    codes, torques, _ = controller.result
    assert not codes.any()
    assert_equal(torques)


@needs_cxx
def test_between_points_it_follows_the_polynomial_of_fifth_degree_and_then_holds(controller):
    knots = np.array([0.0, 0.21, 0.35])
    values = np.zeros((3, 3, 2))
    values[:, 0] = [[0.2, -0.3], [0.23, -0.34], [0.25, -0.35]]
    values[1, 1:] = [[0.15, -0.1], [0.4, -0.2]]
    exact = [BPoly.from_derivatives(knots, values[:, :, j]) for j in range(2)]

    def path(t):
        at = np.minimum(t, knots[-1])
        return tuple(
            np.stack([each(at, nu=order) * (order == 0 or t[0] < knots[-1]) for each in exact], 1)
            for order in range(3)
        )

    class Begun(tuple):
        q = property(lambda self: self[0])

    controller.begin(angle(RIG.counts(values[0, 0])))
    controller.send(JOINTS, knots, values)
    for _ in followed(controller, lambda t: Begun(path(t)), 600):
        pass
    codes, torques, running = controller.result
    assert not codes.any()
    assert_equal(torques, 1e-9)  # roundings of another polynomial
    np.testing.assert_allclose(running.reference, values[-1, 0], atol=1e-12)


@needs_cxx
def test_a_trajectory_that_begins_later_is_joined_from_the_motion_before_it(controller):
    """At rest the arm waits for its start; in motion it goes to its first point at once, to be
    there in time.
    """
    goal, other, still = np.array((0.25, -0.35)), np.array((0.22, -0.36)), np.zeros((2, 2))
    start = np.asarray(RIG.cell_centre(RIG.counts((0.2, -0.3)))).ravel()  # where it stands
    wait, sent, first, later = 40, 190, 0.3, 0.1 + 0.2

    def moved(begun, ended, span, at):
        curves = [
            BPoly.from_derivatives([0.0, span], np.stack([begun, ended])[:, :, j]) for j in range(2)
        ]
        return np.array([[each(min(at, span), nu=order) for each in curves] for order in range(3)])

    def path(t):
        k, rest = round(t[0] / DT), np.vstack([start[None], still])
        if k < wait:
            return tuple(rest[:, None])
        if k < sent:
            return tuple(
                moved(rest, np.vstack([goal[None], still]), first, (k - wait) * DT)[:, None]
            )
        begun = moved(rest, np.vstack([goal[None], still]), first, (sent - 1 - wait) * DT)
        return tuple(moved(begun, np.vstack([other[None], still]), later, (k - sent) * DT)[:, None])

    class Begun(tuple):
        q = property(lambda self: self[0])

    def send(k, at):
        if k in (0, sent):
            ended, ahead = ((goal, wait * DT), (other, 0.1))[k == sent]
            rows, times = np.vstack([ended[None], still])[None], ((first,), (0.2,))[k == sent]
            stamp = controller.now + 700_000 + round(1e9 * ahead)
            assert controller.send(JOINTS, times, rows, stamp=stamp) == ""
        return at

    controller.begin(angle(RIG.counts(start)))
    for _ in followed(controller, lambda t: Begun(path(t)), sent + 600, spoil=send):
        pass
    codes, torques, running = controller.result
    assert not codes.any()
    assert_equal(torques, 1e-9)
    np.testing.assert_allclose(running.reference, other, atol=1e-12)


@needs_cxx
@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("first", [0.0, 0.3])
def test_a_trajectory_that_began_before_it_came_is_joined_where_the_reference_is(
    controller, moving, first
):
    """It should be 50 ms on its way: the torque does not leap, and the arm is there in time."""
    begin = angle(RIG.counts((0.2, -0.3)))
    start = np.asarray(RIG.cell_centre(RIG.counts((0.2, -0.3)))).ravel()
    rows = np.zeros((2, 3, 2))
    rows[:, 0] = start, start + 0.05
    times = np.array([first, 0.5])
    controller.begin(begin)
    robot, torques = SteppedArm(ARM, RIG, (0.2, -0.3)), []
    for k in range(1000):
        if k == 0 and moving:
            controller.send(JOINTS, (0.4,), rows[1:] - [[[0.02], [0], [0]]])
        if k == 200:
            stamp = controller.now + 700_000 - 50_000_000
            # With a first point in the past it is on the way between two points, else before one.
            assert controller.send(JOINTS, times, rows, stamp=stamp) == ""
        torques.append(controller.update(angle(robot.pulses))[1])
        robot.step(torques[-1])
    leaps = np.abs(np.diff(torques, axis=0)).max(axis=1)
    assert leaps[199:205].max() < 100
    assert controller.c.state_value(0) == 0
    np.testing.assert_allclose(robot.pulses, RIG.counts(start + 0.05), atol=4)


@needs_cxx
def test_counts_that_are_missing_are_bridged_and_then_stop_the_arm_as_in_python(controller):
    path = next(each for name, each in motions().items() if "there and back" in name)
    controller.begin(angle(RIG.counts(path([0.0]).q[0])), chained=True)

    def spoil(k, at):
        return np.where([100 <= k < 103 or k > 200, False], np.nan, at)

    codes, torques, running = in_chain(controller, path, 400, spoil=spoil)
    assert not codes.any()
    assert_equal(torques)
    assert running.stopped
    assert controller.c.state_value(0) == memory.NO_COUNTS == controller.c.state_value(1)
    assert controller.c.state_value(2) == running.status.brake


@needs_cxx
def test_without_a_reference_it_holds_and_its_lifecycle_can_be_run_through_again(controller):
    counts = np.array([2000.0, -1500.0])
    for unit, at in (("counts", counts), ("rad", angle(counts))):
        assert controller.begin(at, unit=unit, chained=unit == "rad") == [0, INACTIVE, ACTIVE]
        running = LAW.start(RIG, counts)
        held = np.asarray(RIG.cell_centre(counts)).ravel()
        for _ in range(50):
            code, torque = controller.update(at)
            np.testing.assert_allclose(
                torque, running.step(counts, held, (0, 0), (0, 0)), rtol=0, atol=1e-12
            )
            assert code == 0
        assert controller.c.deactivate() == INACTIVE
        assert controller.c.cleanup() == UNCONFIGURED
        assert controller.c.configure() == INACTIVE
        assert controller.c.shut_down() == FINALIZED


@needs_cxx
def test_deactivated_it_commands_nothing_and_a_value_that_cannot_be_written_is_an_error_in_the_end(
    controller,
):
    counts = np.array([2000.0, -1500.0])
    controller.begin(counts, unit="counts")
    controller.update(counts)
    controller.c.hold(1)
    codes = [controller.update(counts)[0] for _ in range(5)]
    controller.c.hold(0)
    assert codes == [0, 0, 0, 1, 1]
    code, torque = controller.update(counts)
    assert code == 0
    assert np.abs(torque).max() > 1
    controller.c.deactivate()
    zero = np.full(2, 7.0)
    assert controller.c.activate(array(counts)) == ACTIVE
    assert (controller.update(counts)[1] != zero).all()


@needs_cxx
@pytest.mark.parametrize(
    ("parameters", "why"),
    [
        ({"joints": ("a",)}, "joints must have 2 names; got 1"),
        ({"joints": ("a", "a")}, "joints must be different names; got 'a'"),
        ({"unit": "degrees"}, "unit must be rad or counts; got 'degrees'"),
        ({"topic": ""}, "must not be empty"),
        ({"rate": 1000}, "update_rate must be 1428.57"),
    ],
)
def test_parameters_that_cannot_be_are_refused_in_configure(controller, parameters, why):
    assert controller.begin((0.0, 0.0), **parameters) == [0, UNCONFIGURED]
    assert why in controller.said


@needs_cxx
def test_a_parameter_of_another_type_and_counts_that_are_none_are_refused(controller):
    assert controller.begin((0.0, 0.0), unit=("rad", "rad")) == [1]
    assert "another type" in controller.said
    assert controller.begin((0.5, 0.0), unit="counts") == [0, INACTIVE, INACTIVE]
    assert "joint2 must have whole counts to begin with; got 0.5" in controller.said
    assert controller.begin((np.nan, 0.0)) == [0, INACTIVE, INACTIVE]


GOOD = np.zeros((2, 3, 2))


@needs_cxx
@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"joints": ("joint2", "joint4")}, "joint_names must be those of the controller"),
        ({"times": (1.0, 1.0)}, "point 1 must come after the one before it"),
        ({"accelerations": False}, "point 0 must have a position, a velocity and an acceleration"),
        ({"rows": GOOD + np.array([[0, 0], [1, 0], [0, 0]])}, "it must end at rest"),
        ({"rows": GOOD + np.nan}, "point 0 must be finite"),
        ({"times": (), "rows": GOOD[:0]}, "it has no points"),
        ({"stamp": 10**18 - 2 * 10**9}, "it ended before it came"),
    ],
)
def test_a_trajectory_that_cannot_be_is_refused_and_changes_nothing(controller, change, why):
    counts = np.array([2000.0, -1500.0])
    controller.begin(counts, unit="counts")
    good = {"joints": JOINTS, "times": (0.5, 1.0), "rows": GOOD} | change
    running, held = LAW.start(RIG, counts), np.asarray(RIG.cell_centre(counts)).ravel()
    for k in range(6):
        assert k != 1 or why in controller.send(**good)
        torque = controller.update(counts)[1]
        np.testing.assert_allclose(
            torque, running.step(counts, held, (0, 0), (0, 0)), rtol=0, atol=1e-12
        )
    controller.c.deactivate()
    assert "not active" in controller.send(JOINTS, (0.5, 1.0), GOOD)


# -- goals and frames ------------------------------------------------------------------------------
SERVOS = servos.rig()
FRAMES = servos.rig(0.002, None)
FRAMES = dataclasses.replace(FRAMES, inner=MitDrive.for_arm(servos.arm(), FRAMES, stiffness=40))


@needs_cxx
@pytest.mark.parametrize(
    ("loop", "rows", "unit"),
    [
        (SERVOS, 1, "rad"),
        pytest.param(SERVOS, 1, "counts", marks=pytest.mark.slow),
        pytest.param(FRAMES, 5, "counts", marks=pytest.mark.slow),
    ],
)
def test_goals_and_frames_are_those_of_the_running_controller(tmp_path, loop, rows, unit):
    """Along a path; then the positions stand still, the guards stop the law, and the servo holds."""
    law = ComputedTorque(servos.arm(), loop)
    # Classes of one name would be one class in this process.
    name = f"{loop.inner.sends}_in_{unit}"
    to_ros2_control(law, tmp_path, name=name)
    plugin = Controller(tmp_path, name)
    path = Harmonics(period=2.0, offset=(0.6, 0.4), cosine=((0,), (0,)), sine=((0.4,), (-0.4,)))
    motion = path(loop.period * np.arange(200))
    per_unit = 1.0 if unit == "counts" else float(loop.to_angle(np.ones(2))[0])
    counts = loop.counts(motion.q)
    counts[120:] = counts[120]
    begun = plugin.begin(per_unit * counts[0], round(1 / loop.period), chained=True, unit=unit)
    assert begun == [0, INACTIVE, ACTIVE], plugin.said
    running = law.start(loop, counts[0])
    before = plugin.c.allocations()
    for k, state in enumerate(zip(*motion, strict=True)):
        running.step(counts[k], *state, now=(k + 1) * loop.period)
        assert plugin.c.give_reference(array(np.concatenate(state))) == 0
        at = per_unit * counts[k]
        code, sent = plugin.update(at, round(1e9 * loop.period), rows)
        assert code == 0
        ours = running.goal * per_unit if rows == 1 else running.frame.ravel()
        np.testing.assert_allclose(sent, ours, rtol=1e-12, atol=1e-12)
    assert running.stopped
    assert plugin.c.state_value(0) > 0
    assert plugin.c.allocations() == before
    # A servo keeps its last goal; a drive gets the frame of no torque.
    plugin.c.deactivate()


def test_the_interfaces_of_goals_and_frames_are_named(tmp_path):
    for name, loop, interfaces in (
        ("goals", SERVOS, "command_interface: position"),
        ("frames", FRAMES, "command_interfaces: [position, velocity, stiffness, damping, effort]"),
    ):
        to_ros2_control(ComputedTorque(servos.arm(), loop), tmp_path / name, name=name)
        assert interfaces in (tmp_path / name / f"{name}.yaml").read_text()
        readme = (tmp_path / name / "README.md").read_text()
        assert readme.count("| command, written | `<joint>/") == (1 if name == "goals" else 5)


def test_the_package_is_what_ros_reads(tmp_path):
    to_ros2_control(LAW, tmp_path / "new", name="arm", joints=("shoulder", "elbow"))
    package = ElementTree.parse(tmp_path / "new" / "package.xml").getroot()  # noqa: S314
    assert package.findtext("name") == "arm"
    plugin = ElementTree.parse(tmp_path / "new" / "arm_plugin.xml").getroot()  # noqa: S314
    assert plugin.get("path") == "arm"
    assert plugin[0].attrib == {
        "name": "arm/Controller", "type": "arm_plugin::Controller",
        "base_class_type": "controller_interface::ChainableControllerInterface",
    }  # fmt: skip
    compile((tmp_path / "new" / "arm.launch.py").read_text(), "arm.launch.py", "exec")
    assert '"shoulder", "elbow"' in (tmp_path / "new" / "arm.yaml").read_text()
    assert (tmp_path / "new" / "arm.yaml").read_text().count("type: arm/Controller") == 2
    # over an export of its own
    to_ros2_control(LAW, tmp_path / "new", name="arm", without=("gravity",))
    header = " ".join((tmp_path / "new" / "arm.h").read_text().replace(" * ", "").split())
    assert "is without gravity: the firmware adds that" in header


def test_a_law_may_have_a_name_beyond_ascii(tmp_path):
    accented = type("Zähler", (ComputedTorque,), {})
    to_ros2_control(accented(ARM, LAW.rig), tmp_path / "new")
    package = ElementTree.parse(tmp_path / "new" / "package.xml").getroot()  # noqa: S314
    assert "Zähler for" in package.findtext("description")


@pytest.mark.parametrize(
    ("arguments", "options", "why"),
    [
        ((P(gain=(1, 1)),), {}, "rig must be given, since P holds none"),
        ((P(gain=(1, 1)), RIG), {}, "law must have a period, to run in update; P has none"),
        ((LoggedTorque(), RIG), {}, "repeats a log"),
        ((7,), {}, "law must be"),
        ((LAW,), {"name": "Arm"}, "name must be a small letter"),
        ((LAW,), {"name": "a__b"}, "single underscores"),
        ((LAW,), {"joints": ("a b", "c")}, "joints must be letters"),
        ((LAW,), {"joints": ("a", "a")}, "2 different names"),
        ((LAW,), {"guards": None}, "guards must be"),
        ((LAW,), {"name": "board"}, "and not main or board"),
        ((LAW,), {"joints": "ab"}, "joints must be a sequence of names"),
        ((LAW,), {"without": "gravity"}, r"sequence of parts .* Write \('gravity',\)"),
        (
            (ComputedTorque(ARM, dataclasses.replace(RIG, period=0.003), bandwidth=30),),
            {},
            "Make the law for 1 / 333 or",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(tmp_path, arguments, options, why):
    law, *rig = arguments
    with pytest.raises(ValueError, match=why) as error:
        to_ros2_control(law, tmp_path / "new", *rig, **options)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "new").exists()


def test_its_c_is_that_of_the_running_controller_with_the_same_limits(tmp_path):
    options = {"torque_limit": (250, 120), "without": ("gravity",)}
    to_ros2_control(LAW, tmp_path / "ros", name="arm", **options)
    LAW.start(RIG, (0, 0), **options).to_c(tmp_path / "c", name="arm")
    assert (tmp_path / "ros" / "arm.c").read_text() == (tmp_path / "c" / "arm.c").read_text()
    with pytest.raises(ValueError, match="torque_limit must be positive"):
        to_ros2_control(LAW, tmp_path / "more", torque_limit=(0, 1))


def test_a_folder_with_something_else_in_it_is_left_as_it_is(tmp_path):
    (tmp_path / "README.md").write_text("mine\n")
    with pytest.raises(
        ValueError, match=r"README.md must not exist, or be an export of arm_controller"
    ):
        to_ros2_control(LAW, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["README.md"]
