"""A warning of P loops that a lag of the currents makes unstable, by Hurwitz' criterion of one
joint.
"""

import dataclasses

import numpy as np
import pytest
from closed_loops import joint

from identification import identify
from plant import Drive, Encoder, P, PointToPoint, Rig, puma560, simulate

INERTIA, VISCOUS, GAIN = 2.5, 8.0, 0.05
STILL = PointToPoint(start=(0.2,), goal=(0.2,), duration=0.01)


def one_joint(lag):
    """J s^2 + b s + K / (lag s + 1) = 0 is stable for lag K < b (1 + lag b / J): for lag below b
    / (K - b^2 / J).
    """
    drive = Drive(
        gear=(50.0,),
        motor_inertia=(1e-4,),
        viscous=(VISCOUS / 2500,),
        coulomb=(0.0,),
        motor_gain=(0.2,),
        current_limit=(np.inf,),
        current_lag=lag,
    )
    return Rig(drive=drive, encoder=Encoder(resolution=(1000,)), period=0.7e-3)


def test_the_warning_begins_where_hurwitz_puts_it():
    arm, law, pulse = joint(0.0, 0.3, INERTIA), P(gain=(GAIN,)), 2 * np.pi / (50 * 1000)
    stiffness = 50 * GAIN / pulse
    longest = VISCOUS / (stiffness - VISCOUS**2 / INERTIA)
    simulate(arm, one_joint(0.98 * longest), law, STILL)  # a warning would be an error
    hz = np.sqrt(stiffness / INERTIA) / (2 * np.pi)
    with pytest.warns(
        UserWarning, match=rf"the loop of P is unstable: .* oscillates at {hz:.3g} Hz"
    ) as warned:
        simulate(arm, one_joint(1.02 * longest), law, STILL)
    assert warned[0].filename == __file__
    assert "\n" not in str(warned[0].message)


@pytest.mark.slow
def test_what_was_logged_of_such_a_loop_says_so():
    arm, rig = puma560.literature_arm(1.5), puma560.rig()

    def logged(lag):
        late = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, current_lag=lag))
        with pytest.warns(UserWarning, match=r"oscillates at .* without lag it is stable"):
            record = simulate(
                arm, late, P(gain=(0.1, 0.08)), puma560.reference(), steps_per_sample=16
            )
        return dataclasses.replace(record, rig=rig)

    with pytest.raises(
        ValueError, match=r"63% of the samples: its loop oscillates at \d+\.?\d* Hz\. Slow"
    ):
        identify(arm.dynamics, logged(3e-4), method="equation_error", progress=False)
    record = logged(1.5e-4)
    seen = [finding.value for finding in record.check().problems if finding.check == "oscillation"]
    found = identify(arm.dynamics, record, method="equation_error", progress=False)
    assert any(
        f"the loop of the log oscillates at {seen[0]:.3g} Hz" in text for text in found.warnings
    )
