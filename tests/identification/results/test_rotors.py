"""Inertias below those of the stated rotors: what a motor inertia that is stated too large looks
like.
"""

import dataclasses

import numpy as np
import pytest

from identification import identify
from plant import (
    Body,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    Link,
    P,
    Rig,
    puma560,
    read_robot,
    simulate,
)

RIG = puma560.rig()


def rotors(times):
    """The paper's rig with motor inertias that are so many times as large as stated."""
    return dataclasses.replace(
        RIG, drive=dataclasses.replace(RIG.drive, motor_inertia=RIG.drive.motor_inertia * times)
    )


@pytest.fixture(scope="module")
def found():
    record = simulate(puma560.arm(), RIG, puma560.p_law(), puma560.reference(), duration=2.0)
    return identify(puma560.dynamics(), record, progress=False)


def test_rotors_as_they_are_say_nothing(found):
    assert not [line for line in found.warnings if "rotor" in line]
    robot = read_robot("ur5e")
    inertia = np.diag(robot.dynamics.D(np.zeros(6), robot.dynamics.f()).full())
    assert (inertia > robot.rig.drive.reflected_inertia()).all()


@pytest.mark.parametrize("joint", [0, 1])
def test_a_rotor_that_is_heavier_than_its_joint_is_named(found, joint):
    """D at the first pose by the arm itself; between 5 % more and twice as much, only beyond it
    is said.
    """
    q = puma560.reference()([0.0]).q[0]
    inertia = np.diag(found.arm.D(q)) / RIG.drive.reflected_inertia()
    for share, said in ((0.9, False), (1.3, True)):
        times = np.ones(2)
        times[joint] = share * inertia[joint]
        lines = [
            line
            for line in dataclasses.replace(found, rig=rotors(times)).warnings
            if "rotor" in line
        ]
        assert len(lines) == said
        if said:
            label = found.arm.dynamics.chain.joint_labels[joint]
            rotor = RIG.drive.reflected_inertia()[joint] * times[joint]
            assert lines[0].startswith(
                f"the inertia of {label}, {np.diag(found.arm.D(q))[joint]:.3g} kg m^2, is below"
            )
            assert lines[0].endswith(f"Jm k^2 = {rotor:.3g} kg m^2: check motor_inertia and gear.")


def test_what_is_hardly_known_says_nothing(found):
    vague = dataclasses.replace(found.fit, covariance=found.fit.covariance * 1e6)
    doubtful = dataclasses.replace(found, rig=rotors(3.0), fit=vague)
    assert not [line for line in doubtful.warnings if "rotor" in line]


@pytest.mark.slow
def test_a_rotor_that_the_log_shows_alone_is_the_stated_one():
    """Where axes are parallel the inertia of the second rotor is a parameter of its own."""
    drive = Drive(
        gear=(100, -80),
        motor_inertia=(1.2e-4, 8e-5),
        viscous=(6e-4, 5e-4),
        coulomb=(0.09, 0.06),
        motor_gain=(0.15, 0.12),
        current_limit=(15, 12),
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=(4000, 4000)), period=1e-3)
    bodies = [
        Body(
            mass=mass,
            com=(length / 2, 0.01, 0),
            inertia=(0, 0, 0, inertia, 0, inertia),
            rotor=rotor,
        )
        for mass, length, inertia, rotor in zip(
            (7, 4), (0.4, 0.35), (0.1, 0.04), drive.reflected_inertia(), strict=True
        )
    ]
    links = (Link(name="shoulder", alpha=np.pi / 2), Link(name="elbow", a=0.4))
    dynamics = Dynamics.from_chain(Chain(links=links, bodies=bodies))
    path = Harmonics(
        period=4,
        offset=(0.5, -0.6),
        cosine=((-0.5, -0.1), (0.4, -0.5)),
        sine=((0.3, 0.2), (-0.4, 0.3)),
    )
    record = simulate(
        dynamics.arm(dynamics.f()), rig, P(gain=(0.03, 0.02)), path, steps_per_sample=16
    )
    found = identify(dynamics, record, progress=False)
    assert not [line for line in found.warnings if "rotor" in line]
    for share, said in ((0.5, True), (0.85, False), (1.15, False), (1.4, True)):
        own = dataclasses.replace(drive, motor_inertia=drive.motor_inertia * (1, share))
        lines = dataclasses.replace(found, rig=dataclasses.replace(rig, drive=own)).warnings
        lines = [line for line in lines if "rotor" in line]
        assert len(lines) == said
        if said:
            jm = own.reflected_inertia()[1]
            assert lines[0].startswith(
                f"the rotor of joint elbow (q[1]) is not as stated: J_elbow is {found.f[-1]:.3g} kg"
            )
            assert f"Jm k^2 = {jm:.3g} kg m^2" in lines[0]
