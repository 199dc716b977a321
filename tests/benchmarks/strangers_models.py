"""Models as strangers write them, and `check_model` on public arms that were spoilt by one mistake.

    python tests/benchmarks/strangers_models.py [--public] [--versions 400] [--seed 0]

Without an option: 40 models, each with one feature that public files have (a gripper, a tendon, an
encoding, an include, ...), and drawn numbers. Each is read with the torques that it must have, or
refused with the right word. With --public: the arms of `model_files.py` as they are, and versions
with one mistake each (package example-robot-data, the extra `robots`).
"""

import argparse
import sys
import tempfile
import warnings
import xml.etree.ElementTree as ET  # of an installed package
from collections import Counter
from pathlib import Path

import numpy as np

from plant import check_model

sys.path.insert(0, str(Path(__file__).parent))

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

    from plant import Chain

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
            wrong += wrongly(check, arms[name][0], kind, name, old)
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


def wrongly(check, source, kind, name, old):
    """Repairs after which a number is not that of the sound file."""
    if not check.findings or all(f.repair is None for f in check.findings):
        return []
    target = check.path.with_name("repaired.urdf")
    check.write(target, overwrite=True)
    sound, repaired = ET.parse(source).getroot(), ET.parse(target).getroot()  # noqa: S314
    rows = []
    for finding in check.findings:
        if finding.repair is None or finding.link in old:
            continue
        a, b = values(sound, finding.link), values(repaired, finding.link)
        six = np.abs(a[4:]).max()
        scale = np.array([abs(a[0]), *[max(np.linalg.norm(a[1:4]), 1e-3)] * 3, *[six] * 6])
        if (np.abs(a - b) > 0.01 * scale).any():
            rows.append((kind, name, finding.link, finding.mistake))
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--public", action="store_true")
    parser.add_argument("--versions", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.public:
        public(options.versions, options.seed)
