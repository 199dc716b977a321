"""Script commands of a UR controller: a payload in its order of the inertia, scales that leave
no friction.
"""

import dataclasses

import numpy as np
import pytest

from identification import to_urscript
from plant import Body, puma560

RIG = puma560.rig()
# what the controller compensates at 1
OWN = {"viscous": np.array([8e-4, 6e-4]), "coulomb": np.array([0.5, 0.3])}


def left(scale):
    """The rig as it appears under a scale: what the controller compensates is gone."""
    drive = RIG.drive
    # at which nothing would be left
    shares = {"viscous": np.array([0.8, 0.9]), "coulomb": np.array([0.75, 0.6])}
    friction = {name: OWN[name] * (shares[name] - scale) for name in OWN}
    return scale, dataclasses.replace(RIG, drive=dataclasses.replace(drive, **friction))


def test_scales_are_those_that_leave_nothing():
    said = to_urscript(friction=(left(0.0), left(0.4)))
    assert said == "viscous_scale = [0.8, 0.9]\ncoulomb_scale = [0.75, 0.6]"


def test_a_payload_has_the_inertia_about_its_centre_in_the_controllers_order():
    body = Body(mass=2.0, com=(0.01, -0.02, 0.1), inertia=(1e-2, 1e-4, 2e-4, 2e-2, 3e-4, 2.5e-2))
    values = to_urscript(body).removeprefix("set_target_payload(2, ")
    assert values == "[0.01, -0.02, 0.1], [0.01, 0.02, 0.025, 0.0001, 0.0002, 0.0003])"


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({}, "needs a body or friction"),
        ({"body": Body(mass=0.0, com=(0, 0, 0))}, "body must have mass"),
        ({"body": 3}, "body must be"),
        ({"friction": (left(0.2),)}, "two pairs"),
        ({"friction": (left(0.2), left(0.2))}, "must fall"),
        ({"friction": (left(0.0), (0.3, left(0.0)[1]))}, "must fall"),
    ],
)
def test_bad_input_is_refused_in_one_line(given, why):
    with pytest.raises(ValueError, match=why) as error:
        to_urscript(**given)
    assert "\n" not in str(error.value)
