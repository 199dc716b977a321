"""What 1 % of an assumed number moves: against an identification in which it is 1 % larger."""

import dataclasses

import numpy as np
import pytest

from ctc import certify
from identification import Tolerances, identify
from identification.results import Assumed
from plant import Dynamics, puma560, simulate

EXACT = {"progress": False, "tolerances": Tolerances.none()}


@pytest.fixture(scope="module")
def log():
    path = dataclasses.replace(
        puma560.reference(), offset=np.add(puma560.reference().offset, (0.013, -0.021))
    )
    record = simulate(
        puma560.literature_arm(1.5),
        puma560.rig(),
        puma560.p_law((0.2, 0.15)),
        path,
        steps_per_sample=16,
    )
    return dataclasses.replace(
        record, reference=None, true_q=None, true_qd=None, link_counts=None, initial=None
    )


@pytest.fixture(scope="module")
def found(log):
    return identify(Dynamics.from_chain(puma560.literature_arm().dynamics.chain), log, **EXACT)


def longer(log, name):
    """The record and the equations with 1 % more of a number."""
    chain = puma560.literature_arm().dynamics.chain
    if name.startswith("links"):
        links = (chain.links[0], dataclasses.replace(chain.links[1], a=1.01 * chain.links[1].a))
        return Dynamics.from_chain(dataclasses.replace(chain, links=links)), log
    numbers = log.rig.numbers() | log.law.numbers("law.")
    value = {name: 1.01 * numbers[name]}
    changed = dataclasses.replace(log, rig=log.rig.filled(value), law=log.law.filled(value, "law."))
    return Dynamics.from_chain(chain), changed


@pytest.mark.slow
@pytest.mark.parametrize("name", ["links[1].a", "drive.gear[1]", "law.gain[0]"])
def test_the_moves_are_those_of_another_identification(log, found, name):
    again = identify(*longer(log, name), **EXACT)
    said = found.assumed()
    by_list, by_fit = (
        said.moves[said.names.index(name)] / found.fit.std,
        (again.f - found.f) / found.fit.std,
    )
    assert np.abs(by_list - by_fit).max() < 1  # each finds its own bias by rounding
    if name != "links[1].a":  # of which the moves are small
        assert by_list @ by_fit > 0.9 * np.linalg.norm(by_list) * np.linalg.norm(by_fit)


@pytest.mark.slow
def test_it_is_said_and_can_be_drawn_from(log, found):
    said = str(found.assumed())
    assert said in found.summary()
    assert "drive.gear[0]" in said
    assert max(map(len, said.splitlines())) <= 80
    covariance = found.assumed().covariance(0.5)
    np.testing.assert_allclose(covariance, found.assumed().covariance() / 4)
    each = np.zeros(len(found.assumed().names))
    each[0] = 2.0
    np.testing.assert_allclose(
        found.assumed().covariance(each), 4 * np.outer(*[found.assumed().moves[0]] * 2)
    )


def test_without_a_covariance_there_is_no_list_and_a_certificate_asks_for_it(log, found):
    bare = dataclasses.replace(
        found, fit=dataclasses.replace(found.fit, covariance=None, fallback_reason="told apart")
    )
    with pytest.raises(ValueError, match="found must have a covariance; it has none: told apart"):
        bare.assumed()
    with pytest.raises(ValueError, match=r"found\.assumed\(\)\.covariance"):
        certify(
            found.arm,
            puma560.rig(),
            puma560.p_law((0.2, 0.15)),
            puma560.reference(),
            progress=False,
        )


@pytest.mark.parametrize("percent", [-1.0, (1.0, 2.0), np.nan])
def test_bad_percents(percent):
    assumed = Assumed(names=("a", "b", "c"), unknown=("f1",), moves=np.ones((3, 1)), std=np.ones(1))
    with pytest.raises(ValueError, match="percent must be"):
        assumed.covariance(percent)
