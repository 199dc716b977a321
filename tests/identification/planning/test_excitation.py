"""Designed motions: within their limits, and worth more than trajectory (6)."""

import dataclasses

import numpy as np
import pytest

from ctc import ComputedTorque
from identification import design_motion, identify, pulse_budget
from plant import (
    Body,
    Chain,
    Coupling,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    JointSpring,
    Limits,
    Link,
    LoggedTorque,
    P,
    Rig,
    puma560,
    read_robot,
    simulate,
)  # fmt: skip

ARM, RIG, LAW = puma560.literature_arm(1.5), puma560.rig(), puma560.p_law()
LIMITS = {
    "position": [(-1.6, 0.1), (-0.1, 1.7)],
    "velocity": (3.0, 4.0),
    "acceleration": (12.0, 16.0),
}
WIDTH = np.diff(puma560.PRINTED_RANGES, axis=1).ravel()
ONE_JOINT = Rig(
    drive=Drive(
        gear=(9,),
        **dict.fromkeys(("motor_inertia", "viscous", "coulomb", "motor_gain"), 1e-3),
        current_limit=1.0,
    ),
    encoder=Encoder(resolution=400),
    period=1e-3,
)


@pytest.fixture(scope="module")
def motion():
    return design_motion(ARM, RIG, LAW, period=3.65, harmonics=4, starts=1, iterations=60, **LIMITS)


def test_designed_motion_stays_within_its_limits(motion):
    q, qd, qdd = motion(np.linspace(0, 3.65, 2000))
    low, high = np.array(LIMITS["position"]).T
    assert (q >= low).all()
    assert (q <= high).all()
    assert (np.abs(qd) <= LIMITS["velocity"]).all()
    assert (np.abs(qdd) <= LIMITS["acceleration"]).all()
    np.testing.assert_allclose(qd[0], 0.0, atol=1e-6)
    torque = np.array(
        [ARM.inverse(*state) for state in zip(q, qd, qdd, strict=True)]
    ) + RIG.drive.friction(qd)
    assert (np.abs(torque) < RIG.drive.torque_limit()).all()


def test_a_motion_of_many_harmonics_stays_within_its_limits_between_samples_too():
    body = Body(mass=1e-3, com=(0.1, 0, 0), inertia=(1e-4, 1e-4, 1e-4, 0, 0, 0))
    strong = dataclasses.replace(ONE_JOINT.drive, current_limit=np.inf)
    path = design_motion(
        Chain(links=(Link(name="lever"),), bodies=(body,)),
        dataclasses.replace(ONE_JOINT, drive=strong),
        period=3.65,
        position=[(-1.0, 1.0)],
        velocity=(4.0,),
        acceleration=(30.0,),
        harmonics=16,
        starts=1,
        iterations=6,
    )
    assert np.abs(path(np.linspace(0, 3.65, 4000)).qdd).max() <= 30.0


def test_springs_that_carry_the_arm_leave_its_amplifiers_free():
    """Amplifiers too weak to hold the arm where it moves: without springs there is no motion."""
    pose = np.array([-0.75, 0.8])
    weight = ARM.h(pose, np.zeros(2))
    weak = dataclasses.replace(RIG, drive=RIG.drive.limited_to((0.6 * np.abs(weight[0]), 40.0)))
    carried = JointSpring(stiffness=(0.0, 0.0), angle=pose, preload=weight)
    limits = LIMITS | {"position": [(-0.9, -0.6), (0.65, 0.95)], "acceleration": (2.0, 2.0)}
    options = {"period": 3.65, "harmonics": 2, "starts": 1, "iterations": 20, **limits}
    with pytest.raises(ValueError, match="limits must allow a motion"):
        design_motion(ARM, weak, LAW, **options)
    path = design_motion(ARM, dataclasses.replace(weak, springs=carried), LAW, **options)
    q, qd, qdd = path(np.linspace(0, 3.65, 500))
    needed = np.array([ARM.inverse(*state) for state in zip(q, qd, qdd, strict=True)])
    # as the design takes it; dry friction is in what it keeps free
    needed += RIG.drive.joint_viscous() * qd
    assert (np.abs(needed - weight) < weak.drive.torque_limit()).all()


@pytest.mark.parametrize("law", [None, LAW])
def test_coupled_motors_use_the_limits_of_their_shafts(law):
    """Shaft 1 carries half the torque of joint 1; nothing but this torque is needed."""
    coupling = Coupling(matrix=((2, 0), (0, -1)))
    body = Body(mass=5.0, com=(0.2, 0, 0), inertia=(0.1, 0.1, 0.1, 0, 0, 0))
    chain = dataclasses.replace(ARM.dynamics.chain, coupling=coupling, bodies=(body, body))
    drive = dataclasses.replace(
        RIG.drive, coupling=coupling, current_limit=(0.4, 1.0), coulomb=0.0, viscous=0.0
    )
    rig = dataclasses.replace(RIG, drive=drive)
    limits = LIMITS | {"velocity": (6.0, 6.0), "acceleration": (30.0, 30.0)}
    path = design_motion(
        chain, rig, law, period=3.65, harmonics=2, starts=1, iterations=15, **limits
    )
    dynamics = Dynamics.from_chain(chain.with_rotors(drive))
    share = path.torque_share(dynamics.arm(dynamics.f()), rig)
    # All that the motion may take, less a margin that stays free.
    np.testing.assert_allclose(share, 0.8, atol=0.03)


def test_worst_known_parameter_becomes_known(motion):
    """By the bound of rounding, and by identification from one log: f3, which (6) hardly shows."""
    bounds = [
        pulse_budget(ARM, RIG, LAW, path).bound / WIDTH for path in (puma560.reference(), motion)
    ]
    assert bounds[1].max() < bounds[0].max()
    logs = [
        simulate(ARM, RIG, LAW, path, steps_per_sample=16) for path in (puma560.reference(), motion)
    ]
    found = [
        identify(puma560.dynamics(), log, method="prediction_error", progress=False) for log in logs
    ]
    worst = [(100 * np.abs(each.f - ARM.f) / WIDTH).max() for each in found]
    said = [(100 * np.sqrt(np.diag(each.fit.noise_covariance)) / WIDTH).max() for each in found]
    assert said[1] < said[0] / 2
    assert worst[1] < 3.0


def test_same_seed_same_motion(motion):
    again = design_motion(
        ARM, RIG, LAW, period=3.65, harmonics=4, starts=1, iterations=60, **LIMITS
    )
    np.testing.assert_allclose(again.cosine, motion.cosine, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"position": [(0, 1)]}, "position must have shape"),
        ({"position": [(1, 0), (0, 1)]}, "low < high"),
        ({"velocity": (0, 1)}, "speeds and accelerations positive"),
        ({"period": -1}, "period must be a positive number"),
        ({"law": ComputedTorque(ARM, RIG)}, "fast and without memory"),
        ({"law": LoggedTorque()}, "fast and without memory"),
        ({"law": P(gain=(0.2, 0.0))}, r"law must give .* that of joint q\[1\] gets none"),
        ({"law": "P"}, "law must be of type Law"),
        ({"rig": ONE_JOINT, "law": None}, "rig must have 2 joints like the arm; got 1"),
        ({"harmonics": 0}, "harmonics must be a whole number of at least 1; got 0"),
        ({"harmonics": 2.5}, "harmonics must be a whole number of at least 1; got 2.5"),
        ({"seed": -1}, "seed must be a whole number of at least 0; got -1"),
        ({"seed": 1.5}, "seed must be a whole number of at least 0; got 1.5"),
        ({"arm": puma560.dynamics()}, "arm must be of type Arm"),
        ({"starts": 0}, "starts must be a whole number of at least 1; got 0"),
        ({"velocty": (1, 1)}, "Did you mean 'velocity'"),
        ({"acceleration": (1e-6, 1e-6), "starts": 1, "iterations": 20}, "limits must allow"),
    ],
)
def test_bad_input_is_refused(change, says):
    given = {"arm": ARM, "rig": RIG, "law": LAW, "period": 3.65, **LIMITS}
    with pytest.raises(ValueError, match=says):
        design_motion(**(given | change))


def test_limits_without_room_are_refused():
    """The arm cannot be held there: gravity alone takes more than the amplifier's share."""
    drive = dataclasses.replace(RIG.drive, current_limit=(0.5, 0.5))
    level = LIMITS | {"position": [(-0.2, 0.1), (-0.1, 0.2)]}
    with pytest.raises(ValueError, match="limits must allow"):
        design_motion(
            ARM,
            dataclasses.replace(RIG, drive=drive),
            LAW,
            period=3.65,
            starts=1,
            iterations=20,
            **level,
        )


# -- from a model file alone ---------------------------------------------------------------------
@pytest.fixture(scope="module")
def first():
    """Three joints of the UR5e, with limits that bind; a rig; its first experiment."""
    model = read_robot("ur5e").model
    chain = Chain.from_urdf(model, tip="forearm")
    limits = Limits(
        lower=(-2.0, -2.5, -np.inf),
        upper=(1.0, 0.5, np.inf),
        velocity=(1.0, 2, 3),
        effort=(60, 120, 40),
    )
    chain = dataclasses.replace(chain, limits=limits)
    drive = Drive.from_urdf(
        model,
        tip="forearm",
        gear=101,
        motor_inertia=6e-5,
        motor_gain=0.1,
        viscous=1e-3,
        coulomb=0.06,
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=4096), period=2e-3)
    return model, chain, rig, design_motion(chain, rig, harmonics=3, starts=1, iterations=25)


def test_a_first_experiment_keeps_the_limits_and_efforts_of_the_model_file(first):
    """Torques by pinocchio of the same file."""
    pin = pytest.importorskip("pinocchio")
    file, chain, rig, motion = first
    model = pin.buildModelFromUrdf(str(file))
    data = model.createData()
    q, qd, qdd = motion(np.linspace(0, motion.period, 800))
    assert (q[:, :2] >= chain.limits.lower[:2]).all()
    assert (q[:, :2] <= chain.limits.upper[:2]).all()
    assert (np.abs(q[:, 2]) <= np.pi / 2).all()
    assert (np.abs(qd) <= chain.limits.velocity).all()
    tau = np.array(
        [
            pin.rnea(model, data, *(np.append(x, np.zeros(3)) for x in s))[:3]
            for s in zip(q, qd, qdd, strict=True)
        ]
    )
    tau += rig.drive.reflected_inertia() * qdd + rig.drive.friction(qd)
    assert (np.abs(tau) < chain.limits.effort).all()
    assert (np.abs(tau).max(axis=0) > 0.2 * chain.limits.effort).any()


def test_a_first_experiment_shows_more_than_random_ones(first):
    """The worst parameter's bound in torques of the regressor, against ten random motions in the
    same limits.
    """
    _, chain, rig, motion = first
    dynamics = Dynamics.from_chain(chain.with_rotors(rig.drive))
    unit = np.maximum(np.abs(dynamics.f()), 1e-2 * np.abs(dynamics.f()).max())

    def worst(path):
        rows = [
            dynamics.Y(*s).full() / chain.limits.effort[:, None]
            for s in zip(*path(np.linspace(0, 6, 200)), strict=True)
        ]
        rows = np.concatenate(rows) * unit
        return np.linalg.inv(rows.T @ rows).diagonal().max()

    random, offset = np.random.default_rng(0), motion.offset
    waves = 0.15 * random.normal(size=(10, 2, 3, 3))
    others = [Harmonics(period=6.0, offset=offset, cosine=wave[0], sine=wave[1]) for wave in waves]
    assert worst(motion) < 0.3 * min(worst(path) for path in others)


def test_what_a_model_file_must_have_for_a_first_experiment(first):
    _, chain, rig, _ = first
    for given, said in (
        ({"arm": dataclasses.replace(chain, bodies=())}, "bodies must be known"),
        (
            {"arm": Chain(links=chain.links[:2], bodies=chain.bodies[:2])},
            "rig must have 2 joints like the arm; got 3",
        ),
        ({"position": [(0, 1)]}, "position must have shape"),
        ({"period": 0}, "period must be a positive number"),
    ):
        with pytest.raises(ValueError, match=said) as error:
            design_motion(**{"arm": chain, "rig": rig} | given)
        assert "\n" not in str(error.value)
    sliding = Chain(
        links=(Link(name="rail", prismatic=True),), bodies=(Body(mass=1.0, com=(0, 0, 0)),)
    )
    with pytest.raises(
        ValueError, match=r"position must be given: joint rail .* slides without limits"
    ):
        design_motion(sliding, ONE_JOINT)
