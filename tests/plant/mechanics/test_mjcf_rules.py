"""Rules of MJCF that a file seldom needs, against MuJoCo's own compiler."""

import numpy as np
import pytest

from plant import Chain, Dynamics

pytest.importorskip("mujoco")
pytest.importorskip("pinocchio")
import mujoco
from model_texts import mujoco_torques

INERTIAL = '<inertial pos="0.1 0.2 0.3" mass="2" diaginertia="0.1 0.2 0.25"/>'
FILE = (
    "<mujoco>{top}<worldbody>{world}"
    '<body name="a" pos="0.3 0 0.1" euler="0.4 20 0.2">{in_a}{inertial}'
    '<body name="b" pos="0 0.2 0.5"><joint name="bend" axis="1 0 0.2"/>{in_b}'
    '<inertial pos="0.1 0 0.1" mass="1" diaginertia="0.1 0.1 0.1"/></body></body></worldbody>'
    "{sections}</mujoco>"
)
SWING = '<joint name="swing" axis="0 1 0" range="-1 0.5"/>'
PARTS = dict.fromkeys(("top", "world", "in_b", "sections"), "") | {
    "in_a": SWING,
    "inertial": INERTIAL,
}
# Rounding of MuJoCo's own diagonalisation and quaternions, of the largest torque.
ROUNDING = 1e-9


def written(tmp_path, **parts):
    path = tmp_path / "arm.xml"
    path.write_text(FILE.format(**PARTS | parts))
    return path


def agreeing(path):
    """The chain of a file, whose torques and ranges are those of MuJoCo."""
    model = mujoco.MjModel.from_xml_path(str(path))
    chain = Chain.from_mjcf(path)
    names = [link.name for link in chain.links]
    states = np.random.default_rng(5).uniform(-1, 1, (8, 3, len(names)))
    expected = mujoco_torques(path, names, states)
    dynamics = Dynamics.from_chain(chain)
    arm = dynamics.arm(dynamics.f())
    torques = np.array([arm.inverse(*state) for state in states])
    np.testing.assert_allclose(torques, expected, rtol=0, atol=ROUNDING * np.abs(expected).max())
    # In the order of the tree, as the names of the chain are.
    ranges = np.where(model.jnt_limited[:, None], model.jnt_range, (-np.inf, np.inf))
    limits = np.transpose([chain.limits.lower, chain.limits.upper])
    np.testing.assert_allclose(limits, ranges, rtol=1e-15)
    return chain


TOPS = {
    "angle": '<compiler angle="radian"/><compiler boundmass="0.1"/>',
    "angle, changed": '<compiler angle="radian"/><compiler angle="degree"/>',
    "bounds": '<compiler boundmass="3"/><compiler boundinertia="0.3"/><compiler/>',
    "balance": '<compiler balanceinertia="true" boundinertia="0.01"/><compiler angle="degree"/>',
    "sequence": '<compiler eulerseq="ZYX"/><compiler angle="radian"/>',
    "total mass, taken back": '<compiler settotalmass="5"/><compiler settotalmass="-1"/>',
    "gravity": '<option gravity="1 2 3"/><option timestep="0.001"/>',
    "gravity, changed": '<option gravity="1 2 3"/><option gravity="0 3 -1"/>',
    "no gravity": '<option gravity="1 2 3"><flag gravity="disable"/></option>',
    "no gravity, kept": '<option><flag gravity="disable"/></option><option><flag/></option>',
    "gravity, enabled": '<option><flag gravity="disable"/></option>'
    '<option><flag gravity="enable"/></option>',
}


@pytest.mark.parametrize("top", TOPS.values(), ids=TOPS)
def test_a_later_setting_changes_what_it_states(tmp_path, top):
    plate = INERTIAL.replace("0.1 0.2 0.25", "0.1 0.2 0.35")
    agreeing(written(tmp_path, top=top, inertial=plate if "balance" in top else INERTIAL))


def test_masses_of_geoms_stay_with_a_second_compiler(tmp_path):
    top = '<compiler inertiafromgeom="true"/><compiler angle="radian"/>'
    path = written(tmp_path, top=top, in_a=SWING + '<geom size="0.1"/>')
    # MuJoCo computes the mass of the body from its geom, which is not read.
    assert mujoco.MjModel.from_xml_path(str(path)).body("a").mass != 2
    with pytest.raises(ValueError, match="inertiafromgeom"):
        Chain.from_mjcf(path)


def test_a_flag_of_gravity_has_two_values(tmp_path):
    path = written(tmp_path, top='<option><flag gravity="off"/></option>')
    with pytest.raises(ValueError, match="gravity of <flag> must be one of"):
        Chain.from_mjcf(path)


# -- frames --------------------------------------------------------------------------------------
ROTORS = '<default><default class="heavy"><joint armature="0.4"/></default></default>'
PLACE = 'pos="0.1 -0.2 0.3" euler="40 10 -70"'
FRAMES = {
    "a joint": {"in_a": f'<frame {PLACE}><joint name="swing" pos="0 0.1 0" axis="0 1 0"/></frame>'},
    "a class": {"top": ROTORS, "in_a": f'<frame childclass="heavy">{SWING}</frame>'},
    "an inertial": {"inertial": f"<frame {PLACE}>{INERTIAL}</frame>"},
    "nested frames": {
        "in_a": f'<frame {PLACE}><frame axisangle="0 1 1 30">{SWING}</frame></frame>',
        "inertial": f"<frame {PLACE}><frame {PLACE}>{INERTIAL}</frame></frame>",
    },
    "two joints": {
        "in_a": f'{SWING}<frame {PLACE}><joint name="twist" axis="1 0 0" pos="0 0.2 0"/></frame>'
        '<joint name="slide" type="slide" axis="0 1 1"/>'
    },
}


@pytest.mark.parametrize("parts", FRAMES.values(), ids=FRAMES)
def test_a_frame_moves_all_that_it_holds(tmp_path, parts):
    agreeing(written(tmp_path, **parts))


@pytest.mark.parametrize("part", [SWING, INERTIAL, "the body"], ids=["joint", "inertial", "body"])
def test_a_frame_without_a_place_is_refused_for_what_it_holds(tmp_path, part):
    path = written(tmp_path)
    text = path.read_text()
    if part == "the body":
        part = text[text.index("<body") : text.rindex("</body>") + len("</body>")]
    path.write_text(text.replace(part, f'<frame pos="1 2">{part}</frame>'))
    with pytest.raises(ValueError, match=r"frame in (a|world) must have 3 finite numbers in pos"):
        Chain.from_mjcf(path)


def test_two_inertials_are_one_too_many(tmp_path):
    path = written(tmp_path, inertial=2 * INERTIAL)
    with pytest.raises(ValueError, match="unique element 'inertial'"):
        mujoco.MjModel.from_xml_path(str(path))
    with pytest.raises(ValueError, match="it has 2"):
        Chain.from_mjcf(path)
