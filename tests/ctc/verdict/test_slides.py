"""An arm with a slide: its torques are N, in every table, and no N is compared with N m."""

import numpy as np
import pytest

from ctc import ComputedTorque, compare, evaluate
from ctc.commandline import records_of
from plant import (
    Body,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    Link,
    Rig,
    Robot,
    read_robot,
    simulate,
    write_robot,
)
from plant.parts import heading, largest, largest_cell, with_units

UNITS = ["N m", "N"]


@pytest.fixture(scope="module")
def machine():
    """A joint that turns and one that slides on a ball screw of 20 mm."""
    drive = Drive(
        gear=(80.0, 2 * np.pi / 0.02),
        motor_inertia=(6e-5, 2e-5),
        viscous=(1e-4, 1e-4),
        coulomb=(0.01, 0.01),
        motor_gain=(0.1, 0.1),
        current_limit=(20, 20),
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=(16384, 16384)), period=1e-3)
    links = Link(name="base"), Link(name="slide", a=0.3, prismatic=True)
    bodies = [
        Body(mass=m, com=(0.1, 0, 0), inertia=(0.02, 0, 0, 0.02, 0, 0.02), rotor=rotor)
        for m, rotor in zip((5, 2), drive.reflected_inertia(), strict=True)
    ]
    dynamics = Dynamics.from_chain(Chain(links=links, bodies=bodies))
    path = Harmonics(period=1.0, offset=(0.2, 0.0), cosine=[[0.1], [0.02]], sine=[[0.1], [0.02]])
    arm = dynamics.arm(dynamics.f())
    return arm, rig, ComputedTorque(arm, rig), path


def test_the_units_of_a_slide_are_those_of_a_force(machine):
    """Position, rate, torque, stiffness, damping and inertia of both kinds of joints."""
    turns, slides = machine[0].dynamics.chain.joint_units
    assert (*turns, turns.speed) == ("rad", "N m", "N m/rad", "N m s/rad", "kg m^2", "rad/s")
    assert (*slides, slides.speed) == ("m", "N", "N/m", "N s/m", "kg", "m/s")


def test_every_torque_of_an_evaluation_has_the_unit_of_its_joint(machine):
    """In the table of one run, in that of several, and on the axes."""
    run = evaluate(*machine, duration=0.3)
    texts = [str(run), str(compare(*machine[:2], {"it": machine[2]}, machine[3], duration=0.3))]
    for text in texts:
        assert "[N m]" not in text
        assert " N m " in text
    assert [axis.get_ylabel() for axis in run.plot()[:, 1]] == ["torque [N m]", "torque [N]"]


def test_newtons_are_not_compared_with_newton_metres():
    """The largest of each unit is named, and the unit stands beside it."""
    assert largest([1.0, 5.0, 3.0], ["N m", "N", "N m"]) == [2, 1]
    assert largest_cell([1.0, 5.0], UNITS) == "1.0 N m, 5.0 N"
    assert largest_cell([1.0, 5.0], ["N m", "N m"]) == "5.0"
    assert heading("chatter", UNITS) == "chatter"
    assert heading("chatter", ["N m", "N m"]) == "chatter [N m]"
    assert with_units(["1", "2"], UNITS) == ["1 N m", "2 N"]


def test_the_command_line_names_the_joints_of_a_rig_after_the_links(machine, tmp_path):
    """Checks of a log know the rig alone."""
    arm, rig, law, path = machine
    assert rig.joint_labels[1] == "joint q[1]"
    write_robot(Robot(rig=rig, arm=arm), tmp_path / "a.toml")
    simulate(arm, rig, law, path, duration=0.1).to_csv(tmp_path / "log.csv")
    (record,) = records_of([str(tmp_path / "log.csv")], read_robot(tmp_path / "a.toml"))
    assert record.rig.joint_labels == arm.dynamics.chain.joint_labels
