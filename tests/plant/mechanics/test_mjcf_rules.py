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


@pytest.mark.parametrize("around", ["{}", '<frame pos="0 0 2" euler="90 0 0">{}</frame>'])
def test_the_least_mass_of_an_empty_body_lies_where_mujoco_has_it(tmp_path, around):
    """At the body's own ``pos``, in the body's frame: it copies the frame of the body."""
    empty = '<body name="empty" pos="1 0.2 0" euler="0 30 90"/>'
    top = '<compiler boundmass="0.5" boundinertia="0.01"/>'
    path = written(tmp_path, top=top, in_a=SWING + around.format(empty))
    assert mujoco.MjModel.from_xml_path(str(path)).body("empty").ipos.tolist() == [1, 0.2, 0]
    agreeing(path)


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


# -- limits --------------------------------------------------------------------------------------
def efforts(path, names):
    """Largest efforts (n,) that the actuators have at the joints in MuJoCo; infinite without end."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    largest = np.zeros(model.nv)
    for control in (-HUGE, HUGE):
        data.ctrl[:] = control
        mujoco.mj_forward(model, data)
        largest = np.maximum(largest, np.abs(data.qfrc_actuator))
    largest[largest > HUGE / 100] = np.inf
    return largest[[model.joint(name).dofadr[0] for name in names]]


# A control beyond all limits of the files.
HUGE = 1e6
MANUAL = '<compiler autolimits="false"/>'
FORCES = 'actuatorfrcrange="-5 7"'
RANGED = '<default><joint range="-30 40" actuatorfrcrange="-3 3"/></default>'
LIMITS = {
    "force, switched off": ("", f'{FORCES} actuatorfrclimited="false"', ""),
    "force, switched on": (MANUAL, f'{FORCES} actuatorfrclimited="true"', ""),
    "force of one sign": ("", 'actuatorfrcrange="2 3"', ""),
    "ranges of the class": (RANGED, "", ""),
    "ranges of the class, taken back": (RANGED, 'range="0 0" actuatorfrcrange="0 0"', ""),
    "range of the class, switched off": (RANGED, 'limited="false"', ""),
    "gear of zero": ("", "", 'gear="0"'),
    "gear of zero in this direction": ("", FORCES, 'gear="0 1" forcerange="-2 2"'),
    "gear and force": ("", "", 'gear="-6" forcerange="-2 1"'),
    "force of the actuator, switched off": ("", "", 'forcerange="-2 1" forcelimited="false"'),
    "force of the actuator, switched on": (
        MANUAL,
        "",
        'ctrlrange="-8 8" ctrllimited="false" forcerange="-2 1" forcelimited="true"',
    ),
    "empty control": ("", "", 'ctrlrange="0 0"'),
    "control": ("", "", 'gear="3" ctrlrange="-2 2" forcerange="-30 30"'),
}


@pytest.mark.parametrize(("top", "of_joint", "of_motor"), LIMITS.values(), ids=LIMITS)
def test_limits_and_efforts_are_those_of_mujoco(tmp_path, top, of_joint, of_motor):
    path = written(
        tmp_path,
        top=top,
        in_a=f'<joint name="swing" axis="0 1 0" {of_joint}/>',
        sections=f'<actuator><motor joint="swing" {of_motor}/><motor joint="bend"/></actuator>',
    )
    chain = agreeing(path)
    names = [link.name for link in chain.links]
    np.testing.assert_allclose(chain.limits.effort, efforts(path, names), rtol=1e-12)


# As MuJoCo saves its motors; then what else decides whether the control is the force.
GENERAL = {
    "a saved motor": ("", 'ctrlrange="-3 2" gear="2"'),
    "a gain": ("", 'ctrlrange="-3 2" gainprm="-5 0 0"'),
    "a gain and a force": ("", 'ctrlrange="-3 2" gainprm="5" forcerange="-4 4"'),
    "the gain of the class": ('<general gainprm="5"/>', 'ctrlrange="-3 2"'),
    "the motor of the class": ('<general gainprm="5" biastype="affine"/><motor/>', 'ctrlrange="-3 2"'),
    "a servo": ("", 'ctrlrange="-3 2" gainprm="5" biastype="affine" biasprm="0 -5"'),
    "the servo of the class": ('<position kp="5"/>', 'ctrlrange="-3 2"'),
    "a servo without attributes": ("<position/>", 'ctrlrange="-3 2"'),
    "another gain": ("", 'ctrlrange="-3 2" gaintype="affine" gainprm="1 1e9"'),
}  # fmt: skip


@pytest.mark.parametrize(("of_class", "of_motor"), GENERAL.values(), ids=GENERAL)
def test_the_control_of_a_general_actuator_may_be_its_force(tmp_path, of_class, of_motor):
    path = written(
        tmp_path,
        top=f"<default>{of_class}</default>",
        sections=f'<actuator><general joint="swing" {of_motor}/><motor joint="bend"/></actuator>',
    )
    model = mujoco.MjModel.from_xml_path(str(path))
    is_force = not model.actuator_biastype[0] and not model.actuator_gaintype[0]
    # The force of a servo grows with its error, which has no end.
    ends = model.actuator_gainprm[0, 0] * model.actuator_gear[0, 0] * model.actuator_ctrlrange[0]
    forces = model.actuator_forcerange[0] if model.actuator_forcelimited[0] else np.inf
    expected = np.minimum(np.abs(ends).max() if is_force else np.inf, np.abs(forces).max())
    assert agreeing(path).limits.effort.tolist() == [expected, np.inf]


def test_actuators_of_no_effort_add_none(tmp_path):
    path = written(
        tmp_path,
        sections='<actuator><motor joint="swing" gear="0"/><motor joint="swing" ctrlrange="-4 4"/>'
        '<position joint="bend" kp="9" gear="0"/></actuator>',
    )
    np.testing.assert_array_equal(efforts(path, ["swing", "bend"]), [4, 0])
    np.testing.assert_array_equal(agreeing(path).limits.effort, [4, 0])


WITHOUT_RANGE = {
    "a joint": ('limited="true"', "", r"joint swing must have range"),
    "an empty range": ('limited="true" range="0 0"', "", r"range of joint swing .*rise; got 0 and 0"),
    "the force of a joint": ('actuatorfrclimited="true"', "", r"must have actuatorfrcrange"),
    "an actuator": ("", 'forcelimited="true"', r"<motor> must have forcerange"),
    "a control": ("", 'ctrllimited="true" ctrlrange="3 1"', r"ctrlrange of <motor> .* rise"),
    "a misspelt switch": ('limited="yes"', "", r"limited of joint swing must be one of"),
    "an unknown class": ("", 'class="weak"', r"class of <motor> must be one of 'main'; got 'weak'"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("of_joint", "of_motor", "said"), WITHOUT_RANGE.values(), ids=WITHOUT_RANGE
)
def test_a_limit_that_mujoco_refuses_is_refused(tmp_path, of_joint, of_motor, said):
    path = written(
        tmp_path,
        in_a=f'<joint name="swing" axis="0 1 0" {of_joint}/>',
        sections=f'<actuator><motor joint="swing" {of_motor}/></actuator>',
    )
    with pytest.raises(ValueError, match=r"Error"):
        mujoco.MjModel.from_xml_path(str(path))
    with pytest.raises(ValueError, match=said):
        Chain.from_mjcf(path)
    # A chain that does not have the joint does not need its limits.
    assert Chain.from_mjcf(path, ["bend"]).n == 1


def test_exchanged_ends_are_a_mistake(tmp_path):
    """MuJoCo reads them as no limit, which would leave out one that is meant."""
    path = written(tmp_path, in_a='<joint name="swing" axis="0 1 0" range="1 -1"/>')
    assert not mujoco.MjModel.from_xml_path(str(path)).joint("swing").limited
    with pytest.raises(ValueError, match=r"range of joint swing .* got 1 and -1"):
        Chain.from_mjcf(path)


# -- names ---------------------------------------------------------------------------------------
def test_unnamed_joints_of_one_body_have_names_of_their_own(tmp_path):
    axes = ("1 0 0", "0 1 0", "0 0 1")
    joints = [f'<joint axis="{axis}" pos="0 0.1 0"/>' for axis in axes]
    unnamed = written(tmp_path, in_a="".join(joints))
    assert mujoco.MjModel.from_xml_path(str(unnamed)).njnt == 4
    chain = Chain.from_mjcf(unnamed)
    names = [link.name for link in chain.links]
    assert names == ["joint of a", "joint 2 of a", "joint 3 of a", "bend"]
    # The same joints with these names in the file, which MuJoCo then knows as well.
    for name, joint in zip(names, joints, strict=False):
        joints[joints.index(joint)] = joint.replace("<joint", f'<joint name="{name}"')
    assert agreeing(written(tmp_path, in_a="".join(joints))) == chain


HOOKS = '<site name="hook"/>', '<geom name="hook" size="0.1" mass="0"/>'
BY_SITE = '<site site="eye"/><site site="hook"/>'
BY_GEOM = '<site site="eye"/><geom geom="hook"/><site site="far"/>'


@pytest.mark.parametrize(
    ("in_world", "in_arm", "ends", "acts"),
    [
        (*HOOKS, BY_SITE, False),
        (*HOOKS, BY_GEOM, True),
        (*HOOKS[::-1], BY_SITE, True),
        (*HOOKS[::-1], BY_GEOM, False),
    ],
)
def test_a_site_and_a_geom_may_have_one_name(tmp_path, in_world, in_arm, ends, acts):
    path = written(
        tmp_path,
        world=f'<site name="eye" pos="1 0 0"/><site name="far" pos="0 1 0"/>{in_world}',
        in_b=in_arm,
        sections=f"<tendon><spatial>{ends}</spatial></tendon>",
    )
    model = mujoco.MjModel.from_xml_path(str(path))
    bodies_of = {
        int(mujoco.mjtWrap.mjWRAP_SITE): model.site_bodyid,
        int(mujoco.mjtWrap.mjWRAP_SPHERE): model.geom_bodyid,
    }
    bodies = [
        bodies_of[kind][place]
        for kind, place in zip(model.wrap_type, model.wrap_objid, strict=True)
    ]
    # The world is body 0.
    assert acts == any(bodies)
    if not acts:
        assert Chain.from_mjcf(path).n == 2
        return
    with pytest.raises(ValueError, match=r"<tendon> must not act on the chain.*acts on b, world"):
        Chain.from_mjcf(path)


# -- zeros ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("zero", ["0.00", "0e0", "-0", "+.0", "0.", " 0 "])
def test_zero_is_a_number(tmp_path, zero):
    path = written(
        tmp_path,
        top=f'<option viscosity="{zero}" density="{zero}"/><compiler settotalmass="{zero}"/>',
        in_a=f'<joint name="swing" axis="0 1 0" stiffness="{zero}" springdamper="{zero} {zero}"/>',
    )
    path.write_text(path.read_text().replace('name="b"', f'name="b" gravcomp="{zero}"'))
    # A warning would be an error here.
    assert agreeing(path).n == 2


def test_a_negative_total_mass_is_none(tmp_path):
    for total in ("-2", "-1.0"):
        agreeing(written(tmp_path, top=f'<compiler settotalmass="{total}"/>'))


# Of each attribute a text with an effect, and where MuJoCo has it.
EFFECTS = {
    "stiffness": ("-1", lambda model: model.jnt_stiffness[0]),
    "viscosity": ("-1", lambda model: model.opt.viscosity),
    "density": ("1e-3", lambda model: model.opt.density),
}


@pytest.mark.parametrize("name", EFFECTS)
def test_what_is_not_zero_is_refused(tmp_path, name):
    text, value = EFFECTS[name]
    stated = f'{name}="{text}"'
    joint = f'<joint name="swing" axis="0 1 0" {stated if name == "stiffness" else ""}/>'
    top = f"<option {stated}/>" if name != "stiffness" else ""
    path = written(tmp_path, top=top, in_a=joint)
    assert value(mujoco.MjModel.from_xml_path(str(path))) == float(text)
    with pytest.raises(ValueError, match=rf"{name} of <\w+> must be zero"):
        Chain.from_mjcf(path)


def test_a_total_mass_is_refused(tmp_path):
    path = written(tmp_path, top='<compiler settotalmass="5"/>')
    assert mujoco.MjModel.from_xml_path(str(path)).body_mass.sum() == pytest.approx(5)
    with pytest.raises(ValueError, match="settotalmass of <compiler> must be zero"):
        Chain.from_mjcf(path)


def test_a_body_that_is_moved_by_hand_is_refused_where_it_moves(tmp_path):
    for mocap, moved in (("false", False), ("true", True)):
        path = written(tmp_path)
        path.write_text(path.read_text().replace('name="b"', f'name="b" mocap="{mocap}"'))
        if not moved:
            agreeing(path)
            continue
        with pytest.raises(ValueError, match="mocap of <body> must be zero"):
            Chain.from_mjcf(path)


# -- what is not read ----------------------------------------------------------------------------
OTHER_ARM = f'<body name="other"><joint name="lift"/>{INERTIAL}</body>'
REPLICA = f'<replicate count="2" offset="1 0 0">{OTHER_ARM}</replicate>'
UNREAD = {
    "a copied body": (REPLICA, r"<replicate> must not be in world"),
    "a copied body in a frame": (f'<frame pos="0 1 0">{REPLICA}</frame>', r"<replicate> must not"),
    "a copied body on a pedestal": (
        f'<body name="pedestal">{REPLICA}</body>',
        r"<replicate> must not be in pedestal",
    ),
    "another model": ('<attach model="m" prefix="p"/>', r"<attach> must not be in world"),
    "a missing file": ('<include file="gone.xml"/>', r"<include> must name a file that is there"),
    "a misspelt body": (OTHER_ARM.replace("body", "bodie"), r"<bodie> must not be in world"),
    "a joint of the world": ("<joint/>", r"<joint> must not be in world"),
}


@pytest.mark.parametrize(("world", "said"), UNREAD.values(), ids=UNREAD)
def test_a_branch_that_is_not_read_may_hold_the_chain(tmp_path, world, said):
    path = written(tmp_path, world=world)
    for sought in ({}, {"joints": ["lift0"]}, {"tip": "other0"}, {"base": "other0", "tip": "b"}):
        with pytest.raises(ValueError, match=said):
            Chain.from_mjcf(path, **sought)
    # A chain that lies elsewhere does not need it.
    expected = Chain.from_mjcf(written(tmp_path))
    written(tmp_path, world=world)
    assert Chain.from_mjcf(path, ["swing", "bend"]) == expected == Chain.from_mjcf(path, tip="b")
    # A file may have nothing else.
    path.write_text(f"<mujoco><worldbody>{world}</worldbody></mujoco>")
    with pytest.raises(ValueError, match=said):
        Chain.from_mjcf(path)


def test_mujoco_has_the_joints_of_a_replicate(tmp_path):
    model = mujoco.MjModel.from_xml_path(str(written(tmp_path, world=REPLICA)))
    assert model.njnt == 4


def test_a_copied_shape_has_no_joints(tmp_path):
    tiles = '<replicate count="3" offset="1 0 0"><geom size="0.1"/></replicate>'
    assert agreeing(written(tmp_path, world=tiles)).n == 2


@pytest.mark.parametrize("section", ["actuator", "equality", "tendon", "default", "option"])
def test_a_missing_file_of_what_acts_on_chains_is_refused(tmp_path, section):
    path = written(tmp_path, top=f'<{section}><include file="gone.xml"/></{section}>')
    with pytest.raises(ValueError, match=r"Error opening file 'gone.xml'"):
        mujoco.MjModel.from_xml_path(str(path))
    with pytest.raises(ValueError, match=r"<include> must name a file that is there; .*gone.xml"):
        Chain.from_mjcf(path, ["bend"])
