"""Named vectors: what is written by name is read by name, in numpy and in casadi."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant.parts.vector import MODEL_TORQUE, TORQUE_ERROR, Fields, per_joint, scalars

GEARS = Fields(link=per_joint(start=1.0), torque=per_joint(role=MODEL_TORQUE))
STATE = Fields(
    error=per_joint(),
    disturbance=per_joint(role=TORQUE_ERROR),
    gears=GEARS,
    learnt=per_joint(rows=3, start=0.5, role=TORQUE_ERROR),
    begun=scalars(),
)


@given(st.integers(1, 7), st.integers(0, 2**32 - 1))
def test_a_vector_survives_the_round_trip(n, seed):
    vector = np.random.default_rng(seed).normal(size=STATE.length(n))
    state = STATE.read(vector, n)
    np.testing.assert_array_equal(STATE.write(n, **state._asdict()), vector)
    symbol = ca.SX.sym("state", STATE.length(n))
    same = STATE.write(n, **STATE.read(symbol, n)._asdict())
    np.testing.assert_array_equal(
        ca.Function("same", [symbol], [same])(vector).full().ravel(), vector
    )


def test_names_and_roles_become_places():
    assert STATE.length(2) == 2 + 2 + 4 + 6 + 1
    assert STATE.at(2)["gears"] == range(4, 8)
    assert STATE.places(2, TORQUE_ERROR) == (range(2, 4), range(8, 14))
    assert STATE.places(2, MODEL_TORQUE) == (range(6, 8),)
    assert STATE.places(2, "no such role") == ()


def test_the_start_and_what_is_read_have_the_declared_shapes():
    start = STATE.initial(2)
    np.testing.assert_array_equal(start[4:8], (1, 1, 0, 0))
    np.testing.assert_array_equal(start[8:14], np.full(6, 0.5))
    state = STATE.read(start, 2)
    assert state.begun == 0
    assert state.gears.link.shape == (2,)
    assert STATE.read(np.zeros((15, 3)), 2).learnt.shape == (6, 3)
    assert Fields().initial(2).shape == (0,)


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"error": 0}, "begun"),
        ({"error": np.zeros(2), "begun": 0, "bogus": 1}, "bogus"),
        ({"error": np.zeros(3), "begun": 0}, "error"),
        ({"error": ca.SX.sym("e", 2, 2), "begun": 0}, "error"),
    ],
)
def test_a_clash_names_the_field(values, name):
    with pytest.raises(ValueError, match=f"'{name}'"):
        Fields(error=per_joint(), begun=scalars()).write(2, **values)


def test_wrong_vectors_and_fields_are_refused():
    with pytest.raises(ValueError, match="15 numbers"):
        STATE.read(np.zeros(14), 2)
    with pytest.raises(ValueError, match="'error'"):
        Fields(error=3)
