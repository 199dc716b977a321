"""Unknowns that are not separately identifiable: a few are named pair by pair, many in one line."""

from types import SimpleNamespace

import numpy as np
import pytest

from identification.results.trust import _of_pairs
from identification.search.outcome import Fit


def found(correlation, std=0.1, noise=None):
    names = tuple(f"f{i + 1}" for i in range(len(correlation)))
    fit = Fit(
        unknown=names, values=np.ones(len(names)), candidates=np.ones((1, len(names))), covariance=correlation * std**2,
        noise_covariance=noise,
    )  # fmt: skip
    return SimpleNamespace(covariance=correlation, short_names=names, fit=fit)


@pytest.mark.parametrize(("alike", "lines"), [(0, 0), (2, 1), (3, 3), (4, 1)])
def test_many_pairs_are_one_line(alike, lines):
    correlation = np.eye(6)
    correlation[:alike, :alike] += 0.999 * (1 - np.eye(alike))
    said = list(_of_pairs(found(correlation)))
    assert len(said) == lines
    assert all(name in " ".join(said) for name in ("f1", "f2", "f3", "f4")[:alike])
    assert ("6 pairs" in " ".join(said)) == (alike == 4)


def test_a_pair_that_is_known_well_is_no_warning():
    correlation = np.array([[1, -0.999], [-0.999, 1]])
    assert not list(_of_pairs(found(correlation, std=0.001)))


def test_what_the_rig_may_lack_moves_many_alike_that_the_log_tells_apart():
    correlation = np.array([[1, 0.999], [0.999, 1]])
    assert len(list(_of_pairs(found(correlation, noise=1e-4 * correlation)))) == 1
    assert not list(_of_pairs(found(correlation, noise=1e-4 * np.eye(2))))
