"""Frozen results: equal bit for bit or not at all, and copies that stay frozen."""

import copy
import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest

from plant.parts import Frozen


@dataclasses.dataclass(frozen=True, eq=False)
class Result(Frozen):
    name: str
    values: np.ndarray
    more: Any = None


def result(**changes):
    values = np.array([1.0, np.nan, -0.0])
    values.setflags(write=False)
    return Result(
        **{
            "name": "a",
            "values": values,
            "more": {"x": [1, (2.0, np.array([3]))], "y": float("nan")},
        }
        | changes
    )


def test_equal_when_all_fields_are_nan_included():
    assert result() == result()
    assert hash(result()) == hash(result())
    assert len({result(), result(name="b")}) == 2


@pytest.mark.parametrize(
    "changes",
    [
        {"name": "b"},
        {"values": np.array([1.0, np.nan, 0.0])},  # another zero
        {"values": np.array([1.0, np.nan])},
        {"values": np.array([1, 2, 3])},
        {"values": [1.0, np.nan, -0.0]},
        {"more": {"x": [1, (2.0, np.array([4]))], "y": float("nan")}},
        {"more": {"x": [1, (2.0, np.array([3]), 0)], "y": float("nan")}},
        {"more": {"x": 1}},
        {"more": None},
    ],
)
def test_any_other_bit_differs(changes):
    assert result() != result(**changes)


def test_another_type_is_not_equal():
    @dataclasses.dataclass(frozen=True, eq=False)
    class Other(Result):
        pass

    assert result() != Other(**vars(result()))
    assert (result() == 1) is False


@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])  # noqa: S301
def test_copies_are_equal_and_frozen(way):
    twin = way(result())
    assert twin == result()
    assert not twin.values.flags.writeable
    with pytest.raises(dataclasses.FrozenInstanceError):
        twin.name = "b"
