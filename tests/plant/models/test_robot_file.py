"""Robot files: the same bits on a round trip, the packaged robots, every key checked, no package
imported.
"""

import dataclasses
import re
import subprocess
import sys
import tomllib

import numpy as np
import packaged_arms
import pytest
from hypothesis import given
from hypothesis import strategies as st
from model_texts import urdf

from ctc import ComputedTorque
from plant import (
    PID,
    Chain,
    CosineTorque,
    Coupling,
    Dynamics,
    Elasticity,
    FrictionCurve,
    JointSpring,
    Phase,
    Presliding,
    Rig,
    Robot,
    Transport,
    puma560,
    read_robot,
    write_robot,
)
from plant.models import FOLDER, toml_lines, unit_of

COLUMNS = {"t": "time", "position": ("q 1", "q 2")}
UNITS = {"t": "s", "position": "rad"}


def base(chain, *, rotors=True):
    dynamics = Dynamics.from_chain(chain, rotors=rotors)
    return dynamics.arm(dynamics.f())


def rich_rig():
    """With every kind of part within parts."""
    rig = puma560.rig()
    drive = dataclasses.replace(
        rig.drive,
        curve=FrictionCurve(
            offset=(0.1, 0),
            breakaway=(0.2, 0.1),
            speed=(1, 2),
            viscous_offset=(1e-4 / 3, -2e-4),
            saturation=(20.0 / 3, np.inf),
            rise=(0.1, 0),
        ),
        load_friction=(0.01, 0.02),
        elasticity=Elasticity(stiffness=(1e4 / 3, 2e4), damping=(1, 2), backlash=(1e-4, 0)),
        current_lag=2e-4 / 3,
        presliding=Presliding(distance=(1e-3, 1e-3)),
        joints=("upper", 'fore "arm"'),
    )
    encoder = dataclasses.replace(rig.encoder, phase=Phase(shift=(0.1, 1 / 3)))
    springs = (
        JointSpring(stiffness=(1, 2), angle=(0, 0.1), preload=(0, 0)),
        CosineTorque(amplitude=(1, 0), phase=(0, 0)),
    )
    return Rig(
        drive=drive,
        encoder=encoder,
        period=0.7e-3,
        transport=Transport(delay=1e-4),
        springs=springs,
    )


def robots():
    whole, six = base(packaged_arms.puma560()), packaged_arms.puma560_rig()
    wrist = Coupling(matrix=[[1, 0], [0.25, 1]])
    rig = puma560.rig()
    coupled = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, coupling=wrist))
    return {
        "f of the paper": Robot(
            name="a \u00e9",
            arm=puma560.arm(),
            rig=puma560.rig(),
            law=puma560.p_law(),
            columns=COLUMNS,
            units=UNITS,
        ),
        "computed torque": Robot(arm=whole, rig=six, law=ComputedTorque(whole, six)),
        "no bodies": Robot(
            dynamics=Dynamics.from_chain(packaged_arms.tx40()), rig=packaged_arms.tx40_rig()
        ),
        "every part": Robot(arm=puma560.literature_arm(), rig=rich_rig()),
        "coupled": Robot(
            arm=base(packaged_arms.planar(2).coupled(wrist), rotors=False), rig=coupled
        ),
    }


@pytest.mark.parametrize("robot", robots().values(), ids=robots().keys())
def test_the_same_bits_on_a_round_trip(tmp_path, robot):
    write_robot(robot, tmp_path / "robot.toml")
    again = read_robot(tmp_path / "robot.toml")
    assert again == robot
    if robot.arm is not None:
        assert again.arm.f.tobytes() == robot.arm.f.tobytes()
    write_robot(again, tmp_path / "again.toml")
    assert (tmp_path / "again.toml").read_bytes() == (tmp_path / "robot.toml").read_bytes()


scalars = st.floats(allow_nan=False) | st.integers(-(2**60), 2**60) | st.booleans() | st.text()
values = st.recursive(scalars, lambda inner: st.lists(inner, max_size=3), max_leaves=8)
tables = st.recursive(
    st.dictionaries(st.text(), values, max_size=4),
    lambda inner: st.dictionaries(st.text(), inner | values, max_size=3),
)


@given(tables)
def test_any_table_is_read_back_by_tomllib(table):
    assert tomllib.loads("\n".join(toml_lines(table))) == table


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.float64(0.5), "0.5"),
        (np.int64(2), "2"),
        (np.float32(1.5), "1.5"),
        (np.bool_(True), "true"),
        (np.array([[1.0, 2.0]]), "[[1.0, 2.0]]"),
        ([np.float64(0.5), (np.int64(1),)], "[0.5, [1]]"),
    ],
)
def test_numbers_of_numpy_are_written_as_numbers(value, text):
    lines = toml_lines({"a": value, "b": {"c": {"d": value}}})
    found = tomllib.loads("\n".join(lines))
    expected = tomllib.loads(f"x = {text}")["x"]
    assert found == {"a": expected, "b": {"c": {"d": expected}}}


def test_a_robot_with_constants_of_numpy_is_read_back(tmp_path):
    units = {"position": "rad", "torque": {"N m per A": np.array([0.5, 0.25])}}
    columns = {"position": ["a", "b"], "torque": ["x", "y"]}
    law = ComputedTorque(puma560.arm(), puma560.rig(), delay=np.float64(1.0))
    robot = Robot(arm=puma560.arm(), rig=puma560.rig(), law=law, columns=columns, units=units)
    write_robot(robot, tmp_path / "r.toml")
    again = read_robot(tmp_path / "r.toml")
    assert again.law == law
    assert again.units == {"position": "rad", "torque": {"N m per A": [0.5, 0.25]}}


def test_packaged_robots_are_what_their_sources_say():
    paper, whole, tx40, ur5e = (
        read_robot(name) for name in ("paper_puma560", "puma560", "tx40", "ur5e")
    )
    assert (paper.arm, paper.rig, paper.law) == (puma560.arm(), puma560.rig(), puma560.p_law())
    assert whole.arm.dynamics.lumping == Dynamics.from_chain(whole.dynamics.chain).lumping
    assert whole.rig.encoder.resolution.tolist() == [1000, 800, 1000, 1000, 1000, 500]
    assert tx40.arm is None
    assert tx40.dynamics.chain.coupling == tx40.rig.drive.coupling
    assert ur5e.arm.dynamics.chain.links[1].name == "shoulder_lift"
    assert sorted(path.stem for path in FOLDER.glob("*.toml")) == [
        "koch",
        "openarm",
        "panda",
        "paper_puma560",
        "puma560",
        "so100",
        "so101",
        "tx40",
        "ur10",
        "ur5e",
        "yam",
    ]
    # published: 150 and 28 N m; the arm is 0.85 m long, and holds itself level
    np.testing.assert_allclose(
        ur5e.rig.drive.torque_limit(), ur5e.dynamics.chain.limits.effort, rtol=4e-3
    )
    held = np.abs(ur5e.arm.h(np.zeros(6), np.zeros(6)))
    assert 40 < held[1] < 80
    assert (np.linalg.eigvalsh(ur5e.arm.D(np.zeros(6))) > 0).all()


def test_an_arm_may_lie_in_a_model_file_beside_it(tmp_path):
    (tmp_path / "arm.urdf").write_text(urdf(1, kinds=("revolute", "revolute")))
    text = (FOLDER / "paper_puma560.toml").read_text()
    start, end = text.index("[arm]"), text.index("[law]")
    (tmp_path / "r.toml").write_text(
        text[:start] + '[arm]\nurdf = "arm.urdf"\nrotors = "drive"\n\n' + text[end:]
    )
    robot = read_robot(tmp_path / "r.toml")
    chain = Chain.from_urdf(tmp_path / "arm.urdf").with_rotors(puma560.rig().drive)
    assert robot.arm.dynamics.chain == chain


PAPER = (FOLDER / "paper_puma560.toml").read_text()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (PAPER.replace("viscous", "viscos"), r"\[drive\] must have keys of Drive; got 'viscos'. Did you mean 'viscous' "
                                             r"\(Kfr-visc \[N m s/rad\]\)"),
        (PAPER.replace("motor_gain", "#motor_gain"), r"must have 'motor_gain' \(K_i, .* \[N m/A\]\); it has not"),
        (PAPER.replace("[drive]", "[drives]"), "a table of the file must be one of .*Did you mean 'drive'"),
        (PAPER.replace("ranges", "rangs"), r"a key of \[arm\] must be one of .*Did you mean 'ranges'"),
        (PAPER.replace("alpha", "alhpa"), r"\[arm.links\[0\]\] must have keys of Link; got 'alhpa'. Did you mean 'alpha'"),
        (PAPER.replace("[law]", "[columns]").replace("[rig]", 'law = "P"\n[rig]', 1), r"\[law\] must be a table of keys; got 'P'"),
        (PAPER.replace("107.8, ", ""), "gear must have 2 numbers; got 1. Give one per joint, or one for all"),
        (PAPER.replace("plant.P", "plant.PP"), r"kind in \[law\] must be that of a part; got 'plant.PP'. Did you mean"),
        (PAPER.replace("plant.P", "ctc.Nothing"), "must be that of a part; got 'ctc.Nothing'"),
        (PAPER.replace("\ngain = [0.2", "\ngian = [0.2"), r"keys of P; got 'gian'. Did you mean 'gain'"),
        (PAPER.replace("Izz3 = 1.0, J3", "Izz33 = 1.0, J3"), "a term of f1 of .*Did you mean 'Izz3'"),
        (PAPER.replace('torque = "inertial"', 'torque = "inert"', 1), "torque of f1 .*Did you mean 'inertial'"),
        (PAPER.replace("f7 = {", "f7 = {m2 = 1.0, "), "lumping must describe the motion of the chain"),
        (PAPER.replace("[arm]", '[arm]\nurdf = "x.urdf"'), "must have one of links, urdf, mjcf; got links and urdf"),
        (PAPER.replace("[arm]", '[arm]\njoints = ["a"]'), r"\[arm\] must not have 'joints' beside 'links'"),
        (PAPER.replace("[arm]", '[arm]\ntable = "standard"\nbodies = 3'), r"bodies of \[arm\] must be of type list; got a value of type int"),
        (PAPER.replace("[rig]", "[rig]\ndrive = 3"), r"\[rig\] must not have 'drive'"),
        (PAPER.replace("0.0007", "-1"), "period must be a positive number"),
        (PAPER + '[columns]\nt = "time"\npos = "q"', "what a column is mapped to must be one of .*'position'"),
        (PAPER.replace("[drive]", "drive = 3\n[x]", 1), "a table of the file must be one of"),
        ("a = ", "must be TOML"),
        ("", r"the file must have \[arm\]"),
        (PAPER.replace("0.0007", '"?"').replace("107.8,", '"?",'), "still missing: rig.period, drive.gear. Rep"),
        (re.sub(r"viscous = .*", 'viscous = "urdf"', PAPER), r"\[drive\] must have numbers where \[arm\] has no urdf"),
    ],
)  # fmt: skip
def test_a_bad_file_is_refused_in_one_line(tmp_path, text, said):
    path = tmp_path / "r.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=said) as error:
        read_robot(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_units_of_inherited_numbers_are_those_of_the_base():
    assert [unit_of(PID, name) for name in ("gain", "integral", "derivative", "period")] == [
        "N m",
        "N m/s",
        "N m s",
        "s",
    ]


@pytest.mark.parametrize(
    ("name", "heaviest", "mass"),
    [
        ("so100", 1, 0.162409),
        ("so101", 2, 0.104),
        ("yam", 1, 1.24434),
        ("openarm", 0, 1.1416685),
        ("koch", 2, 0.06379),
        ("panda", 0, 4.970684),
        ("ur10", 1, 12.7),
    ],
)
def test_packaged_arms_have_the_masses_of_their_models(name, heaviest, mass):
    bodies = read_robot(name).dynamics.chain.bodies
    assert bodies[heaviest].mass == pytest.approx(mass, rel=1e-6)
    # All inertias are those of bodies that exist.
    for body in bodies:
        xx, xy, xz, yy, yz, zz = body.inertia
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert 0 < moments[2] < moments[0] + moments[1]


def test_servos_of_an_so101_are_those_of_the_published_fit():
    robot = read_robot("so101")
    drive = robot.rig.drive
    kt, ohm, volts = 1.212, 2.676, 7.4
    np.testing.assert_allclose(drive.viscous, kt**2 / ohm + 0.059, rtol=1e-3)
    np.testing.assert_allclose(drive.current_limit, kt / ohm * volts, rtol=1e-3)
    assert robot.rig.inner.sends == "goal"
    # Stretched out level it carries its weight; one rotor is a good part of its inertia.
    level = max(abs(robot.arm.h((0, q, 0, 0, 0), np.zeros(5))[1]) for q in (0, np.pi / 2))
    assert 0.5 < level < 1.2
    assert robot.arm.D(np.zeros(5))[4, 4] == pytest.approx(0.0284, rel=0.01)


def test_servos_of_a_koch_are_those_of_the_data_sheets():
    """XL430-W250 at 12 V and XL330-M288 at 5 V: stall torque, and speed without load."""
    rig = read_robot("koch").rig
    stall = np.array([1.5, 1.5, 0.52, 0.52, 0.52])
    free = np.array([61, 61, 103, 103, 103]) * 2 * np.pi / 60
    np.testing.assert_allclose(rig.drive.torque_limit(), stall)
    np.testing.assert_allclose(rig.drive.viscous, stall / free, rtol=2e-3)
    # P / 128 steps of 885 that are full voltage.
    P = np.array([800, 800, 400, 400, 400])
    np.testing.assert_allclose(rig.inner.gain, P / 128 / 885 * stall, rtol=3e-3)


@pytest.mark.parametrize(
    ("name", "pose", "reach", "torque"),
    [
        # From the axis of the second joint to the flange and the fingers; to the last axis.
        ("panda", (0, np.pi / 2, 0, -0.0698, 0, 1.6, 0), 0.316 + 0.384, 87),
        ("ur10", (0, 0, 0, 0, 0, 0), 0.612 + 0.5723, 330),
    ],
)
def test_industrial_arms_hold_themselves_stretched_out(name, pose, reach, torque):
    """The published torque carries the arm level, and the lever is the published one."""
    robot = read_robot(name)
    n = robot.rig.n
    held = abs(robot.arm.h(pose, np.zeros(n))[1])
    assert 0.2 * torque < held < torque
    # Mass times lever: the centre of mass is about the middle of the arm.
    mass = sum(body.mass for body in robot.dynamics.chain.bodies[1:])
    assert 0.3 * reach < held / (9.81 * mass) < 0.7 * reach
    np.testing.assert_allclose(robot.rig.drive.torque_limit()[1], torque)
    np.testing.assert_allclose(robot.dynamics.chain.limits.effort[1], torque)


@pytest.mark.parametrize(
    ("name", "kinds", "sends"),
    [
        ("yam", ("viscous",), "frame"),
        ("openarm", ("viscous", "coulomb"), "frame"),
        ("koch", ("coulomb",), "goal"),
        ("panda", ("viscous", "coulomb"), None),
        ("ur10", ("viscous", "coulomb"), None),
    ],
)
def test_friction_that_nobody_published_is_open(name, kinds, sends):
    robot = read_robot(name)
    assert robot.rig.drive.left_open == kinds
    assert getattr(robot.rig.inner, "sends", None) == sends
    with pytest.raises(ValueError, match="friction must be known"):
        ComputedTorque(robot.arm, robot.rig)


def test_refusals(tmp_path):
    with pytest.raises(
        ValueError,
        match=r"there is none. Give its path, or one of koch, openarm, panda, paper_puma560, puma560",
    ):
        read_robot("ur6e")
    robot = read_robot("paper_puma560")
    write_robot(robot, tmp_path / "r.toml")
    with pytest.raises(ValueError, match="target must be a new file"):
        write_robot(robot, tmp_path / "r.toml")
    write_robot(robot, tmp_path / "r.toml", overwrite=True)
    with pytest.raises(ValueError, match="arm or dynamics must be given"):
        Robot(rig=puma560.rig())
    with pytest.raises(ValueError, match="rig must have 6 joints like the arm; got 2"):
        Robot(rig=puma560.rig(), dynamics=Dynamics.from_chain(packaged_arms.tx40()))


def test_a_law_of_a_package_that_is_not_imported(tmp_path):
    """plant imports no other package for a file."""
    write_robot(robots()["computed torque"], tmp_path / "r.toml")
    code = f"import plant; plant.read_robot({str(tmp_path / 'r.toml')!r})"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)  # noqa: S603
    assert "Import ctc first." in said.stderr
