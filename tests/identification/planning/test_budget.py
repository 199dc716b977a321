"""Pulse budget: worth of each number against simulations, the bound against the scatter of fits
to rounded readings.
"""

import dataclasses

import numpy as np
import pytest

from identification import pulse_budget
from identification.replay import Prediction, gauss_newton
from plant import PointToPoint, puma560, simulate
from plant.machine import smooth_rig

ARM, RIG, LAW, PATH = puma560.arm(), puma560.rig(), puma560.p_law((0.1, 0.08)), puma560.reference()


@pytest.fixture(scope="module")
def budget():
    return pulse_budget(ARM, RIG, LAW, PATH)


def test_one_per_cent_is_worth_what_a_simulation_says(budget):
    rig = smooth_rig(RIG)
    base = simulate(ARM, rig, LAW, PATH).error_pulses
    for i in (0, 2, 8):
        f = ARM.f.copy()
        f[i] *= 1.01
        change = np.abs(simulate(ARM.dynamics.arm(f), rig, LAW, PATH).error_pulses - base)
        # 1 % is not nothing: the mode goes out of step
        assert budget.peak[i] == pytest.approx(change.max(), rel=0.2)
        assert budget.rms[i] == pytest.approx(np.sqrt((change**2).mean()), rel=0.2)


def test_bound_is_the_scatter_of_fits_to_readings_that_err_by_rounding_alone(budget):
    """A loop without rounding, read with an error evenly spread over a cell: output error
    reaches the bound.
    """
    made, random, found = simulate(ARM, smooth_rig(RIG), LAW, PATH), np.random.default_rng(0), []
    for _ in range(12):
        noise = random.uniform(-0.5, 0.5, made.error_pulses.shape)
        log = dataclasses.replace(made, error_pulses=made.error_pulses + noise)
        prediction = Prediction(ARM.dynamics, log, simulated=True)
        prediction._followed[0].weight[:] = 1.0
        fit = gauss_newton(prediction, ARM.f, budget.bound * 0.1, np.array([(-np.inf, np.inf)] * 9))
        found.append((fit.values - ARM.f) / budget.bound)
    assert 0.75 < np.sqrt(np.mean(np.square(found))) < 1.3


def test_what_is_known_helps(budget):
    assert (budget.bound_alone <= budget.bound).all()
    text = str(budget).splitlines()
    assert len(text) == 11
    assert text[2].startswith("f1")


def test_friction_and_gains_have_a_worth_too():
    names = (*ARM.dynamics.names, "drive.coulomb[0]", "law.gain[1]")
    wider = pulse_budget(ARM, RIG, LAW, PATH, unknown=names)
    assert wider.names == names
    assert (wider.peak[-2:] > 0.01).all()


def test_dry_friction_of_zero_has_the_bound_of_hardly_any():
    def bound(coulomb):
        rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, coulomb=coulomb))
        unknown = (*ARM.dynamics.names, "drive.coulomb[0]")
        return pulse_budget(ARM, rig, LAW, PATH, unknown=unknown, duration=1.0).bound[-1]

    assert bound((0.0, 0.1)) == pytest.approx(bound((1e-4, 0.1)), rel=0.02)


def test_a_number_of_zero_is_not_the_weakest():
    drive = dataclasses.replace(RIG.drive, viscous=(0.0, 1e-3))
    rig = dataclasses.replace(RIG, drive=drive)
    unknown = (*ARM.dynamics.names, "drive.viscous[0]")
    budget = pulse_budget(ARM, rig, LAW, PATH, unknown=unknown, duration=0.5)
    assert budget.peak[-1] == 0
    assert "f8 is excited least" in repr(budget)


def test_a_step_that_loses_the_log_is_shortened_without_another_result(budget, monkeypatch):
    simulated = Prediction.all_innovations
    moved = []

    def lost_once(self, values):
        """Innovations; the first steps of the second number lose the log."""
        rows = list(simulated(self, values))
        for i, row in enumerate(values):
            step = abs(row[1] - ARM.f[1])
            moved.append(step)
            if step > 0.5e-4 * abs(ARM.f[1]):
                rows[i] = np.full_like(rows[i], np.inf)
        return rows

    monkeypatch.setattr(Prediction, "all_innovations", lost_once)
    shortened = pulse_budget(ARM, RIG, LAW, PATH)
    assert max(moved) > 3 * min(step for step in moved if step)
    for name in ("peak", "rms", "bound", "bound_alone"):
        np.testing.assert_allclose(getattr(shortened, name), getattr(budget, name), rtol=1e-3)


def test_numbers_without_worth_are_refused():
    still = PointToPoint(start=(0.0, 0.5), goal=(0.5, 0.5), duration=0.5)
    with pytest.raises(ValueError, match=r"separately identifiable|does not in this motion"):
        pulse_budget(
            ARM,
            RIG,
            LAW,
            PATH,
            unknown=(*ARM.dynamics.names, "drive.motor_inertia[0]"),
            duration=0.3,
        )
    with pytest.raises(ValueError, match="Did you mean 'unknown'"):
        pulse_budget(ARM, RIG, LAW, still, unknwon=("f1",))
