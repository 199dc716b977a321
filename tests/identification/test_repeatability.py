"""The paper's *alteration*: a case by hand, its invariants, and the table beside the paper's nine
values.

Tolerance 1e-12: one division of sums of a few numbers.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification import GeneticSettings, identify, spread
from identification.repeatability import alteration
from plant import puma560, simulate

SMALL = GeneticSettings(individuals=4, subpopulations=2, generations=2)


@pytest.fixture(scope="module")
def record():
    return simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.2
    )


def test_alteration_by_hand():
    """(max - min) / (2 abs(mean)): (5 - 1) / (2 3), (-1 + 3) / (2 2), and nothing for a
    constant.
    """
    runs = np.array([[1.0, -1.0, 7.0], [3.0, -2.0, 7.0], [5.0, -3.0, 7.0]])
    np.testing.assert_allclose(alteration(runs), [4 / 6, 2 / 4, 0.0], rtol=1e-12)


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10), st.sampled_from([-1.0, 1.0]))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_alteration_does_not_depend_on_order_scale_or_sign(seed, scale, sign):
    random = np.random.default_rng(seed)
    runs = random.uniform(1, 2, (6, 3))
    np.testing.assert_allclose(
        alteration(sign * scale * random.permutation(runs)), alteration(runs), rtol=1e-12
    )


def test_a_spread_is_the_runs_of_identify(record):
    found = spread(puma560.dynamics(), record, seeds=(3, 5), settings=SMALL, progress=False)
    assert [run.search.seed for run in found.runs] == [3, 5]
    for run in found.runs:
        again = identify(
            puma560.dynamics(),
            record,
            seed=run.search.seed,
            settings=SMALL,
            method="paper",
            progress=False,
        )
        np.testing.assert_array_equal(run.f, again.f)
    np.testing.assert_array_equal(found.f, [run.f for run in found.runs])
    np.testing.assert_array_equal(found.alteration, alteration(found.f))
    assert found.names == puma560.dynamics().names
    assert "paper" not in str(found)


def test_the_table_shows_the_papers_nine_values(record):
    published = puma560.PUBLISHED_ALTERATION
    found = spread(
        puma560.dynamics(),
        record,
        seeds=(1, 2),
        published=published,
        settings=SMALL,
        progress=False,
    )
    first, head, *rows = str(found).splitlines()
    assert head.split() == ["mean", "min", "max", "alteration", "paper"]
    assert [row.split()[-1] for row in rows] == [
        "10%",
        "21%",
        "80%",
        "30%",
        "16%",
        "14%",
        "11%",
        "40%",
        "3%",
    ]
    for row, name, column, share in zip(
        rows, found.names, found.f.T, found.alteration, strict=True
    ):
        printed = [
            name,
            *(f"{x:.3f}" for x in (column.mean(), column.min(), column.max())),
            f"{share:.0%}",
        ]
        assert row.split()[:-1] == printed
    middle = [
        np.median([getattr(run, name) for run in found.runs])
        for name in ("initial_objective", "objective")
    ]
    assert f"{middle[0]:.0f} -> {middle[1]:.0f} pulses^2" in first


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"seeds": (1,)}, "two or more"),
        ({"seeds": (1, 2), "published": (0.1, 0.2)}, "shape"),
        ({"seeds": (1, 2), "methd": "paper"}, "'method'"),
        ({"seeds": (1, -2)}, "seed"),
    ],
)
def test_bad_input_is_refused_in_one_line(record, options, said):
    with pytest.raises(ValueError, match=said) as refusal:
        spread(puma560.dynamics(), record, **{"settings": SMALL, "progress": False, **options})
    assert "\n" not in str(refusal.value)
