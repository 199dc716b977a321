"""Settings that a user gives: numbers out of range are refused by name, with the usual value."""

import dataclasses

import pytest

from ctc import ComputedTorqueSettings, DefaultGainSettings, LearnSettings
from plant import part, structure
from plant.parts import Settings

KINDS = ComputedTorqueSettings, DefaultGainSettings, LearnSettings


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, field.name) for kind in KINDS for field in dataclasses.fields(kind)]
)
def test_a_negative_number_is_refused_by_name(kind, name):
    usual = getattr(kind(), name)
    wrong = type(usual)(*(-x for x in usual)) if hasattr(usual, "_fields") else None
    if wrong is None:
        wrong = (-1.0,) if isinstance(usual, tuple) else -usual
    with pytest.raises(ValueError, match=f"^{name} of {kind.__name__} must .*usual"):
        kind(**{name: wrong})


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (ComputedTorqueSettings, "predicted_stiffness"),
        (DefaultGainSettings, "step"),
        (LearnSettings, "gain"),
    ],
)
def test_a_share_above_one_is_refused_by_name(kind, name):
    with pytest.raises(ValueError, match=f"^{name} of .* must be at most .*; got 1.01"):
        kind(**{name: 1.01})


def test_zero_is_refused_unless_it_is_allowed():
    @part
    class Two(Settings):
        may_be_zero = ("free",)
        free: float = structure(float, default=1.0)
        bound: float = structure(float, default=1.0)

    assert Two(free=0).free == 0
    with pytest.raises(ValueError, match="bound of Two must be positive; got 0"):
        Two(bound=0)


def test_a_whole_number_is_asked_for():
    with pytest.raises(ValueError, match="halvings of LearnSettings must be a whole number"):
        LearnSettings(halvings=2.5)


@pytest.mark.parametrize("wrong", [(), 1.0, "ab", (1.0, float("inf")), (1.0, "a")])
def test_some_numbers_are_asked_for(wrong):
    """None would pass every test that is made at each of them."""
    with pytest.raises(ValueError, match=r"stiffer of DefaultGainSettings must be .*usual"):
        DefaultGainSettings(stiffer=wrong)
    assert DefaultGainSettings(stiffer=[1, 4]).stiffer == (1.0, 4.0)
