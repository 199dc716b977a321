"""Friction that depends on the load and on time: statics by hand, motions in closed form, rigid
and elastic gears.
"""

import dataclasses

import numpy as np
import pytest
from closed_loops import Constant, NoTorque, joint

from plant import Drive, Elasticity, Encoder, FrictionDrift, PointToPoint, Rig, puma560, simulate

GEAR, ROTOR, LINK, LEVEL = 50.0, 0.8, 1.2, 0.5
WEIGHT = 5.0 * 0.3 * 9.81


def rig(*, level=LEVEL, viscous=0.0, stiffness=None, **options):
    """One motor of inertia ROTOR and friction LEVEL on the joint, behind a gear."""
    if stiffness is not None:
        options["elasticity"] = Elasticity(stiffness=(stiffness,), damping=(60.0,))
    drive = Drive(
        gear=(-GEAR,),
        motor_inertia=(ROTOR / GEAR**2,),
        viscous=(viscous / GEAR**2,),
        coulomb=(level / GEAR,),
        motor_gain=(0.2,),
        current_limit=(np.inf,),
        **options,
    )
    return Rig(drive=drive, encoder=Encoder(resolution=(1000,)), period=0.7e-3)


def moved(rig, *, torque=0.0, speed=0.0, mass=0.0, duration=1.0):
    """Time, angle and speed of a joint under a constant torque; of a mass, its weight WEIGHT
    pulls it down.
    """
    arm = joint(mass, 0.3, ROTOR + LINK + mass * 0.09)
    still = PointToPoint(start=(0.0,), goal=(0.0,), duration=duration)
    law = Constant(torque=torque, period=rig.period) if torque else NoTorque()
    record = simulate(arm, rig, law, still, initial=[[0.0], [speed]])
    return record.t, record.true_q[:, 0], record.true_qd[:, 0]


# -- load ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("stiffness", [None, 1e6])
@pytest.mark.parametrize(("share", "holds"), [(0.04, False), (0.06, True)])
def test_a_loaded_gear_holds_a_weight_by_its_own_friction(share, holds, stiffness):
    """Nobody drives; at rest the gear transmits the weight, so friction holds up to level +
    share weight.
    """
    given = rig(level=0.95 * WEIGHT, stiffness=stiffness, load_friction=(share,))
    _, q, qd = moved(given, mass=5.0, duration=0.2)
    assert (abs(qd[-1]) < 1e-6) == holds
    if not holds:  # falling, a little below what level + share weight would leave
        assert q[-1] < -1e-4


@pytest.mark.parametrize("torque", [1.16, 1.14, 0.86, 0.84])
def test_it_takes_so_much_torque_to_lift_and_to_let_go(torque):
    """Level 0.05 and share 0.1 of the weight: moves above 1.15 weights, and below 0.85."""
    _, _, qd = moved(
        rig(level=0.05 * WEIGHT, load_friction=(0.1,)),
        mass=5.0,
        torque=torque * WEIGHT,
        duration=0.2,
    )
    moves = 1 if torque > 1.15 else -1 if torque < 0.85 else 0
    assert np.sign(np.round(qd[-1], 6)) == moves


@pytest.mark.parametrize("stiffness", [None, 1e6])
@pytest.mark.parametrize("torque", [2.0, -2.0])
def test_only_what_passes_the_gear_counts(torque, stiffness):
    """T - level - share LINK a = (ROTOR + LINK) a: the rotor's own inertia loads no gear."""
    t, _, qd = moved(rig(stiffness=stiffness, load_friction=(0.2,)), torque=torque, duration=0.5)
    expected = np.sign(torque) * (abs(torque) - LEVEL) / (ROTOR + LINK + 0.2 * LINK)
    late = t > 0.2
    assert np.polyfit(t[late], qd[late], 1)[0] == pytest.approx(expected, rel=2e-3)


def test_viscous_friction_and_offsets_load_no_gear():
    """A joint that turns steadily against its own viscous friction carries nothing: T = level +
    viscous speed.
    """
    _, _, qd = moved(rig(viscous=2.0, load_friction=(0.3,)), torque=1.5, duration=12.0)
    assert qd[-1] == pytest.approx((1.5 - LEVEL) / 2.0, rel=1e-4)


# -- drift ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("amount", [-0.4, 0.5])
def test_coulomb_friction_drifts_from_its_level_towards_another(amount):
    """J dv/dt = -level (1 + amount (1 - exp(-t / T)))."""
    time, speed = 0.7, 1.0
    given = rig(friction_drift=FrictionDrift(amount=(amount,), time=(time,)))
    t, _, qd = moved(given, speed=speed, duration=2.0)
    spent = t + amount * (t - time * (1 - np.exp(-t / time)))
    np.testing.assert_allclose(qd, speed - LEVEL / (ROTOR + LINK) * spent, rtol=0, atol=1e-4)


def test_viscous_friction_drifts_too():
    """The logarithm of the speed falls by the integral of the coefficient."""
    time, amount, viscous = 0.7, -0.4, 1.5
    given = rig(
        level=0.0, viscous=viscous, friction_drift=FrictionDrift(amount=(amount,), time=(time,))
    )
    t, _, qd = moved(given, speed=1.0, duration=2.0)
    spent = t + amount * (t - time * (1 - np.exp(-t / time)))
    np.testing.assert_allclose(np.log(qd), -viscous / (ROTOR + LINK) * spent, rtol=0, atol=2e-4)


def test_drift_is_exact_over_any_step():
    drift = FrictionDrift(amount=(0.3,), time=(2.0,))
    one, ten = drift.following(np.zeros(1), np.array(1.0)), np.zeros(1)
    for _ in range(10):
        ten = drift.following(ten, np.array(0.1))
    np.testing.assert_allclose(ten, one, rtol=1e-14)
    np.testing.assert_allclose(drift.factor(one), 1 + 0.3 * (1 - np.exp(-0.5)), rtol=1e-14)


# -- refusals ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: rig(load_friction=(1.0,)), "load_friction must be from 0 to below 1"),
        (lambda: rig(load_friction=(-0.1,)), "load_friction must be from 0 to below 1"),
        (lambda: rig(load_friction=(0.1, 0.1)), "load_friction.share must have 1 joints; got 2"),
        (lambda: rig(load_friction=0.1), "share of LoadFriction must have shape"),
        (lambda: FrictionDrift(amount=(-1.0,), time=(1.0,)), "amount must be above -1"),
        (lambda: FrictionDrift(amount=(0.1,), time=(0.0,)), "time must be positive"),
        (
            lambda: FrictionDrift(amount=(0.1,), time=(1.0, 1.0)),
            "time of FrictionDrift must have shape",
        ),
        (lambda: rig(friction_drift=0.1), "friction_drift of Drive must be of type FrictionDrift"),
        (
            lambda: dataclasses.replace(
                puma560.rig().drive, friction_drift=FrictionDrift(amount=(0.1,), time=(1.0,))
            ),
            "friction_drift.amount must have 2 joints; got 1",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(make, said):
    with pytest.raises(ValueError, match=said) as error:
        make()
    assert "\n" not in str(error.value)
