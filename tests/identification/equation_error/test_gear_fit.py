"""The torque equation behind elastic gears: exact motions made backwards, the rigid limit, and a
simulated P loop.
"""

import dataclasses

import numpy as np
import pytest
from elastic_motion import STIFFNESS, experiment

from identification.equation_error import (
    GearFitSettings,
    Known,
    Prior,
    fit_deflection,
    fit_gears,
    mode_in,
    record_band,
    regressor_along,
)
from plant import Elasticity, JointSpring, LoggedTorque, puma560, simulate
from plant.motion import Motion


@pytest.fixture(scope="module")
def made():
    return experiment()


def test_the_compliances_of_an_exact_motion_are_found_among_others(made):
    """In the band of the motion; a rigid fit is far off. Coupled shafts: each motor turns
    several joints.
    """
    dynamics, record, f = made
    grid = np.geomspace(1 / 9, 9, 5)[:, None] / STIFFNESS
    fit = fit_gears(dynamics, [record], dynamics.names, Known(), grid)[0]
    np.testing.assert_array_equal(fit.compliance, 1 / STIFFNESS)
    rigid = fit_gears(dynamics, [record], dynamics.names, Known(), np.full((1, 3), 1e-12))[0]
    assert np.abs(fit.torque.values - f).max() < 0.012 < 0.1 < np.abs(rigid.torque.values - f).max()


def test_wrong_names_are_named(made):
    dynamics, record, _ = made
    grid = 1 / STIFFNESS[None]
    with pytest.raises(ValueError, match=r"drive\.viscous\[7\]"):
        fit_gears(dynamics, [record], (*dynamics.names, "drive.viscous[7]"), Known(), grid)


@pytest.fixture(scope="module")
def logged():
    """A P loop on gears of 40 Hz, and these gears."""
    arm, rig = puma560.literature_arm(1.5), puma560.rig()
    elasticity = Elasticity.from_resonance(arm, 40, 0.02, drive=rig.drive)
    elastic = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=elasticity))
    law, path = puma560.p_law((0.1, 0.08)), puma560.reference()
    log = simulate(arm, elastic, law, path, steps_per_sample=8)
    return arm, dataclasses.replace(log, rig=rig), elasticity


def test_numbers_in_rows_without_weight_spoil_no_fit_of_gears(logged):
    """Neither its bands, which the oscillation of the errors gives, nor its motions."""
    arm, record, elasticity = logged
    gap = np.zeros((len(record), 1), bool)
    gap[2000:2040] = True
    spoilt = dataclasses.replace(
        record,
        error_pulses=np.where(gap, record.reference_pulses, record.error_pulses),
        valid=np.where(gap[:, 0], 0.0, 1.0),
    )
    assert mode_in(spoilt) == pytest.approx(mode_in(record), rel=0.02)
    grid = 1.3 ** np.arange(-4.0, 5.0, 2)[:, None] / elasticity.stiffness
    names = arm.dynamics.names
    whole, found = (fit_gears(arm.dynamics, [r], names, Known(), grid) for r in (record, spoilt))
    for with_all, without in zip(whole[2:], found[2:], strict=True):
        np.testing.assert_array_equal(without.compliance, with_all.compliance)
        assert without.torque.relative_error == pytest.approx(with_all.torque.relative_error, 0.1)


def test_a_joint_without_equations_has_no_say_in_the_gears_of_others(logged):
    """It stands still, and a prior gives what the log does not."""
    arm, record, elasticity = logged
    counts = np.array(record.counts)
    counts[:, 1] = counts[0, 1]
    still = dataclasses.replace(
        record, error_pulses=record.reference_pulses - counts, law=LoggedTorque()
    )
    known = Known({}, Prior.of(arm.dynamics, record.rig, (arm, 0.3)))
    grid = np.array([1 / 9, 1.0, 9.0])[:, None] / elasticity.stiffness

    def errors(rows):
        fits = fit_gears(arm.dynamics, [still], arm.dynamics.names, known, rows)
        assert all(np.isnan(fit.torque.sigma[1]) for fit in fits)
        return np.array([fit.torque.sigma[0] for fit in fits])

    of_rows = [errors(row[None]) for row in grid]
    assert np.ptp(of_rows, axis=0).min() > 0
    assert (errors(grid) <= np.min(of_rows, axis=0)).all()


def test_two_sensors_show_compliances_and_the_offset_of_their_zeros(made):
    dynamics, record, f = made
    shifted = dataclasses.replace(
        record, link_counts=record.link_counts + np.array([30.0, -20.0, 10.0])
    )
    for each in (record, shifted):
        seen = fit_deflection(dynamics, [each], dynamics.names, Known())
        np.testing.assert_allclose(seen.compliance * STIFFNESS, 1, atol=0.005)
        assert np.abs(seen.torque.values - f).max() < 0.015
    # an offset for each record
    apart = fit_deflection(dynamics, [record, shifted], dynamics.names, Known())
    np.testing.assert_allclose(apart.compliance, seen.compliance, rtol=1e-3)


def test_missing_rows_do_not_shift_what_follows_them(made):
    dynamics, record, f = made
    kept = np.delete(np.arange(len(record)), slice(3000, 3200))
    columns = ("t", "error_pulses", "reference_pulses", "valid", "torque", "link_counts")
    rows = {name: getattr(record, name)[kept] for name in columns}
    short = dataclasses.replace(record, current=None, **rows)
    seen = fit_deflection(dynamics, [short], dynamics.names, Known())
    np.testing.assert_allclose(seen.compliance * STIFFNESS, 1, atol=0.01)
    assert np.abs(seen.torque.values - f).max() < 0.03
    grid = np.geomspace(1 / 9, 9, 5)[:, None] / STIFFNESS
    fit = fit_gears(dynamics, [short], dynamics.names, Known(), grid)[0]
    np.testing.assert_array_equal(fit.compliance, 1 / STIFFNESS)
    assert np.abs(fit.torque.values - f).max() < 0.02


def test_springs_on_the_links_are_no_part_of_what_the_gears_wind():
    """Both ways to the compliances; without the springs the torque on the links is another."""
    springs = JointSpring(stiffness=(60.0, 40.0, 10.0), angle=(0.4, -0.3, 0.2))
    dynamics, record, f = experiment(springs=springs)
    grid = np.geomspace(1 / 9, 9, 5)[:, None] / STIFFNESS
    fit = fit_gears(dynamics, [record], dynamics.names, Known(), grid)[0]
    np.testing.assert_array_equal(fit.compliance, 1 / STIFFNESS)
    assert np.abs(fit.torque.values - f).max() < 0.012
    seen = fit_deflection(dynamics, [record], dynamics.names, Known())
    np.testing.assert_allclose(seen.compliance * STIFFNESS, 1, atol=0.005)
    unknown = (*dynamics.names, "springs.stiffness[1]")
    other = dataclasses.replace(
        record.rig, springs=dataclasses.replace(springs, stiffness=(60.0, 0.0, 10.0))
    )
    seen = fit_deflection(dynamics, [dataclasses.replace(record, rig=other)], unknown, Known())
    assert seen.torque["springs.stiffness[1]"] == pytest.approx(40.0, abs=0.5)


def test_motors_that_move_with_their_links_are_rigid_gears(made):
    dynamics, record, _ = made
    random = np.random.default_rng(3)
    motion = Motion(*random.normal(size=(3, 7, 3)))
    names = (*dynamics.names, "drive.viscous[1]")
    rigid = regressor_along(dynamics, record.rig, names, motion)
    elastic = regressor_along(dynamics, record.rig, names, motion, motion)
    for a, b in zip(rigid, elastic, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)


def test_rotors_turn_with_the_motors_alone(made):
    """Links that stand still: what is left of the torque is friction and rotors', by hand."""
    dynamics, record, _ = made
    drive, random = record.rig.drive, np.random.default_rng(4)
    still, qd, qdd = np.zeros((5, 3)), *random.normal(size=(2, 5, 3))
    _, given = regressor_along(
        dynamics, record.rig, dynamics.names, Motion(still, still, still), Motion(still, qd, qdd)
    )
    C = np.array(drive.coupling.matrix)
    shaft = 2e-4 * drive.gear**2 * (qdd @ C.T)
    np.testing.assert_allclose(given - drive.friction(qd), shaft @ C, rtol=1e-12)


@pytest.mark.parametrize("hz", [25, 60])
def test_counts_of_a_p_loop_show_its_resonance(hz):
    """From whole counts of the motors alone, to a place of the grid (a factor of 1.3), and f to
    a few per cent.
    """
    arm, rig = puma560.literature_arm(1.5), puma560.rig()
    elasticity = Elasticity.from_resonance(arm, hz, 0.02, drive=rig.drive)
    elastic = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=elasticity))
    log = simulate(
        arm, elastic, puma560.p_law((0.1, 0.08)), puma560.reference(), steps_per_sample=16
    )
    record = dataclasses.replace(log, rig=rig)
    grid = 1.3 ** np.arange(-8.0, 9.0, 2)[:, None] / elasticity.stiffness
    fits = fit_gears(arm.dynamics, [record], arm.dynamics.names, Known(), grid)
    best = min(fits, key=lambda fit: np.abs(fit.torque.values - arm.f).max())
    assert len(fits) == 4
    assert np.median(
        [fit.compliance * elasticity.stiffness for fit in fits], axis=0
    ) == pytest.approx(1, rel=0.75)
    assert (
        np.abs(best.torque.values - arm.f) / np.ptp(puma560.PRINTED_RANGES, axis=1)
    ).max() < 0.06


def test_bands_are_fixed_where_the_log_replays_its_torque_and_multiples_of_the_oscillation_elsewhere():
    record = simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.5
    )
    assert [record_band(record, i) for i in range(4)] == [
        share * mode_in(record) for share in GearFitSettings().bands
    ]
    assert [
        record_band(dataclasses.replace(record, law=LoggedTorque()), i) for i in range(4)
    ] == list(GearFitSettings().replayed_bands)
