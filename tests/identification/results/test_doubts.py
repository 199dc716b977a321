"""Doubt is loud: where it is found, in the repr, and in each law that is built on it; right logs
are quiet.
"""

import dataclasses
import json
import warnings
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from packaged_arms import elbow_of_a_ur5e

from ctc import ComputedTorque, ComputedTorquePID, Uncertainty, certify, tune
from identification import Identification, IdentificationWarning, identify
from identification.search import exceeded_value, simulated_record
from plant import Dynamics, Harmonics, P, puma560, simulate

RIG, LAW, PATH = puma560.rig(), puma560.p_law(), puma560.reference()


@cache
def log():
    return simulate(puma560.arm(), RIG, LAW, PATH)


@cache
def wrong():
    stated = dataclasses.replace(
        log(), law=P(gain=[1.5 * gain for gain in LAW.gain]), torque=None, current=None
    )
    with pytest.warns(
        IdentificationWarning, match=r"identify: identified with \d+ warning"
    ) as caught:
        found = identify(
            puma560.dynamics(), stated, seed=1, method="equation_error", progress=False
        )
    assert len(caught) == 1  # of all lines
    assert caught[0].filename == __file__
    for line in found.warnings:
        assert f"- {line}" in str(caught[0].message)
    return found


@cache
def right():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return identify(puma560.dynamics(), log(), seed=1, progress=False)


def test_what_follows_a_mistake_of_the_log_is_called_its_possible_effect():
    """A fit to gravity of the wrong sign needs offsets; without mistakes nothing is said of any."""
    chain = puma560.dynamics().chain
    down = np.array(chain.gravity)
    dynamics = Dynamics.from_chain(dataclasses.replace(chain, gravity=-down))
    with pytest.warns(IdentificationWarning):
        found = identify(dynamics, log(), method="equation_error", progress=False)
    mistake, effects, *others = found.warnings
    assert [cause.name for cause in found.causes][:2] == ["gravity direction", "offset"]
    assert mistake == found.causes[0].line
    assert "effects" in effects
    assert others[0] == found.causes[1].line
    assert [cause.behind for cause in found.causes][:2] == ["", "gravity direction"]
    assert effects not in found.doubts
    assert not any("effects" in line for line in wrong().warnings)


def test_what_is_significant_and_not_named_asks_for_what_was_stated():
    detection = right().diagnostics.detection
    assert "next to nothing" not in str(detection)
    signs = [
        dataclasses.replace(sign, threshold=-1.0) if sign.name == "gear" else sign
        for sign in detection.signs
    ]
    said = str(dataclasses.replace(detection, signs=tuple(signs)))
    assert "significant, but explaining next to nothing: gear (are lengths and rig right?)" in said


@pytest.mark.parametrize(
    ("rms", "of_rounding", "doubted"), [(0.44, 0, 1), (0.44, 0.42, 0), (0.5, 0.42, 1)]
)
def test_innovations_that_rounding_explains_but_for_its_scatter_are_no_doubt(
    rms, of_rounding, doubted
):
    """A slow clock feels its counts: a right log of 10 ms had 0.432 pulses, simulated ones 0.422."""
    fit = dataclasses.replace(right().fit, rms_innovation=rms, rounding_innovation=of_rounding)
    found = dataclasses.replace(right(), fit=fit)
    assert any(f"{rms:.2f} pulses" in line for line in found.doubts) == bool(doubted)


@pytest.mark.slow
def test_a_result_in_doubt_says_so_in_its_repr():
    assert f"{len(wrong().warnings)} warning" in repr(wrong())
    fallen = dataclasses.replace(
        wrong(), fit=dataclasses.replace(wrong().fit, fallback_reason="the fit is no arm")
    )
    assert "a fallback" in repr(fallen)


@pytest.mark.parametrize(
    ("law", "numbers"),
    [
        (ComputedTorque, {}),
        (
            ComputedTorquePID,
            {
                "bandwidth": 155,
                "ratio": 1.66,
                "integral": 40.6,
                "roll_off": 449,
                "roll_off_damping": 0.53,
            },
        ),
    ],
)
def test_a_law_does_not_take_it_silently(law, numbers):
    with pytest.warns(IdentificationWarning, match=rf"{law.__name__}: identified with") as caught:
        law(wrong(), **numbers)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        law(wrong().arm, wrong().rig, **numbers)  # accepted by whoever writes this


@pytest.mark.parametrize("study", [certify, tune])
def test_nor_does_a_study(study):
    law, found = () if study is tune else (P(gain=LAW.gain),), wrong()
    warnings.simplefilter("error", IdentificationWarning)
    with pytest.raises(IdentificationWarning, match=rf"{study.__name__}: identified with"):
        study(found, RIG, *law, PATH, Uncertainty(covariance=np.eye(found.fit.values.size)))


def test_a_file_has_the_warnings_and_what_is_read_from_it_warns_again(tmp_path):
    wrong().save(tmp_path / "found.json")
    assert (
        json.loads((tmp_path / "found.json").read_text())["provenance"]["warnings"]
        == wrong().warnings
    )
    with pytest.warns(IdentificationWarning, match="ComputedTorque: identified with"):
        ComputedTorque(Identification.load(tmp_path / "found.json"))


def test_a_right_log_is_quiet():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ComputedTorque(right())
    assert "warning" not in repr(right())


@cache
def two_joints_of_a_ur5e():
    """Shoulder lift and elbow, gears of 100 and encoders of 4,096 counts: the P loop hunts by a
    count or two.
    """
    chain, rig = elbow_of_a_ur5e("fix")
    one, other = (0.2, 0.1, -0.05), (-0.15, 0.1, 0.1)
    path = Harmonics(period=6.0, offset=(0.0, 0.0), cosine=(one, other), sine=(other, one))
    dynamics = Dynamics.from_chain(chain.with_rotors(rig.drive))
    return dynamics.arm(dynamics.f()), rig, path


# in the linear, where nothing limits it
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*the loop of P is unstable")
@pytest.mark.parametrize(  # without a lag, what its start sets swinging decays over the log
    ("gain", "lag", "hunts"),
    [
        pytest.param((0.080, 0.0295), None, (), marks=pytest.mark.slow),
        ((0.042, 0.0153), 3e-5, (0,)),
    ],
)
def test_a_loop_that_hunts_by_counts_is_described_and_not_doubted(gain, lag, hunts):
    arm, rig, path = two_joints_of_a_ur5e()
    rig = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, current_lag=lag))
    record = simulate(arm, rig, P(gain=gain), path, duration=3.0, steps_per_sample=16)
    found = identify(arm.dynamics, record, method="prediction_error", progress=False)
    assert found.diagnostics.difference > 0.9
    # Which of its runs the log is, the last bit decides.
    assert found.diagnostics.expected > (0.6 if lag else 0.8) * found.diagnostics.difference
    assert found.diagnostics.hunts == hunts
    assert found.warnings == []
    said = " ".join(found.summary(full=True).split())
    assert ("the loop hunts by counts, as the model's does" in said) == bool(hunts)
    worn = dataclasses.replace(
        rig, drive=dataclasses.replace(rig.drive, coulomb=0.5 * rig.drive.coulomb)
    )
    other = dataclasses.replace(
        simulate(arm, worn, P(gain=gain), path, duration=3.0, steps_per_sample=16), rig=rig
    )
    lower = dataclasses.replace(record, law=P(gain=0.7 * np.array(gain)), torque=None, current=None)
    for wrong, cause in ((other, "friction"), (lower, "gain")):
        with pytest.warns(IdentificationWarning):
            doubted = identify(arm.dynamics, wrong, method="prediction_error", progress=False)
        assert doubted.diagnostics.detection.names == (cause,)


@pytest.mark.slow
def test_what_is_named_is_not_blamed_on_the_rest_of_the_rig():
    """A lag of 16 us puts the loop's runs apart by 1.2 to 1.7 pulses: more than two runs are,
    less than is doubted.
    """
    arm, rig, path = two_joints_of_a_ur5e()
    late = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, current_lag=1.6e-5))
    record = simulate(arm, late, P(gain=(0.042, 0.0153)), path, duration=3.0, steps_per_sample=16)
    with pytest.warns(IdentificationWarning):
        found = identify(
            arm.dynamics,
            dataclasses.replace(record, rig=rig),
            method="prediction_error",
            progress=False,
        )
    told = found.diagnostics
    assert 1.1 * told.expected < told.difference < told.limit
    assert len(found.warnings) == 1
    assert found.warnings[0].startswith("torques lag behind commands by 0.017 ms")


@pytest.mark.parametrize(
    "method",
    [
        "seeded",
        pytest.param("prediction_error", marks=pytest.mark.slow),
        "equation_error",
        "output_error",
    ],
)
def test_no_method_blames_a_healthy_log_whose_loop_hunts(method):
    """The rough methods' values repeat it worse than their deviations say: that is said of them,
    not of the log.
    """
    arm, rig, path = two_joints_of_a_ur5e()
    record = simulate(arm, rig, P(gain=(0.080, 0.0295)), path, duration=3.0, steps_per_sample=16)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentificationWarning)
        found = identify(arm.dynamics, record, method=method, progress=False)
    told = found.diagnostics
    # The rough methods may come near enough to the right values.
    if method in ("seeded", "prediction_error") or np.isnan(told.closest):
        assert found.warnings == []
        assert told.expected < told.limit
        assert told.difference < told.limit
        assert np.isnan(told.closest)
    else:
        assert 0 < told.closest < told.difference
        assert found.warnings == [  # nor of its rotors
            f"these values repeat the log to {told.difference:.2f} pulses (rms), those of"
            f" prediction_error to {told.closest:.2f}, as the model repeats itself. The log fits"
            " its model: identify with that method."
        ]


@pytest.mark.slow
def test_a_validation_record_whose_loop_hunts_is_not_blamed_and_one_of_another_arm_is():
    """Searched at gains that do not hunt: the other differs more than 1.5 times as much, as runs
    of the model do.
    """
    arm, rig, path = two_joints_of_a_ur5e()
    calm, hunting = (simulate(arm, rig, P(gain=gain), path, duration=3.0, steps_per_sample=16)
                     for gain in ((0.02, 0.008), (0.080, 0.0295)))  # fmt: skip
    found = identify(arm.dynamics, calm, held_out=hunting, progress=False)
    told = found.diagnostics
    assert told.held_out_difference > 1.5 * max(told.difference, 0.58)
    assert told.held_out_difference < told.held_out_limit
    assert found.warnings == []
    heavy = arm.dynamics.arm(arm.f * 1.3)
    other = simulate(heavy, rig, P(gain=(0.080, 0.0295)), path, duration=3.0, steps_per_sample=16)
    with pytest.warns(IdentificationWarning, match="the values do not hold for both"):
        identify(arm.dynamics, calm, held_out=other, progress=False)


def test_one_more_number_exceeds_the_limit_with_the_stated_probability():
    """Of normal logarithms, whatever their mean and standard deviation."""
    draws = np.random.default_rng(0).normal(0.3, 0.2, (20_000, 5))
    above = [np.exp(row[-1]) > exceeded_value(list(row[:-1]), 0.02) for row in draws]
    assert abs(np.mean(above) - 0.02) < 4 * np.sqrt(0.02 * 0.98 / len(draws))


def test_a_record_under_another_law_than_the_first_is_run_under_its_own():
    arm, slow = puma560.arm(), P(gain=0.5 * np.array(LAW.gain))
    record = simulate(arm, RIG, slow, PATH, duration=0.5)
    problem = SimpleNamespace(
        unknown=arm.dynamics.names, parts=lambda values: (arm.dynamics.arm(values), RIG, LAW)
    )
    np.testing.assert_array_equal(
        simulated_record(problem, arm.f, record).error_pulses, record.error_pulses
    )


def test_coarse_steps_accuse_no_log_of_fine_encoders():
    """Of a quarter of a million counts per turn the steps of the simulation leave a pulse."""
    finer = 256
    encoder = dataclasses.replace(RIG.encoder, resolution=finer * RIG.encoder.resolution)
    rig = dataclasses.replace(RIG, encoder=encoder)
    law = P(gain=LAW.gain / finer)
    arm = puma560.literature_arm(1.5)
    record = simulate(arm, rig, law, PATH, duration=2.0, steps_per_sample=64)
    record = dataclasses.replace(record, true_q=None, true_qd=None)
    found = identify(puma560.dynamics(), record, method="prediction_error", progress=False)
    assert found.warnings == []
    assert found.diagnostics.difference < 0.6
