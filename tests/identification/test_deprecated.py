"""Old names work for one release, give what the new ones give, and say what to write instead."""

import operator

import pytest

from identification import find_load, identify
from plant import puma560, simulate

RECORD = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.4)


@pytest.fixture(scope="module")
def found():
    return identify(puma560.dynamics(), RECORD, method="equation_error", progress=False)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("scatter", "fit.rms_innovation"),
        ("trouble", "fit.fallback_reason"),
        ("zeros", "fit.zeros"),
        ("correlation", "fit.correlation"),
        ("ranges", "search.ranges"),
        ("stages", "search.stages"),
        ("initial_costs", "search.initial_costs"),
        ("bands", "diagnostics.bands"),
        ("delay", "diagnostics.delay"),
        ("delay_std", "diagnostics.delay_std"),
        ("difference", "diagnostics.difference"),
        ("held_out_difference", "diagnostics.held_out_difference"),
    ],
)
def test_attributes_that_moved_into_groups(found, old, new):
    with pytest.warns(DeprecationWarning, match=rf"Identification\.{old} will go .* Use Identification\.{new}"):
        got = getattr(found, old)
    expected = operator.attrgetter(new)(found)
    assert (got == expected).all() if old in ("correlation", "initial_costs") else got == expected


def test_scatter_of_a_load():
    load = find_load(puma560.arm(), RECORD, (0.0, -0.55, 0.0))
    with pytest.warns(DeprecationWarning, match=r"Load\.scatter will go .* Use Load\.rms_innovation"):
        assert load.scatter == load.rms_innovation
