"""Names of f for tables and figures, and representations that stay short, on arms with short and
with long names.
"""

import numpy as np
import pytest

from plant import Body, Chain, Dynamics, Link, Lumping, puma560

JOINTS = [
    f"{name}_joint"
    for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
]


@pytest.fixture(scope="module")
def six():
    """A chain shaped like a UR5, with invented bodies."""
    rows = [
        (0, 0, 0.089),
        (np.pi / 2, 0, 0),
        (0, -0.425, 0),
        (0, -0.392, 0.109),
        (np.pi / 2, 0, 0.095),
        (-np.pi / 2, 0, 0.082),
    ]
    links = [
        Link(name=name, alpha=alpha, a=a, d=d)
        for name, (alpha, a, d) in zip(JOINTS, rows, strict=True)
    ]
    body = Body(
        mass=2.0, com=(0.05, 0.01, 0.02), inertia=(0.02, 0.001, 0, 0.03, 0, 0.02), rotor=0.1
    )
    return Dynamics.from_chain(Chain(links=tuple(links), bodies=(body,) * 6))


def test_short_names_are_the_names_where_these_are_short():
    dynamics = puma560.dynamics()
    assert dynamics.short_names == dynamics.names == tuple(f"f{i}" for i in range(1, 10))
    assert dynamics.legend == ""


def test_sums_are_numbered_and_the_legend_says_which(six):
    assert max(map(len, six.names)) > 60
    assert six.short_names == tuple(f"f{i + 1}" for i in range(six.p))
    lines = six.legend.splitlines()
    assert [line.split(" = ", 1)[1] for line in lines] == list(six.names)
    assert [line.split(" = ", 1)[0].strip() for line in lines] == list(six.short_names)
    assert len({line.index("=") for line in lines}) == 1  # aligned


def test_joints_are_labelled_by_their_links(six):
    assert six.chain.joint_labels == [f"{name} (q[{i}])" for i, name in enumerate(JOINTS)]
    assert puma560.dynamics().chain.joint_labels == ["joint 2 (q[0])", "joint 3 (q[1])"]


def test_representations_stay_short(six):
    assert repr(puma560.dynamics()) == "Dynamics(2 joints, 9 parameters f1..f9)"
    assert repr(six) == f"Dynamics(6 joints, {six.p} parameters f1..f{six.p})"
    assert repr(six.lumping) == f"Lumping({six.p} of 66 standard parameters)"
    assert repr(six.arm(six.f())).startswith(f"Arm(dynamics={six!r}, f=array([")


def test_refusals_stay_short(six):
    with pytest.raises(
        ValueError,
        match=rf"this arm has {six.p} parameters \(f1\.\.f{six.p}\)\. Pass found\.arm\.f",
    ):
        six.arm(np.ones(3))
    same = {"names": ("a" * 90, "b" * 90), "matrix": np.ones((2, 11)), "inertial": (True, True)}
    lumping = Lumping(**same, gravitational=(False, False))
    with pytest.raises(
        ValueError, match=r"^f must be independent; the 2 of one torque are not\. Leave some out\.$"
    ):
        lumping.inertial_section()
