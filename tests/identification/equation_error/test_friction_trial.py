"""Friction that is simulated and not modelled is named by its kind and its level; friction that
is modelled, none.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest
from coupled_arm import PERIOD, arm_of, path_of, rig_of

from identification import fit_torque
from identification.equation_error import FrictionTrial, gain
from plant import FrictionCurve

RIG = rig_of(coulomb=(0.1, 0.08, 0.05), current_limit=(20.0,) * 3)
ARM, MOTION, COUPLING = arm_of(RIG), path_of(4.0)(np.arange(0, 8, PERIOD)), RIG.drive.coupling
SHAFT = COUPLING.shaft(MOTION.qd)
USUAL, COULOMB = np.sqrt((SHAFT**2).mean(axis=0)), RIG.drive.joint_coulomb()
VISCOUS = RIG.drive.joint_viscous()
RIGID = np.array([ARM.inverse(*state) for state in zip(*MOTION, strict=True)])
LOAD = RIGID - RIG.drive.rotor_torque(MOTION.qdd)  # what the gears transmit
FRICTION = tuple(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(3))

KINDS = {  # torque on the shafts beside Coulomb and viscous friction
    None: 0 * SHAFT,
    "asymmetric": 0.25 * COULOMB + 0 * SHAFT,
    "load-dependent": 0.08 * np.abs(COUPLING.shaft_torque(LOAD)) * np.sign(SHAFT),
    "Stribeck": 0.8 * COULOMB * np.exp(-((SHAFT / (0.12 * USUAL)) ** 2)) * np.sign(SHAFT),
    # In place of what is in proportion to the speed: arsinh, which is that at low speed.
    "saturating viscous": VISCOUS * (0.3 * USUAL * np.arcsinh(SHAFT / (0.3 * USUAL)) - SHAFT),
    # In place of the Coulomb level: half of it at 0.1 of the usual speed.
    "rising": -COULOMB * np.sign(SHAFT) * 0.1 * USUAL / (np.abs(SHAFT) + 0.1 * USUAL),
}
FITTED = (None, "asymmetric", "rising")  # where evidence asks for it, the others are named


def fit(kind, unknown=FRICTION, rig=RIG, **options):
    shaft = COULOMB * np.sign(SHAFT) + RIG.drive.joint_viscous() * SHAFT + KINDS[kind]
    noise = 0.5 * np.random.default_rng(0).normal(size=RIGID.shape)
    torque = RIGID + COUPLING.joint_torque(shaft) + noise
    return fit_torque(
        ARM.dynamics, MOTION.q, torque, rig=rig, unknown=(*ARM.dynamics.names, *unknown), band=25.0,
        **options,
    )  # fmt: skip


@cache
def plain(kind):
    """With what the rig states, and everything unknown: one fit for all tests."""
    return fit(kind)


def test_a_level_that_rises_with_speed_is_fitted_and_its_levels_are_within_intervals():
    found = plain("rising")
    assert found.rising is not None
    assert not any("rising" in warning for warning in found.warnings)
    shares = found.rig.drive.curve.rise / (USUAL * np.abs(RIG.drive.gear))
    np.testing.assert_allclose(shares, 0.1, rtol=0.3)
    names = [f"drive.coulomb[{i}]" for i in range(3)]
    off = np.array([found[name] for name in names]) - RIG.drive.coulomb
    std = np.array([found.std[found.names.index(name)] for name in names])
    # The speeds of the rise are a grid's: their steps move the level by some hundredths.
    assert (np.abs(off) < 3 * std + 0.03 * RIG.drive.coulomb).all(), off / std


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "rising"])
def test_no_other_kind_is_fitted_as_one_that_rises(kind):
    assert plain(kind).rising is None


OFFSETS = tuple(f"drive.curve.offset[{i}]" for i in range(3))


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in FITTED])
def test_the_kind_is_named_first(kind):
    found = plain(kind)
    first = found.friction[0]
    assert first.kind == kind
    assert first.clear
    assert [kind in warning for warning in found.warnings].count(True) == 1
    # The place is the warning's: another trial of the fit has the same advice for itself.
    named = next(warning for warning in found.warnings if kind in warning)
    assert named == f"{first.advice} (fit.friction[0])"
    assert all("friction[0]" not in trial.advice for trial in found.friction)


def test_offsets_are_fitted_where_there_is_evidence_of_them():
    found = plain("asymmetric")
    assert set(OFFSETS) <= set(found.names)
    np.testing.assert_allclose(
        [found[name] for name in OFFSETS] * RIG.drive.gear, 0.25 * COULOMB, rtol=0.05
    )
    assert not set(OFFSETS) & set(plain(None).names)
    assert not any(trial.clear for trial in found.friction)


def test_offsets_are_those_of_their_joints(monkeypatch):
    monkeypatch.setitem(KINDS, "asymmetric", 0.2 * COULOMB * np.array([0, 1, 0]) + 0 * SHAFT)
    found = fit("asymmetric")
    assert [name for name in OFFSETS if name in found.names] == [OFFSETS[1]]


def test_levels_are_those_that_were_made():
    np.testing.assert_allclose(plain("load-dependent").friction[0].levels, 0.08, rtol=0.1)


def test_what_is_modelled_is_not_accused():
    found = plain(None)
    assert len(found.friction) > 3
    assert not any(trial.clear for trial in found.friction)
    assert found.warnings == []
    assert "blocks kept aside" in " ".join(str(found).split())
    assert fit(None, ()).friction == ()  # no friction is unknown, so none is tried


@pytest.mark.parametrize("kind", ["Stribeck", "saturating viscous", "load-dependent"])
def test_a_drive_that_takes_what_is_found_leaves_nothing_to_find(kind):
    before = plain(kind)
    drive = before.friction[0].drive(RIG.drive)
    after = fit(kind, rig=dataclasses.replace(RIG, drive=drive))
    assert after.relative_error < 0.9 * before.relative_error
    assert not any(trial.clear for trial in after.friction)
    # Friction along the motion is that which was made, also where it depends on the load.
    made = COUPLING.joint_torque(COULOMB * np.sign(SHAFT) + VISCOUS * SHAFT + KINDS[kind])
    got = after.rig.drive.friction(MOTION.qd, LOAD)
    fast = (np.abs(SHAFT) > 0.02 * USUAL).all(axis=1)
    error = np.sqrt(np.mean((got - made)[fast] ** 2, axis=0))
    assert (error < 0.03 * np.sqrt(np.mean(made**2, axis=0))).all()


@pytest.mark.parametrize("kind", ["saturating viscous", "load-dependent"])
def test_its_numbers_are_within_their_intervals(kind):
    """With the speed or the load that was made: the fit of what remains is linear."""
    zero = FrictionCurve(offset=(0, 0, 0), saturation=0.3 * USUAL * np.abs(RIG.drive.gear))
    stated = {
        "saturating viscous": {"curve": zero},
        "load-dependent": {"load_friction": (0.5, 0.5, 0.5)},
    }[kind]
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, **stated))
    shares = tuple(f"drive.load_friction.share[{i}]" for i in range(3))
    unknown = FRICTION + shares * (kind == "load-dependent")
    # Around a reversal the low-pass of a sign is no sign: no noise covers that.
    found = fit(kind, unknown, rig, least_speed=0.1 * USUAL)
    truth = dict(zip(FRICTION, (*RIG.drive.viscous, *RIG.drive.coulomb), strict=True))
    truth |= dict.fromkeys(shares, 0.08) if kind == "load-dependent" else {}
    std = dict(zip(found.names, found.std, strict=True))
    off = [abs(found[name] - value) / std[name] for name, value in truth.items()]
    assert np.mean(np.array(off) < 1.96) > 0.8
    assert max(off) < 5
    assert all(std[name] < 0.2 * value for name, value in truth.items())


def test_viscous_friction_may_differ_by_direction(monkeypatch):
    offset = np.array([3e-4, -6e-4, 2e-4])
    made = offset * RIG.drive.gear**2 * np.sign(SHAFT * RIG.drive.gear) * SHAFT
    monkeypatch.setitem(KINDS, "saturating viscous", made)
    names = tuple(f"drive.curve.viscous_offset[{i}]" for i in range(3))
    curve = FrictionCurve(offset=(0, 0, 0), viscous_offset=(0, 0, 0))
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, curve=curve))
    found = fit("saturating viscous", FRICTION + names, rig)
    np.testing.assert_allclose([found[name] for name in names], offset, rtol=0.05)


def test_joints_have_stribeck_speeds_of_their_own(monkeypatch):
    speeds = np.array((0.08, 0.2, 0.3))
    made = 0.8 * COULOMB * np.exp(-((SHAFT / (speeds * USUAL)) ** 2)) * np.sign(SHAFT)
    monkeypatch.setitem(KINDS, "Stribeck", made)
    first = fit("Stribeck").friction[0]
    assert first.kind == "Stribeck"
    np.testing.assert_allclose(first.share, speeds, rtol=0.35)
    np.testing.assert_allclose(first.levels, 0.8 * COULOMB, rtol=0.25)


def trial(kind, levels, share=(0.1, 0.1, 0.1)):
    units = ("N m",) * 3
    return FrictionTrial(
        kind=kind, share=share, better=0.5, errors=9.0, levels=np.array(levels), units=units,
        usual=USUAL,
    )  # fmt: skip


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in (None, "asymmetric")])
def test_a_level_that_is_slightly_negative_becomes_none_at_all(kind):
    got = trial(kind, [0.5, -0.1, 0.5]).drive(RIG.drive)
    assert got == trial(kind, [0.5, 0.0, 0.5]).drive(RIG.drive)


def test_a_joint_that_was_not_tried_keeps_a_level_that_does_not_rise():
    drive = trial("rising", [5.0, np.nan, 5.0]).drive(RIG.drive)
    assert drive.coulomb[1] == RIG.drive.coulomb[1]
    np.testing.assert_array_equal(drive.curve.rise > 0, [True, False, True])


def test_speeds_that_print_alike_are_one():
    assert "at 10% of the usual speed:" in str(trial("Stribeck", COULOMB, (0.101, 0.102, 0.1)))


def test_a_gain_is_relative_to_the_losses_of_its_own_blocks():
    """A block that another fit cannot predict, here the loudest, counts on neither side."""
    losses = np.array([1.0, 1.2, 100.0])
    gains = np.array([0.5, 0.6, np.nan])
    assert gain(losses, gains) == gain(losses[:2], gains[:2])
    assert gain(np.ones(1), gains)[0] == pytest.approx(0.55)


def test_what_a_drive_cannot_have_twice_is_refused():
    for kind, says in (
        ("Stribeck", "one Stribeck speed"),
        ("saturating viscous", "one saturation"),
    ):
        first = plain(kind).friction[0]
        with pytest.raises(ValueError, match=says):
            first.drive(first.drive(RIG.drive))
