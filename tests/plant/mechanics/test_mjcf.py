"""MJCF import against MuJoCo itself, then what the subset leaves out."""

import numpy as np
import pytest

from plant import Chain, Dynamics

pytest.importorskip("mujoco")
pytest.importorskip("pinocchio")
from model_texts import mjcf, mujoco_torques


def written(tmp_path, text, name="robot.xml"):
    path = tmp_path / name
    path.write_text(text)
    return path


@pytest.mark.parametrize(("seed", "sequence"), [(0, "xyz"), (1, "ZYX"), (2, "XYz")])
def test_agrees_with_mujoco(tmp_path, seed, sequence):
    """Rounding of MuJoCo's own diagonalisation and quaternions leaves 1e-9 of the largest
    torque.
    """
    path = written(tmp_path, mjcf(seed, sequence=sequence))
    chain = Chain.from_mjcf(path)
    names = [link.name for link in chain.links]
    assert names == ["j0", "j2", "j3", "j4"]
    dynamics = Dynamics.from_chain(chain)
    arm, states = dynamics.arm(dynamics.f()), np.random.default_rng(0).uniform(-1, 1, (20, 3, 4))
    expected = mujoco_torques(path, names, states)
    got = np.array([arm.inverse(*state) for state in states])
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert [body.rotor for body in chain.bodies] == [0.1] * 4


JOINT = '<joint name="j"/>'
BODY = '<body name="b">{}<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
GOOD = f'<mujoco><worldbody><geom size="1"/>{BODY.format(JOINT)}</worldbody></mujoco>'


def with_top(text):
    return GOOD.replace("<mujoco>", f"<mujoco>{text}")


def with_joint(text):
    return GOOD.replace(JOINT, text)


def test_limits_armature_and_degrees(tmp_path):
    text = with_joint('<joint name="j" range="-90 45" armature="0.3" actuatorfrcrange="-5 7"/>')
    chain = Chain.from_mjcf(written(tmp_path, text))
    np.testing.assert_allclose(
        [chain.limits.lower[0], chain.limits.upper[0]], [-np.pi / 2, np.pi / 4], rtol=1e-15
    )
    assert (chain.limits.effort[0], chain.limits.velocity[0], chain.bodies[0].rotor) == (
        7,
        np.inf,
        0.3,
    )
    text = text.replace("<mujoco>", '<mujoco><compiler angle="radian" autolimits="false"/>')
    assert np.isinf(Chain.from_mjcf(written(tmp_path, text)).limits.lower[0])
    assert Chain.from_mjcf(written(tmp_path, GOOD)).gravity == (0, 0, -9.81)


def test_included_files_are_read(tmp_path):
    (tmp_path / "more.xml").write_text(f"<mujocoinclude>{BODY.format(JOINT)}</mujocoinclude>")
    text = '<mujoco><worldbody><include file="more.xml"/></worldbody></mujoco>'
    assert Chain.from_mjcf(written(tmp_path, text)).n == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (with_top("<tendon><fixed/></tendon>"), "<tendon> must not act on the chain"),
        (with_top("<equality><weld/></equality>"), "<equality> must not act"),
        (
            with_top('<deformable><flex body="b world"/></deformable>'),
            "<deformable> must not act on the chain.* acts on b, world",
        ),
        (with_top('<option density="1.2"/>'), "density of <option> must be zero: a fluid"),
        (
            with_top('<compiler inertiafromgeom="true"/>').replace("<inertial", "<geom/><inertial"),
            "body b must have its mass from <inertial>",
        ),
        (with_top('<compiler angle="grad"/>'), "angle of <compiler> must be one of"),
        (
            with_top('<include file="gone.xml"/>'),
            "<include> must name a file that is there; .*gone.xml is not",
        ),
        (with_joint("<freejoint/>"), "joint of b must be a hinge or a slide; it is <freejoint>"),
        (
            with_joint('<joint name="j" type="ball"/>'),
            "joint j must be a hinge or a slide; it is <joint type='ball'>",
        ),
        (with_joint('<joint name="j" type="free"/>'), "it is <joint type='free'>"),
        (
            with_joint('<joint name="j" stiffness="3"/>'),
            "stiffness of <joint> must be zero: a spring",
        ),
        (with_joint('<joint name="j" class="amr"/>'), "class of joint j must be one of"),
        (with_joint('<joint name="j" axis="0 0 0"/>'), "axis that is not zero"),
        (with_joint(JOINT + "<composite/>"), "<composite> must not be in b"),
        (
            GOOD.replace("<inertial", "<geom/><site").replace("mass", "name"),
            "body b must have one <inertial>",
        ),
        (
            GOOD.replace('diaginertia="1 1 1"', 'diaginertia="1 1 3"'),
            "body behind joint j .* must have an inertia that a body can have",
        ),
        (GOOD.replace('mass="1"', 'mass="nan"'), "body b must have one finite number in mass"),
        (GOOD.replace('pos="0 0 0"', 'quat="0 0 0 0"'), "must have a direction in quat"),
        (GOOD.replace('pos="0 0 0"', 'xyaxes="1 0 0 2 0 0"'), "axes that differ in xyaxes"),
        (GOOD.replace('pos="0 0 0"', 'xyaxes=".1 .7 .3 .3 2.1 .9"'), "axes that differ in xyaxes"),
        (
            GOOD.replace('pos="0 0 0"', 'quat="1 0 0 0" euler="0 0 0"'),
            "must have one orientation; it has quat and euler",
        ),
        ("<mujoco><worldbody/></mujoco>", "the file must have bodies"),
        ("<robot/>", "must hold a <mujoco>; got <robot>"),
        ("<mujoco>" * 201 + "</mujoco>" * 201, "must nest at most 200 elements"),
    ],
    ids=lambda x: x[:50] if len(x) < 110 else "file",
)
def test_what_is_not_read_is_refused_by_name(tmp_path, text, said):
    with pytest.raises(ValueError, match=said) as error:
        Chain.from_mjcf(written(tmp_path, text))
    assert "\n" not in str(error.value)
