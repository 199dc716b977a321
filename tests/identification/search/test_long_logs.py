"""Parts that stand for a long log: where they are, that they show what comes late, and that f is
the whole log's.
"""

import dataclasses
import itertools

import numpy as np
import pytest

from identification import identify
from identification.search import problem as long_logs
from plant import PID, LoggedTorque, Resumed, puma560, simulate

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
COUNT = 15_000


@pytest.fixture
def short(monkeypatch):
    """What counts as long: lowered to logs that a test can afford."""
    monkeypatch.setattr(long_logs, "LONG", 8000)
    monkeypatch.setattr(long_logs, "PARTS", 8)


def simulated(**options):
    made = simulate(
        ARM, RIG, puma560.p_law(), PATH, duration=COUNT * RIG.period, steps_per_sample=16
    )
    return dataclasses.replace(made, **options)


def changed(row):
    """A log whose robot has 40 % more friction from this sample on, of which its rig says
    nothing.
    """
    before = simulated()
    drive = dataclasses.replace(
        RIG.drive, viscous=1.4 * RIG.drive.viscous, coulomb=1.4 * RIG.drive.coulomb
    )
    after = simulate(
        ARM,
        dataclasses.replace(RIG, drive=drive),
        puma560.p_law(),
        PATH.later(before.t[row]),
        duration=(COUNT - row) * RIG.period,
        steps_per_sample=16,
        initial=(before.true_q[row], before.true_qd[row]),
    )
    joined = {
        name: np.concatenate([getattr(before, name)[:row], getattr(after, name)])
        for name in ("reference_pulses", "error_pulses")
    }
    return dataclasses.replace(
        before, **joined, torque=None, current=None, true_q=None, true_qd=None
    )


def test_parts_are_spread_from_the_first_sample_to_the_last(short):
    rows = long_logs.parts_of(simulated())
    assert (rows[0].start, rows[-1].stop, len(rows)) == (0, COUNT, 8)
    assert np.ptp([b.start - a.start for a, b in itertools.pairwise(rows)]) <= 1
    assert {part.stop - part.start for part in rows} == {1000}


def test_parts_are_where_the_arm_moves(short):
    log = simulated()
    stands = slice(1200, 3400)  # the parts that begin at 2000 and 4000 would stand still, or nearly
    counts = log.counts.copy()
    counts[stands] = counts[1200]
    still = dataclasses.replace(log, error_pulses=log.reference_pulses - counts)
    own = long_logs.parts_of(still)[1]
    assert own.start > 2000
    assert own.stop <= 3750


@pytest.mark.slow
def test_f_is_that_of_the_whole_log_and_its_intervals_too(short, monkeypatch):
    log = simulated()
    parts = identify(ARM.dynamics, log, method="prediction_error", progress=False)
    told, said = "on 20 parts of 2,500, spread over it", str(parts)
    monkeypatch.setattr(long_logs, "LONG", 50_000)
    whole = identify(ARM.dynamics, log, method="prediction_error", progress=False)
    np.testing.assert_array_equal(parts.f, whole.f)
    np.testing.assert_array_equal(parts.fit.noise_covariance, whole.fit.noise_covariance)
    assert parts.diagnostics.detection.names == whole.diagnostics.detection.names == ()
    np.testing.assert_allclose(parts.fit.std, whole.fit.std, rtol=0.3)
    assert told in said
    assert told not in str(whole)


@pytest.mark.slow
def test_friction_that_rises_in_the_last_eighth_is_told(short):
    found = identify(
        ARM.dynamics, changed(COUNT * 7 // 8), method="prediction_error", progress=False
    )
    assert found.diagnostics.detection.names


def test_the_genetic_search_of_parts_leads_to_the_arm(short):
    found = identify(ARM.dynamics, simulated(), seed=1, progress=False)
    assert (abs(found.f - ARM.f) < 4 * found.fit.std).all()
    costs = found.search.initial_costs
    assert found.search.initial_objective == costs.min()
    assert costs.min() < found.diagnostics.objective  # of 8,000 samples, not of 15,000


@pytest.mark.parametrize("logged", [True, False])
def test_a_law_with_memory_is_in_parts_where_its_torque_is_known(short, logged):
    pid = PID(
        gain=(0.1, 0.075),
        derivative=(4e-4, 3e-4),
        filter=3000.0,
        integral=(0.5, 0.4),
        period=RIG.period,
    )
    log = simulate(ARM, RIG, pid, PATH, duration=COUNT * RIG.period)
    law = LoggedTorque() if logged else Resumed(law=pid, state=pid.initial_state(2)).along(RIG)
    parts = long_logs.in_parts(dataclasses.replace(log, law=law))
    assert len(parts) == (8 if logged else 1)
    rows = long_logs.parts_of(parts[0] if not logged else dataclasses.replace(log, law=law))
    for part, own in zip(parts, rows, strict=True):
        np.testing.assert_array_equal(part.torque, log.torque[own])
