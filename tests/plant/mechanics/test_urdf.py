"""URDF import against pinocchio's own reader, then files that must be refused."""

import re
import sys

import numpy as np
import pytest
from hypothesis import given as drawn
from hypothesis import strategies as st

from plant import Chain, Coupling, Drive, Dynamics, Placement
from plant.mechanics import righted

pin = pytest.importorskip("pinocchio")
from model_texts import urdf  # noqa: E402


def written(tmp_path, text):
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return path


def compared(chain, model, locked=()):
    """Torques of both at random states; pinocchio has a continuous joint as cosine and sine."""
    dynamics, data = Dynamics.from_chain(chain, rotors=False), model.createData()
    arm = dynamics.arm(dynamics.f())
    names = [link.name for link in chain.links]
    assert [name for name in model.names[1:] if name not in locked] == names
    for state in np.random.default_rng(0).uniform(-1, 1, (5, 3, chain.n)):
        q, v, a = np.zeros(model.nq), np.zeros(model.nv), np.zeros(model.nv)
        q[:] = pin.neutral(model)
        for value, speed, rate, name in zip(*state, names, strict=True):
            other = model.joints[model.getJointId(name)]
            q[other.idx_q : other.idx_q + other.nq] = (
                [value] if other.nq == 1 else [np.cos(value), np.sin(value)]
            )
            v[other.idx_v], a[other.idx_v] = speed, rate
        tau = pin.rnea(model, data, q, v, a)[
            [model.joints[model.getJointId(name)].idx_v for name in names]
        ]
        np.testing.assert_allclose(arm.inverse(*state), tau, rtol=0, atol=1e-10 * np.abs(tau).max())


@pytest.mark.parametrize("seed", range(5))
def test_agrees_with_pinocchio_s_reader(tmp_path, seed):
    text = urdf(seed)
    compared(Chain.from_urdf(written(tmp_path, text)), pin.buildModelFromXML(text))


def test_named_joints_leave_the_others_at_zero(tmp_path):
    """j3 slides in the file; left out, it is a fixed joint, and its masses hang on the link
    before it.
    """
    text = urdf(9)
    chain = Chain.from_urdf(written(tmp_path, text), ["j1", "j4", "j6"])
    assert [link.prismatic for link in chain.links] == [False, False, False]
    compared(chain, pin.buildModelFromXML(text), locked=("j3",))


def test_axes_along_each_direction(tmp_path):
    for axis in ("0 0 1", "0 0 -1", "1 0 0", "0 -1 0", "0 0 2"):
        text = urdf(1, kinds=("revolute", "revolute"))
        start = text.index("<axis")
        text = text[:start] + f'<axis xyz="{axis}"/>' + text[text.index("/>", start) + 2 :]
        compared(Chain.from_urdf(written(tmp_path, text)), pin.buildModelFromXML(text))


BALL = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
LINK = '<link name="{0}"><inertial><mass value="1"/>' + BALL + "</inertial></link>"
ENDS = '<parent link="{}"/><child link="{}"/>'
GOOD = (
    '<robot name="r">'
    + LINK.format("base")
    + LINK.format("arm")
    + '<joint name="shoulder" type="revolute">'
)
GOOD += ENDS.format("base", "arm") + '<axis xyz="0 0 1"/></joint></robot>'
MORE = '<joint name="elbow" type="revolute">' + ENDS + "</joint></robot>"


def of_arm(sound, spoilt):
    """The file with another text of the link that moves."""
    return spoilt.join(GOOD.rsplit(sound, 1))


def test_the_file_that_the_bad_ones_are_made_of_is_good(tmp_path):
    assert Chain.from_urdf(written(tmp_path, GOOD)).n == 1
    massless = GOOD.replace('mass value="1"', 'mass value="0"', 1)  # of the base, which never moves
    assert Chain.from_urdf(written(tmp_path, massless)).n == 1


def pose(*angles, position="0.1 0.2 0.3"):
    return f'<origin rpy="{" ".join(map(repr, angles))}" xyz="{position}"/>'


@drawn(
    st.lists(st.integers(-2, 2), min_size=3, max_size=3),
    st.lists(st.floats(-9e-4, 9e-4), min_size=3, max_size=3),
)
def test_right_angles_that_a_file_rounds_are_put_right(quarters, off):
    """Any of roll, pitch and yaw, and all three; what is no right angle stays as it is."""
    exact = Placement.of_angles(*(np.pi / 2 * np.array(quarters)))
    rounded = Placement.of_angles(*(np.pi / 2 * np.array(quarters) + np.array(off) / 3))
    put_right, by = righted(rounded)
    np.testing.assert_allclose(put_right.rotation, exact.rotation, atol=1e-9)  # less is no rounding
    assert by < 1e-3
    other = Placement.of_angles(0.3, 0.4, 0.5)
    assert righted(other) == (other, 0.0)


def test_rounded_right_angles_are_said_and_give_no_parameter_more(tmp_path):
    def text(angle):
        joints = [
            f'<joint name="{name}"'
            f' type="revolute">{ENDS.format(parent, name)}{pose(angle, 0.0, 0.0)}<axis xyz="0 0'
            ' 1"/></joint>'
            for parent, name in (("base", "a"), ("a", "b"), ("b", "c"))
        ]
        return (
            "<robot"
            f' name="r">{"".join(LINK.format(name) for name in ("base", "a", "b", "c"))}{"".join(joints)}</robot>'
        )

    exact = Dynamics.from_chain(Chain.from_urdf(written(tmp_path, text(np.pi / 2))))
    with pytest.warns(
        UserWarning,
        match="rounds right angles, that before joint a by 3.7e-06 rad; they are put right",
    ):
        chain = Chain.from_urdf(written(tmp_path, text(1.5708)))
    assert Dynamics.from_chain(chain).names == exact.names


TREE = (
    '<robot name="r">'
    + "".join(
        LINK.format(name) for name in ("base", "torso", "arm", "hand", "left", "right", "other")
    )
    + "".join(
        f'<joint name="to_{child}" type="{kind}">{ENDS.format(parent, child)}<axis xyz="0 0'
        f' 1"/>{more}</joint>'
        for parent, child, kind, more in (
            ("base", "torso", "revolute", ""),
            ("torso", "arm", "revolute", ""),
            ("arm", "hand", "revolute", ""),
            ("hand", "left", "prismatic", ""),
            ("hand", "right", "prismatic", '<mimic joint="to_left"/>'),
            ("base", "other", "fixed", ""),
        )
    )
    + "</robot>"
)


@pytest.mark.parametrize(
    ("given", "joints"),
    [
        # without the gripper, one finger of which follows the other
        ({}, ["to_torso", "to_arm", "to_hand"]),
        ({"tip": "arm"}, ["to_torso", "to_arm"]),
        ({"base": "torso", "tip": "right"}, ["to_arm", "to_hand"]),
    ],
    ids=str,
)
def test_a_chain_between_two_links(tmp_path, given, joints):
    chain = Chain.from_urdf(written(tmp_path, TREE), **given)
    assert [link.name for link in chain.links] == joints
    named = Chain.from_urdf(written(tmp_path, TREE), joints)
    assert chain == named


def test_a_finger_of_the_chain_has_another_one_that_mimics_it(tmp_path):
    with pytest.warns(UserWarning, match=r"mimic joints of the chain: to_right \(to_left\)"):
        chain = Chain.from_urdf(written(tmp_path, TREE), tip="left")
    assert [link.name for link in chain.links] == ["to_torso", "to_arm", "to_hand", "to_left"]
    # The other finger stays on the hand.
    assert [body.mass for body in chain.bodies] == [1, 1, 2, 1]


# A rod beside the arm, as of a parallel linkage, follows its middle joint.
ROD = LINK.format("rod")
LINKAGE = TREE.replace(
    "</robot>",
    '<joint name="to_rod" type="revolute">'
    + ENDS.format("torso", "rod")
    + f'<axis xyz="0 0 1"/><mimic joint="to_arm"/></joint>{ROD}</robot>',
)


@pytest.mark.parametrize(
    "given", [{}, {"tip": "hand"}, {"joints": ["to_torso", "to_arm", "to_hand"]}], ids=str
)
def test_a_joint_of_the_arm_moves_though_a_rod_beside_it_mimics_it(tmp_path, given):
    with pytest.warns(UserWarning, match=r"mimic joints of the chain: to_rod \(to_arm\)"):
        chain = Chain.from_urdf(written(tmp_path, LINKAGE), **given)
    assert [link.name for link in chain.links] == ["to_torso", "to_arm", "to_hand"]
    assert [body.mass for body in chain.bodies] == [2, 1, 3]


def test_a_rod_without_mass_or_one_that_follows_no_joint_of_the_chain_is_not_said(tmp_path):
    """Warnings are errors here."""
    drawn_only = LINKAGE.replace(ROD, '<link name="rod"/>')
    assert Chain.from_urdf(written(tmp_path, drawn_only)).n == 3
    assert Chain.from_urdf(written(tmp_path, LINKAGE), ["to_torso", "to_hand"]).n == 2


def test_names_of_joints_may_be_a_column_of_a_table(tmp_path):
    path = written(tmp_path, TREE)
    names = ["to_torso", "to_arm"]
    assert Chain.from_urdf(path, np.array(names)) == Chain.from_urdf(path, names)
    with pytest.raises(ValueError, match="list of at least one name"):
        Chain.from_urdf(path, np.array([]))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"tip": "hnad"}, "Did you mean 'hand'"),
        ({"base": "hand", "tip": "arm"}, "tip must lie below base; arm does not hang on hand"),
        ({"base": "toroso", "tip": "arm"}, "Did you mean 'torso'"),
        ({"tip": "other"}, "a joint must move between base and tip other; none does"),
        ({"base": "arm"}, "tip must be given with base.* Give tip="),
        ({"base": "amr"}, "Did you mean 'arm'"),
        ({"joints": ["to_left", "to_right"]}, "They are on two branches"),
        ({"tip": "arm", "joints": ["to_arm"]}, r"no joints; got .*\['to_arm'\]. Leave joints out"),
        ({}, "to_arm mimics to_torso"),
        ({"tip": "hand"}, "to_arm mimics to_torso"),
        ({"tip": "arm"}, "to_arm mimics to_torso"),
        ({"joints": ["to_torso", "to_hand"]}, "to_arm mimics to_torso"),
    ],
    ids=str,
)
def test_ends_that_are_none(tmp_path, given, said):
    mimic = '<mimic joint="to_torso"/>' * ("mimics" in said)
    text = TREE.replace('<child link="arm"/>', f'<child link="arm"/>{mimic}')
    with pytest.raises(ValueError, match=said) as error:
        Chain.from_urdf(written(tmp_path, text), **given)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (of_arm('mass value="1"', 'mass value="nan"'), "link arm, mass must have one finite number in value"),
        (of_arm('mass value="1"', 'mass value="17,4"'), "got '17,4'"),
        (of_arm('mass value="1"', 'mass value="-1"'), "link arm must have a positive mass"),
        (of_arm('<mass value="1"/>', ""), "link arm, mass must have value"),
        (GOOD.replace('ixx="1"', 'ixx="3"'), r"body behind .* must have an inertia that a body can have \(triangle"),
        (GOOD.replace('ixy="0"', 'ixy="2"'), "body behind .* must have a positive semidefinite inertia"),
        (GOOD.replace('axis xyz="0 0 1"', 'axis xyz="0 0 0"'), "joint shoulder must have an axis that is not zero"),
        (GOOD.replace('axis xyz="0 0 1"', 'axis xyz="0 1"'), "joint shoulder, axis must have 3 finite numbers"),
        (GOOD.replace('child link="arm"', 'child link="amr"'), "got 'amr'. Did you mean 'arm'"),
        (GOOD.replace('type="revolute"', 'type="revolut"'), "Did you mean 'revolute'"),
        (
            GOOD.replace("</robot>", LINK.format("b") + MORE.format("arm", "b").replace("revolute", "revolut")),
            "joint elbow .*Did you mean 'revolute'",
        ),
        (GOOD.replace('type="revolute"', 'type="floating"'), "must move about or along one axis; it is floating"),
        (GOOD.replace('type="revolute"', 'type="fixed"'), "at least one joint that moves"),
        (GOOD.replace('<parent link="base"/>', ""), "must have a parent and a child link"),
        (GOOD.replace("</robot>", MORE.format("base", "arm")), "link arm must hang on one joint"),
        (GOOD.replace("</robot>", MORE.format("arm", "base")), "hangs on itself"),
        (GOOD.replace("</robot>", LINK.format("arm") + "</robot>"), "names of their own; got 'arm'. Rename"),
        (GOOD.replace('"elbow"', '"shoulder"').replace("</robot>", MORE.format("arm", "arm")), "hangs on"),
        (GOOD.replace("</robot>", LINK.format("b") + MORE.format("base", "b")), "joints must be named where"),
        (of_arm('mass value="1"', 'mass value="1_7"'), "got '1_7'"),
        (of_arm("<inertial>", "<inertial/><inertial>"), "link arm must have one <inertial>; it has 2"),
        (GOOD.replace("</joint>", '<mimic joint="other"/></joint>'), "shoulder mimics other"),
        (of_arm('<mass value="1"/>', '<mass value="1"/><mass value="2"/>'), "link arm must have one <mass>; it has 2"),
        (of_arm("<inertial>", "<inertial><origin/><origin/>"), "link arm must have one <origin>; it has 2"),
        (of_arm("</inertial>", BALL + "</inertial>"), "link arm must have one <inertia>; it has 2"),
        ('<robot name="r"/>', "the file must have links"),
        ("<robot>", "must be well-formed XML"),
        ("", "must be well-formed XML"),
        ("<sdf/>", "must hold a <robot>; got <sdf>"),
        ('<!DOCTYPE r [<!ENTITY a "b">]>' + GOOD, "must not declare a document type or entities"),
        ('<!DOCTYPE r SYSTEM "file:///etc/passwd">' + GOOD, "must not declare a document type or entities"),
        (" " * 5_300_000, "must have at most 5 MiB; got 6"),
    ],
    ids=lambda x: x[:40] if len(x) < 100 else "file",
)  # fmt: skip
def test_bad_file_is_refused_in_one_line(tmp_path, text, said):
    with pytest.raises(ValueError, match=said) as error:
        Chain.from_urdf(written(tmp_path, text))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        (["sholder"], "Did you mean 'shoulder'"),
        (["shoulder", "shoulder"], "comes twice"),
        ([], "list of at least one name"),
        ("shoulder", "list of at least one name"),
    ],
)
def test_bad_names_of_joints_are_refused(tmp_path, joints, said):
    with pytest.raises(ValueError, match=said):
        Chain.from_urdf(written(tmp_path, GOOD), joints)


def test_fixed_joint_is_no_joint_of_a_chain_and_text_is_no_file(tmp_path):
    text = GOOD.replace(
        "</robot>", LINK.format("b") + MORE.format("arm", "b").replace("revolute", "fixed")
    )
    with pytest.raises(ValueError, match="joints must move; elbow is fixed"):
        Chain.from_urdf(written(tmp_path, text), ["elbow"])
    with pytest.raises(ValueError, match=r"none.urdf must be a file; there is none"):
        Chain.from_urdf(tmp_path / "none.urdf")
    with pytest.raises(ValueError, match="got its text"):
        Chain.from_urdf(GOOD)


def test_billion_laughs_in_another_encoding(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_bytes(
        ('<?xml version="1.0" encoding="UTF-16"?><!DOCTYPE r [<!ENTITY a "b">]>' + GOOD).encode(
            "utf-16"
        )
    )
    with pytest.raises(ValueError, match="must not declare"):
        Chain.from_urdf(path)


# -- limits and xacro ----------------------------------------------------------------------------
def test_limits_are_kept(tmp_path):
    limit = '<axis xyz="0 0 1"/><limit lower="-1" upper="2" velocity="3" effort="4"/>'
    text = GOOD.replace('<axis xyz="0 0 1"/>', limit)
    limits = Chain.from_urdf(written(tmp_path, text)).limits
    assert [limits.lower[0], limits.upper[0], limits.velocity[0], limits.effort[0]] == [-1, 2, 3, 4]
    endless = Chain.from_urdf(written(tmp_path, text.replace("revolute", "continuous"))).limits
    assert [endless.lower[0], endless.upper[0], endless.velocity[0]] == [-np.inf, np.inf, 3]
    none = Chain.from_urdf(written(tmp_path, GOOD)).limits
    assert np.isinf(none.number_values()).all()
    with pytest.raises(ValueError, match="one finite number in velocity"):
        Chain.from_urdf(written(tmp_path, text.replace('velocity="3"', 'velocity="fast"')))


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ('lower="-1"', 'lower="5"'),
        ('velocity="3"', 'velocity="-1"'),
        ('effort="4"', 'effort="-4"'),
        ('lower="-1" upper="2"', 'lower="inf" upper="inf"'),
        ('lower="-1" upper="2"', 'lower="-inf" upper="-inf"'),
    ],
)
def test_limits_that_no_joint_has_are_refused_with_joint_and_file(tmp_path, right, wrong):
    limit = '<axis xyz="0 0 1"/><limit lower="-1" upper="2" velocity="3" effort="4"/>'
    text = GOOD.replace('<axis xyz="0 0 1"/>', limit.replace(right, wrong))
    with pytest.raises(
        ValueError, match=r"joint shoulder of .*robot\.urdf must have limits"
    ) as error:
        Chain.from_urdf(written(tmp_path, text))
    assert all(
        part.replace("=", " ").replace('"', "") in str(error.value) for part in wrong.split()
    )


XACRO = GOOD.replace(
    '<robot name="r">',
    '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="mass"'
    ' value="3"/>',
).replace('mass value="1"', 'mass value="${mass}"')


def test_xacro_is_expanded(tmp_path):
    pytest.importorskip("xacrodoc")
    chain = Chain.from_urdf(written(tmp_path, XACRO))
    assert chain.bodies[0].mass == 3
    with pytest.raises(ValueError, match="must be xacro that can be expanded"):
        Chain.from_urdf(written(tmp_path, XACRO.replace("${mass}", "${mas}")))
    with pytest.raises(ValueError, match="must not declare a document type"):
        Chain.from_urdf(written(tmp_path, '<!DOCTYPE r [<!ENTITY a "b">]>' + XACRO))


def test_expressions_alone_are_xacro(tmp_path):
    pytest.importorskip("xacrodoc")
    for value in ("${1 + 2}", "$(eval 1 + 2)"):
        text = GOOD.replace('mass value="1"', f'mass value="{value}"')
        assert Chain.from_urdf(written(tmp_path, text)).bodies[0].mass == 3


def test_a_mesh_in_a_package_is_no_xacro(tmp_path, monkeypatch):
    """Meshes are never read, so the file needs no tool."""
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    mesh = '<visual><geometry><mesh filename="$(find arm)/a.stl"/></geometry></visual></link>'
    text = GOOD.replace("</link>", mesh, 1)
    assert Chain.from_urdf(written(tmp_path, text)).n == 1


def test_xacro_without_its_tool_is_said(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    with pytest.raises(ValueError, match=r"it is xacro. Expand it .*pip install xacrodoc"):
        Chain.from_urdf(written(tmp_path, XACRO))


# -- friction and efforts ------------------------------------------------------------------------
MOTORS = {"gear": (100, -50), "motor_inertia": 1e-4, "motor_gain": 0.2}
STATED = (
    '<limit lower="-1" upper="2" velocity="3" effort="40"/><dynamics damping="2" friction="0.5"/>',
    (
        '<limit lower="-2" upper="1" velocity="4" effort="30"/><dynamics damping="0.7"'
        ' friction="0.3"/>'
    ),
)


def two_joints(*more):
    """Two revolute joints of a random file, with what is stated of each in place of its limits."""
    text = urdf(1, kinds=("revolute", "revolute"))
    for each in more:
        text = text.replace('<limit lower="-1" upper="1" effort="1" velocity="1"/>', each, 1)
    return text


def test_a_drive_has_the_friction_and_the_efforts_of_pinocchio_s_reader(tmp_path):
    text = two_joints(*STATED)
    path, model = written(tmp_path, text), pin.buildModelFromXML(text)
    drive = Drive.from_urdf(path, **MOTORS)
    np.testing.assert_allclose(drive.joint_viscous(), model.damping, rtol=1e-14)
    np.testing.assert_allclose(drive.joint_coulomb(), model.friction, rtol=1e-14)
    np.testing.assert_allclose(drive.torque_limit(), model.effortLimit, rtol=1e-14)
    limits = Chain.from_urdf(path).limits
    np.testing.assert_array_equal(limits.velocity, model.velocityLimit)
    np.testing.assert_array_equal(limits.lower, model.lowerPositionLimit)
    assert drive.joints == ("j1", "j2")
    mine = Drive.from_urdf(path, joints=["j2"], gear=50, motor_inertia=0, motor_gain=1, viscous=0.1)
    assert (mine.n, mine.viscous.tolist(), mine.torque_limit().tolist()) == (1, [0.1], [30.0])


@pytest.mark.parametrize(
    ("second", "given", "said"),
    [
        (
            STATED[1].replace('"30"', '"0"'),
            {},
            "effort of joint j2 in robot.urdf must be stated; .* Give current_limit",
        ),
        (
            STATED[1].split("<dyn")[0],
            {},
            "damping of joint j2 in robot.urdf must be stated; .* Give viscous",
        ),
        (STATED[1].split("<dyn")[0], {"viscous": 1e-3}, "friction of joint j2 .* Give coulomb"),
        (
            STATED[1].replace(' friction="0.3"', ""),
            {},
            r"Give coulomb motor side \(friction: or None\)",
        ),
        (
            STATED[1].replace('"0.3"', '"-0.3"'),
            {},
            "joint j2 must not have negative friction; got 0.7 and -0.3",
        ),
        (STATED[1], {"gear": (100, 0)}, "gear must not be zero; got 0.0 at joint j2"),
        (STATED[1], {"gear": (1, 2, 3)}, "joints must be 3 different names"),
        (
            STATED[1],
            {"coupling": Coupling(matrix=((1, 1), (1, -1)))},
            "viscous must be given of coupled motors",
        ),
        (STATED[1], {"gears": 1}, "an option of Drive must be one of .*Did you mean 'gear'"),
    ],
)
def test_what_a_file_does_not_state_of_a_drive_is_said_with_its_joint(
    tmp_path, second, given, said
):
    path = written(tmp_path, two_joints(STATED[0], second))
    with pytest.raises(ValueError, match=said) as error:
        Drive.from_urdf(path, **MOTORS | given)
    assert "\n" not in str(error.value)


def test_a_link_without_mass_between_two_joints_is_that_of_pinocchio(tmp_path):
    """As files write ball joints; the last link has a mass, or moves nothing."""
    kinds = ("revolute", "revolute", "revolute")
    text = re.sub(
        r'(<link name="l1">)<inertial>.*?</inertial>', r"\1", urdf(3, kinds=kinds), count=1
    )
    assert text != urdf(3, kinds=kinds)
    chain = Chain.from_urdf(written(tmp_path, text))
    assert [body.mass > 0 for body in chain.bodies] == [False, True, True]
    compared(chain, pin.buildModelFromXML(text))
    bare = (
        GOOD[: GOOD.rindex("<inertial>")] + GOOD[GOOD.rindex("</inertial>") + len("</inertial>") :]
    )
    with pytest.raises(
        ValueError, match="links must state their masses; of links arm to arm none does"
    ):
        Chain.from_urdf(written(tmp_path, bare))
