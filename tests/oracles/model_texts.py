"""Random model files, and their torques by MuJoCo and pinocchio."""

import mujoco
import numpy as np
import pinocchio as pin


def numbers(values):
    return " ".join(repr(float(x)) for x in np.atleast_1d(values))


def inertia_of(random):
    """A possible inertia (3, 3)."""
    root = random.normal(size=(3, 3)) * 0.2
    return np.trace(root @ root.T) * np.eye(3) - root @ root.T


def urdf_inertial(random):
    matrix = inertia_of(random)
    i = {
        f"i{a}{b}": float(matrix["xyz".index(a), "xyz".index(b)])
        for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")
    }
    place = (
        f'<origin xyz="{numbers(random.uniform(-0.3, 0.3, 3))}"'
        f' rpy="{numbers(random.uniform(-3, 3, 3))}"/>'
    )
    inertia = " ".join(f'{key}="{value!r}"' for key, value in i.items())
    return (
        f'<inertial>{place}<mass value="{random.uniform(0.5, 3)!r}"/><inertia'
        f" {inertia}/></inertial>"
    )


def urdf_joint(name, kind, parent, child, random):
    place = (
        f'<origin xyz="{numbers(random.uniform(-0.5, 0.5, 3))}"'
        f' rpy="{numbers(random.uniform(-3, 3, 3))}"/>'
    )
    axis = "" if kind == "fixed" else f'<axis xyz="{numbers(random.normal(size=3))}"/>'
    limit = (
        '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
        if kind in ("revolute", "prismatic")
        else ""
    )
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{place}{ends}{axis}{limit}</joint>'


def urdf(seed, kinds=("revolute", "fixed", "prismatic", "continuous", "fixed", "revolute")):
    """A chain of links, with a branch of two fixed bodies on one of them and a last link without
    mass.
    """
    random = np.random.default_rng(seed)
    text = f'<link name="l0">{urdf_inertial(random)}</link>'
    for i, kind in enumerate(kinds):
        text += f'<link name="l{i + 1}">{urdf_inertial(random)}</link>' + urdf_joint(
            f"j{i + 1}", kind, f"l{i}", f"l{i + 1}", random
        )
    text += f'<link name="tool">{urdf_inertial(random)}</link>' + urdf_joint(
        "flange", "fixed", f"l{min(3, len(kinds))}", "tool", random
    )
    text += f'<link name="tip">{urdf_inertial(random)}</link>' + urdf_joint(
        "glue", "fixed", "tool", "tip", random
    )
    text += '<link name="nothing"/>' + urdf_joint(
        "end", "fixed", f"l{len(kinds)}", "nothing", random
    )
    return f'<?xml version="1.0"?><robot name="r">{text}</robot>'


def mjcf_inertial(random, form):
    """A body in one of the forms that MJCF has; degrees, axes that turn along."""
    matrix, place = inertia_of(random), f'pos="{numbers(random.uniform(-0.3, 0.3, 3))}"'
    mass = f'mass="{random.uniform(0.5, 3)!r}"'
    if form == "full":
        six = numbers([*np.diag(matrix), matrix[0, 1], matrix[0, 2], matrix[1, 2]])
        return f'<inertial {place} {mass} fullinertia="{six}"/>'
    turned = {
        "quat": f'quat="{numbers(random.normal(size=4))}"',
        "euler": f'euler="{numbers(random.uniform(-150, 150, 3))}"',
        "axisangle": f'axisangle="{numbers(random.normal(size=3))} 70"',
        "xyaxes": f'xyaxes="{numbers(random.normal(size=6))}"',
        "zaxis": f'zaxis="{numbers(random.normal(size=3))}"',
    }[form]
    return (
        f'<inertial {place} {turned} {mass}\n diaginertia="{numbers(np.linalg.eigvalsh(matrix))}"/>'
    )


FORMS = ("full", "quat", "euler", "axisangle", "xyaxes", "zaxis")


def mjcf(seed, kinds=("hinge", "weld", "slide", "hinge", "hinge"), sequence="xyz"):
    """A chain of bodies with comments, a default class, a weld, anchors beside the origin,
    references, armature.
    """
    random = np.random.default_rng(seed)
    text, ends = "", ""
    for i, kind in enumerate(kinds):
        pose = (
            f'pos="{numbers(random.uniform(-0.5, 0.5, 3))}"'
            f' euler="{numbers(random.uniform(-150, 150, 3))}"'
        )
        text += (
            f'\n  <!-- body {i} -->\n  <body name="b{i}" {pose}>\n '
            f" {mjcf_inertial(random, FORMS[i % len(FORMS)])}\n  "
        )
        if kind != "weld":
            text += (
                f'<joint name="j{i}" class="arm" type="{kind}"'
                f' axis="{numbers(random.normal(size=3))}" '
            )
            text += (
                f'pos="{numbers(random.uniform(-0.2, 0.2, 3))}"'
                f' ref="{numbers(random.uniform(-0.3, 0.3))}"/>'
            )
        text += '<geom size="0.01" contype="0" conaffinity="0"/>'
        ends += "</body>"
    defaults = (
        '<joint armature="0.1"/><default class="arm"><joint damping="0" range="-90 90"'
        ' limited="false"/></default>'
    )
    return (
        f'<mujoco model="m"><compiler angle="degree" eulerseq="{sequence}"/><option gravity="1 2'
        f' -9"/><default>{defaults}</default><worldbody>{text}{ends}</worldbody></mujoco>'
    )


def mujoco_torques(path, names, states):
    """Torques (N, n) of states (N, 3, n), without contacts, limits, friction."""
    model = mujoco.MjModel.from_xml_path(str(path))
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= (
        flags.mjDSBL_CONTACT.value | flags.mjDSBL_LIMIT.value | flags.mjDSBL_FRICTIONLOSS.value
    )
    model.dof_damping[:] = 0
    data, result = mujoco.MjData(model), []
    joints = [model.joint(name) for name in names]
    at, dof = [j.qposadr[0] for j in joints], [j.dofadr[0] for j in joints]
    for q, qd, qdd in states:
        data.qpos[at], data.qvel[dof], data.qacc[dof] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        result.append(data.qfrc_inverse[dof].copy())
    return np.array(result)


def pinocchio_torques(path, names, states):
    """Torques (N, n) of states (N, 3, n) by pinocchio's reader of URDF; others at zero."""
    model = pin.buildModelFromXML(path.read_text())
    data, result = model.createData(), []
    joints = [model.joints[model.getJointId(name)] for name in names]
    for state in states:
        q, v, a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        for joint, value, speed, rate in zip(joints, *state, strict=True):
            q[joint.idx_q : joint.idx_q + joint.nq] = (
                [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
            )
            v[joint.idx_v], a[joint.idx_v] = speed, rate
        result.append(pin.rnea(model, data, q, v, a)[[joint.idx_v for joint in joints]])
    return np.array(result)
