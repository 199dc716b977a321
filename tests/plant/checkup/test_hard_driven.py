"""Right logs of loops that are soft, lag far behind, or have amplifiers at their limits."""

import dataclasses

import pytest
from random_rigs import driven, hard_driven

from plant import PD, PID, P, puma560, simulate


@pytest.mark.parametrize(
    ("seed", "factor", "limit", "torque"),
    [
        pytest.param(11, 30, 1.0, False, id="cascade in a limit cycle"),
        pytest.param(22, 10, 0.3, False, id="PD at its limit"),
        pytest.param(24, 30, 1.0, False, id="PID in a limit cycle"),
        pytest.param(24, 10, 0.3, False, id="PID at its limit"),
        pytest.param(6, 30, 1.0, True, id="PID in a limit cycle, with a torque"),
        pytest.param(25, 10, 0.3, False, id="cascade far behind"),
        pytest.param(26, 3, 1.0, False, id="cascade that follows to three quarters"),
        pytest.param(27, 1, 0.25, True, id="P at its limit, with a torque"),
        pytest.param(5, 1, 1.0, False, id="friction of a PD to half"),
    ],
)
def test_a_right_log_of_a_hard_driven_loop_has_no_cause(seed, factor, limit, torque):
    record = hard_driven(seed, factor, limit)
    if not torque:
        record = dataclasses.replace(record, torque=None, current=None)
    assert [cause.name for cause in record.check().causes] == []


ARM, RIG = puma560.arm(), puma560.rig()
GAIN = puma560.p_law().gain


@pytest.mark.parametrize(
    "law",
    [
        pytest.param(P(gain=0.5 * GAIN), id="P of half the gain"),
        pytest.param(P(gain=0.2 * GAIN), id="P of a fifth"),
        pytest.param(
            PID(
                gain=0.2 * GAIN,
                derivative=8e-4 * GAIN,
                integral=GAIN,
                filter=2000.0,
                period=RIG.period,
            ),
            id="PID of a fifth",
        ),
    ],
)
def test_a_right_log_of_a_soft_loop_has_no_cause(law):
    record = simulate(ARM, RIG, law, puma560.reference(), duration=1.5)
    alone = dataclasses.replace(record, torque=None, current=None)
    assert [cause.name for cause in alone.check().causes] == []


@pytest.mark.parametrize("torque", [True, False])
def test_a_motor_that_is_too_weak_for_its_load_accuses_nothing(torque):
    law = PD(gain=GAIN, derivative=4e-3 * GAIN, filter=2000.0, period=RIG.period)
    record = driven(RIG, law, ARM, puma560.reference(), 1, 0.35, duration=1.5)
    if torque:
        (wrong,) = (finding for finding in record.check().problems if finding.verdict == "wrong")
        assert (wrong.check, wrong.joint) == ("saturation", 0)
    else:
        record = dataclasses.replace(record, torque=None, current=None)
    assert record.check().causes == ()
