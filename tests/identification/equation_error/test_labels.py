"""Units of parameters, against what happens to them when all lengths are doubled."""

import dataclasses

import numpy as np
import packaged_arms
import pytest

from identification import RecordError
from identification.equation_error import held_out, units
from plant import Body, Chain, Dynamics, Link, puma560, simulate

POWER = {"kg": 0, "kg m": 1, "kg m²": 2}


def doubled(chain):
    """The chain with all lengths twice as long and the same masses."""

    def place(given):
        return dataclasses.replace(given, position=2 * np.array(given.position))

    links = [
        dataclasses.replace(
            link, a=2 * link.a, d=2 * link.d, before=place(link.before), frame=place(link.frame)
        )
        for link in chain.links
    ]
    bodies = [
        Body(
            mass=body.mass,
            com=2 * np.array(body.com),
            inertia=4 * np.array(body.inertia),
            rotor=4 * body.rotor,
        )
        for body in chain.bodies
    ]
    return Chain(links=tuple(links), bodies=tuple(bodies))


@pytest.mark.parametrize("n", [3, 6])
def test_units_are_the_power_of_a_length(n):
    whole = packaged_arms.puma560()
    chain = Chain(links=whole.links[:n], bodies=whole.bodies[:n])
    dynamics, larger = Dynamics.from_chain(chain), Dynamics.from_chain(doubled(chain))
    assert len(dynamics.names) == len(larger.names)
    f, grown = dynamics.f(), larger.f()
    some = np.abs(f) > 1e-9
    power = np.log2(grown[some] / f[some])
    expected = [POWER[unit] for unit in units(dynamics, dynamics.names)]
    np.testing.assert_allclose(power, np.array(expected)[some], atol=1e-9)
    assert set(units(dynamics, dynamics.names)) >= {"kg m", "kg m²"}


def test_a_sliding_link_has_a_mass():
    links = (Link(name="1"), Link(name="2", alpha=np.pi / 2, prismatic=True))
    body = Body(mass=2.0, com=(0.1, 0.2, 0.05), inertia=(0.1, 0, 0, 0.1, 0, 0.1))
    dynamics = Dynamics.from_chain(Chain(links=links, bodies=(body, body)))
    assert "kg" in units(dynamics, dynamics.names)
    # Its rotor counts as mass, and its gear as a spring along a way.
    assert units(dynamics, ["J2"]) == ("kg",)
    stiffness = "drive.elasticity.stiffness[0]", "drive.elasticity.stiffness[1]"
    assert units(dynamics, stiffness) == ("N m/rad", "N/m")


def test_the_papers_parameters_and_numbers_of_rig_and_law():
    """Eq. (3): f3 and f4 are first moments times a length where they are inertial, f5 and f6 are
    not.
    """
    dynamics, inertia = puma560.dynamics(), ["kg m²"] * 4
    assert units(dynamics, dynamics.names) == (*inertia, "kg m", "kg m", "kg m²", "kg m", "kg m")
    asked = ("drive.viscous[1]", "law.gain[0]", "law.speed[1]", "encoder.resolution[0]")
    assert units(dynamics, asked) == ("N m s/rad", "N m per pulse", "N m s per pulse", "")
    # The unit of a gear's stiffness is that of its joint.
    no_joint = [f"drive.elasticity.stiffness{joint}" for joint in ("", "[2]", "[x]")]
    assert units(dynamics, no_joint) == ("", "", "")


def test_a_refusal_of_a_changed_copy_passes_as_it_is():
    parts = puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference()
    record = simulate(*parts, duration=0.05)
    copy = dataclasses.replace(record)
    with pytest.raises(RecordError) as refusal, held_out([record], 0, among=False):
        raise RecordError("it is short. Log longer.", copy, "the copy")
    assert refusal.value.record is copy
    assert str(refusal.value).startswith("the copy")
    with (
        pytest.raises(RecordError, match=r"held_out\[1\]"),
        held_out([record, copy], 0, among=False),
    ):
        raise RecordError("it is short. Log longer.", copy, "the copy")
