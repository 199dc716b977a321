"""A loop that oscillates is named with its frequency; one that rings and settles is not."""

import dataclasses
import re

import numpy as np
import pytest
from mujoco_odd import run
from packaged_arms import elbow_of_a_ur5e

from ctc import ComputedTorque, FeedForward
from plant import (
    PD,
    Dynamics,
    Elasticity,
    Harmonics,
    P,
    TorqueRipple,
    linearise,
    modes,
    puma560,
    simulate,
)
from plant.analysis import SampledLoops
from plant.checkup import Signals, own_oscillations, share_of_rotors

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
START = PATH([0.0]).q[0]


def rig(hz=None, **changes):
    gears = (
        None if hz is None else Elasticity.from_resonance(ARM, hz, 0.02, drive=RIG.drive, q=START)
    )
    return dataclasses.replace(
        RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears, **changes)
    )


def found(record):
    return [finding for finding in record.check().findings if finding.check == "oscillation"]


pytestmark = pytest.mark.filterwarnings("ignore:with a current_lag:UserWarning")


@pytest.mark.parametrize("lag", [7e-5, 1e-4])
def test_a_loop_that_its_lag_makes_unstable_swings_near_a_mode(lag):
    """Its frequency falls with the amplitude, by friction: within a third of a mode of the
    linearised loop.
    """
    late = rig(current_lag=lag)
    own = modes(linearise(ARM, late, puma560.p_law(), START))
    assert (own[:, 1] < 0).all()
    for finding in found(simulate(ARM, late, puma560.p_law(), PATH, steps_per_sample=16)):
        assert finding.verdict == "look"
        assert finding.unit == "Hz"
        assert np.abs(finding.value / own[:, 0] - 1).min() < 0.33
        assert "The loop oscillates" in finding.advice


def test_what_grows_is_told_from_what_goes_on():
    """Of 0.1 ms the swing takes a second to grow to its size; of 0.3 ms it is there from the
    start.
    """
    for lag, does in ((1e-4, "grows"), (3e-4, "goes on")):
        record = simulate(ARM, rig(current_lag=lag), puma560.p_law(), PATH, steps_per_sample=16)
        assert all(f"of tracking, and {does}: " in finding.advice for finding in found(record))


def test_every_joint_that_oscillates_is_told_and_more_where_less_is_asked():
    """A run of a model is compared at the joints that a log names, whichever is first in its own
    list.
    """
    record = simulate(ARM, rig(current_lag=1e-4), puma560.p_law(), PATH, steps_per_sample=16)
    of_joints = [finding.value for finding in found(record) if not finding.ok]
    assert own_oscillations(record) == of_joints
    assert len(of_joints) == 2
    still = dataclasses.replace(
        record, error_pulses=record.error_pulses * (0.02, 1.0), torque=None, current=None
    )
    assert own_oscillations(still) == of_joints[1:]
    assert len(own_oscillations(still, 1e-3)) == 2


def test_a_loop_that_its_gears_make_unstable_swings_at_its_pole():
    gears, law = rig(40), ComputedTorque(ARM, RIG, bandwidth=90)
    hz = abs(SampledLoops(ARM, gears, law, START).unstable_pole().imag) / (2 * np.pi)
    for finding in found(simulate(ARM, gears, law, PATH, steps_per_sample=16)):
        assert finding.verdict == "look"
        assert finding.value == pytest.approx(hz, rel=0.1)
        # The rig states them.
        assert "backlash (or driven" in finding.advice


@pytest.mark.parametrize(
    ("bandwidth", "machine", "soft"),
    [
        (90.0, {"hertz": 40.0}, True),
        (160.0, {"play": 0.006, "hertz": 300.0}, True),
        (100.0, {"delay": 6.0}, False),
    ],
    ids=["elastic", "backlash", "late loop"],
)
def test_motors_with_less_than_the_inertia_of_their_rotors_have_soft_gears(
    bandwidth, machine, soft
):
    """In MuJoCo; the counts alone are logged, and the torque is that of the law."""
    law = ComputedTorque(ARM, RIG, bandwidth=bandwidth)
    record = dataclasses.replace(run(ARM, RIG, law, PATH, **machine), torque=None, current=None)
    swings = [finding for finding in found(record) if not finding.ok]
    assert swings
    for finding in swings:
        assert (share_of_rotors(Signals(record), finding.value) < 0.9) == soft
        assert ("the joints are elastic, or one has backlash" in finding.advice) == soft


def log(seed):
    """Of a stable P loop with other friction, gains and motion."""
    random, order = np.random.default_rng(seed), np.arange(1, 4)
    cosine, sine = (0.3 * random.normal(size=(2, 3)) / order**1.5 for _ in range(2))
    path = Harmonics(period=4.0, offset=random.uniform(-1, 1, 2), cosine=cosine, sine=sine)
    viscous, coulomb = (
        random.uniform(0.3, 1.5) * RIG.drive.viscous,
        random.uniform(0.1, 1.5) * RIG.drive.coulomb,
    )
    return simulate(
        ARM,
        rig(viscous=viscous, coulomb=coulomb),
        P(gain=random.uniform(0.3, 2) * np.array((0.2, 0.15))),
        path,
    )


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))]
)
def test_no_loop_that_is_stable_is_accused(seed):
    record = log(seed)
    noise = np.round(np.random.default_rng(seed).normal(scale=10, size=record.error_pulses.shape))
    noisy = dataclasses.replace(
        record, error_pulses=record.error_pulses + noise, torque=None, current=None
    )
    for each in (record, noisy):
        assert [finding.verdict for finding in found(each)] == ["fine", "fine"]


PD_LAW = PD(gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=3000.0, period=RIG.period)
RIPPLE = TorqueRipple(amplitude=(0.05, 0.05), cycles=(6.0, 6.0), phase=(0.0, 0.0))


@pytest.mark.parametrize(("gears", "law"), [
    (rig(), ComputedTorque(ARM, RIG)),
    (rig(), FeedForward(ARM, RIG, feedback=PD_LAW)),
    (rig(25), puma560.p_law()),
    (rig(100), puma560.p_law()),
    pytest.param(rig(60), ComputedTorque(ARM, RIG, bandwidth=60), marks=pytest.mark.slow),
    (rig(ripple=RIPPLE), PD_LAW),
], ids=["computed torque", "feed-forward", "soft gears", "gears", "computed torque on gears", "ripple"])  # fmt: skip
def test_other_stable_loops_are_not_accused_either(gears, law):
    record = simulate(ARM, gears, law, PATH, steps_per_sample=16)
    assert [finding.verdict for finding in found(record)] == ["fine", "fine"]


def test_what_cannot_be_told():
    record = log(0)
    (finding,) = found(
        dataclasses.replace(record, reference_pulses=None, error_pulses=-record.counts, law=None)
    )
    assert finding.verdict == "cannot tell: no reference"


def ur5e(about, period):
    """Shoulder lift and elbow of a UR5e, their rig and P controller, and a path about an angle
    of the first.
    """
    chain, rig = elbow_of_a_ur5e()
    dynamics = Dynamics.from_chain(chain.with_rotors(rig.drive))
    one, other = (0.2, 0.1, -0.05), (-0.15, 0.1, 0.1)
    path = Harmonics(period=period, offset=(about, 0.0), cosine=(one, other), sine=(other, one))
    return dynamics.arm(dynamics.f()), rig, P(gain=(0.042, 0.0153)), path


@pytest.mark.slow
def test_backlash_is_told_from_where_the_loop_swings():
    """In MuJoCo about hanging, where the loads change sign."""
    for finding in found(run(*ur5e(np.pi / 2, 2.7), play=0.003, hertz=300.0)):
        assert finding.verdict == "look"
        assert re.search(
            r"just after the load changes sign it is [2-9][\d.]* times .* a gear has bac",
            finding.advice,
        )


def test_backlash_that_the_torque_shows_comes_before_the_swings_that_it_causes():
    """In MuJoCo about hanging, in a loop that swings between its reversals, too."""
    record = run(*ur5e(np.pi / 2, 2.7), play=0.005, hertz=300.0)
    names = [finding.check for finding in record.check().problems]
    assert names.index("backlash") < names.index("oscillation")


def test_what_the_start_sets_swinging_and_decays_is_no_oscillation():
    record = simulate(*ur5e(0.0, 6.0), duration=3.0, steps_per_sample=16)
    swing = record.error_pulses[:, 0] - np.convolve(
        record.error_pulses[:, 0], np.ones(101) / 101, mode="same"
    )
    assert swing[100:600].std() > 3 * swing[-600:-100].std()
    assert all(finding.ok for finding in found(record))
