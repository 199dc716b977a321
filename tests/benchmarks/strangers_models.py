"""Models as strangers write them, and `check_model` on public arms that were spoilt by one mistake.

    python tests/benchmarks/strangers_models.py [--public] [--versions 400] [--seed 0]

Without an option: 40 models, each with one feature that public files have (a gripper, a tendon, an
encoding, an include, ...), and drawn numbers. Each is read with the torques that it must have, or
refused with the right word. With --public: the arms of `model_files.py` as they are, and versions
with one mistake each (package example-robot-data, the extra `robots`).
"""

import argparse
import os
import re
import sys
import tempfile
import warnings
import xml.etree.ElementTree as ET  # of an installed package
from collections import Counter
from pathlib import Path

import numpy as np

from plant import Chain, Dynamics, Placement, check_model

sys.path.append(str(Path(__file__).parent))

MOMENTS = ("ixx", "iyy", "izz")
KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def text(values):
    """Numbers as a file has them."""
    return " ".join(f"{float(value):.9g}" for value in np.atleast_1d(values))


def numbers(element, name):
    return np.array([float(word) for word in element.get(name).split()])


def scaled(element, factor, *names):
    for name in names:
        element.set(name, text(factor * numbers(element, name)))


# -- mistakes ------------------------------------------------------------------------------------
def of_mass(factor):
    return lambda link, joint, random: scaled(link.find("inertial/mass"), factor, "value")


def of_inertia(factor):
    return lambda link, joint, random: scaled(link.find("inertial/inertia"), factor, *KEYS)


def of_both(factor):
    def spoil(link, joint, random):
        of_mass(factor)(link, joint, random)
        of_inertia(factor)(link, joint, random)

    return spoil


def of_centre(factor):
    def spoil(link, joint, random):
        origin = link.find("inertial/origin")
        if origin is None or np.abs(numbers(origin, "xyz")).max() < 1e-3:
            return False
        return scaled(origin, factor, "xyz")

    return spoil


def negative_moment(link, joint, random):
    scaled(link.find("inertial/inertia"), -1, MOMENTS[random.integers(3)])


def negative_moments(link, joint, random):
    scaled(link.find("inertial/inertia"), -1, *MOMENTS)


def zero_inertia(link, joint, random):
    for key in KEYS:
        dust = random.choice([0.0, 1.0]) * random.normal() * 1e-20
        link.find("inertial/inertia").set(key, text(dust))


def placeholder(link, joint, random):
    size = random.choice([1.0, 10.0, 100.0])
    for key in KEYS:
        link.find("inertial/inertia").set(key, text(size * (key in MOMENTS)))


def missing(link, joint, random):
    link.remove(link.find("inertial"))


def decimal_point(link, joint, random):
    """To the right, of the largest moment: the triangle inequality breaks."""
    inertia = link.find("inertial/inertia")
    largest = max(MOMENTS, key=lambda key: float(inertia.get(key)))
    scaled(inertia, random.choice([10.0, 100.0]), largest)


def parallel_axis_off(link, joint, random):
    """The parallel-axis term taken off an inertia that is about the centre of mass already."""
    origin, inertia = link.find("inertial/origin"), link.find("inertial/inertia")
    mass = float(link.find("inertial/mass").get("value"))
    c = np.zeros(3) if origin is None else numbers(origin, "xyz")
    term = mass * (c @ c * np.eye(3) - np.outer(c, c))
    before = [float(inertia.get(key)) for key in MOMENTS]
    after = np.array(before) - np.diag(term)
    if after.min() > 0:
        return False
    for key, (i, j) in zip(KEYS, ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)), strict=True):
        inertia.set(key, text(float(inertia.get(key)) - term[i, j]))
    return None


def assembly_mass(link, joint, random):
    """The mass of the whole robot on one link, which keeps its inertia."""
    link.find("inertial/mass").set("value", text(link.total))


def degrees_of_limits(link, joint, random):
    limit = joint.find("limit")
    if joint.get("type") != "revolute" or limit is None or limit.get("lower") is None:
        return False
    if np.ptp([float(limit.get("lower")), float(limit.get("upper"))]) < 0.3:
        return False
    return scaled(limit, 180 / np.pi, "lower", "upper")


def degrees_of_angles(link, joint, random):
    origin = joint.find("origin")
    if origin is None or origin.get("rpy") is None or np.abs(numbers(origin, "rpy")).max() < 0.3:
        return False
    return scaled(origin, 180 / np.pi, "rpy")


def millimetres_of_joint(link, joint, random):
    origin = joint.find("origin")
    if origin is None or origin.get("xyz") is None or np.abs(numbers(origin, "xyz")).max() < 0.02:
        return False
    return scaled(origin, 1000, "xyz")


MISTAKES = {
    "grams (mass)": of_mass(1e3),
    "grams (mass and inertia)": of_both(1e3),
    "tonnes (mass)": of_mass(1e-3),
    "g m^2": of_inertia(1e3),
    "kg cm^2": of_inertia(1e4),
    "kg mm^2": of_inertia(1e6),
    "g mm^2": of_inertia(1e9),
    "too small by 1e6": of_inertia(1e-6),
    "centre in mm": of_centre(1e3),
    "centre in cm": of_centre(1e2),
    "negative mass": of_mass(-1.0),
    "negative moment": negative_moment,
    "negative moments": negative_moments,
    "zero inertia": zero_inertia,
    "placeholder": placeholder,
    "no inertial": missing,
    "decimal point": decimal_point,
    "parallel axis taken off": parallel_axis_off,
    "mass of the assembly": assembly_mass,
    "limits in degrees": degrees_of_limits,
    "angles in degrees": degrees_of_angles,
    "joint in mm": millimetres_of_joint,
}
OF_JOINTS = ("limits in degrees", "angles in degrees", "joint in mm")


def public_arms():
    """Name -> (root of the file, names of the links of the chain)."""
    from model_files import ARMS, file_of

    arms = {}
    for name, (_, base, tip) in ARMS.items():
        path = file_of(name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            joints = [link.name for link in Chain.from_urdf(path, base=base, tip=tip).links]
        arms[name] = path, joints
    return arms


def spoilt(path, joints, kind, random):
    """The tree with one mistake, the link or joint that has it, and the link; None for none."""
    root = ET.parse(path).getroot()  # noqa: S314
    links = {link.get("name"): link for link in root.findall("link")}
    names = [j for j in root.findall("joint") if j.get("name") in joints]
    joint = names[random.integers(len(names))]
    link = links[joint.find("child").get("link")]
    inertial = link.find("inertial")
    mass = 0.0 if inertial is None else float(inertial.find("mass").get("value"))
    if kind not in OF_JOINTS and not mass > 1e-3:
        return None
    if kind == "mass of the assembly":
        total = sum(float(m.get("value")) for m in root.iterfind("link/inertial/mass"))
        if total < 4 * mass:
            return None
        link.find("inertial/mass").set("value", text(total))
    elif MISTAKES[kind](link, joint, random) is False:
        return None
    place = (joint if kind in OF_JOINTS else link).get("name")
    return ET.ElementTree(root), place, link.get("name")


def public(count, seed, verbose=True):
    """Of versions with a mistake the share that is named, and what was repaired wrongly."""
    arms = public_arms()
    random = np.random.default_rng(seed)
    before, found, total, wrong = {}, Counter(), Counter(), []
    for name, (path, _) in arms.items():
        findings = check_model(path).findings
        before[name] = {(f.link, f.mistake) for f in findings}
        for f in findings:
            print(f"unspoilt {name}: {str(f).replace(chr(10), '')}")
    kinds = list(MISTAKES)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "spoilt.urdf"
        i = 0
        while sum(total.values()) < count:
            kind = kinds[i % len(kinds)]
            name = list(arms)[random.integers(len(arms))]
            made = spoilt(*arms[name], kind, random)
            i += 1
            if made is None:
                continue
            tree, place, link = made
            old = {link for link, _ in before[name]}
            # What is wrong already is no place for one more mistake.
            if link in old:
                continue
            tree.write(target)
            total[kind] += 1
            check = check_model(target)
            named = [
                f
                for f in check.findings
                if place in (f.link, f.joint) and (f.link, f.mistake) not in before[name]
            ]
            found[kind] += bool(named)
            if not named and verbose:
                print("missed", kind, name, place)
            wrong += wrongly(check, arms[name][0], target, kind, name, old)
            news = {f.joint or f.link for f in check.findings} - old - {place}
            if news and verbose:
                print("blamed", kind, name, place, news)
    for kind in kinds:
        print(f"{kind:28}{found[kind]:4} of {total[kind]}")
    print(f"found {sum(found.values())} of {sum(total.values())}, wrongly repaired {len(wrong)}")
    for row in wrong:
        print("   ", *row)


def values(root, link):
    element = next(e for e in root.findall("link") if e.get("name") == link).find("inertial")
    if element is None:
        return None
    origin = element.find("origin")
    xyz = np.zeros(3) if origin is None or origin.get("xyz") is None else numbers(origin, "xyz")
    six = [float(element.find("inertia").get(key)) for key in KEYS]
    return np.array([float(element.find("mass").get("value")), *xyz, *six])


def wrongly(check, source, spoilt_file, kind, name, old):
    """Repairs that change a right number, or by which a wrong one is not right within 3 %."""
    if not check.findings or all(f.repair is None for f in check.findings):
        return []
    target = check.path.with_name("repaired.urdf")
    check.write(target, overwrite=True)
    sound, repaired, broken = (ET.parse(path).getroot() for path in (source, target, spoilt_file))  # noqa: S314
    rows = []
    for finding in check.findings:
        if finding.repair is None or finding.link in old:
            continue
        a, b, given = (values(root, finding.link) for root in (sound, repaired, broken))
        given = np.full(10, np.inf) if given is None else given
        six = np.abs(a[4:]).max()
        scale = np.array([abs(a[0]), *[max(np.linalg.norm(a[1:4]), 1e-3)] * 3, *[six] * 6])
        # A right zero has no digits to keep.
        kept = np.abs(a - given) < 1e-6 * scale
        if (np.abs(a - b) > np.where(kept, 1e-5, 0.03) * scale).any():
            rows.append((kind, name, finding.link, finding.mistake))
    return rows


# -- files as strangers write them ---------------------------------------------------------------
class Arm:
    """Three joints and a gripper with drawn numbers, as URDF and as MJCF."""

    JOINTS = ("turn", "lift", "bend")

    def __init__(self, random):
        self.random = random
        self.mass = random.uniform(0.4, 6, 5)
        self.com = random.uniform(-0.15, 0.15, (5, 3))
        # Principal moments of boxes: any such are those of a body.
        edges = random.uniform(0.04, 0.4, (5, 3)) ** 2
        self.moments = (self.mass / 12)[:, None] * (edges.sum(axis=1)[:, None] - edges)
        self.place = random.uniform(-0.4, 0.4, (4, 3))
        self.rpy = random.uniform(-3, 3, (4, 3))
        self.axis = random.normal(size=(4, 3))
        self.effort = random.uniform(5, 90, 4)

    def urdf(
        self, more="", head="", names=("base", "one", "two", "three", "finger"), **joint_texts
    ):
        """The file; `joint_texts` replace the limits of joints."""
        text = f'{head}<robot name="r">'
        for i, name in enumerate(names):
            x, y, z = map(float, self.moments[i])
            text += (
                f'<link name="{name}"><inertial><origin xyz="{text_of(self.com[i])}"/><mass'
                f' value="{text_of(self.mass[i])}"/><inertia ixx="{x!r}" ixy="0" ixz="0"'
                f' iyy="{y!r}" iyz="0" izz="{z!r}"/></inertial></link>\n'
            )
        for i, joint in enumerate((*self.JOINTS, "grip")):
            limit = f'<limit lower="-1" upper="2" effort="{float(self.effort[i])!r}" velocity="3"/>'
            kind = "prismatic" if joint == "grip" else "revolute"
            text += (
                f'<joint name="{joint}" type="{kind}"><parent link="{names[i]}"/><child'
                f' link="{names[i + 1]}"/><origin xyz="{text_of(self.place[i])}"'
                f' rpy="{text_of(self.rpy[i])}"/><axis xyz="{text_of(self.axis[i])}"/>'
                f"{joint_texts.get(joint, limit)}</joint>\n"
            )
        return f"{text}{more}</robot>"

    def mjcf(
        self, compiler="", within="", of_finger="", of_body="", of_joint="", world="", more=""
    ):
        def body(i, name, joint, inner, extra):
            x, y, z = map(float, self.moments[i + 1])
            kind = "slide" if joint == "grip" else "hinge"
            return (
                f'<body name="{name}" pos="{text_of(self.place[i])}" euler="{text_of(self.rpy[i])}"'
                f' {of_body if i == 1 else ""}><inertial pos="{text_of(self.com[i + 1])}"'
                f' mass="{text_of(self.mass[i + 1])}" diaginertia="{x!r} {y!r} {z!r}"/><joint'
                f' name="{joint}" type="{kind}" axis="{text_of(self.axis[i])}" {extra}/><site'
                f' name="at_{name}"/>{inner}</body>'
            )

        finger = body(3, "finger", "grip", "", of_finger)
        inner = body(2, "three", "bend", finger + within, of_joint)
        arm = body(0, "one", "turn", body(1, "two", "lift", inner, ""), "")
        return (
            f'<mujoco><compiler angle="radian" {compiler}/><worldbody><site name="hook"'
            f' pos="0 0 2"/>{world}{arm}</worldbody>{more}</mujoco>'
        )


def text_of(values):
    return " ".join(repr(float(value)) for value in np.atleast_1d(values))


LINK = '<link name="{}"><inertial><mass value="{}"/><inertia ixx="{}" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial></link>'
JOINT = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/>{}</joint>'
XACRO = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
BODY = (
    '<body name="{}" {}><inertial pos="0 0 0.1" mass="{}" diaginertia="2e-3 2e-3 1e-3"/>{}</body>'
)


def same(arm, folder, text, data=None, joints=Arm.JOINTS, expected=None, **given):
    """The file gives the chain of the plain one."""
    path = folder / "robot.urdf"
    path.write_text(arm.urdf())
    expected = expected or Chain.from_urdf(path, joints)
    path = folder / "strange.urdf"
    path.write_bytes(text.encode() if data is None else data)
    chain = Chain.from_urdf(path, None if given else joints, **given)
    assert [link.name for link in chain.links] == list(joints)
    assert chain == expected, "another chain"


def refused(folder, text, word, read=None, joints=Arm.JOINTS, name="strange.urdf"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    refusal = refusal_of(read or Chain.from_urdf, path, joints)
    assert "\n" not in refusal, "several lines"
    assert re.search(word, refusal), f"refused with: {refusal}"


def refusal_of(read, *arguments):
    try:
        read(*arguments)
    except ValueError as error:
        return str(error)
    raise AssertionError("read")


def as_mujoco(arm, folder, text, joints=Arm.JOINTS, **given):
    """Torques of MuJoCo at a random state, and of the chain."""
    import mujoco

    path = folder / "strange.xml"
    path.write_text(text)
    chain = Chain.from_mjcf(path, None if given else joints, **given)
    dynamics = Dynamics.from_chain(chain)
    model = mujoco.MjModel.from_xml_path(str(path))
    data, states = mujoco.MjData(model), arm.random.uniform(-1, 1, (3, len(joints)))
    dofs = [model.joint(name).dofadr[0] for name in joints]
    data.qpos[[model.joint(name).qposadr[0] for name in joints]] = states[0]
    data.qvel[dofs], data.qacc[dofs] = states[1:]
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    model.body_gravcomp[:] = 0  # a controller's
    mujoco.mj_inverse(model, data)
    expected = data.qfrc_inverse[dofs]
    got = dynamics.arm(dynamics.f()).inverse(*states)
    assert np.abs(got - expected).max() < 1e-9 * np.abs(expected).max(), "other torques"
    return chain


def coded(encoding, word):
    def variant(arm, folder):
        names = ("base", "one", "two", "three", word)
        text = arm.urdf(head=f'<?xml version="1.0" encoding="{encoding}"?>', names=names)
        same(arm, folder, "", text.encode(encoding))

    return variant


def slip(share):
    """The largest moment of a link of the chain misses the triangle inequality by a share of it."""

    def variant(arm, folder):
        x, y, _ = arm.moments[2]
        arm.moments[2, 2] = (x + y) / (1 - share)
        path = folder / "strange.urdf"
        path.write_text(arm.urdf())
        if share > 0.1:
            return refused(folder, arm.urdf(), "triangle inequality")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            chain = Chain.from_urdf(path, Arm.JOINTS)
        assert any("triangle" in str(w.message) for w in caught), "not said"
        np.testing.assert_allclose(chain.bodies[1].mass, arm.mass[2], rtol=1e-8)
        return None

    return variant


def unused_slip(arm, folder):
    """Of a link on another branch."""
    more = LINK.format("mast", 2.0, 5.0) + JOINT.format("fix", "fixed", "base", "mast", "")
    same(arm, folder, arm.urdf(more))


def urdf_with(make):
    return lambda arm, folder: same(arm, folder, make(arm))


def urdf_refused(make, word):
    return lambda arm, folder: refused(folder, make(arm), word)


def floating(arm, folder):
    more = LINK.format("hull", arm.random.uniform(1, 9), 1e-3)
    more += JOINT.format("sea", "floating", "hull", "base", "")
    same(arm, folder, arm.urdf(more), base="base", tip="three")
    refused(
        folder, arm.urdf(more), "it is floating", lambda path, _: Chain.from_urdf(path, tip="three")
    )


def mimicked(arm, folder):
    more = LINK.format("other", 0.1, 1e-3)
    more += JOINT.format("follow", "prismatic", "three", "other", '<mimic joint="grip"/>')
    path = folder / "mimic.urdf"
    path.write_text(arm.urdf(more))
    chain = Chain.from_urdf(path)
    assert [link.name for link in chain.links] == list(Arm.JOINTS)
    assert abs(chain.bodies[2].mass - arm.mass[3] - arm.mass[4] - 0.1) < 1e-9


def xacro(place, depth=1, mesh=""):
    """Macros in other files, read from another working directory."""

    def variant(arm, folder):
        package = folder / "its_arm"
        parts = package / "urdf" / "parts"
        parts.mkdir(parents=True, exist_ok=True)
        (package / "package.xml").write_text("<package><name>its_arm</name></package>")
        inner = arm.urdf().removeprefix('<robot name="r">').removesuffix("</robot>")
        inner = inner.replace("</link>", f"{mesh}</link>", 2)
        mass = text_of(arm.mass[1])
        inner = inner.replace(f'"{mass}"', '"${m}"')
        text = f'{XACRO}<xacro:property name="m" value="{mass}"/>{inner}</robot>'
        for i in range(depth):
            (parts / f"{i}.xacro").write_text(text)
            text = f'{XACRO}<xacro:include filename="{i}.xacro"/></robot>'
        path = package / "urdf" / "strange.urdf.xacro"
        path.write_text(text.replace(f"{depth - 1}.xacro", f"{place}/{depth - 1}.xacro"))
        plain = folder / "robot.urdf"
        plain.write_text(arm.urdf())
        before = Path.cwd()
        os.chdir("/")
        try:
            assert Chain.from_urdf(path, Arm.JOINTS) == Chain.from_urdf(plain, Arm.JOINTS)
        finally:
            os.chdir(before)

    return variant


def mjcf_with(make, joints=Arm.JOINTS, **given):
    return lambda arm, folder: as_mujoco(arm, folder, arm.mjcf(**make(arm)), joints, **given)


def mjcf_refused(make, word):
    return lambda arm, folder: refused(
        folder, arm.mjcf(**make(arm)), word, Chain.from_mjcf, name="strange.xml"
    )


def nested_includes(arm, folder):
    (folder / "parts").mkdir(exist_ok=True)
    (folder / "parts" / "a.xml").write_text(
        '<mujocoinclude><include file="b.xml"/></mujocoinclude>'
    )
    (folder / "parts" / "b.xml").write_text(
        f"<mujocoinclude>{BODY.format('eye', '', 0.2, '')}</mujocoinclude>"
    )
    as_mujoco(arm, folder, arm.mjcf(within='<include file="parts/a.xml"/>'))


def efforts(arm, folder):
    low, high, gear = arm.random.uniform(1, 50, 3)
    text = arm.mjcf(
        more=f'<actuator><general joint="turn" forcerange="-{low} {high}"/><motor joint="lift"'
        f' gear="{gear}" ctrlrange="-{low} {low}"/></actuator>'
    )
    chain = as_mujoco(arm, folder, text)
    np.testing.assert_allclose(
        chain.limits.effort, [max(low, high), gear * low, np.inf], rtol=1e-12
    )


def parallel_rows(arm, folder):
    """A calibrated table: the same tool as by the definition of the table."""
    tilt, offset = arm.random.uniform(5e-4, 5e-3), arm.random.uniform(60, 900)
    rows = [
        {"theta": 1e-3, "alpha": np.pi / 2 + 3e-4, "a": 2e-4, "d": 0.1},
        {"theta": 0.3, "alpha": tilt, "a": -0.4, "d": offset},
        {"theta": -0.2, "alpha": -2 * tilt, "a": -0.35, "d": -1.6 * offset},
        {"theta": 0.1, "alpha": np.pi / 2, "a": 1e-4, "d": 0.1 + 0.6 * offset},
        {"theta": 0.0, "alpha": 0.0, "a": 0.0, "d": 0.09},
    ]
    chain, q = Chain.standard(rows), arm.random.uniform(-2, 2, 5)
    pose, expected = Placement(), Placement()
    for link, row, angle in zip(chain.links, rows, q, strict=True):
        near = Placement.of_row(alpha=link.alpha, a=link.a, d=link.d, theta=link.theta + angle)
        pose = pose @ link.before @ near
        expected = expected @ Placement.of_row(theta=row["theta"] + angle, d=row["d"])
        expected = expected @ Placement.of_row(alpha=row["alpha"], a=row["a"])
        assert np.abs(link.before.position).max() < 20, "a frame far away"
    difference = np.subtract((pose @ chain.links[-1].frame).position, expected.position)
    assert np.abs(difference).max() < 1e-9, "another tool"


def rows_in_mm(arm, folder):
    d = arm.random.uniform(80, 400)
    for rows in (
        [{"alpha": 1.57, "a": 0.0, "d": d}, {"alpha": 0.0, "a": d, "d": 0.0}],
        [{"alpha": 1.0, "a": 0.1, "d": 0.1}, {"alpha": 0.5, "a": 0.0, "d": d}],
    ):
        assert "mm" in refusal_of(Chain.standard, rows)


WORLD = JOINT.format("weld", "fixed", "world", "base", "")
PAD = '<link name="pad"/>'
LATER = '<link name="pad"><inertial><mass value="{}"/></inertial></link>' + JOINT.format(
    "glue", "fixed", "base", "pad", ""
)
MESH = '<visual><geometry><mesh filename="{}"/></geometry></visual>'
COMMA = re.compile(r'(mass\s+value="\d+)\.')

VARIANTS = {
    "urdf: the world is not declared": urdf_with(lambda arm: arm.urdf(WORLD)),
    "urdf: latin-1": coded("iso-8859-1", "Griff_für_Gerät"),
    "urdf: windows-1250": coded("windows-1250", "chwytak_ściskający"),
    "urdf: utf-16": coded("utf-16", "käsi"),
    "urdf: gb2312": coded("gb2312", "夹爪"),
    "urdf: shift_jis": coded("shift_jis", "グリッパ"),
    "urdf: an encoding that it has not": lambda arm, folder: refused(
        folder, arm.urdf(head='<?xml version="1.0" encoding="utf-16"?>'), "encoding"
    ),
    "urdf: effort inf": lambda arm, folder: infinite(arm, folder),
    "urdf: negative friction beside the chain": urdf_with(
        lambda arm: arm.urdf(grip=f'<dynamics damping="-{arm.random.uniform(1, 9)}"/>')
    ),
    "urdf: negative friction in the chain": urdf_refused(
        lambda arm: arm.urdf(bend=f'<dynamics friction="-{arm.random.uniform(1, 9)}"/>'),
        "joint bend must not have negative friction",
    ),
    "urdf: limits turned beside the chain": urdf_with(
        lambda arm: arm.urdf(grip='<limit lower="3" upper="-3"/>')
    ),
    "urdf: no number beside the chain": urdf_with(lambda arm: arm.urdf(LATER.format("nan"))),
    "urdf: a planar joint beside the chain": urdf_with(
        lambda arm: arm.urdf(PAD + JOINT.format("slide", "planar", "base", "pad", ""))
    ),
    "urdf: a joint of another program": urdf_with(
        lambda arm: arm.urdf(PAD + JOINT.format("screw", "screw", "base", "pad", ""))
    ),
    "urdf: a floating base": floating,
    "urdf: a gripper that mimics": mimicked,
    "urdf: meshes of no package": urdf_with(
        lambda arm: arm.urdf().replace("</link>", MESH.format("package://x/a.dae") + "</link>")
    ),
    "urdf: a slip of the triangle inequality": slip(0.03),
    "urdf: no body": slip(0.3),
    "urdf: no body beside the chain": unused_slip,
    "urdf: a link that is not declared": urdf_refused(
        lambda arm: arm.urdf().replace('child link="two"', 'child link="tow"'),
        r"'tow'.*'two'.*missing",
    ),
    "urdf: decimal commas": urdf_refused(
        lambda arm: COMMA.sub(r"\1,", arm.urdf()), "decimals with a point"
    ),
    "xacro: include beside the file": xacro("parts"),
    "xacro: include of an include": xacro("parts", depth=3),
    "xacro: a package around the file": xacro("$(find its_arm)/urdf/parts"),
    "xacro: meshes of no package": xacro("parts", mesh=MESH.format("package://none/a.stl")),
    "xacro: meshes of $(find)": xacro("parts", mesh=MESH.format("$(find none)/a.stl")),
    "xacro: an include of no package": lambda arm, folder: refused(
        folder,
        f'{XACRO}<xacro:include filename="$(find its_parts)/a.xacro"/></robot>',
        "Put the folder of its_parts",
    ),
    "mjcf: tendon and equality of a gripper": mjcf_with(
        lambda arm: {
            "more": '<tendon><fixed name="t"><joint joint="grip" coef="1"/></fixed></tendon>'
            '<equality><tendon tendon1="t"/></equality>'
        }
    ),
    "mjcf: a tendon within the hand": mjcf_with(
        lambda arm: {
            "more": f'<tendon><spatial stiffness="{arm.random.uniform(1, 9)}"><site site="at_three"'
            '/><site site="at_finger"/></spatial></tendon>'
        }
    ),
    "mjcf: a tendon to the world": mjcf_refused(
        lambda arm: {
            "more": '<tendon><spatial name="rope"><site site="at_three"/><site site="hook"/>'
            "</spatial></tendon>"
        },
        "<tendon> rope must not act on the chain",
    ),
    "mjcf: an equality of the arm": mjcf_refused(
        lambda arm: {"more": '<equality><joint joint1="lift" joint2="bend"/></equality>'},
        "<equality> must not act on the chain.*bend, lift",
    ),
    "mjcf: a spring of a finger": mjcf_with(
        lambda arm: {"of_finger": f'stiffness="{arm.random.uniform(1, 99)}"'}
    ),
    "mjcf: a spring of the arm": mjcf_refused(
        lambda arm: {"of_joint": f'stiffness="{arm.random.uniform(1, 99)}"'}, "stiffness of <joint>"
    ),
    "mjcf: gravity compensation": mjcf_with(lambda arm: {"of_body": 'gravcomp="1"'}),
    "mjcf: frames": mjcf_with(
        lambda arm: {
            "within": f'<frame euler="{text_of(arm.random.uniform(-1, 1, 3))}"><frame pos="0.1 0 0">'
            f"{BODY.format('camera', '', arm.random.uniform(0.1, 1), '')}</frame></frame>"
        }
    ),
    "mjcf: a free body": mjcf_with(
        lambda arm: {"world": BODY.format("ball", 'pos="1 1 1"', 0.2, "<freejoint/>")}
    ),
    "mjcf: two joints of a thumb": mjcf_with(
        lambda arm: {
            "within": BODY.format(
                "thumb", 'pos="0 0.1 0"', arm.random.uniform(0.1, 1),
                '<joint name="out" axis="1 0 0"/><joint name="curl" axis="0 1 0" pos="0 0 0.05"/>',
            )
        },
        (*Arm.JOINTS, "out", "curl"),
    ),
    "mjcf: balanced inertia": mjcf_with(
        lambda arm: {
            "compiler": 'balanceinertia="true"',
            "within": BODY.format("plate", "", 0.3, "").replace("2e-3 2e-3 1e-3", "1e-3 1e-3 5e-3"),
        }
    ),
    "mjcf: least masses": mjcf_with(
        lambda arm: {
            "compiler": f'boundmass="{arm.random.uniform(1, 4)}" boundinertia="{arm.random.uniform(1e-3, 0.1)}"'
        }
    ),
    "mjcf: includes of includes": nested_includes,
    "mjcf: efforts of actuators": efforts,
    "mjcf: a controller's plugin": mjcf_with(
        lambda arm: {"more": '<extension><plugin plugin="mujoco.pid"/></extension>'}
    ),
    "mjcf: base and tip": mjcf_with(lambda arm: {}, ("lift", "bend"), base="one", tip="three"),
    "DH: nearly parallel axes": parallel_rows,
    "DH: millimetres": rows_in_mm,
}  # fmt: skip


def infinite(arm, folder):
    path = folder / "strange.urdf"
    path.write_text(
        arm.urdf(lift='<limit lower="-inf" upper="inf" effort="inf" velocity="Infinity"/>')
    )
    limits = Chain.from_urdf(path, Arm.JOINTS).limits
    assert np.isinf([limits.effort[1], limits.upper[1], limits.velocity[1]]).all()
    np.testing.assert_allclose(limits.effort[[0, 2]], arm.effort[[0, 2]])


def variants(seed=0):
    """Name -> what went wrong with this variant, empty if nothing did."""
    results = {}
    for i, (name, variant) in enumerate(VARIANTS.items()):
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                variant(Arm(np.random.default_rng((seed, i))), Path(folder))
                results[name] = ""
            except Exception as error:  # of any kind: that is what is counted
                results[name] = f"{type(error).__name__}: {error}"
    return results


def rows(seed=0):
    """Name, whether it is as it should be, and what is not, of each variant."""
    for name, failure in variants(seed).items():
        yield name, not failure, failure


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--public", action="store_true")
    parser.add_argument("--versions", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.public:
        return public(options.versions, options.seed)
    results = variants(options.seed)
    for name, failure in results.items():
        if failure:
            print(f"{name}: {failure}")
    print(f"{sum(not failure for failure in results.values())} of {len(results)} as they should be")
    return None


if __name__ == "__main__":
    main()
