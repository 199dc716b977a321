"""A stop that does not drive: lies of encoders, clocks and scripts, beside the arm without
torque from the stop on.
"""

import numpy as np
import pytest
from spoilt import DT, LIES, healthy, told

CASES = {
    ("sign", "hold"): "no torque since joint 2 (q[0]) grew faster in the stop",
    ("sign", "motion"): "no torque since joint 2 (q[0]) ran away: joint 2 (q[0]) moved by",
    ("swap", "motion"): "no torque since joint 2 (q[0]) ran away: joint 2 (q[0]) moved by",
    ("swap", "hold"): "no torque since",
    # no encoder's doing
    ("saturation", "motion"): "ramp to gravity compensation: the torque of joint 2",
    ("nan", "motion"): "no whole numbers",
    ("double", "motion"): "holding: calls lost or doubled",
    ("lost", "motion"): "calls lost or doubled",
}


@pytest.mark.parametrize(("name", "when"), CASES, ids=["-".join(case) for case in CASES])
def test_a_stop_is_no_faster_than_no_torque_and_soon_off_the_limit(name, when):
    run = told(LIES[name], when)
    assert run.stop is not None
    assert CASES[name, when] in run.status
    assert np.abs(run.speed[run.stop :]).max() <= 1.05 * np.abs(run.alone).max()
    assert run.energy[run.stop :].max() <= 1.05 * run.energy_alone.max()
    assert run.at_limit <= 0.05


@pytest.mark.parametrize("name", ["sign", "swap"])
@pytest.mark.parametrize("mujoco", [False, True])
def test_a_joint_that_moves_against_its_torque_stops_the_arm_within_20_ms(name, mujoco):
    run = told(LIES[name], "motion", end=100, mujoco=mujoco)
    assert "against its torque, which is at its limit" in run.status
    assert run.stop * DT < 0.02


@pytest.mark.parametrize("name", ["frozen", "sign", "swap"])
def test_at_rest_a_lie_moves_nothing(name):
    """Static friction holds the arm, no count moves, and none of these encoders says a thing:
    there is no stop.
    """
    run = told(LIES[name], "rest")
    assert run.status == "running"
    assert np.abs(run.speed).max() < 1e-9


@pytest.mark.parametrize(
    ("name", "when"),
    [
        ("dead", "rest"),
        ("sign", "motion"),
        ("swap", "hold"),
        pytest.param("frozen", "motion", marks=pytest.mark.slow),
    ],
)
def test_in_another_engine_too(name, when):
    """The first drove a joint at 2.4 rad/s here, where friction is soft: a hold by a counter
    that stood at zero.
    """
    run = told(LIES[name], when, end=1300, mujoco=True)
    assert run.stop is not None
    assert np.abs(run.speed[run.stop :]).max() <= 1.05 * np.abs(run.alone).max()
    assert run.energy[run.stop :].max() <= 1.05 * run.energy_alone.max()
    assert run.at_limit <= 0.05


@pytest.mark.parametrize("seed", [144, 174])
def test_a_joint_that_friction_holds_while_another_moves_is_no_dead_encoder(seed):
    """A slow law on an unknown load; and a path that is barely feasible made slower. 1,000 of
    them: faults.py.
    """
    assert healthy(seed) == "running"
