"""What a file has beside the chain: read as MuJoCo, pinocchio and xacro read it, or refused where it
acts on the chain.
"""

import os
import time

import numpy as np
import pytest

from plant import Body, Chain, Drive, Dynamics, Link

# -- MJCF ----------------------------------------------------------------------------------------
ARM = """<mujoco>
  <compiler angle="radian" {compiler}/>
  <default><general forcerange="-31 31"/><default class="weak"><general forcerange="-9 4"/></default>
  </default>
  <worldbody>{world}
    <body name="pedestal" pos="0 0 0.4">
      <body name="upper" pos="0 0.1 0" {of_body}>
        <inertial mass="2.5" pos="0.01 -0.03 0.11" diaginertia="0.03 0.025 0.012"/>
        <joint name="swing" axis="0 1 0" range="-2 1"/>
        <body name="lower" pos="0.2 0 0.3" quat="1 0.2 -0.3 0.1">
          <inertial mass="1.3" pos="0 0.05 0.02" diaginertia="0.011 0.009 0.006"/>
          <joint name="bend" axis="1 0 0.2" {of_joint}/>{within}
          <site name="wrist"/>
          <body name="finger" pos="0 0.1 0.2">
            <inertial mass="0.2" pos="0 0 0.03" diaginertia="3e-4 2e-4 2e-4"/>
            <joint name="grip" type="slide" axis="0 1 0" {of_finger}/><site name="tip"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>{sections}
</mujoco>"""
PARTS = ("compiler", "world", "of_body", "of_joint", "of_finger", "within", "sections")


def mjcf(tmp_path, **parts):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(**dict.fromkeys(PARTS, "") | parts))
    return path


def torques_agree(path, joints, chain=None):
    """Of MuJoCo and of the chain, with all other joints at rest at zero, a random state."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(path))
    chain = chain or Chain.from_mjcf(path, joints)
    dynamics = Dynamics.from_chain(chain)
    states = np.random.default_rng(3).uniform(-1, 1, (3, len(joints)))
    data = mujoco.MjData(model)
    dofs = [model.joint(name).dofadr[0] for name in joints]
    data.qpos[[model.joint(name).qposadr[0] for name in joints]] = states[0]
    data.qvel[dofs], data.qacc[dofs] = states[1:]
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    mujoco.mj_inverse(model, data)
    expected = data.qfrc_inverse[dofs]
    got = dynamics.arm(dynamics.f()).inverse(*states)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


CAMERA = (
    '<body name="camera"><inertial mass="0.3" pos="0 0 0" diaginertia="2e-4 2e-4 2e-4"/></body>'
)
BESIDE = {
    "tendon and equality of fingers": {
        "sections": '<tendon><fixed><joint joint="grip" coef="1"/></fixed></tendon>'
        '<equality><joint joint1="grip" polycoef="0.1"/></equality>'
    },
    "spatial tendon within the hand": {
        "sections": '<tendon><spatial stiffness="20"><site site="wrist"/><site site="tip"/>'
        "</spatial></tendon>"
    },
    "spring of a finger": {"of_finger": 'stiffness="40"'},
    "a free body": {"world": f'<body name="ball" pos="1 1 1"><freejoint/>{CAMERA}<geom size=".1"/></body>'},
    "nested frames": {
        "within": '<frame pos="0.1 0.2 0" euler="0.3 0 0"><frame quat="1 0 1 0"><geom size=".01"'
        f' mass="0"/>{CAMERA}</frame></frame>'
    },
    "two joints of a thumb": {
        "within": '<body name="thumb" pos="0 0.1 0"><inertial mass="0.1" pos="0 0 0.1"'
        ' diaginertia="1e-4 1e-4 1e-4"/><joint name="out" axis="1 0 0" pos="0 0.1 0"/><joint'
        ' name="curl" axis="0 1 0"/></body>'
    },
    "a ball joint": {"within": f'<body pos="0 0 0.2"><joint type="ball"/>{CAMERA}<inertial mass="0.1" pos="0 0 0" diaginertia="1e-4 1e-4 1e-4"/></body>'},
    "bounds of masses": {"compiler": 'boundmass="0.25" boundinertia="0.008"'},
    "balanced inertia": {
        "compiler": 'balanceinertia="true"',
        "within": '<body name="plate"><inertial mass="0.3" pos="0.1 0 0" quat="1 1 0 0"'
        ' diaginertia="1e-3 1e-3 4e-3"/></body>',
    },
    "a controller's plugin": {"sections": '<extension><plugin plugin="mujoco.pid"/></extension>'},
}  # fmt: skip


@pytest.mark.parametrize("parts", BESIDE.values(), ids=BESIDE)
def test_what_is_beside_the_chain_is_no_reason_to_refuse_it(tmp_path, parts):
    torques_agree(mjcf(tmp_path, **parts), ["swing", "bend"])


def test_two_joints_of_one_body_turn_one_after_the_other(tmp_path):
    path = mjcf(tmp_path, **BESIDE["two joints of a thumb"])
    torques_agree(path, ["swing", "bend", "out", "curl"])
    torques_agree(path, ["swing", "curl"])


ACTS = {
    "a tendon to the pedestal": (
        {
            "world": '<site name="hook"/>',
            "sections": '<tendon><spatial name="rope"><site site="hook"/><site site="tip"/>'
            "</spatial></tendon>",
        },
        "<tendon> rope must not act on the chain.*finger, world",
    ),
    "an equality of its joint": (
        {"sections": '<equality><joint name="pair" joint1="grip" joint2="bend"/></equality>'},
        "<equality> pair .*acts on bend",
    ),
    "a weld to the world": (
        {"sections": '<equality><weld body1="finger"/></equality>'},
        "<equality> must not act on the chain.*finger, world",
    ),
    "a spring of its joint": ({"of_joint": 'stiffness="3"'}, "stiffness of <joint> must be zero"),
    "a copied body on it": (
        {"within": '<replicate count="2"><geom size="1"/></replicate>'},
        "<replicate> must not be in lower",
    ),
    "masses of geoms": (
        {"within": '<body name="cup"><geom size="0.1"/></body>'},
        "body cup must have one <inertial>",
    ),
    "a missing part of it": (
        {"within": '<include file="gone.xml"/>'},
        "<include> must name a file that is there; gone.xml is not",
    ),
}


@pytest.mark.parametrize(("parts", "said"), ACTS.values(), ids=ACTS)
def test_what_acts_on_the_chain_is_refused_by_name(tmp_path, parts, said):
    path = mjcf(tmp_path, **parts)
    with pytest.raises(ValueError, match=said) as error:
        Chain.from_mjcf(path, ["swing", "bend"])
    assert "\n" not in str(error.value)


def test_gravity_compensation_is_a_controller_s(tmp_path):
    """The bodies have their weight; only links of the chain are a matter for the warning."""
    plain = Chain.from_mjcf(mjcf(tmp_path), ["swing", "bend"])
    path = mjcf(tmp_path, of_body='gravcomp="1"')
    with pytest.warns(UserWarning, match="gravity of upper"):
        assert Chain.from_mjcf(path, ["swing", "bend"]) == plain
    Chain.from_mjcf(path, ["bend"])


def test_efforts_of_actuators(tmp_path):
    actuators = (
        '<actuator><position joint="swing" kp="4"/><general joint="bend" gear="6" class="weak"/>'
        '<motor joint="grip" ctrlrange="-7 7"/></actuator>'
    )
    limits = Chain.from_mjcf(mjcf(tmp_path, sections=actuators), ["swing", "bend", "grip"]).limits
    np.testing.assert_array_equal(limits.effort, [31, 54, 7])
    free = Chain.from_mjcf(mjcf(tmp_path), tip="lower").limits
    np.testing.assert_array_equal(free.effort, [np.inf, np.inf])


def test_base_and_tip_of_an_mjcf_file(tmp_path):
    path = mjcf(tmp_path, world=f'<body name="ball"><freejoint name="loose"/>{CAMERA}</body>')
    assert Chain.from_mjcf(path, tip="lower") == Chain.from_mjcf(path, ["swing", "bend"])
    assert [link.name for link in Chain.from_mjcf(path, base="upper", tip="finger").links] == [
        "bend",
        "grip",
    ]
    with pytest.raises(ValueError, match=r"joint loose must be a hinge.*<freejoint>"):
        Chain.from_mjcf(path, tip="ball")


def test_an_include_is_relative_to_the_model_or_to_its_own_file(tmp_path):
    """As MuJoCo reads them."""
    folder = tmp_path / "parts"
    folder.mkdir()
    path = mjcf(tmp_path, within='<include file="parts/hand.xml"/>')
    (folder / "hand.xml").write_text('<mujocoinclude><include file="eye.xml"/></mujocoinclude>')
    (folder / "eye.xml").write_text(f"<mujocoinclude>{CAMERA}</mujocoinclude>")
    torques_agree(path, ["swing", "bend"])
    (tmp_path / "eye.xml").write_text(
        f"<mujocoinclude>{CAMERA.replace('0.3', '0.7')}</mujocoinclude>"
    )
    torques_agree(path, ["swing", "bend"])
    sketch = mjcf(tmp_path, sections='<asset><include file="meshes.xml"/></asset>')
    assert Chain.from_mjcf(sketch, ["swing"]).n == 1


# -- URDF ----------------------------------------------------------------------------------------
BALL = '<inertia ixx="{2}" ixy="0" ixz="0" iyy="{2}" iyz="0" izz="{2}"/>'
LINK = (
    '<link name="{0}"><inertial><origin xyz="0.1 0 0.2"/><mass value="{1}"/>'
    + BALL
    + "</inertial></link>"
)
JOINT = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/>{}</joint>'
FILE = (
    '<robot name="r">'
    + LINK.format("base", 1, 0.02)
    + LINK.format("arm", 2, 0.03)
    + LINK.format("gripper", 0.3, 0.01)
    + JOINT.format("turn", "revolute", "base", "arm", '<axis xyz="0 1 0"/>{turn}')
    + JOINT.format("grip", "prismatic", "arm", "gripper", '<axis xyz="1 0 0"/>{grip}')
    + "{more}</robot>"
)  # fmt: skip


def urdf(tmp_path, **parts):
    path = tmp_path / "robot.urdf"
    path.write_text(FILE.format(**{"turn": "", "grip": "", "more": ""} | parts))
    return path


def spoilt(tmp_path, wrong, right):
    path = urdf(tmp_path)
    text = path.read_text()
    assert text.count(wrong) == 1
    path.write_text(text.replace(wrong, right))
    return path


@pytest.mark.parametrize(
    "parts",
    [
        {"grip": '<dynamics damping="-2.5" friction="1"/>'},
        {"grip": '<limit lower="4" upper="-4" effort="fast" velocity="1"/>'},
        {"grip": '<limit effort="-3"/>'},
        {"more": JOINT.format("idle", "planar", "base", "pad", "") + '<link name="pad"/>'},
        {"more": JOINT.format("idle", "screw", "arm", "pad", "") + '<link name="pad"/>'},
        {"more": JOINT.format("loose", "fixed", "shelf", "box", "") + '<link name="box"/>'},
        {
            "more": '<link name="pad"><inertial><mass value="nan"/></inertial></link>'
            + JOINT.format("fix", "fixed", "base", "pad", "")
        },
    ],
    ids=str,
)
def test_what_a_chain_does_not_use_is_not_judged(tmp_path, parts):
    expected = Chain.from_urdf(urdf(tmp_path), ["turn"])
    assert Chain.from_urdf(urdf(tmp_path, **parts), ["turn"]) == expected


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ({"turn": '<dynamics friction="-1"/>'}, "joint turn must not have negative friction"),
        ({"turn": '<limit effort="fast"/>'}, "joint turn, limit must have one finite number"),
        ({"grip": '<origin xyz="0 0"/>'}, "joint grip, origin must have 3 finite numbers"),
        (
            {
                "more": '<link name="pad"><inertial><mass value="nan"/></inertial></link>'
                + JOINT.format("fix", "fixed", "gripper", "pad", "")
            },
            "link pad, mass must have one finite number",
        ),
        ({"more": JOINT.format("fix", "fixed", "arm", "grper", "")}, "got 'grper'.*'gripper'.*missing"),
    ],
)  # fmt: skip
def test_what_a_chain_needs_is_refused_by_name(tmp_path, parts, said):
    path = urdf(tmp_path, **parts)
    for read in (Chain.from_urdf, lambda path, joints: Chain.from_urdf(path, tip="arm")):
        with pytest.raises(ValueError, match=said) as error:
            read(path, ["turn"])
        assert "\n" not in str(error.value)


def test_the_world_is_there_without_being_declared(tmp_path):
    path = urdf(tmp_path, more=JOINT.format("weld", "fixed", "world", "base", ""))
    assert Chain.from_urdf(path, ["turn", "grip"]) == Chain.from_urdf(
        urdf(tmp_path), base="base", tip="gripper"
    )
    path = urdf(tmp_path, more=JOINT.format("weld", "fixed", "floor", "base", ""))
    with pytest.raises(ValueError, match=r"joint weld .*'floor'. Add <link name=\"floor\"/>, or"):
        Chain.from_urdf(path)


@pytest.mark.parametrize("tip", ["one", "two"])
@pytest.mark.parametrize("order", [1, -1])
def test_a_link_that_is_not_declared_is_refused_wherever_it_is_named(tmp_path, tip, order):
    joints = [JOINT.format(f"to_{name}", "revolute", "ghost", name, "") for name in ("one", "two")]
    links = [LINK.format(name, 1, 0.02) for name in ("one", "two")]
    path = urdf(tmp_path, more="".join(links + joints[::order]))
    with pytest.raises(ValueError, match=f"joint to_{tip} .*'ghost'"):
        Chain.from_urdf(path, base="ghost", tip=tip)


@pytest.mark.parametrize("order", [1, -1])
def test_a_world_that_moves_is_refused_wherever_it_is_named(tmp_path, order):
    joints = [
        JOINT.format("sway", "revolute", "gripper", "world", ""),
        JOINT.format("weld", "fixed", "world", "pad", ""),
    ]
    path = urdf(tmp_path, more="".join([LINK.format("pad", 1, 0.02), *joints[::order]]))
    with pytest.raises(ValueError, match=r"joint sway .*'world'"):
        Chain.from_urdf(path, base="base", tip="pad")


def test_infinite_limits(tmp_path):
    limit = '<limit lower="-inf" upper="+Infinity" effort="inf" velocity="INF"/>'
    limits = Chain.from_urdf(urdf(tmp_path, turn=limit), ["turn"]).limits
    assert np.isinf(limits.number_values()).all()
    with pytest.raises(ValueError, match="one finite number in effort; got 'nan'"):
        Chain.from_urdf(urdf(tmp_path, turn='<limit effort="nan"/>'), ["turn"])
    drive = {"gear": 50, "motor_inertia": 0, "motor_gain": 1, "viscous": 0, "coulomb": 0}
    with pytest.raises(ValueError, match=r"effort of joint turn .* must be stated"):
        Drive.from_urdf(urdf(tmp_path, turn=limit), joints=["turn"], **drive)


@pytest.mark.parametrize(
    "encoding",
    ["utf-8", "utf-8-sig", "iso-8859-1", "windows-1252", "utf-16", "gb2312", "shift_jis", "euc-kr"],
)
def test_any_declared_encoding(tmp_path, encoding):
    """And edits are written in it: all other characters stay."""
    from plant.mechanics import parsed, spliced

    word = {"gb2312": "机器人", "shift_jis": "ロボット", "euc-kr": "로봇"}.get(encoding, "Gerät")
    text = urdf(tmp_path).read_text()
    declared = encoding.removesuffix("-sig")
    head = f'<?xml version="1.0" encoding="{declared}"?>\n<!-- {word} -->'
    text = head + text.replace("gripper", word)
    path = tmp_path / "coded.urdf"
    path.write_bytes(text.encode(encoding))
    chain = Chain.from_urdf(path, tip=word)
    assert chain.bodies == Chain.from_urdf(urdf(tmp_path), tip="gripper").bodies
    root, data = parsed(path, "robot", "URDF")
    edit = root.all("link")[1].find("inertial").find("mass").attribute_edit(data, "value", "7")
    edited = text.replace('value="2"', 'value="7"').encode(encoding)
    assert spliced(data, [edit]) == edited


def test_an_encoding_that_a_file_does_not_have(tmp_path):
    path = tmp_path / "coded.urdf"
    for name in ("utf-16", "klingon", "hex"):
        path.write_bytes(f'<?xml version="1.0" encoding="{name}"?>\n<robot name="ö"/>'.encode())
        with pytest.raises(ValueError, match="must be text in the encoding"):
            Chain.from_urdf(path)


def test_a_file_whose_bytes_tell_another_encoding_is_read_but_not_written(tmp_path):
    """UTF-16 is known by its first bytes; the name that it declares is needed to write it."""
    from plant.mechanics import parsed, spliced

    path = tmp_path / "coded.urdf"
    for name in ("klingon", "hex"):
        head = f'<?xml version="1.0" encoding="{name}"?>'
        path.write_bytes((head + urdf(tmp_path).read_text()).encode("utf-16"))
        root, data = parsed(path, "robot", "URDF")
        assert Chain.from_urdf(path) == Chain.from_urdf(urdf(tmp_path))
        with pytest.raises(ValueError, match=f"encoding of text; got '{name}'"):
            spliced(data, [root.attribute_edit(data, "name", "new")])


def test_new_text_in_a_file_of_ascii_is_ascii(tmp_path):
    """Its own bytes stay, although they are UTF-8 under a declaration of ASCII."""
    from plant.mechanics import parsed, spliced

    path = tmp_path / "coded.urdf"
    for comment in ("", "<!-- Gerät -->"):
        text = f'<?xml version="1.0" encoding="US-ASCII"?>{comment}<robot name="r"/>'
        path.write_text(text, encoding="utf-8")
        root, data = parsed(path, "robot", "URDF")
        edits = [root.attribute_edit(data, "name", "é"), root.child_edit(data, '<link name="ü"/>')]
        written = '<robot name="&#233;"><link name="&#252;"/></robot>'
        edited = text.replace('<robot name="r"/>', written).encode()
        assert spliced(data, edits) == edited
        path.write_bytes(edited)
        again, _ = parsed(path, "robot", "URDF")
        assert (again.attributes["name"], again.children[0].attributes["name"]) == ("é", "ü")


@pytest.mark.parametrize("empty", ["<inertial/>", "<inertial></inertial>", "<inertial />"])
def test_an_empty_inertial_is_filled(tmp_path, empty):
    from plant.mechanics import parsed, spliced
    from plant.models import urdf_inertial

    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="r"><link name="a">{empty}</link></robot>')
    robot, data = parsed(path, "robot", "URDF")
    body = Body(mass=2.0, com=(0.1, 0, 0), inertia=(0.1, 0, 0, 0.1, 0, 0.1))
    path.write_bytes(spliced(data, urdf_inertial(data, robot.children[0], body)))
    robot, _ = parsed(path, "robot", "URDF")
    parts = robot.children[0].find("inertial").children
    assert [part.tag for part in parts] == ["origin", "mass", "inertia"]


def test_two_edits_of_the_same_bytes_are_refused(tmp_path):
    """Both children of an empty element would close it."""
    from plant.mechanics import parsed, spliced

    path = tmp_path / "arm.urdf"
    path.write_text('<robot name="r"/>')
    robot, data = parsed(path, "robot", "URDF")
    edits = [robot.child_edit(data, f'<link name="{name}"/>') for name in "ab"]
    with pytest.raises(ValueError, match="must not overlap; two replace byte 15"):
        spliced(data, edits)
    path.write_text('<robot name="r"></robot>')
    robot, data = parsed(path, "robot", "URDF")
    edits = [robot.child_edit(data, f'<link name="{name}"/>') for name in "ab"]
    expected = b'<robot name="r"><link name="a"/><link name="b"/></robot>'
    assert spliced(data, edits) == expected


def test_a_long_text_of_digits_is_refused_at_once(tmp_path):
    path = urdf(tmp_path)
    long = "1" * 12_000 + "x"
    path.write_text(path.read_text().replace('<mass value="2"', f'<mass value="{long}"'))
    begin = time.process_time()
    with pytest.raises(ValueError, match="must have one finite number in value; got '1111"):
        Chain.from_urdf(path)
    # The time grows with the digits, not with their square, which takes seconds.
    assert time.process_time() - begin < 1


def test_a_slip_of_the_triangle_inequality_is_said_and_read(tmp_path):
    """Of 4 %; one of 30 % is no slip. Of a link that the chain does not use nothing is said."""
    path = spoilt(tmp_path, 'ixx="0.03"', 'ixx="0.0625"')
    with pytest.warns(UserWarning, match="link arm that misses the triangle inequality by 4 %"):
        chain = Chain.from_urdf(path, ["turn"])
    dynamics = Dynamics.from_chain(chain)
    assert dynamics.f().shape == (dynamics.p,)
    path = spoilt(tmp_path, 'ixx="0.03"', 'ixx="0.09"')
    with pytest.raises(ValueError, match="triangle inequality"):
        Chain.from_urdf(path, ["turn"])
    Chain.from_urdf(path, ["grip"])


# -- xacro ---------------------------------------------------------------------------------------
HEAD = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'


@pytest.mark.parametrize("place", ["$(find my_arm)/urdf/parts", "parts", "../urdf/parts"])
def test_xacro_in_a_folder_that_is_no_package_of_this_machine(tmp_path, monkeypatch, place):
    """Includes relative to their own files, and packages around the file; meshes are not needed."""
    pytest.importorskip("xacrodoc")
    folder = tmp_path / "my_arm" / "urdf" / "parts"
    folder.mkdir(parents=True)
    (tmp_path / "my_arm" / "package.xml").write_text("<package><name>my_arm</name></package>")
    mesh = '<visual><geometry><mesh filename="{}"/></geometry></visual></link>'
    text = urdf(tmp_path).read_text().removeprefix('<robot name="r">').removesuffix("</robot>")
    first, rest = text.split("</link>", 1)
    (folder / "all.xacro").write_text(
        HEAD + f'<xacro:include filename="more.xacro"/>{first}' + mesh.format("package://none/a.stl")
        + rest.replace("</link>", mesh.format("$(find none_at_all)/b.stl"), 1) + "</robot>"
    )  # fmt: skip
    (folder / "more.xacro").write_text(f'{HEAD}<xacro:property name="m" value="4"/></robot>')
    path = tmp_path / "my_arm" / "urdf" / "arm.urdf.xacro"
    path.write_text(f'{HEAD}<xacro:include filename="{place}/all.xacro"/></robot>')
    monkeypatch.chdir("/")
    expected = Chain.from_urdf(urdf(tmp_path))
    assert Chain.from_urdf(path) == expected
    assert Chain.from_urdf(os.path.relpath(path)) == expected
    path.write_text(path.read_text().replace(place, "$(find other_arm)"))
    with pytest.raises(ValueError, match=r"Put the folder of other_arm beside it") as error:
        Chain.from_urdf(path)
    assert "\n" not in str(error.value)


# -- Denavit-Hartenberg --------------------------------------------------------------------------
def standard_tool(rows, q):
    """Place of the tool by the definition of the standard table."""
    pose = np.eye(4)
    for row, angle in zip(rows, q, strict=True):
        c, s = np.cos(angle + row["theta"]), np.sin(angle + row["theta"])
        ca, sa = np.cos(row["alpha"]), np.sin(row["alpha"])
        a, d = row["a"], row["d"]
        pose = pose @ np.array(
            [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    return pose[:3, 3]


def calibrated(offset, tilt=1.5e-3):
    """A shoulder, three parallel axes and a wrist, calibrated: nearly parallel axes meet far away.

    Rows of the same geometry but for `tilt`, which run `offset` along the second axis.
    """
    right = np.pi / 2
    return [
        {"theta": 1e-4, "alpha": right + 2e-4, "a": 1e-4, "d": 0.12},
        {"theta": 0.7, "alpha": tilt, "a": 0.31, "d": offset},
        {"theta": -1.1, "alpha": -2 * tilt, "a": 0.27, "d": 0.4 - 1.6 * offset},
        {"theta": 0.4, "alpha": right, "a": 0.01, "d": -0.35 + 0.6 * offset},
        {"theta": 0.0, "alpha": -right, "a": 0.0, "d": 0.1},
        {"theta": 0.2, "alpha": 0.0, "a": 0.0, "d": 0.08},
    ]


def chain_tool(chain, q):
    from plant import Placement

    pose = Placement()
    for link, angle in zip(chain.links, q, strict=True):
        row = Placement.of_row(alpha=link.alpha, a=link.a, d=link.d, theta=link.theta + angle)
        pose = pose @ link.before @ row
    return (pose @ chain.links[-1].frame).position


@pytest.mark.parametrize("offset", [3.0, 130.0, -612.0])
def test_rows_along_nearly_parallel_axes(offset):
    """The tool is where the table has it, and no frame is far from its neighbours; bodies are in
    the frames of the table.
    """
    rows, random = calibrated(offset), np.random.default_rng(1)
    bodies = [Body(mass=1, com=random.normal(size=3)) for _ in rows]
    chain = Chain.standard(rows, bodies=bodies)
    for q in random.uniform(-2, 2, (5, 6)):
        np.testing.assert_allclose(chain_tool(chain, q), standard_tool(rows, q), atol=1e-11)
    if abs(offset) > 50:
        size = max(np.abs(link.before.position).max() + abs(link.d) for link in chain.links)
        assert size < abs(offset) * 6e-3 + 1.5
    assert chain.bodies == tuple(bodies)


def test_an_offset_in_millimetres_is_still_refused():
    """Of a row whose axis is not nearly parallel to a neighbour's, and of parallel ones in mm."""
    rows = calibrated(0.2)
    rows[4]["d"] = 85.4
    with pytest.raises(
        ValueError, match=r"d of link 5 must be a length in metres.*nearly parallel"
    ):
        Chain.standard(rows)
    rows = [Link(name="1", d=0.3), Link(name="2", a=0.4, alpha=1.0, d=-166.0)]
    with pytest.raises(ValueError, match=r"d of link 2 .* Divide by 1000 if it is in mm"):
        Chain(links=rows)


@pytest.mark.parametrize(
    ("rows", "name"),
    [
        ((Link(name="1", d=0.4), Link(name="2", d=-200.0, prismatic=True)), "2"),
        ((Link(name="1", d=300.0), Link(name="2", a=0.1)), "1"),
        ((Link(name="1", d=300.0), Link(name="2", a=0.1), Link(name="3", a=0.1, d=-300.0)), "1"),
    ],
)
def test_an_offset_that_no_parallel_axis_leads_back_is_refused(rows, name):
    """Also that of the last link, whose body would lie far away."""
    with pytest.raises(ValueError, match=rf"^d of link {name} must be a length in metres"):
        Chain(links=rows)


def test_rows_that_come_back_exactly_are_near_each_other():
    chain = Chain(links=[Link(name="1", d=300.0), Link(name="2", a=0.1, d=-300.0)])
    np.testing.assert_allclose(chain_tool(chain, (0.0, 0.0)), (0.1, 0.0, 0.0), atol=1e-12)
    assert max(np.abs(link.before.position).max() for link in chain.links) < 1
