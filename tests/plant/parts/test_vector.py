"""Named vectors: what is written by name is read by name, in numpy and in casadi."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant import Fields, per_joint, scalars
from plant.parts import MODEL_TORQUE, TORQUE_ERROR, vector_of

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
    with pytest.raises(ValueError, match=r"'count' must have a name .* Rename it\.$"):
        Fields(count=scalars())
    with pytest.raises(ValueError, match=r"'error' must be declared once; .* Rename one\.$"):
        STATE.extended(error=scalars())
    with pytest.raises(ValueError, match=r"'error' must be declared once; .* Rename one\.$"):
        STATE | Fields(time=per_joint(), error=scalars())
    with pytest.raises(ValueError, match="must be of type Fields"):
        STATE | {"rate": per_joint()}
    with pytest.raises(ValueError, match=r"'gain' must start with one number or with 4;"):
        Fields(gain=per_joint(rows=2, start=(1.0, 2.0, 3.0))).initial(2)


@pytest.mark.parametrize(
    ("inner", "name"),
    [
        ({"link": 0}, "gears.torque"),
        ({"link": 0, "torque": 0, "bogus": 1}, "gears.bogus"),
        ({"link": np.zeros(3), "torque": 0}, "gears.link"),
        (3, "gears"),
    ],
)
def test_a_clash_within_a_group_names_the_group(inner, name):
    with pytest.raises(ValueError, match=f"'model.{name}'"):
        Fields(model=Fields(gears=GEARS)).write(1, model={"gears": inner})


def test_a_wrong_start_within_a_group_names_the_group():
    wrong = Fields(gears=Fields(link=per_joint(start=(1.0, 2.0, 3.0))))
    with pytest.raises(ValueError, match=r"'gears\.link' must start .* got shape \(3,\)"):
        wrong.initial(2)


def test_joined_vectors_hold_the_fields_of_both_in_order():
    both = GEARS | Fields(begun=scalars(start=2))
    np.testing.assert_array_equal(both.initial(1), (1, 0, 2))
    np.testing.assert_array_equal(both.write(1, begun=5, torque=4, link=3), (3, 4, 5))


def test_a_whole_vector_is_a_field_whose_roles_are_found():
    """As the state of a law within a law."""
    outer = Fields(time=scalars(), law=vector_of(STATE), more=vector_of(initial=np.ones))
    assert outer.length(2) == 1 + 15 + 2
    assert outer.places(2, TORQUE_ERROR) == (range(3, 5), range(9, 15))
    start = outer.initial(2)
    np.testing.assert_array_equal(outer.read(start, 2).law, STATE.initial(2))
    np.testing.assert_array_equal(outer.read(start, 2).more, (1, 1))
    np.testing.assert_array_equal(outer.write(2, **outer.read(start, 2)._asdict()), start)


def test_a_role_is_changed_wherever_it_is():
    vector = ca.SX.sym("state", STATE.length(2))
    changed = STATE.changed(vector, 2, TORQUE_ERROR, lambda value: 10 * value)
    values = ca.Function("changed", [vector], [changed])(np.arange(15.0)).full().ravel()
    expected = np.arange(15.0)
    expected[[2, 3, *range(8, 14)]] *= 10
    np.testing.assert_array_equal(values, expected)
