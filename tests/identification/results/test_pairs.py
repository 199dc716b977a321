"""Unknowns that are not separately identifiable: a few pairs are told, many are a warning in one
line.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from identification.results import inseparable, pairs_of
from identification.search import Fit


def found(correlation, std=0.1, noise=None):
    names = tuple(f"f{i + 1}" for i in range(len(correlation)))
    fit = Fit(
        unknown=names,
        values=np.ones(len(names)),
        candidates=np.ones((1, len(names))),
        covariance=correlation * std**2,
        noise_covariance=noise,
    )
    return SimpleNamespace(covariance=correlation, short_names=names, fit=fit)


@pytest.mark.parametrize(("alike", "pairs"), [(0, 0), (2, 1), (3, 3), (4, 6)])
def test_many_pairs_are_a_warning_in_one_line(alike, pairs):
    correlation = np.eye(6)
    correlation[:alike, :alike] += 0.999 * (1 - np.eye(alike))
    told = pairs_of(found(correlation))
    said = list(inseparable(SimpleNamespace(identification=found(correlation))))
    assert len(told) == pairs
    assert sorted({name for pair in told for name in pair}) == ["f1", "f2", "f3", "f4"][:alike]
    assert len(said) == (alike == 4)
    assert all("f1, f2, f3, f4 are not" in line and "6 pairs" in line for line in said)


def test_a_pair_that_is_known_well_is_not_told():
    correlation = np.array([[1, -0.999], [-0.999, 1]])
    assert not pairs_of(found(correlation, std=0.001))


def test_what_the_rig_may_lack_moves_many_alike_that_the_log_tells_apart():
    correlation = np.array([[1, 0.999], [0.999, 1]])
    assert len(pairs_of(found(correlation, noise=1e-4 * correlation))) == 1
    assert not pairs_of(found(correlation, noise=1e-4 * np.eye(2)))
