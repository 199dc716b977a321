"""Arms without the rotors of their drive: said in `simulate` and `p_gains`, not where the rotors
are in f.
"""

import dataclasses
import warnings

import numpy as np
import pytest
from packaged_arms import planar

from plant import Dynamics, PointToPoint, p_gains, puma560, simulate

RIG = puma560.rig()
PATH = PointToPoint(start=(-1.0, 0.5), goal=(-0.9, 0.6), duration=0.3)
LAW = puma560.p_law()


def arm_of(chain):
    dynamics = Dynamics.from_chain(chain)
    return dynamics.arm(dynamics.f())


def test_bodies_without_rotors_are_said_and_with_rotors_are_not():
    bare, (first, second) = planar(2, rotor=0.0), RIG.drive.reflected_inertia()
    arm = arm_of(bare)
    with pytest.warns(
        UserWarning,
        match=r"no rotors, and the drive has 0\.577 kg m\^2 at joint 2 .*chain.with_rotors",
    ):
        simulate(arm, RIG, LAW, PATH, duration=0.01, backend="casadi")
    full = bare.with_rotors(RIG.drive)
    assert [body.rotor for body in full.bodies] == [first, second]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulate(arm_of(full), RIG, LAW, PATH, duration=0.01, backend="casadi")
        # f that is not the bodies': nothing is known of rotors
        identified = dataclasses.replace(arm, f=1.01 * arm.f)
        simulate(identified, RIG, LAW, PATH, duration=0.01, backend="casadi")
        light = dataclasses.replace(RIG.drive, motor_inertia=(1e-6, 1e-6))
        simulate(
            arm, dataclasses.replace(RIG, drive=light), LAW, PATH, duration=0.01, backend="casadi"
        )
    np.testing.assert_allclose(
        arm_of(full).D([0, 1]) - arm.D([0, 1]), np.diag([first, second]), rtol=0, atol=1e-12
    )


def test_p_gains_says_it_once():
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        with pytest.raises(ValueError, match=r"Allow a larger peak|gains must meet"):
            p_gains(arm_of(planar(2, rotor=0.0)), RIG, PATH, 2.0)
    assert sum("have no rotors" in str(each.message) for each in said) == 1


def test_a_chain_takes_rotors_only_of_its_own_drive():
    with pytest.raises(ValueError, match="drive must have 3 joints like the chain; got 2"):
        planar(3).with_rotors(RIG.drive)
    with pytest.raises(ValueError, match="bodies must be known"):
        dataclasses.replace(planar(2), bodies=()).with_rotors(RIG.drive)
