"""What a stretch of path shows of a load: against what the torque of two loads says, and by
hand.
"""

import numpy as np
import pytest

from plant import Harmonics, puma560, visibility


def test_at_rest_gravity_shows_two_first_moments_at_most():
    """A vertical plane at rest: the torque is linear in m (through link 2), mx and my; with one
    pose only two rows.
    """
    still = Harmonics(
        period=1.0, offset=(-0.5, 0.8), cosine=np.zeros((2, 1)), sine=np.zeros((2, 1))
    )
    seen = visibility(puma560.dynamics(), still, load=-1)
    assert len(seen.combinations) == 2
    assert set(seen.invisible) == {"mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz"}


def test_motion_shows_the_moment_about_the_axes_too():
    seen = visibility(puma560.dynamics(), puma560.reference(), load=-1, start=1.0, duration=0.2)
    assert seen.combinations == ("m", "mx", "my", "Izz")
    assert "Ixx" in seen.invisible


def test_what_is_invisible_does_not_change_the_torque():
    dynamics, path = puma560.dynamics(), puma560.reference()
    phi = np.zeros(10)
    phi[[3, 4, 5, 6, 7, 8]] = 1.0, 2.0, 3.0, 4.0, 5.0, 6.0  # mz, Ixx .. Iyz
    motion = path(np.linspace(1.0, 1.2, 9))
    torque = [
        dynamics.Y(*state).full() @ dynamics.load_matrix() @ phi
        for state in zip(*motion, strict=True)
    ]
    np.testing.assert_allclose(torque, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    "stretch", [{"start": -0.1}, {"start": 3.7}, {"start": 3.0, "duration": 1.0}, {"duration": 0}]
)
def test_a_stretch_outside_is_refused(stretch):
    with pytest.raises(ValueError, match=r"segment|positive"):
        visibility(puma560.dynamics(), puma560.reference(), load=-1, **stretch)
