"""Stiffness and damping as unknowns: simulated robots of known resonance, found from one log; rigid
ones; refusals.

The robot is stepped four times finer than the model. Truth is stated as the resonance of each link
against its locked motor, which `Elasticity.from_resonance` and the identification work out apart.
"""

import dataclasses
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from identification import identify, nearest_physical
from identification.replay import Start
from identification.search import elastic
from plant import Elasticity, puma560, simulate

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference(2.0)
NAMES = ARM.dynamics.names
GEARS = tuple(
    f"drive.elasticity.{what}[{i}]" for what in ("stiffness", "damping") for i in range(2)
)
WIDTH = np.ptp(puma560.PRINTED_RANGES, axis=1)


def on(elasticity, side="motor"):
    encoder = dataclasses.replace(RIG.encoder, side=side)
    return dataclasses.replace(
        RIG, drive=dataclasses.replace(RIG.drive, elasticity=elasticity), encoder=encoder
    )


def gears(hz, ratio=0.02):
    return Elasticity.from_resonance(ARM, hz, ratio, drive=RIG.drive)


@cache
def log(hz, side="motor"):
    rig = RIG if hz is None else on(gears(hz), side)
    return simulate(ARM, rig, puma560.p_law((0.1, 0.08)), PATH, steps_per_sample=16)


@cache
def found(hz):
    """From a log whose rig says nothing of gears."""
    return identify(
        ARM.dynamics, dataclasses.replace(log(hz), rig=RIG), elasticity=True, progress=False
    )


def holds(resonance, hz):
    return (resonance.low <= hz) & (hz <= resonance.high)


@pytest.mark.parametrize("hz", [(25, 25), pytest.param((60, 40), marks=pytest.mark.slow)])
def test_resonances_are_found_and_their_intervals_hold_them(hz):
    result = found(hz)
    resonance = result.fit.resonance
    assert resonance.searched.all()
    np.testing.assert_allclose(resonance.hz, hz, rtol=0.1)
    assert holds(resonance, hz).all()
    assert (resonance.high < 1.3 * resonance.low).all()
    assert holds(
        dataclasses.replace(resonance, low=resonance.damping_low, high=resonance.damping_high), 0.02
    ).all()
    assert (np.abs(result.f - ARM.f) / WIDTH).max() < 0.06
    # Rig, table and values say the same.
    elasticity = Elasticity.from_resonance(
        result.arm, resonance.hz, resonance.damping_ratio, drive=RIG.drive
    )
    np.testing.assert_allclose(
        result.rig.drive.elasticity.stiffness, elasticity.stiffness, rtol=1e-9
    )
    np.testing.assert_allclose(result.fit.values[-2:], elasticity.damping, rtol=1e-9)
    assert result.fit.unknown == (*NAMES, *GEARS)
    assert (result.fit.std > 0).all()
    assert result.warnings == []


def test_slopes_of_a_number_on_its_bound_are_one_sided(monkeypatch):
    """Of friction at zero a central one vanishes, and no profile would fit it again."""
    taken = []

    def stopped(view, best, change, *_, **__):
        taken.append(change)
        raise StopIteration

    monkeypatch.setattr(elastic, "Profile", stopped)
    rows = np.array([[1.0, 2.0], [3.0, -1.0]])
    view = SimpleNamespace(
        unknown=("period", "friction"),
        weights=np.ones(2),
        stiffness={0: 0},
        settle=lambda z: 1.0,
        inertia=lambda z: np.ones(1),
        innovations=lambda z: rows @ np.abs(z),
        all_innovations=lambda vectors: [rows @ np.abs(z) for z in vectors],
    )
    start = Start(np.array([1.0, 0.0]), np.full(2, 1e-3), np.array([[0.5, 2.0], [0.0, 1.0]]))
    with pytest.raises(StopIteration):
        elastic.Intervals(view, SimpleNamespace(values=start.coordinates), start, final=True)
    np.testing.assert_allclose(taken[0], 1e-3 * rows, rtol=1e-9)


@pytest.mark.slow
def test_a_rigid_log_gives_a_bound_and_no_number():
    """And f about as well as without gears."""
    result = found(None)
    resonance = result.fit.resonance
    assert np.isinf(resonance.hz).all()
    assert np.isinf(resonance.high).all()
    assert ((resonance.low > 80) & (resonance.low < 500)).all()
    assert (result.fit.std[9:] == 0).all()
    text = result.summary()
    for i, label in enumerate(resonance.joints):
        assert f"{label} stiffer than {resonance.low[i]:.0f}" in " ".join(text.split())
    assert text.count("bounded") == 4
    assert (np.abs(result.f - ARM.f) / WIDTH).max() < 0.06


@pytest.mark.slow
def test_what_a_rig_says_is_a_guess_that_may_be_far_off():
    """Stiffness 16 times too large and damping nought: the same resonances to within their
    intervals.
    """
    wrong = gears((60, 40))
    wrong = dataclasses.replace(wrong, stiffness=16 * wrong.stiffness, damping=(0, 0))
    record = dataclasses.replace(log((60, 40)), rig=on(wrong))
    again = identify(ARM.dynamics, record, unknown=(*NAMES, *GEARS), progress=False).fit.resonance
    np.testing.assert_allclose(again.hz, found((60, 40)).fit.resonance.hz, rtol=0.01)


@pytest.mark.slow
def test_one_gear_unknown_and_the_others_known():
    record = dataclasses.replace(log((60, 40)), rig=on(gears((60, 100))))
    result = identify(ARM.dynamics, record, unknown=(*NAMES, GEARS[1]), progress=False)
    assert result.fit.resonance.searched.tolist() == [False, True]
    assert result.fit.resonance.hz[1] == pytest.approx(40, rel=0.05)
    stiffness = result.rig.drive.elasticity.stiffness
    assert stiffness[0] == gears(60).stiffness[0]
    assert "as the rig says" in str(result.fit.resonance)


@pytest.mark.slow
def test_backlash_that_no_rig_states_leaves_a_bound():
    """It makes the gear look softer than it is: 70 Hz look like 53."""
    played = Elasticity.from_resonance(ARM, 70, 0.02, drive=RIG.drive, backlash=(2e-4, 2e-4))
    record = simulate(ARM, on(played), puma560.p_law((0.1, 0.08)), PATH, steps_per_sample=16)
    result = identify(
        ARM.dynamics,
        dataclasses.replace(record, rig=on(gears(70))),
        unknown=(*NAMES, GEARS[1]),
        progress=False,
    )
    resonance = result.fit.resonance
    assert "joint 3 (q[1])" in resonance.played
    assert resonance.hz[1] < 65
    assert 30 < resonance.low[1] < 70
    assert np.isinf(resonance.high[1])
    assert np.isfinite(resonance.high[0])
    assert "joint 3 (q[1]) stiffer than" in " ".join(str(resonance).split())
    assert "bounds alone: backlash was found at" in " ".join(result.summary().split())


def test_gears_that_are_known_leave_f_alone_to_find():
    result = identify(ARM.dynamics, log((25, 25)), progress=False)
    assert result.fit.unknown == NAMES
    assert not result.fit.resonance.searched.any()
    np.testing.assert_allclose(result.fit.resonance.hz, 25, rtol=0.02)
    assert (np.abs(result.f - ARM.f) / WIDTH).max() < 0.06


def test_a_second_sensor_shows_stiffness_directly():
    """Where one sensor leaves an interval of 20 %, the second one leaves a few."""
    rig = on(Elasticity(stiffness=(1e5, 1e5), damping=(10, 10)), "both")
    record = dataclasses.replace(log((100, 80), "both"), rig=rig)
    resonance = identify(
        ARM.dynamics, record, unknown=(*NAMES, *GEARS), progress=False
    ).fit.resonance
    np.testing.assert_allclose(resonance.hz, [100, 80], rtol=0.05)
    assert holds(resonance, [100, 80]).all()
    assert (resonance.high < 1.2 * resonance.low).all()


@pytest.mark.slow
def test_a_second_sensor_on_one_link_narrows_the_interval_of_its_gear():
    rig = on(Elasticity(stiffness=(1e5, 1e5), damping=(10, 10)), ("both", "motor"))
    record = dataclasses.replace(log((100, 80), ("both", "motor")), rig=rig)
    resonance = identify(
        ARM.dynamics, record, unknown=(*NAMES, *GEARS), progress=False
    ).fit.resonance
    np.testing.assert_allclose(resonance.hz, [100, 80], rtol=0.1)
    assert holds(resonance, [100, 80]).all()
    assert resonance.high[0] < 1.2 * resonance.low[0]


def test_rigid_identification_has_no_resonance_to_tell():
    record = simulate(ARM, RIG, puma560.p_law((0.1, 0.08)), PATH, duration=0.5)
    result = identify(ARM.dynamics, record, method="prediction_error", progress=False)
    assert result.fit.resonance is None
    assert "resonance" not in result.summary()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"elasticity": 1}, "elasticity must be"),
        (
            {"elasticity": True, "ranges": puma560.PRINTED_RANGES},
            "ranges need every unknown by name",
        ),
        ({"elasticity": True, "method": "equation_error"}, "can be found by prediction error"),
        ({"elasticity": True, "method": "paper"}, "ranges must be given"),
    ],
)
def test_what_cannot_be_searched_is_refused_in_one_line(options, text):
    record = dataclasses.replace(log((25, 25)), rig=RIG)
    with pytest.raises(ValueError, match=text) as caught:
        identify(ARM.dynamics, record, progress=False, **options)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_logs_that_no_start_follows_are_refused():
    """Errors with the wrong sign."""
    short = log((25, 25)).cut(0.0, 1.0)
    turned = dataclasses.replace(short, rig=RIG, error_pulses=-short.error_pulses)
    with pytest.raises(ValueError, match="must start from an arm that follows the log"):
        identify(ARM.dynamics, turned, elasticity=True, progress=False)


def test_the_nearest_physical_arm_takes_such_an_identification():
    boxes = [[(0.0, 0.45), (-0.2, 0.2), (0, 0)], [(-0.2, 0.2), (-0.6, 0.1), (0, 0)]]
    assert np.isfinite(nearest_physical(found((25, 25)), boxes).distance)
