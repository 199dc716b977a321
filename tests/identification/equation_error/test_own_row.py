"""A row of one's own in the table of the torque equation, as docs/guides/own_hypothesis.md says."""

import numpy as np

from identification.equation_error import HYPOTHESES, TorqueEquation, contradictions
from plant import Harmonics, Hypothesis, puma560, simulate

PATH = Harmonics(
    period=2.5,
    offset=(0.3, -0.5),
    cosine=((0.6, 0.1), (0.2, 0.6)),
    sine=((0.1, -0.6), (0.6, 0.1)),
)


def with_spring(equation, joints, stiffness):
    """The equation with the torque of a spring at the shoulder."""
    pull = np.zeros_like(equation.torque)
    pull[:, 0] = stiffness * equation.motion.q[:, 0]
    return equation.with_torque(equation.torque + pull)


SPRING = Hypothesis(
    name="spring",
    sentence="A spring of {value:.0f} N m/rad pulls at the shoulder",
    remedy="Add its torque to the column",
    undo=with_spring,
    sizes=(100.0, 200.0, 400.0),
    against=8.0,
)


def test_a_row_of_ones_own_is_named_with_its_size_and_accuses_no_right_log():
    arm = puma560.arm()
    record = simulate(arm, puma560.rig(), puma560.p_law(), PATH)
    equation = TorqueEquation.of(arm.dynamics, record)
    cause = contradictions(with_spring(equation, (), -200.0), (*HYPOTHESES, SPRING))[0]
    assert (cause.name, cause.size) == ("spring", 200.0)
    assert contradictions(equation, (*HYPOTHESES, SPRING)) == ()
