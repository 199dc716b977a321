"""Deviations of counts from their motion: what an arm, its encoder and an uneven clock may do."""

from dataclasses import replace

import numpy as np
import pytest

from plant import Drive, Encoder, Harmonics, LoggedTorque, Record, Rig, read_robot, simulate
from plant.checkup import Signals, acceleration, longest_line, time_findings

TURN = 2 * np.pi


def rig(n, counts, period):
    """Joints without gears whose encoders have so many counts per turn."""
    one = np.ones(n)
    drive = Drive(
        gear=one, motor_inertia=0 * one, viscous=None, coulomb=None, motor_gain=one,
        current_limit=np.inf * one,
    )  # fmt: skip
    return Rig(
        drive=drive, encoder=Encoder(resolution=counts * one, rounding="round"), period=period
    )


def logged(t, q, counts, period):
    """A log of angles (N, n), without reference, law or torque."""
    stated = rig(q.shape[1], counts, period)
    return Record(t=t, error_pulses=-stated.counts(q), rig=stated)


def serial_line(seed, count=2500, shortest=0.018):
    """Stamps of a serial line: intervals of 18 ms and more, some of them ten times as long."""
    random = np.random.default_rng(seed)
    return np.cumsum(shortest + random.exponential(0.018, count))


def problems(record, *names):
    return [
        (finding.check, finding.joint)
        for finding in record.check().problems
        if not names or finding.check in names
    ]


# -- the motion ----------------------------------------------------------------------------------
@pytest.mark.parametrize("least", [1, 30])
@pytest.mark.parametrize("uneven", [False, True])
def test_the_acceleration_is_that_of_the_motion_however_coarse_its_counts(least, uneven):
    """A sine of 9,000 counts at 2 rad/s has 36,000 / sqrt(2) counts/s^2, less the largest 2 %."""
    t = serial_line(1) if uneven else 0.005 * np.arange(4000)
    counts = least * np.round(9000 * np.sin(2 * t) / least)
    assert acceleration(t, counts[:, None], least) == pytest.approx(36000 / np.sqrt(2), rel=0.08)


def test_a_line_is_the_shorter_the_faster_the_motion_and_none_replaces_a_rest():
    """A T^2 / 8 of the rms acceleration is a thousandth of the range, by hand."""
    t = 0.002 * np.arange(6000)
    slow, fast = (20000 * np.sin(w * t)[:, None] for w in (1.0, 5.0))
    by_hand = np.sqrt(8e-3 * 2 * np.sqrt(2))
    assert longest_line(t, slow) == pytest.approx(by_hand, rel=0.05)
    assert longest_line(t, fast) == pytest.approx(by_hand / 5, rel=0.05)
    # the faster joint decides, and one at rest has no say
    both = np.hstack([slow, fast, np.zeros_like(slow)])
    assert longest_line(t, both) == longest_line(t, fast)
    assert longest_line(t, np.zeros((6000, 2))) == pytest.approx(1.5 * 0.002)


# -- fine encoders -------------------------------------------------------------------------------
def starts(counts, period=0.01, size=3.0):
    """A joint that rests, and now and then jogs for some samples with so many rad/s^2."""
    t = period * np.arange(4000)
    force = np.zeros(len(t))
    for k in range(200, 3900, 400):
        force[k : k + 3], force[k + 3 : k + 6] = size, -size
    speed = np.cumsum(force) * period
    q = np.cumsum(speed) * period
    return logged(t, np.column_stack([q, 0.5 * np.sin(t)]), counts, period)


@pytest.mark.parametrize("counts", [2.0**12, 2.0**19, 2.0**24])
def test_a_start_at_three_radians_per_second_squared_is_no_jump(counts):
    assert not problems(starts(counts), "jumps", "glitches", "rows left out", "clipped counts")


@pytest.mark.parametrize("counts", [2.0**19, 2.0**24])
def test_a_count_that_is_off_by_more_than_an_arm_moves_in_a_sample_is_a_glitch(counts):
    """Half a degree within 10 ms and back would need 350 rad/s^2."""
    record = starts(counts)
    errors = np.array(record.error_pulses)
    errors[1500, 1] -= np.round(counts * 0.5 / 360)
    glitches = problems(replace(record, error_pulses=errors), "jumps", "glitches")
    assert glitches == [("glitches", 1)]


@pytest.fixture(scope="module")
def ur5e():
    """A right log of the UR5e, whose dry friction holds its joints where they turn back."""
    robot, random = read_robot("ur5e"), np.random.default_rng(3)
    cosine, sine = 0.1 * random.standard_normal((2, 6, 4))
    offset = (0.1, -1.2, 1.3, -0.5, 0.4, 0.2)
    path = Harmonics(period=7.0, offset=offset, cosine=cosine, sine=sine)
    return simulate(robot.arm, robot.rig, robot.law, path, duration=7.0)


def test_a_joint_that_friction_holds_where_it_turns_back_is_not_clipped(ur5e):
    encoders = Record(t=ur5e.t, error_pulses=-ur5e.counts, rig=ur5e.rig, law=None)
    assert not problems(encoders, "clipped counts")
    counts = np.array(ur5e.counts)
    counts[:, 2] = np.minimum(counts[:, 2], np.quantile(counts[:, 2], 0.9))
    cut_off = replace(encoders, error_pulses=-counts)
    assert problems(cut_off, "clipped counts") == [("clipped counts", 2)]


def test_joints_at_rest_are_no_copies_and_not_stuck():
    """Two joints rest but for a count of noise, which a third one moves beside."""
    t = 0.02 * np.arange(1500)
    q = np.column_stack([0.4 * np.sin(0.7 * t), *np.zeros((2, len(t)))])
    q[::5, 1], q[3::11, 2] = TURN / 2**14, TURN / 2**14
    record = logged(t, q, 2.0**14, 0.02)
    assert not problems(record, "stuck encoder", "copied columns")
    # a copy is one still
    q[:, 2] = q[:, 0]
    assert ("copied columns", 2) in problems(logged(t, q, 2.0**14, 0.02))


# -- uneven clocks -------------------------------------------------------------------------------
def test_an_uneven_clock_lacks_no_rows_and_keeps_all_joints():
    t = serial_line(2)
    q = np.column_stack([0.5 * np.sin(0.6 * t), 0.3 * np.cos(0.5 * t)])
    record = logged(t, q, 2.0**14, float(np.median(np.diff(t))))
    # that it is uneven is so
    assert problems(record) == [("time jitter", None)]
    assert (record.resampled(0.03).valid > 0).mean() > 0.8
    # where the clock is even, a row that lacks is lost
    even = 0.03 * np.arange(2000)
    even = even[np.random.default_rng(0).random(2000) > 0.02]
    motion = np.column_stack([0.5 * np.sin(0.6 * even), 0.3 * np.cos(0.5 * even)])
    names = [
        f.check for f in time_findings(Signals(logged(even, motion, 2.0**14, 0.03))) if not f.ok
    ]
    assert names == ["missing samples"]


def test_a_period_is_judged_by_as_much_as_uneven_stamps_tell():
    """A median of stamps that scatter is off by chance; a period that is off by 5 % is wrong."""
    t = 0.008 * np.arange(3000) + 0.008 * np.random.default_rng(4).uniform(-0.25, 0.25, 3000)
    q = np.column_stack([0.5 * np.sin(1.1 * t)])
    assert not problems(logged(t, q, 2.0**16, 0.008), "period")
    assert problems(logged(t, q, 2.0**16, 0.0084), "period") == [("period", None)]


@pytest.mark.parametrize("seed", [5, 6])
def test_a_slow_motion_over_a_serial_line_has_its_friction(seed):
    """Torque by hand: an inertia of 0.2 kg m^2, 3 N m of gravity, and friction of 0.6 N m."""
    from identification import fit_torque
    from plant import Body, Chain, Dynamics, Link

    t = serial_line(seed)
    w = 0.55
    q = 0.6 * np.sin(w * t) + 0.25 * np.cos(1.3 * w * t)
    qd = 0.6 * w * np.cos(w * t) - 0.25 * 1.3 * w * np.sin(1.3 * w * t)
    qdd = -0.6 * w**2 * np.sin(w * t) - 0.25 * (1.3 * w) ** 2 * np.cos(1.3 * w * t)
    torque = 0.2 * qdd + 3.0 * np.cos(q) + 0.6 * np.tanh(200 * qd) + 0.3 * qd
    torque += 0.05 * np.random.default_rng(seed).normal(size=len(t))
    record = replace(
        logged(t, q[:, None], 2.0**14, 0.03), torque=torque[:, None], law=LoggedTorque()
    )
    body = Body(mass=2.0, com=(0.15, 0, 0), inertia=(0.01, 0, 0, 0.01, 0, 0.01))
    link = Link(name="j1", alpha=np.pi / 2)
    dynamics = Dynamics.from_chain(Chain(links=(link,), bodies=[body]), rotors=False)
    fit = fit_torque(
        dynamics, record, unknown=(*dynamics.names, "drive.viscous[0]", "drive.coulomb[0]")
    )
    assert fit.rows > 300
    assert dict(zip(fit.names, fit.values, strict=True))["drive.coulomb[0]"] == pytest.approx(
        0.6, abs=0.08
    )
