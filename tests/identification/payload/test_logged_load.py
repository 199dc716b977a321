"""A load on a known arm: its mass within its own deviation, and the arm that carries it."""

import numpy as np
import pytest

from identification import find_load
from plant import puma560, simulate

RIG, LAW, PATH, PLACE = puma560.rig(), puma560.p_law(), puma560.reference(), (0.0, -0.55, 0.0)


def log(mass):
    return simulate(puma560.literature_arm(mass), RIG, LAW, PATH, steps_per_sample=16)


@pytest.mark.parametrize("mass", [0.0, 0.3, 2.5])
def test_mass_is_found_to_some_grams(mass):
    found = find_load(puma560.literature_arm(), log(mass), PLACE)
    assert found.mass == pytest.approx(mass, abs=max(3 * found.std, 0.01))
    assert found.std < 0.01
    assert found.rms_innovation < 0.33
    np.testing.assert_allclose(found.arm.f, puma560.literature_arm(mass).f, atol=0.02)


def test_load_at_the_wrong_place_shows_in_the_innovations():
    right, wrong = (find_load(puma560.literature_arm(), log(2.5), (0.0, y, 0.0)) for y in (-0.55, -0.2))
    assert wrong.rms_innovation > 1.02 * right.rms_innovation
    assert abs(wrong.mass - 2.5) > 10 * right.std


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"arm": puma560.dynamics()}, "arm must be of type Arm"),
        ({"record": RIG}, "record must be of type Record"),
        ({"position": (0, 1)}, "position must have shape"),
        ({"postion": PLACE}, "Did you mean 'position'"),
        ({"link": 0, "position": (0, 0, 0)}, "load does not in this motion"),
    ],
)
def test_bad_input_is_refused(change, says):
    given = {"arm": puma560.literature_arm(), "record": log(0.0), "position": PLACE}
    with pytest.raises(ValueError, match=says):
        find_load(**(given | change))
