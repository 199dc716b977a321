"""A load on a known arm: its mass within its own deviation, and the arm that carries it."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from identification import find_load, identify
from identification.equation_error import NotIdentifiableError
from identification.payload import LoadSearch
from plant import PID, Body, Harmonics, puma560, simulate

RIG, LAW, PATH, PLACE = puma560.rig(), puma560.p_law(), puma560.reference(), (0.0, -0.55, 0.0)


@cache
def log(mass):
    return simulate(puma560.literature_arm(mass), RIG, LAW, PATH, steps_per_sample=16)


@cache
def load(mass):
    return find_load(puma560.literature_arm(), log(mass), PLACE)


@pytest.mark.parametrize("mass", [0.0, 0.3, 2.5])
def test_mass_is_found_to_some_grams(mass):
    found = load(mass)
    assert found.mass == pytest.approx(mass, abs=max(3 * found.std, 0.01))
    assert found.std < 0.01
    assert found.rms_innovation < 0.33
    np.testing.assert_allclose(found.arm.f, puma560.literature_arm(mass).f, atol=0.02)


def test_load_at_the_wrong_place_shows_in_the_innovations():
    right, wrong = load(2.5), find_load(puma560.literature_arm(), log(2.5), (0.0, -0.2, 0.0))
    assert wrong.rms_innovation > 1.02 * right.rms_innovation
    assert abs(wrong.mass - 2.5) > 10 * right.std


# -- friction that is not what the rig says ------------------------------------------------------
MASS, ARM = 2.5, puma560.literature_arm()
WORN = dataclasses.replace(
    RIG.drive, viscous=RIG.drive.viscous * (1.1, 0.9), coulomb=RIG.drive.coulomb * (0.9, 1.1)
)
PID_LAW = PID(
    gain=(0.1, 0.075),
    integral=(0.5, 0.4),
    derivative=(4e-4, 3e-4),
    filter=3000.0,
    period=RIG.period,
)


BODY = Body(mass=MASS, com=PLACE)


@cache
def worn_log(law=LAW, path=PATH, body=BODY, duration=None):
    """On drives with 10 % more or less friction than the record's rig says, and without torques."""
    loaded = ARM.dynamics.arm(ARM.f + ARM.dynamics.load_matrix() @ body.standard_parameters)
    record = simulate(
        loaded,
        dataclasses.replace(RIG, drive=WORN),
        law,
        path,
        steps_per_sample=16,
        duration=duration,
    )
    return dataclasses.replace(
        record, rig=RIG, torque=None, current=None, true_q=None, true_qd=None
    )


@cache
def worn_load():
    return find_load(ARM, worn_log(), PLACE)


def z(found, mass=MASS):
    return (found.mass - mass) / found.std


def test_friction_is_found_beside_the_load():
    found = worn_load()
    assert abs(z(found)) < 3
    assert found.std < 0.03
    assert found.warnings == ()
    ratio = found.values[1:5] / (*WORN.viscous, *WORN.coulomb)
    assert (np.abs(ratio - 1) < 0.08).all()  # 10 % as the rig states them
    np.testing.assert_array_equal(found.rig.drive.coulomb, found.values[3:5])
    assert found.names[0] == "mass"
    assert found.covariance.shape == (7, 7)
    assert found.std == pytest.approx(np.sqrt(found.covariance[0, 0]))
    np.testing.assert_allclose(found.interval, found.mass + 1.96 * found.std * np.array([-1, 1]))


@pytest.mark.slow
def test_friction_that_was_assumed_is_warned_of_and_biases():
    """Under PID the log tells the torque, and 10 % of friction is worth some hundred grams."""
    record = worn_log(law=PID_LAW, duration=1.2)
    free, exact, stated = (
        find_load(ARM, record, PLACE, friction=share) for share in (None, 0.0, 0.1)
    )
    assert abs(free.mass - MASS) < 0.005
    assert abs(exact.mass - MASS) > 10 * abs(free.mass - MASS)
    assert abs(z(exact)) < 4  # what friction does to f is counted as if it were noise
    assert any("friction was taken from the rig, as exact" in text for text in exact.warnings)
    assert any("no load on this arm explains the logs" in text for text in exact.warnings)
    assert abs(stated.mass - MASS) < 0.005
    assert any("within 10%" in text for text in stated.warnings)


@pytest.mark.slow
def test_friction_stated_widely_is_free_and_tightly_exact():
    free = worn_load()
    wide, tight, exact = (
        find_load(ARM, worn_log(), PLACE, friction=share) for share in (10.0, 1e-5, 0.0)
    )
    assert abs(wide.mass - free.mass) < 0.3 * free.std
    assert tight.mass == pytest.approx(exact.mass, abs=0.01 * exact.std)
    np.testing.assert_allclose(tight.rig.drive.coulomb, RIG.drive.coulomb, rtol=1e-3)
    np.testing.assert_allclose(wide.rig.drive.coulomb, free.rig.drive.coulomb, rtol=0.02)


@pytest.mark.slow
def test_a_joint_at_rest_says_little_of_its_friction_and_nothing_of_the_mass():
    path = Harmonics(period=2.0, offset=(0.3, 0.2), cosine=((0.0,), (-0.6,)), sine=((0.0,), (0.0,)))
    found = find_load(ARM, worn_log(path=path, duration=4.0), PLACE)
    assert abs(z(found)) < 3
    viscous = found.names.index("drive.viscous[0]")
    assert found.covariance[viscous, viscous] > (5 * WORN.viscous[0]) ** 2


def test_friction_that_does_not_show_stays_as_the_rig_states_it(monkeypatch):
    fitted = LoadSearch._fitted

    def refusing(search, problem):
        if search.deviation[3] > 0:
            raise NotIdentifiableError("drive.coulomb[1] does not show", "drive.coulomb[1]")
        return fitted(search, problem)

    monkeypatch.setattr(LoadSearch, "_fitted", refusing)
    found = find_load(ARM, worn_log(), PLACE)
    assert found.rig.drive.coulomb[1] == RIG.drive.coulomb[1]
    assert (found.covariance[4] == 0).all()
    assert (
        found.warnings[0]
        == "drive.coulomb[1] is not identifiable from these logs, and was taken from the rig."
    )
    assert "known" in str(found)


# -- where the load is ---------------------------------------------------------------------------
def test_mass_and_centre_where_they_show():
    found = find_load(ARM, worn_log())
    assert found.names[:3] == ("mass", "com[0]", "com[1]")
    assert abs(z(found)) < 3
    assert (np.abs(found.com[:2] - PLACE[:2]) < 3 * found.com_std[:2]).all()
    assert found.com_std[:2].max() < 0.01
    assert np.isnan(found.com[2])  # along the axes of both joints
    assert "z is not identifiable" in " ".join(str(found).split())
    expected = ARM.f + ARM.dynamics.load_matrix() @ Body(mass=MASS, com=PLACE).standard_parameters
    np.testing.assert_allclose(found.arm.f, expected, atol=0.05)


def test_inertia_is_as_stated():
    body = Body(mass=MASS, com=PLACE, inertia=(0.1, 0, 0, 0.1, 0, 0.15))
    right = find_load(ARM, worn_log(body=body), PLACE, inertia=body.inertia)
    wrong = find_load(ARM, worn_log(body=body), PLACE)
    assert abs(z(right)) < 3
    assert abs(z(wrong)) > abs(z(right))
    assert wrong.rms_innovation > right.rms_innovation
    expected = ARM.f + ARM.dynamics.load_matrix() @ body.standard_parameters
    np.testing.assert_allclose(right.arm.f, expected, atol=0.05)


# -- laws and logs -------------------------------------------------------------------------------
@pytest.mark.slow
def test_a_log_of_a_law_with_a_memory_that_was_cut():
    found = find_load(ARM, worn_log(law=PID_LAW, duration=2.2).cut(0.437), PLACE)
    assert abs(found.mass - MASS) < 0.005
    np.testing.assert_allclose(found.rig.drive.viscous, WORN.viscous, rtol=0.02)


def test_several_logs_tell_more_and_each_is_shown():
    logs = [worn_log(), worn_log(path=puma560.reference(2.5), duration=3.65)]
    found, first = find_load(ARM, logs, PLACE), worn_load()
    assert found.runs[0] == pytest.approx((first.mass, first.std))
    assert len(found.runs) == 2
    assert first.runs == ()
    assert abs(z(found)) < 3
    assert found.std < first.std
    assert "record 1 alone" in str(found)


@pytest.mark.slow
def test_logs_that_contradict_each_other_widen_the_interval():
    heavier = worn_log(body=Body(mass=MASS + 0.5, com=PLACE))
    found = find_load(ARM, [worn_log(), heavier], PLACE)
    assert any("differ by more than their deviations" in text for text in found.warnings)
    assert found.interval[0] < MASS + 0.05
    assert found.interval[1] > MASS + 0.45


# -- what is said --------------------------------------------------------------------------------
def test_a_bound_that_is_hit_is_said():
    found = find_load(ARM, worn_log(), PLACE, mass=(0.0, 1.0))
    assert found.mass == 1.0
    assert any("mass ends at the upper bound, 1" in text for text in found.warnings)
    assert "warning: mass ends" in str(found)


def test_an_arm_that_is_another_is_said_and_counted():
    found = find_load(ARM.dynamics.arm(1.05 * ARM.f), worn_log(), PLACE)
    assert any("no load on this arm explains the logs" in text for text in found.warnings)
    assert found.chi_square > 10 * found.freedom
    right = worn_load()
    assert right.chi_square < 3 * found.freedom
    assert found.std > 2.5 * right.std
    assert find_load(ARM, worn_log(), PLACE, friction=0.0).covariance[1:, 1:].max() == 0


def test_a_negative_mass_is_said():
    found = find_load(puma560.literature_arm(1.0), worn_log(body=Body(mass=0.2, com=PLACE)), PLACE)
    assert found.mass == pytest.approx(-0.8, abs=max(0.05, 4 * found.std))
    assert any("the mass is negative" in text for text in found.warnings)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"arm": puma560.dynamics()}, "arm must be of type Arm"),
        ({"record": RIG}, "records must be at least one Record; got Rig"),
        ({"position": (0, 1)}, "position must have shape"),
        ({"postion": PLACE}, "Did you mean 'position'"),
        ({"link": 0, "position": (0, 0, 0)}, "load does not in this motion"),
        ({"record": [RIG]}, "records must be at least one Record; got Rig"),
        ({"record": []}, "records must be at least one Record"),
        ({"mass": (2.0, 1.0)}, "mass must increase"),
        ({"mass": (-1.0, 1.0), "position": None}, "mass must be positive where the place"),
        ({"friction": -0.1}, "friction must not be negative"),
        ({"inertia": (1.0, 2.0)}, "inertia must have shape"),
        ({"link": "hand"}, "link must be one of"),
        (
            {"link": 0, "position": None},
            "mass and centre of the load must be separately identifiable",
        ),
    ],
)
def test_bad_input_is_refused(change, says):
    given = {"arm": puma560.literature_arm(), "record": log(0.0), "position": PLACE}
    with pytest.raises(ValueError, match=says):
        find_load(**(given | change))


# -- an arm that was identified ------------------------------------------------------------------
@pytest.mark.slow
def test_what_is_uncertain_of_the_arm_is_uncertain_of_the_load():
    """Under PID the log tells f more closely than the identification did, and contradicts an arm
    taken as exact.
    """
    unknown = (
        *ARM.dynamics.names,
        *(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in (0, 1)),
    )
    own = dataclasses.replace(
        simulate(ARM, dataclasses.replace(RIG, drive=WORN), LAW, PATH), rig=RIG
    )
    known, record = (
        identify(ARM.dynamics, own, unknown=unknown, progress=False),
        worn_log(law=PID_LAW, duration=2.2),
    )
    found, exact = (find_load(arm, record, PLACE) for arm in (known, known.arm))
    assert any("no load on this arm explains the logs" in text for text in exact.warnings)
    assert not found.warnings
    assert found.std < exact.std / 3
    assert abs(z(found)) < 3
    bare = dataclasses.replace(
        known, fit=dataclasses.replace(known.fit, covariance=None, fallback_reason="no fit")
    )
    with pytest.raises(ValueError, match="needs a covariance here; this has none: no fit"):
        find_load(bare, record, PLACE)
