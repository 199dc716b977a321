"""What a verdict does not say of a machine, and says so: starts in motion, unlogged motion,
gears no log shows.
"""

import dataclasses
import json
import warnings

import numpy as np
import pytest
from uncertain import with_uncertainty

from ctc import Certificate, ComputedTorque, Uncertainty, certify, compare, evaluate
from ctc.certification import Influence
from ctc.verdict import with_gears
from identification import identify
from identification.results import seen
from plant import PD, Elasticity, Guards, Harmonics, P, puma560, simulate

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
LAW = ComputedTorque(ARM, RIG, bandwidth=150)
UNDER_WAY = PATH.later(0.5)
BEGINS = "joint 3 (q[1]) at 2.7 rad/s"


@pytest.fixture(scope="module")
def found():
    return identify(ARM.dynamics, simulate(ARM, RIG, puma560.p_law(), PATH), progress=False)


@pytest.fixture(scope="module")
def certified(found):
    def certified(path, **options):
        law = ComputedTorque(found)
        return certify(
            found,
            found.rig,
            law,
            path,
            **with_uncertainty(samples=8, duration=1.2, progress=False, **options),
        )

    return certified


# -- a path that begins in motion ----------------------------------------------------------------
def test_an_arm_that_stands_on_a_moving_path_is_simulated():
    moving = evaluate(ARM, RIG, LAW, UNDER_WAY, duration=0.8)
    start = np.array([UNDER_WAY(np.zeros(1)).q[0], np.zeros(2)])
    stood = simulate(ARM, RIG, LAW, UNDER_WAY, duration=0.8, steps_per_sample=16, initial=start)
    error = np.abs(stood.error_pulses).max(axis=1)
    assert moving.within(1)
    assert moving.from_rest.peak == error.max() > 100
    (after,) = np.flatnonzero(stood.t == moving.from_rest.back)
    assert (error[after:] <= 1).all()
    assert error[after - 1] > 1
    assert BEGINS in moving.from_rest.begins
    assert "the path begins in motion" in " ".join(str(moving).split())
    assert 'class="verdict bad"' in moving._repr_html_()
    short = evaluate(ARM, RIG, LAW, UNDER_WAY, duration=0.02)
    assert np.isnan(short.from_rest.back)
    assert short.from_rest.simulated == pytest.approx(len(short.record) * RIG.period)
    assert f"after {short.from_rest.simulated:g} s" in str(short.from_rest)


@pytest.mark.parametrize("options", [{}, {"reference": UNDER_WAY, "initial": "rest"}])
def test_a_run_from_rest_has_nothing_to_say(options):
    reference = options.get("reference", PATH)
    initial = np.array([reference(np.zeros(1)).q[0], np.zeros(2)]) if "initial" in options else None
    evaluation = evaluate(ARM, RIG, LAW, reference, duration=0.1, initial=initial)
    assert evaluation.from_rest is None
    assert "in motion" not in str(evaluation)


def test_a_slow_start_within_a_pulse_is_none():
    creeping = Harmonics(
        period=50.0, offset=(0.0, 0.0), cosine=((0.0,), (0.0,)), sine=((1e-3,), (0.0,))
    )
    assert evaluate(ARM, RIG, LAW, creeping, duration=0.3).from_rest is None


def test_a_comparison_says_it_of_each_law_that_holds():
    laws = {"P": puma560.p_law(), "computed torque": LAW}
    text = " ".join(str(compare(ARM, RIG, laws, UNDER_WAY, duration=0.3)).split())
    assert "computed torque: the path begins in motion (joint 3 (q[1]) at 2.7 rad/s)" in text
    assert "P: the path" not in text
    assert 'class="verdict bad"' in compare(ARM, RIG, laws, UNDER_WAY, duration=0.3)._repr_html_()
    assert "in motion" not in str(compare(ARM, RIG, laws, PATH, duration=0.1))


def test_a_certificate_says_it_in_its_verdict(certified):
    certificate = certified(UNDER_WAY)
    assert BEGINS in certificate.verdict
    assert 'class="verdict bad"' in certificate._repr_html_()
    assert "in motion" not in certified(PATH).verdict


# -- a run that ends before it counts on elastic gears ---------------------------------------------
@pytest.mark.parametrize("duration", [0.015, 0.02])
def test_gears_of_a_run_without_a_sample_that_counts_are_unknown(duration):
    """Such a run once stayed within ±1 pulse at any resonance."""
    evaluation = evaluate(ARM, RIG, LAW, PATH, duration=duration, backend="numba")
    assert np.isnan(evaluation.lowest_resonance)
    assert "cannot tell" in str(evaluation.on_gears)
    stated = Uncertainty(plants=[ARM.f])
    certificate = certify(ARM, RIG, LAW, PATH, stated, samples=2, duration=duration, progress=False)
    assert np.isnan(certificate.lowest_resonance)


# -- a law that cannot start ---------------------------------------------------------------------
@pytest.mark.parametrize("bandwidth", [15, 150])
def test_what_start_refuses_is_said(bandwidth):
    soft = Elasticity.from_resonance(ARM, 60, 0.02, drive=RIG.drive)
    law, rig = ComputedTorque(ARM, RIG, bandwidth=bandwidth), with_gears(RIG, soft)
    evaluation = evaluate(ARM, rig, law, PATH, duration=0.05)
    said = None
    try:
        law.start(rig, evaluation.record.counts[0])
    except ValueError as error:
        said = f"`start` refuses this controller: {error}"
    assert (said is None) == (bandwidth == 15)
    assert evaluation.refused == said
    # Until it has swung up it is within ±1 pulse: its comparison is not positive for that.
    early = compare(ARM, rig, {"mine": law}, PATH, duration=0.005)
    assert early.evaluations["mine"].within(1)
    verdict = "bad" if said else "good"
    assert f'class="verdict {verdict}"' in early._repr_html_()
    assert ("mine: `start` refuses this controller" in str(early)) == (said is not None)
    assert evaluate(ARM, RIG, P(gain=(0.11, 0.17)), PATH, duration=0.05).refused is None


# -- what the log shows --------------------------------------------------------------------------
def test_a_path_that_leaves_the_log_is_named(found, certified):
    wide = Harmonics(period=1.2, offset=(0.3, 0.8), cosine=((-0.3,), (0.0,)), sine=((0.0,), (0.0,)))
    certificate = certified(wide)
    (line,) = certificate.seen.beyond
    assert line == "joint 2 (q[0]) 0.00 to 0.60 rad (log: -1.57 to 0.00) and 1.6 rad/s (log: 1.4)"
    assert f"the path exceeds the log: {line}" in " ".join(str(certificate).split())
    assert "The path exceeds angles or speeds of the log." in certificate.verdict
    within = certified(PATH)
    assert within.seen.beyond == ()
    assert "The path exceeds" not in within.verdict


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.5, 2.0])
def test_gears_that_the_log_would_have_shown_are_named(certified, share):
    """Whoever states them is told that they are not this arm's; of stiffer ones nothing is said."""
    plain = certified(PATH)
    shown = plain.seen.resonance
    stated = " ".join(str(certified(PATH, resonance=(share * shown, 4 * shown))).split())
    said = (
        f"gears that resonate below {shown:.3g} Hz would have shown in the log, and did not: those"
        " sampled from"
    )
    assert (said in stated) == ("would have shown" in stated) == (share < 1)
    assert "leaves the log" not in str(plain)


def test_the_log_is_held_against_the_gears_of_the_verdict(found, certified):
    certificate = certified(PATH)
    shown, lowest = certificate.seen.resonance, certificate.lowest_resonance
    assert 30 < shown < lowest < 500
    wanted = (
        f"not those from {shown:.3g} to {lowest:.3g} Hz: certify with resonance=({shown:.3g},"
        f" {lowest:.3g})."
    )
    assert wanted in certificate.verdict
    compliance = next(
        sign for sign in found.diagnostics.detection.signs if sign.name == "compliance"
    )
    assert shown == pytest.approx(min(value**-0.5 for value in compliance.visible.values()))
    stiff = dataclasses.replace(
        certificate, seen=dataclasses.replace(certificate.seen, resonance=600.0)
    )
    assert "below 600 Hz would have shown in the log." in stiff.verdict
    none = dataclasses.replace(
        certificate, seen=dataclasses.replace(certificate.seen, resonance=None)
    )
    assert "log" not in none.verdict


def test_an_arm_alone_has_no_log():
    covariance = np.diag((0.01 * ARM.f) ** 2)
    certificate = certify(
        ARM,
        RIG,
        LAW,
        PATH,
        Uncertainty(covariance=covariance),
        samples=8,
        duration=0.1,
        progress=False,
    )
    assert certificate.seen is None
    assert "log" not in certificate.verdict


@pytest.mark.slow
def test_samples_show_nothing_above_half_their_rate():
    """A log of known torques at 1 kHz of fine encoders, in which the innovations alone would
    show 1 kHz.
    """
    rig = dataclasses.replace(
        RIG,
        period=1e-3,
        encoder=dataclasses.replace(RIG.encoder, resolution=RIG.encoder.resolution * 8),
    )
    law = PD(gain=(0.02, 0.015), derivative=(5e-5, 4e-5), filter=2000.0, period=1e-3)
    found = identify(ARM.dynamics, simulate(ARM, rig, law, PATH), progress=False)
    assert seen(found, PATH, 1.0).resonance <= 500 * (1 + 1e-12)
    assert "detectable below 500 Hz" in " ".join(str(found).split())


def test_a_file_from_before_is_read(certified, tmp_path):
    certificate, path = certified(PATH), tmp_path / "certificate.json"
    certificate.save(path)
    assert Certificate.load(path) == certificate
    written = json.loads(path.read_text())
    del written["content"]["seen"]
    path.write_text(json.dumps(written))
    assert Certificate.load(path).seen is None
    del written["content"]["within"]
    path.write_text(json.dumps(written))
    with pytest.raises(ValueError, match="must have the field 'within'"):
        Certificate.load(path)


# -- what was stated in another unit -------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            {"resonance": (0.04, 0.12)},
            r"resonance must be 1 Hz or more; got 0\.04\. .* is it in kHz\?",
        ),
        ({"friction": 10}, r"friction must be a share from 0 to 1; got 10\.0\. 0\.1 is 10 %\."),
    ],
)
def test_other_units_are_refused(certified, options, said):
    with pytest.raises(ValueError, match=said):
        certified(PATH, **options)


def test_guards_in_degrees_are_doubted():
    fine = Guards(position=((-np.pi, -np.pi), (np.pi, np.inf)), speed=(3.0, np.inf))
    LAW.start(RIG, (0, 0), guards=fine)
    degrees = Guards(position=((-90, -2), (90, 2)), speed=180)
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        LAW.start(RIG, (0, 0), guards=degrees)
    # This law has no arm: nobody knows which of its joints slide.
    speed = "move at 180, in rad/s or m/s: is it in degrees or mm per second?"
    assert [str(each.message) for each in given] == [
        "position of Guards lets joint q[0] move from -90 to 90, in rad or m: is it in degrees or"
        " mm?",
        f"speed of Guards lets joint q[0] {speed}",
        f"speed of Guards lets joint q[1] {speed}",
    ]


def test_a_rig_whose_gear_turns_the_other_way_is_refused():
    drive = dataclasses.replace(RIG.drive, gear=RIG.drive.gear * (1, -1))
    with pytest.raises(ValueError, match=r"must turn the same way; that of joint q\[1\] is"):
        evaluate(ARM, dataclasses.replace(RIG, drive=drive), LAW, PATH, duration=0.05)


def test_how_well_f_is_known_decides(certified, found, monkeypatch):
    """Told where plants leave and f explains most of it, and not where friction does; else
    another law may hold.
    """
    stated = Uncertainty(friction=0.0, phase=False, covariance=np.diag((0.3 * found.f) ** 2))
    vague = certify(
        found,
        found.rig,
        ComputedTorque(found),
        PATH,
        stated,
        samples=64,
        duration=1.2,
        progress=False,
    )
    assert vague.failures
    assert "the uncertainty of f decides" in str(vague)
    # A number of the drive comes first, and tolerances make up most of the first f.
    f1, f2, *_ = vague.plants.arm.dynamics.names
    shares = {"drive.motor_gain[0]": 0.4, f1: 0.3, f2: 0.3}
    influences = [Influence(name, share, 0.0) for name, share in shares.items()]
    monkeypatch.setattr(Certificate, "sensitivities", influences)
    by_tolerances = dataclasses.replace(vague.seen, by_tolerances={f1: 0.9})
    other = dataclasses.replace(vague, seen=by_tolerances)
    other.__dict__["friction_known"] = None
    assert f"of the variance of {f1} comes from tolerances" in " ".join(str(other).split())
    monkeypatch.undo()
    vague.__dict__["friction_known"] = 0.1  # where that helps it is said first
    assert "with friction identified from this log, 10 % of the first" in " ".join(
        str(vague).split()
    )
    assert "decides" not in str(certified(PATH))
    with_zeros = certify(
        found,
        found.rig,
        ComputedTorque(found),
        PATH,
        samples=16,
        duration=0.2,
        within=0,
        progress=False,
    )
    assert with_zeros.failures == 16
    assert "another controller may hold: tune" in str(with_zeros)


def test_friction_that_comes_first_is_to_be_identified(found):
    """Also where few samples exceed the limit: with the share that would, and not that another
    law may hold.
    """
    stated = Uncertainty(friction=0.3)
    rubs = certify(
        found,
        found.rig,
        ComputedTorque(found),
        PATH,
        stated,
        samples=256,
        duration=1.2,
        progress=False,
    )
    assert rubs.sensitivities[0].name == "drive.coulomb[1]"
    assert 0 < rubs.probability < 0.5
    # At most one of 256: the last bits of f decide on a sample at the limit.
    assert rubs.friction_known <= 1 / 256
    said = " ".join(str(rubs).split())
    share = "0 %" if not rubs.friction_known else "0.39 %"
    assert (
        f"friction decides: with friction identified from this log, {share} of the first samples"
        " exceed the limit" in said
    )
    assert 'identify(..., unknown="friction")' in said
    assert "another controller" not in said
