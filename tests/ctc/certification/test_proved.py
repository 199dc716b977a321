"""A bound without sampling: exact where the loop is linear; no rounding and no arm of the box
exceeds it.
"""

import dataclasses

import casadi as ca
import numpy as np
import pytest

from ctc import ComputedTorque, ComputedTorquePID, Uncertainty, certify
from ctc.certification.proved import _Task
from plant import Body, Chain, Drive, Dynamics, Elasticity, Encoder, Harmonics, Link, Rig, puma560
from plant.analysis.sampled_loops import SampledLoops

ARM, PATH = puma560.arm(), puma560.reference()
RIG = dataclasses.replace(puma560.rig(), encoder=Encoder(resolution=(800, 1000)))
LAW = ComputedTorque(
    ARM, RIG, bandwidth=120, observer_ratio=0.9, dead_zone=0.4, start_boost=3, start_time=0.25
)


def certified(relative, law=LAW, rig=RIG, duration=0.2, samples=256, **stated):
    exact = np.diag((relative * np.abs(ARM.f)) ** 2) + 1e-30 * np.eye(9)
    uncertainty = Uncertainty(covariance=exact, friction=relative, **stated)
    return certify(
        ARM, rig, law, PATH, uncertainty, samples=samples, duration=duration, progress=False
    )


def test_a_linear_loop_has_its_peak_gain():
    """Of one joint without gravity: half a pulse times the sum of the absolute pulse response, by
    other code.

    The first counts are taken as they are; that is left out.
    """
    drive = Drive(gear=[50], motor_inertia=[1e-4], viscous=[1e-3], coulomb=[0.0], motor_gain=[0.2],
                  current_limit=[np.inf])  # fmt: skip
    rig = Rig(drive=drive, encoder=Encoder(resolution=1000), period=1e-3)
    body = Body(
        mass=1.0,
        com=(0, 0, 0),
        inertia=(0, 0, 0, 0, 0, 0.2),
        rotor=float(drive.reflected_inertia()[0]),
    )
    dynamics = Dynamics.from_chain(Chain(links=(Link(name="a"),), bodies=(body,)))
    arm = dynamics.arm(dynamics.f())
    still = Harmonics(period=0.5, offset=(0.3,), cosine=np.zeros((1, 1)), sine=np.zeros((1, 1)))
    law = ComputedTorque(arm, rig, bandwidth=100, start_boost=1)
    known = Uncertainty(plants=[arm.f], friction=0.0, phase=False)
    proved = certify(arm, rig, law, still, known, samples=1, after=0.3, progress=False).proved
    A, B, C = SampledLoops(arm, rig, law, (0.3,)).matrices()
    response, gain = B, 0.0
    for _ in range(500):
        gain, response = gain + abs((C @ response).item()), (A + B @ C) @ response
    assert proved.rounding == pytest.approx(gain / 2, rel=1e-6)
    assert gain / 2 > 0.9


@pytest.fixture(scope="module")
def narrow():
    """Samples of a narrow box, with its bound."""
    certificate = certified(1e-3)
    assert certificate.proved.share == 1
    return certificate


def test_no_sample_exceeds_it(narrow):
    """On the true simulator, with its dry friction and the boosts that counts set."""
    proved = narrow.proved
    assert (narrow.runs.unrounded.max(axis=0) < proved.error).all()
    assert (narrow.by_counts < proved.rounding).all()
    assert (proved.rounding <= proved.error).all()
    assert (proved.error < 3.5).all()
    assert 0.9 < proved.sliding < 1


def test_no_rounding_exceeds_it_and_the_worst_comes_near():
    """The loop of the same steps in numbers, under the rounding that its response to single
    pulses calls the worst.
    """
    law = dataclasses.replace(LAW, dead_zone=0.0)
    narrow = certified(1e-9, law, duration=0.15, samples=8)
    task = _Task(narrow.plants, law, PATH, narrow.settings)
    period, own, n = task._period, task._nominal[~task._zeros], 2
    y, g, v = ca.MX.sym("y", len(period.start)), ca.MX.sym("g", 4 * n), ca.MX.sym("v", n)
    kept = (3 * n + task._held[0], 3 * n + task._held[-1] + 1)
    asked, s = period.law(y[3 * n : -n], period.pulses @ y[:n] - 0.5 + v / 2, y[2 * n : 3 * n], g)
    x, torque = y[: 2 * n], period.limited(asked)
    for _ in range(period.steps):
        x = period.arm(x, torque, own, g)
    run = period.nominal(own, np.zeros(n))
    step = ca.Function("step", [y, g, v], [ca.vertcat(x, torque, s, asked)])
    boost = ca.MX.sym("boost", kept[1] - kept[0])  # as the reference sets it
    following = step(y, g, v)
    following = ca.vertcat(following[: kept[0]], boost, following[kept[1] :])
    every = ca.Function("every", [y, g, v, boost], [following]).mapaccum(period.samples)

    def errors(rounding):
        ran = every(period.start, period.given.T, rounding, run[1:, kept[0] : kept[1]].T).full().T
        return (period.given[1:, :n] - ran[:-1, :n]) @ period.pulses.T

    count, random = period.samples, np.random.default_rng(0)
    for _ in range(5):
        assert (
            np.abs(errors(random.choice((-1.0, 1.0), (n, count)))) < narrow.proved.rounding
        ).all()
    quiet, worst = errors(np.zeros((n, count))), np.zeros((n, count))
    for i in range(n):
        for k in range(count - 2):
            pulse = np.zeros((n, count))
            pulse[i, k] = 0.05
            worst[i, k] = np.sign((errors(pulse) - quiet)[-1, 0])
    reached = np.abs(errors(worst)[-1, 0])
    assert 0.9 * narrow.proved.rounding[0] < reached < narrow.proved.rounding[0]


def test_no_arm_of_the_box_exceeds_it_and_a_corner_comes_near():
    """Runs of the corner that single numbers call the worst; counts are so fine that numbers
    decide.
    """
    fine = dataclasses.replace(RIG, encoder=Encoder(resolution=(80_000, 100_000)))
    law = ComputedTorque(ARM, fine, bandwidth=120, observer_ratio=0.9, start_boost=1)
    certificate = certified(6e-4, law, fine, duration=0.15, phase=False)
    task, proved = _Task(certificate.plants, law, PATH, certificate.settings), certificate.proved

    def error(numbers):
        run = task._period.nominal(numbers, np.zeros(2))
        return (task._period.given[:, 0] - run[:-1, 0]) * task._period.pulses[0, 0]

    alone = np.array(
        [error(task._centre + column) - error(task._centre) for column in task._basis.T]
    )
    worst = np.abs(alone).sum(axis=0).argmax()
    corner = np.abs(error(task._centre + task._basis @ np.sign(alone[:, worst]))).max()
    assert proved.share == 1
    assert proved.error[0] > 10 * proved.rounding[0]
    assert corner < proved.error[0] < corner + 1.5 * proved.rounding[0]


@pytest.mark.slow
def test_wider_ranges_are_cut_until_there_is_a_bound():
    wide = certified(0.012, duration=0.05, samples=64).proved
    assert wide.share == 0.25
    narrower = certified(0.003, duration=0.05, samples=64).proved
    assert narrower.share == 1
    np.testing.assert_allclose(wide.error, narrower.error, rtol=1e-3)
    assert (wide.rounding < wide.error - 1).all()


def test_the_certificate_prints_both_columns():
    stated = Uncertainty(plants=[ARM.f], friction=0.0)
    options = {"samples": 8, "duration": 0.05, "progress": False}
    said = str(certify(ARM, RIG, LAW, PATH, stated, proved=True, **options))
    head = next(
        line
        for line in said.splitlines()
        if line.startswith("largest error before rounding [pulses]")
    )
    assert head.split()[-2:] == ["proved", "sampled"]
    assert "assuming that joints slide the way the reference goes" in said
    assert "boosts are those of the reference" in said
    assert "proved" not in str(certify(ARM, RIG, LAW, PATH, stated, **options))


@pytest.mark.slow
def test_where_there_is_none_it_says_why():
    soft = Elasticity(stiffness=(2e4, 1e4), damping=(20, 10))
    gears = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=soft))
    options = {"duration": 0.02, "samples": 4}
    assert "here is elasticity" in certified(1e-3, rig=gears, **options).proved.reason
    assert "here is transport" in certified(1e-3, delay=(0, 1e-4), **options).proved.reason
    reason = certified(1e-3, law=puma560.p_law(), **options).proved.reason
    assert "laws that run once per sample; P does not" in reason
    fast = ComputedTorque(ARM, RIG)  # its boost takes the torque to the amplifier's limit
    none = certified(1e-3, law=fast, duration=0.1, samples=4).proved
    assert "no bound is proved: what is not linear, such as the amplifier's limit" in str(none)
    assert np.isinf(none.rounding).all()


def test_another_law():
    law = ComputedTorquePID(
        ARM, RIG, bandwidth=120, ratio=1.5, integral=10, roll_off=1500, roll_off_damping=0.9
    )
    certificate = certified(1e-4, law=law, duration=0.1)
    assert certificate.proved.share == 1
    assert certificate.proved.assumed == ()
    assert (certificate.proved.error < 1.2).all()
    assert (certificate.runs.unrounded.max(axis=0) < certificate.proved.error).all()
