"""Guards of the torque in closed loop: which loops they stop and which not, how soon, and what the
arm does then.

`tests/benchmarks/guards.py` measures the margins over many more loops.
"""

from functools import cache

import numpy as np
import pytest
from faults import SimulatedArm
from guarded_loops import LAWS, LIMIT, RIG, closed, elastic, margin
from tuned_laws import MOTIONS

from ctc import ComputedTorque, FeedForward
from identification import identify
from plant import PD, Guards, PointToPoint, fastest, puma560, simulate

PATH = MOTIONS["(6), 3.65 s"]
SAMPLED = [name for name, (fast, _) in LAWS.items() if not fast]
FAST = [name for name, (fast, _) in LAWS.items() if fast]
ENDS = (0, pytest.param(1.5, marks=pytest.mark.slow), 5)
"""Tools of the literature's arm [kg]."""


@cache
def arm(load=None):
    return puma560.arm() if load is None else puma560.literature_arm(load)


# -- healthy loops: none is stopped --------------------------------------------------------------
def test_the_controller_of_the_readme_runs_to_the_end():
    """Identified from the log, on the true arm; the first table of docs/guides/laws.md is this
    too.
    """
    measured = simulate(arm(), RIG, puma560.p_law(), PATH)
    found = identify(puma560.dynamics(), measured, seed=1, progress=False)
    found_margin = margin(arm(), RIG, ComputedTorque(found), PATH)
    assert found_margin.status == "running"
    assert found_margin.saturation < 0.5
    assert found_margin.chatter < 0.5


@pytest.mark.slow  # tests/benchmarks/guards.py has their margins
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("name", SAMPLED)
def test_the_laws_of_the_docs_run_to_the_end_of_every_motion(name, motion):
    """With f known; every margin is at least a factor of two."""
    found = margin(arm(), RIG, name, MOTIONS[motion])
    assert found.status == "running"
    assert max(found.saturation, found.chatter) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("name", FAST)
def test_fast_hardware_runs_too(name):
    """Monitored by the clock. The fastest motion: from rest, and through the peaks of its
    torque.
    """
    found = margin(arm(), RIG, name, MOTIONS["(6), 2.0 s"], duration=0.5)
    assert found.status == "running"
    assert max(found.saturation, found.chatter) < 0.8


@pytest.mark.parametrize("load", ENDS)
@pytest.mark.parametrize("name", SAMPLED)
def test_loaded_arms_run(name, load):
    found = margin(arm(load), RIG, name, PATH, duration=2.0)
    assert found.status == "running"
    assert max(found.saturation, found.chatter) < 0.5


@pytest.mark.parametrize(
    "hz", [25, *(pytest.param(hz, marks=pytest.mark.slow) for hz in (60, 100))]
)
@pytest.mark.parametrize("load", ENDS)
@pytest.mark.parametrize("name", ["the same, every 0.7 ms", "adaptive"])
def test_laws_that_are_stable_on_elastic_gears_run(name, load, hz):
    """Within three pulses on all of these, and no reason to stop."""
    found = margin(arm(load), elastic(arm(load), hz), name, PATH)
    assert found.status == "running"
    assert max(found.saturation, found.chatter) < 0.6


@pytest.mark.parametrize("bandwidth", [150, 250])
def test_a_time_optimal_path_near_the_limits_runs(bandwidth):
    """The spline of examples/7_fastest_path.py at 90 % of the amplifiers' limits."""
    path = fastest(
        arm(),
        RIG,
        PointToPoint(start=(0, 0), goal=(-1, 1), duration=1),
        share=0.9,
        torque_rate=(5e3, 5e3),
    )
    found = margin(arm(), RIG, ComputedTorque(arm(), RIG, bandwidth=bandwidth), path)
    assert found.status == "running"
    assert max(found.saturation, found.chatter) < 0.9


@pytest.mark.parametrize("bandwidth", [150, 250])
def test_a_start_off_the_path_runs(bandwidth):
    """0.02 rad, 274 pulses: some 20 ms at the limits."""
    law, motion = ComputedTorque(arm(), RIG, bandwidth=bandwidth), PATH(np.arange(300) * RIG.period)
    robot, torque = (
        SimulatedArm(arm(), RIG, motion.q[0] + (0.02, -0.02), motion.qd[0]),
        np.empty((300, 2)),
    )
    running = law.start(RIG, robot.counts())
    for k in range(300):
        torque[k] = running.step(robot.counts(), motion.q[k], motion.qd[k], motion.qdd[k])
        robot.push(torque[k])
    assert running.status == "running"
    assert (np.abs(torque) >= LIMIT * (1 - 1e-12)).sum(axis=0).max() * RIG.period > 0.012


# -- unstable loops: all are stopped -------------------------------------------------------------
UNSTABLE = [(hz, bandwidth) for hz in (100, 60) for bandwidth in (250, 300)]
ALONE = {"both": Guards(), "saturation": Guards(chatter=None), "chatter": Guards(saturation=None)}


@cache
def loop(hz, bandwidth, guards):
    """On gears of so many Hz at 2 % damping, with 1.5 kg; 0.7 s."""
    law = ComputedTorque(arm(1.5), RIG, bandwidth=bandwidth)
    return closed(
        arm(1.5), elastic(arm(1.5), hz), law, PATH, samples=1000, guards=ALONE.get(guards)
    )


@pytest.mark.parametrize("guards", ALONE)
@pytest.mark.parametrize(("hz", "bandwidth"), UNSTABLE)
def test_an_unstable_loop_is_stopped_within_100_ms_of_half_of_the_samples_at_the_limit(
    hz, bandwidth, guards
):
    """In a window of 20 ms: from there on the loop without guards has 48 % and more of all
    samples at the limit.
    """
    free, stopped = loop(hz, bandwidth, None), loop(hz, bandwidth, guards)
    first = free.first(0.02)
    at = (np.abs(free.torque[first:]) >= LIMIT * (1 - 1e-12)).mean(axis=0).max()
    assert at > 0.48
    assert free.margin.status == "running"
    assert stopped.stop is not None
    assert (stopped.stop - first) * RIG.period < 0.1
    cause = {"saturation": "was at its limit for 50 of 100 ms", "chatter": "swings by"}
    assert cause.get(guards, "the torque of joint") in stopped.margin.status
    ended = (
        "ramp to gravity compensation: the torque of joint ",
        "no torque since joint 3 (q[1]) ran away: ",
    )
    assert stopped.margin.status.startswith(tuple(f"safe stop, {each}" for each in ended))
    assert stopped.margin.status.brake


@pytest.mark.parametrize("guards", ALONE)
@pytest.mark.parametrize(("hz", "bandwidth"), UNSTABLE)
def test_what_was_unstable_does_not_hold_the_arm(hz, bandwidth, guards):
    """No torque is above half of its limit then; in 200 ms motors rest, and links but for their
    gears' ringing.

    Where a joint ran away from what held it, nothing does, and it falls: brakes were asked for, and
    are none here.
    """
    run = loop(hz, bandwidth, guards)
    after, rest = slice(run.stop, None), slice(run.stop + round(0.2 / RIG.period), None)
    assert (np.abs(run.torque[after]) < LIMIT / 2).all()
    assert np.abs(run.motor_speed[run.stop - 30 : run.stop]).max() > 0.5
    if "ran away" in run.margin.status:
        assert (run.torque[rest] == 0).all()
        return
    assert np.abs(run.motor_speed[rest]).max() < 0.01
    assert np.abs(run.link_speed[rest]).max() < 0.05
    assert len(run.torque[rest]) > 50


def test_a_hold_on_an_unstable_loop_becomes_a_ramp():
    """Stopped by the tracking error before, it would go on oscillating under the law that holds."""
    law = ComputedTorque(arm(1.5), RIG, bandwidth=250)
    blind = Guards(error=8, jump=np.inf, saturation=None, chatter=None)
    rig, runs = elastic(arm(1.5), 100), []
    for guards in (blind, Guards(error=8, jump=np.inf)):
        runs.append(closed(arm(1.5), rig, law, PATH, samples=1000, guards=guards))
    holding, ramp = runs
    assert holding.stop == ramp.stop
    why = holding.margin.status.split(": ", 1)[1]
    # without them it drives the arm
    assert holding.margin.status.startswith("safe stop, no torque since joint ")
    assert ramp.margin.status == f"safe stop, ramp to gravity compensation: {why}"
    assert np.abs(ramp.motor_speed[-100:]).max() < 0.01


def test_the_guards_change_no_bit_before_the_stop():
    free, stopped = loop(100, 150, None), loop(100, 150, "both")
    np.testing.assert_array_equal(free.torque[: stopped.stop], stopped.torque[: stopped.stop])


def test_a_law_that_stays_within_a_pulse_there_goes_on_to_the_end():
    """Feed-forward with PD on 60 Hz, closed sample by sample, no counts replayed."""
    pd = PD(gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=3000.0, period=RIG.period)
    law = FeedForward(arm(1.5), RIG, feedback=pd)
    run = closed(arm(1.5), elastic(arm(1.5), 60), law, PATH, samples=600)
    error = RIG.counts(PATH(np.arange(600) * RIG.period).q) - run.counts
    assert np.abs(error).max() <= 1
    assert run.margin.status == "running"
