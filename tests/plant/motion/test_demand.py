"""What a motion demands: against inverse dynamics at each point, and an arm of one joint by
hand.
"""

import dataclasses

import numpy as np
import pytest
from demands import joint_torque, one_joint
from packaged_arms import planar

from plant import Coupling, Dynamics, Harmonics, PointToPoint, Reference, fastest, puma560

ARM, RIG = puma560.arm(), puma560.rig()
LIMIT = 12 * np.array([0.228 * 107.8, 0.238 * 53.7])


@pytest.mark.parametrize("period", [3.65, 2.0])
def test_share_of_the_limit_by_inverse_dynamics(period):
    """Largest of 800 points against largest of 5,215: near its peak torque bends by less than
    1e-5 of it.
    """
    path = puma560.reference(period)
    torque = joint_torque(ARM, RIG, path(np.linspace(0, period, 801)))
    np.testing.assert_allclose(
        path.torque_share(ARM, RIG), np.abs(torque).max(axis=0) / LIMIT, rtol=1e-3
    )


def test_share_of_coupled_motors_is_that_of_their_currents():
    belt = Coupling(matrix=((1, 0), (1, 1)))
    dynamics = Dynamics.from_chain(planar(2).coupled(belt))
    arm, rig = (
        dynamics.arm(dynamics.f()),
        dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, coupling=belt)),
    )
    path = PointToPoint(start=(0.0, 0.3), goal=(1.0, -0.5), duration=1.0)
    current = rig.drive.current(joint_torque(arm, rig, path(np.linspace(0, 1, 801))))
    np.testing.assert_allclose(
        path.torque_share(arm, rig), np.abs(current).max(axis=0) / 12, rtol=1e-3
    )


def test_shortest_duration_of_one_joint_by_hand():
    """A quintic's peak acceleration is 10 / sqrt(3) d / T^2; at 4,001 points it is met to 1e-7."""
    arm, inertia, rig = one_joint(limit=10.0)
    path = PointToPoint(start=(0.2,), goal=(1.7,), duration=1.0)
    expected = np.sqrt(10 / np.sqrt(3) * 1.5 * inertia / (0.9 * 10.0))
    assert fastest(arm, rig, path, uniform=True).duration == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_shortest_duration_takes_just_that_share(share):
    """Both look once per sample, at other points of the path: near its peak torque bends by 1e-6
    of it.
    """
    path = puma560.reference()
    shortest = fastest(ARM, RIG, path, share=share, uniform=True)
    assert shortest.torque_share(ARM, RIG).max() == pytest.approx(share, rel=1e-6)
    assert shortest.slowed(0.99).torque_share(ARM, RIG).max() > share


def weak(current):
    return dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, current_limit=current))


@dataclasses.dataclass(frozen=True)
class Gap(Reference):
    """The path of the paper with one number that is none, after 1 s."""

    of: int

    n = 2
    duration = 2.0

    def motion(self, t):
        motion = puma560.reference(self.duration)(t)
        motion[self.of][np.searchsorted(t, 1.0), 1] = np.nan
        return motion


@pytest.mark.parametrize("of", range(3), ids=["q", "qd", "qdd"])
@pytest.mark.parametrize(
    "call",
    [
        lambda path: path.torque_share(ARM, RIG),
        lambda path: fastest(ARM, RIG, path, uniform=True),
    ],
    ids=["torque_share", "fastest"],
)
def test_a_motion_that_is_not_finite_is_refused_with_its_place(call, of):
    with pytest.raises(ValueError, match=r"finite torques; joint .* at t = 1.000 s"):
        call(Gap(of))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: fastest(ARM, weak((3.0, 12.0)), puma560.reference(), uniform=True),
         r"can hold the arm and creep; joint 2 \(q\[0\]\) needs 120\.4 of 66\.36 N m at t = .* s, q = \["),
        (lambda: fastest(ARM, weak((np.inf, np.inf)), puma560.reference(), uniform=True),
         "must meet a limit somewhere"),
        (lambda: fastest(ARM, RIG, puma560.reference(), share=-1, uniform=True), "share must be a positive number"),
        (lambda: fastest(ARM, RIG, puma560.reference(), share=90), "share must be at most 1; got 90"),
        (lambda: fastest(ARM, RIG, puma560.reference(), motor_speed=(1, 1), uniform=True), "torque limits alone"),
        (lambda: puma560.reference().torque_share(RIG, ARM), "arm must be of type Arm"),
        (lambda: fastest(ARM, RIG, RIG), "reference must be of type Reference"),
        (lambda: Harmonics(period=1, offset=(0,), cosine=((1,),), sine=((0,),)).torque_share(ARM, RIG),
         "reference must have 2 joints like the rig; got 1"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_one_line(call, message):
    with pytest.raises(ValueError, match=message) as refusal:
        call()
    assert "\n" not in str(refusal.value)
