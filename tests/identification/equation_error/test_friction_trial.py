"""Friction that is simulated and not modelled is named by its kind and its level; friction that
is modelled, none.
"""

import dataclasses

import numpy as np
import pytest
from coupled_arm import PERIOD, arm_of, path_of, rig_of

from identification import fit_torque

RIG = rig_of(coulomb=(0.1, 0.08, 0.05), current_limit=(20.0,) * 3)
ARM, MOTION, COUPLING = arm_of(RIG), path_of(4.0)(np.arange(0, 8, PERIOD)), RIG.drive.coupling
SHAFT = COUPLING.shaft(MOTION.qd)
USUAL, COULOMB = np.sqrt((SHAFT**2).mean(axis=0)), RIG.drive.joint_coulomb()
RIGID = np.array([ARM.inverse(*state) for state in zip(*MOTION, strict=True)])
FRICTION = tuple(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(3))

KINDS = {  # torque on the shafts beside Coulomb and viscous friction
    None: 0 * SHAFT,
    "asymmetric": 0.25 * COULOMB + 0 * SHAFT,
    "load-dependent": 0.08 * np.abs(COUPLING.shaft_torque(RIGID)) * np.sign(SHAFT),
    "Stribeck": 0.8 * COULOMB * np.exp(-((SHAFT / (0.12 * USUAL)) ** 2)) * np.sign(SHAFT),
    "saturating viscous": COULOMB * np.tanh(SHAFT / (0.5 * USUAL)),
}


def fit(kind, unknown=FRICTION, rig=RIG):
    shaft = COULOMB * np.sign(SHAFT) + RIG.drive.joint_viscous() * SHAFT + KINDS[kind]
    noise = 0.5 * np.random.default_rng(0).normal(size=RIGID.shape)
    torque = RIGID + COUPLING.joint_torque(shaft) + noise
    return fit_torque(
        ARM.dynamics, MOTION.q, torque, rig=rig, unknown=(*ARM.dynamics.names, *unknown), band=25.0
    )


OFFSETS = tuple(f"drive.curve.offset[{i}]" for i in range(3))


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in (None, "asymmetric")])
def test_the_kind_is_named_first(kind):
    found = fit(kind)
    first = found.friction[0]
    assert first.kind == kind
    assert first.clear
    assert [kind in warning for warning in found.warnings].count(True) == 1


def test_offsets_are_fitted_where_there_is_evidence_of_them():
    found = fit("asymmetric")
    assert set(OFFSETS) <= set(found.names)
    np.testing.assert_allclose(
        [found[name] for name in OFFSETS] * RIG.drive.gear, 0.25 * COULOMB, rtol=0.05
    )
    assert not set(OFFSETS) & set(fit(None).names)
    assert not any(trial.clear for trial in found.friction)


def test_offsets_are_those_of_their_joints(monkeypatch):
    monkeypatch.setitem(KINDS, "asymmetric", 0.2 * COULOMB * np.array([0, 1, 0]) + 0 * SHAFT)
    found = fit("asymmetric")
    assert [name for name in OFFSETS if name in found.names] == [OFFSETS[1]]


def test_levels_are_those_that_were_made():
    np.testing.assert_allclose(fit("load-dependent").friction[0].levels, 0.08, rtol=0.1)


def test_what_is_modelled_is_not_accused():
    found = fit(None)
    assert len(found.friction) > 3
    assert not any(trial.clear for trial in found.friction)
    assert found.warnings == []
    assert "blocks kept aside" in " ".join(str(found).split())
    assert fit(None, ()).friction == ()  # no friction is unknown, so none is tried


@pytest.mark.parametrize("kind", ["Stribeck"])
def test_a_drive_that_takes_what_is_found_leaves_nothing_to_find(kind):
    before = fit(kind)
    drive = before.friction[0].drive(RIG.drive)
    after = fit(kind, rig=dataclasses.replace(RIG, drive=drive))
    assert after.relative_error < 0.9 * before.relative_error
    assert not any(trial.clear for trial in after.friction)
    speed = 0.3 * USUAL
    made = RIG.drive.friction(COUPLING.joint(speed)) + COUPLING.joint_torque({
        "Stribeck": 0.8 * COULOMB * np.exp(-((0.3 / 0.12) ** 2)),
    }[kind])  # fmt: skip
    fitted = dataclasses.replace(
        drive, coulomb=[after[f"drive.coulomb[{i}]"] for i in range(3)],
        viscous=[after[f"drive.viscous[{i}]"] for i in range(3)],
    )  # fmt: skip
    np.testing.assert_allclose(fitted.friction(COUPLING.joint(speed)), made, rtol=0.1)


def test_joints_have_stribeck_speeds_of_their_own(monkeypatch):
    speeds = np.array((0.08, 0.2, 0.3))
    made = 0.8 * COULOMB * np.exp(-((SHAFT / (speeds * USUAL)) ** 2)) * np.sign(SHAFT)
    monkeypatch.setitem(KINDS, "Stribeck", made)
    first = fit("Stribeck").friction[0]
    assert first.kind == "Stribeck"
    np.testing.assert_allclose(first.share, speeds, rtol=0.35)
    np.testing.assert_allclose(first.levels, 0.8 * COULOMB, rtol=0.25)


def test_what_no_drive_has_is_refused():
    assert fit("load-dependent").friction[0].drive(RIG.drive).load_friction.share == pytest.approx(
        0.08, rel=0.1
    )
    with pytest.raises(
        ValueError, match="must be one that a drive has; got saturating viscous friction"
    ):
        fit("saturating viscous").friction[0].drive(RIG.drive)
    stribeck = fit("Stribeck").friction[0]
    with pytest.raises(ValueError, match="one Stribeck speed"):
        stribeck.drive(stribeck.drive(RIG.drive))
