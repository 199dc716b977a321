"""Joints that hardly move, or move in step, identified with a prior: f is whole, and right where
the log tells it.
"""

import dataclasses
import re
import warnings

import numpy as np
import pinocchio as pin
import pytest

from ctc import ComputedTorque, Uncertainty, certify
from identification import Identification, identify, procedure
from identification.equation_error import NotIdentifiableError, Prior
from identification.results import combinations_of, origins
from plant import Body, Chain, Drive, Dynamics, Encoder, Harmonics, Link, Rig, p_gains, simulate
from tests.oracles.pinocchio_arm import pinocchio_model

BODIES = (
    Body(mass=8.0, com=(0.05, 0.02, -0.1), inertia=(0.2, 0.01, 0.02, 0.25, -0.01, 0.1), rotor=1.5),
    Body(mass=6.0, com=(0.2, 0.01, 0.05), inertia=(0.03, 0.01, -0.005, 0.2, 0.004, 0.2), rotor=1.0),
    Body(
        mass=2.0,
        com=(0.15, -0.03, 0.02),
        inertia=(0.01, 0.002, 0.001, 0.04, 0.001, 0.035),
        rotor=0.3,
    ),
)
"""The truth; the model file has other masses and centres, within its spread."""

FILE = tuple(
    dataclasses.replace(
        body, mass=body.mass * share, com=body.com * np.array(shift), inertia=body.inertia * share
    )
    for body, share, shift in zip(
        BODIES, (1.1, 0.9, 0.85), ((1.1, 1, 0.9), (1.1, 1, 1), (0.9, 1.1, 1)), strict=True
    )
)

LINKS = (
    Link(name="base"),
    Link(name="shoulder", alpha=-np.pi / 2, d=0.1),
    Link(name="elbow", a=0.4),
)

GEAR = 100.0


def chain(bodies):
    return Chain(links=LINKS, bodies=bodies)


def logged(amplitudes, duration=4.0):
    """The log of the true arm whose joints swing by these amplitudes [rad], and the torque of
    two speeds in step.
    """
    every, truth = (
        np.ones(3),
        Dynamics.from_chain(chain(BODIES)).arm(Dynamics.from_chain(chain(BODIES)).f()),
    )
    drive = Drive(
        gear=GEAR * every,
        motor_inertia=[body.rotor / GEAR**2 for body in BODIES],
        viscous=1e-3 * every,
        coulomb=(0.02, 0.02, 0.12),
        motor_gain=every,
        current_limit=10 * every,
        joints=("base", "shoulder", "elbow"),
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=4096 * every), period=1e-3)
    waves = np.array([[[0.5, 0.3, -0.2], [0.3, -0.5, 0.2], [0.2, 0.3, 0.5]]] * 2) * np.array(
        [[[1.0]], [[-0.6]]]
    )
    waves = np.einsum("kij,il->klj", waves, np.asarray(amplitudes))
    path = Harmonics(period=4.0, offset=np.array([0.2, -0.8, 0.6]), cosine=waves[0], sine=waves[1])
    law = p_gains(truth, rig, path, peak=30 * every)
    return simulate(truth, rig, law, path, duration=duration, steps_per_sample=8)


def found_of(record, **options):
    """What is found from the file's bodies, and what was said before the search."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        options = {"method": "prediction_error", "progress": False} | options
        found = identify(Dynamics.from_chain(chain(FILE)), record, **options)
    return found, [str(each.message) for each in said]


@pytest.fixture(scope="module")
def still():
    """The elbow is asked to move by some pulses."""
    return found_of(logged(np.diag([0.8, 0.6, 1e-4]), duration=3.0), prior=0.3)


def torque_off(arm, joints):
    """Error of torques (n,) on another path of these joints, against pinocchio with the true
    bodies; relative, rms.
    """
    model = pinocchio_model(chain(BODIES), BODIES)
    data, t = model.createData(), np.linspace(0, 6, 100)
    q, qd, qdd = (np.zeros((100, 3)) for _ in range(3))
    q[:, 2] = 0.6
    for i in joints:
        rate = 1.0 + 0.7 * i
        q[:, i], qd[:, i], qdd[:, i] = (
            np.sin(rate * t),
            rate * np.cos(rate * t),
            -(rate**2) * np.sin(rate * t),
        )
    rotors = np.array([body.rotor for body in BODIES])
    true = (
        np.array([pin.rnea(model, data, *state) for state in zip(q, qd, qdd, strict=True)])
        + rotors * qdd
    )
    ours = np.array([arm.inverse(*state) for state in zip(q, qd, qdd, strict=True)])
    return np.sqrt(np.mean((ours - true) ** 2, axis=0) / np.mean(true**2, axis=0))


@pytest.mark.slow
def test_the_joint_is_named_before_the_search(still):
    said = still[1]
    assert "joint elbow (q[2]) moves by" in said[0]
    assert "design_motion" in said[0]
    assert "\n" not in said[0]
    named = said[0].partition("parameters: ")[2].partition(". design_motion")[0].split(", ")
    dynamics = still[0].arm.dynamics
    long = dict(zip(dynamics.short_names, dynamics.names, strict=True))
    assert named
    assert not any(long[name].startswith("mx_shoulder") for name in named)


def test_f_is_whole_and_right(still):
    found, _ = still
    truth = found.arm.dynamics.f(BODIES)
    prior, off = found.fit.prior, found.f - found.arm.dynamics.f(BODIES)
    assert (found.fit.std > 0).all()
    assert np.linalg.eigvalsh(found.fit.correlation).min() > 0
    assert np.abs(off / found.fit.std).max() < 3
    left = found.fit.std / np.sqrt(np.diag(prior.covariance))
    assert (left < 1.1).all()
    assert (left < 0.2).sum() > 3
    off_before = np.abs(truth - prior.mean)
    assert np.abs(off[left < 0.2]).max() < 0.2 * off_before[left < 0.2].max()


def test_torque_of_the_other_joints_is_right(still):
    """Where the elbow stands still as in the log; where it moves its own rotor is the prior's."""
    assert torque_off(still[0].arm, (0, 1))[:2].max() < 0.02
    dynamics = still[0].arm.dynamics
    assert torque_off(dynamics.arm(dynamics.f(FILE)), (0, 1))[:2].max() > 0.04


def test_what_came_from_where(still):
    found, _ = still
    those = combinations_of(found)
    count = int((those.shares >= 0.5).sum())
    assert 0 < count < len(those.shares)
    text = found.summary()
    text = " ".join(text.split())
    assert f"{len(those.shares) - count} come from the log, {count} from the prior" in text
    assert "the log does not excite all: joint elbow (q[2]) moves by" in text
    assert f"least told first, 3 of {count} (f in its standard deviations)" in str(
        list(origins(found, full=False))[-1]
    )
    assert "Cramér-Rao bound" not in found.summary(full=True)  # it would be of the log alone
    left = found.fit.std / np.sqrt(np.diag(found.fit.prior.covariance))
    (rotor,) = [i for i, name in enumerate(found.arm.dynamics.names) if name == "J_elbow"]
    assert left[rotor] > 0.8
    (told_by_itself,) = re.findall(r"more than 50 %: ([^;]*);", text)
    assert told_by_itself.split(", ") == [
        name for name, share in zip(found.short_names, left, strict=True) if share > 0.5
    ]
    assert re.search(rf"{found.short_names[rotor]} +\S+ +kg m² +\S+ prior", found.summary())
    assert not [line for line in found.warnings if "prior" in line]


def test_certify_draws_both(still):
    found, _ = still
    law = ComputedTorque(found.arm, found.rig, bandwidth=60)
    certificate = certify(
        found,
        found.rig,
        law,
        found.records[0].reference,
        Uncertainty(friction=0.0),
        samples=64,
        duration=0.2,
        progress=False,
    )
    drawn = certificate.plants.f.std(axis=0)
    assert drawn == pytest.approx(found.fit.std, rel=0.5)


def test_saved(still, tmp_path):
    found, _ = still
    found.save(tmp_path / "found.json")
    assert Identification.load(tmp_path / "found.json") == found


def test_joints_in_step():
    """The elbow follows the shoulder: their parameters are told apart by the prior."""
    follows = np.array([[0.8, 0, 0], [0, 0.6, 0.6], [0, 0, 0]])
    found, said = found_of(logged(follows, duration=2.0), prior=0.3)
    assert "joint shoulder (q[1]) and joint elbow (q[2]) move in step" in said[0]
    assert np.abs((found.f - found.arm.dynamics.f(BODIES)) / found.fit.std).max() < 3
    assert torque_off(found.arm, (0, 1, 2)).max() < 0.05


def test_a_contradicted_prior_is_said():
    """Bodies of half the mass with a spread of 5 %."""
    half = tuple(
        dataclasses.replace(body, mass=body.mass / 2, inertia=body.inertia / 2) for body in BODIES
    )
    found, _ = found_of(
        logged(np.diag([0.8, 0.6, 0.7]), duration=2.5),
        prior=(half, 0.05),
        method="equation_error",
    )
    (line,) = [line for line in found.warnings if "contradicts the prior" in line]
    assert "\n" not in line


@pytest.mark.slow
def test_a_prior_that_holds_the_log_down_is_said_first():
    """So narrow that nothing comes from the log: what is left over looks like the rig's."""
    half = tuple(
        dataclasses.replace(body, mass=body.mass / 2, inertia=body.inertia / 2) for body in BODIES
    )
    found, _ = found_of(
        logged(np.diag([0.8, 0.6, 0.7])), prior=(half, 0.001), method="equation_error"
    )
    assert found.warnings[0].startswith("the log contradicts the prior: ")


def test_by_default_the_model_s_bodies_fill_in_for_a_joint_that_stands_still(still):
    """The chain's own, to 0.3, to the bit; a chain without bodies is refused, with the way out."""
    record = logged(np.diag([0.8, 0.6, 1e-4]), duration=3.0)
    found, said = found_of(record)
    assert (found.f == still[0].f).all()
    assert found.fit.prior == still[0].fit.prior
    assert said[0] == still[1][0]
    assert "From the prior (30 %) are about" in said[0]
    with pytest.raises(ValueError, match=r"joint elbow .* moves by .*design_motion.*prior="):
        identify(Dynamics.from_chain(Chain(links=LINKS)), record, progress=False)


@pytest.mark.parametrize("amplitudes", [(0.004, 0.004, 0.004), (0.0, 0.6, 0.6)])
def test_where_no_arm_follows_from_the_log_alone_the_model_s_bodies_help(amplitudes):
    """All joints move by some tenths of a degree, or one hunts about where it is held, which is
    said at once.
    """
    found, said = found_of(logged(np.diag(amplitudes), duration=2.0))
    why = (
        "no arm follows from the log alone. From the prior"
        if all(amplitudes)
        else "the log does not excite all: joint "
    )
    assert [line for line in said if line.startswith(f"identify: {why}")]
    assert found.fit.prior.spread == 0.3
    assert np.abs((found.f - found.arm.dynamics.f(BODIES)) / found.fit.std).max() < 3
    assert found.warnings == []


def test_the_warning_says_why_the_log_alone_does_not_suffice(monkeypatch):
    """An arm did follow from it, by a rougher method."""

    def rough(problem):
        if problem.prior is not None:
            return search(problem)
        own = Prior.of_model(problem.dynamics, problem.records[0].rig)
        outcome = search(dataclasses.replace(problem, prior=own))
        fit = dataclasses.replace(outcome.fit, covariance=None, fallback_reason="told apart")
        return dataclasses.replace(outcome, fit=fit)

    search = procedure.search
    monkeypatch.setattr(procedure, "search", rough)
    found, said = found_of(logged(np.diag([0.004] * 3), duration=2.0))
    assert found.fit.prior.spread == 0.3
    assert [line for line in said if "told apart. From the prior" in line]
    assert not [line for line in said if "no arm" in line]


def test_no_prior_is_tried_where_a_number_of_the_rig_is_not_identifiable(monkeypatch):
    tried = []

    def refused(problem):
        tried.append(problem.prior)
        raise NotIdentifiableError("drive.viscous[0] is open.", "drive.viscous[0]")

    monkeypatch.setattr(procedure, "search", refused)
    with pytest.raises(NotIdentifiableError):
        found_of(logged(np.diag([0.004] * 3), duration=2.0))
    assert tried == [None]


@pytest.mark.slow
def test_what_moves_in_step_is_named_by_check_and_identify_and_fitted_from_the_log():
    follows = np.array([[0.8, 0, 0], [0, 0.6, 0.6], [0, 0, 0]])
    record = logged(follows)
    found, said = found_of(record)
    assert said == [
        "identify: the log does not excite all: joint shoulder (q[1]) and joint elbow (q[2]) move"
        " in step. design_motion(arm, rig, law, ...) gives a motion that excites more."
    ]
    assert found.fit.prior is None
    (finding,) = record.check().problems
    assert (finding.check, finding.joint, finding.verdict) == ("motion", 2, "look")
    assert finding.advice.startswith("It moves in step with joint shoulder (q[1])")
    assert "design_motion" in finding.advice
    assert logged(np.diag([0.8, 0.6, 0.7])).check().ok
