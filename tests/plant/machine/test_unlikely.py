"""Statements of a rig that no arm has are said where they are used, and right ones are not."""

import dataclasses
import warnings

import numpy as np
import pytest

from plant import Harmonics, puma560, simulate
from plant.machine import unlikely_statements

ARM, RIG, LAW, PATH = puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference()


def moved(factor=1.0):
    numbers = {
        name: factor * np.array(getattr(PATH, name)) for name in ("offset", "cosine", "sine")
    }
    return Harmonics(period=PATH.period, **numbers)


def of_drive(**changes):
    return dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, **changes))


@pytest.mark.parametrize(
    ("rig", "path", "said"),
    [
        (dataclasses.replace(RIG, period=1.0), PATH, "a period of 1 s is no arm's"),
        (RIG, moved(180 / np.pi), r"moves over 14.3 turns"),
        (
            of_drive(viscous=RIG.drive.viscous * RIG.drive.gear**2),
            PATH,
            "viscous friction of joint .* is 1.38e.03 N m",
        ),
        (
            of_drive(coulomb=RIG.drive.coulomb * np.abs(RIG.drive.gear)),
            PATH,
            "Coulomb friction of joint .* is 13.4 N m",
        ),
        (
            of_drive(motor_inertia=(2.0, 2e-4)),
            PATH,
            r"rotor alone 1.4 rad/s\^2 at most: motor_inertia is in kg m\^2",
        ),
        (of_drive(gear=1 / RIG.drive.gear), PATH, r"gear of joint .* is 0.00928.* Is it 107.8\?"),
    ],
)
def test_what_no_arm_has_is_said_before_it_is_simulated(rig, path, said):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(UserWarning, match=said):
            simulate(ARM, rig, LAW, path)


def test_right_statements_are_quiet():
    """A quarter of a turn at 146 rad/s of the motor; a drive along a screw may make many turns."""
    motion = PATH(np.linspace(0, PATH.period, 200))
    assert not list(unlikely_statements(RIG, motion.q, motion.qd, [False, False]))
    far = 40 * motion.q
    assert len(list(unlikely_statements(RIG, far, motion.qd, [False, True]))) == 1


def test_friction_is_compared_at_the_motor():
    """At the motor's speed it may take all that the amplifier gives, 12 A of 0.228 N m/A."""
    motion = PATH(np.linspace(0, PATH.period, 200))
    limit = np.array([12 * 0.228, 12 * 0.238]) / np.abs(RIG.drive.gear * motion.qd).max(axis=0)
    for factor, lines in ((0.999, 0), (1.001, 2)):
        rig = of_drive(viscous=factor * limit)
        assert len(list(unlikely_statements(rig, motion.q, motion.qd, [False, False]))) == lines
