"""Model files broken by somebody who had not read `check_model`: how many it repairs, and how often it is wrong.

    python tests/benchmarks/broken_by_others.py [--seed 18] [--files 50] [--robots FOLDER] [--verbose]

The models: the UR5e of the package, three arms of tubes and motors written here, and the files of the package
`example-robot-data` below FOLDER (share/example-robot-data/robots), as far as each inertial of a file is one that a
body can have. In each file one thing is broken. Right is a repair with every inertial of the file within 1 % of the
sound one: mass, centre of mass (of the link's size) and inertia about the centre in the link's axes. An alarm on a
sound model counts as false. Files with a mistake that was shown by hand (`SHOWN`) are not broken further.
"""

import argparse
import collections
import copy
import re
import sys
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from plant import check_model

OWN = Path(__file__).parents[2] / "plant" / "models" / "robots" / "ur5e.urdf"
SHOWN = {
    "g1_29dof_rev_1_0": (
        "the two knees are mirrored in y but for ixz, which the mirror keeps and the file turns"
    ),
    "g1_29dof_with_hand_rev_1_0": "the same",
    "human": (
        "the two clavicles reach out to z = -0.21 and 0.21 m, and both have their centre of mass at"
        " z = 0.054 m"
    ),
}
"""Mistakes in the files of example-robot-data, by what proves them."""

KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def numbers(text, default="0 0 0"):
    return np.array([float(x) for x in (text or default).split()])


def matrix(i):
    return np.array([[i[0], i[1], i[2]], [i[1], i[3], i[4]], [i[2], i[4], i[5]]])


def six(m):
    return np.array([m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]])


def inertial(link):
    """(mass, centre, inertia in the link's axes) of a link element; None where it has no
    inertial.
    """
    node = link.find("inertial")
    if node is None:
        return None
    origin = node.find("origin")
    xyz, rpy = np.zeros(3), np.zeros(3)
    if origin is not None:
        xyz, rpy = numbers(origin.get("xyz")), numbers(origin.get("rpy"))
    R = Rotation.from_euler("xyz", rpy).as_matrix()
    m = matrix([float(node.find("inertia").get(k)) for k in KEYS])
    return float(node.find("mass").get("value")), xyz, R @ m @ R.T


def possible(body):
    mass, _, m = body
    w = np.linalg.eigvalsh(m)
    return mass > 0 and w[0] > 0 and w[0] + w[1] >= w[2] * (1 - 1e-6)


def same(a, b):
    if a is None or b is None:
        return a is b
    size = np.sqrt(np.trace(b[2]) / b[0]) + np.linalg.norm(b[1])
    return (
        abs(a[0] - b[0]) <= 0.01 * b[0]
        and np.linalg.norm(a[1] - b[1]) <= 0.01 * size
        and np.linalg.norm(a[2] - b[2]) <= 0.01 * np.linalg.norm(b[2])
    )


def bodies(root):
    return {link.get("name"): inertial(link) for link in root.findall("link")}


# --- three arms of tubes, motors and flanges -------------------------------------------------------------------------


def part(rng, kind, size, xyz, density):
    if kind == "box":
        mass = density * np.prod(size)
        j = (
            mass
            / 12
            * np.array(
                [
                    size[1] ** 2 + size[2] ** 2,
                    size[0] ** 2 + size[2] ** 2,
                    size[0] ** 2 + size[1] ** 2,
                ]
            )
        )
    else:
        r, h = size
        mass = density * np.pi * r**2 * h
        j = mass * np.array([(3 * r**2 + h**2) / 12, (3 * r**2 + h**2) / 12, r**2 / 2])
    return kind, size, np.asarray(xyz), mass, np.diag(j)


def arm_of_parts(rng, n, sides):
    """A tree of links: each a tube, a motor beside it and a flange; two sides are mirrored in y."""
    text = ['<?xml version="1.0"?>', '<robot name="made">', '  <link name="base"/>']
    rows = []
    for _ in range(n):
        length = rng.uniform(0.15, 0.45)
        side = rng.choice([-1, 1]) * rng.uniform(0.03, 0.08)
        rows.append(
            (
                length,
                [
                    part(
                        rng,
                        "box",
                        [*rng.uniform(0.04, 0.09, 2), length],
                        [0.01, 0.0, length / 2],
                        rng.uniform(700, 1500),
                    ),
                    part(
                        rng,
                        "cylinder",
                        [0.04, 0.09],
                        [rng.uniform(-0.03, 0.03), side, 0.03],
                        rng.uniform(3000, 5000),
                    ),
                    part(rng, "box", [0.07, 0.05, 0.03], [0.02, -side / 2, length - 0.02], 2700.0),
                ],
                rng.choice(["1 0 0", "0 1 0", "0 0 1"]),
            )
        )
    for name, sign in [("left_", 1), ("right_", -1)] if sides else [("", 1)]:
        parent = "base"
        for k, (_, parts, axis) in enumerate(rows):
            mass = sum(p[3] for p in parts)
            where = [p[2] * [1, sign, 1] for p in parts]
            c = sum(p[3] * w for p, w in zip(parts, where, strict=True)) / mass
            j = sum(
                p[4] + p[3] * ((w - c) @ (w - c) * np.eye(3) - np.outer(w - c, w - c))
                for p, w in zip(parts, where, strict=True)
            )
            text.append(f'  <link name="{name}link{k + 1}">')
            text.append(
                f'    <inertial>\n      <origin xyz="{c[0]:.6g} {c[1]:.6g} {c[2]:.6g}" rpy="0 0'
                ' 0"/>'
            )
            text.append(f'      <mass value="{mass:.6g}"/>')
            text.append(
                "      <inertia "
                + " ".join(f'{a}="{v:.6g}"' for a, v in zip(KEYS, six(j), strict=True))
                + "/>"
            )
            text.append("    </inertial>")
            for (kind, size, *_), w in zip(parts, where, strict=True):
                at = " ".join(f"{v:.6g}" for v in w)
                shape = (
                    f'<box size="{size[0]:.6g} {size[1]:.6g} {size[2]:.6g}"/>'
                    if kind == "box"
                    else f'<cylinder radius="{size[0]:.6g}" length="{size[1]:.6g}"/>'
                )
                text.append(
                    f'    <visual><origin xyz="{at}" rpy="0 0'
                    f' 0"/><geometry>{shape}</geometry></visual>'
                )
            text.append("  </link>")
            z = 0.0 if k == 0 else rows[k - 1][0]
            y = sign * 0.2 if k == 0 and sides else 0.0
            text.append(f'  <joint name="{name}joint{k + 1}" type="revolute">')
            text.append(f'    <parent link="{parent}"/><child link="{name}link{k + 1}"/>')
            text.append(f'    <origin xyz="0 {y:.6g} {z:.6g}" rpy="0 0 0"/><axis xyz="{axis}"/>')
            text.append('    <limit lower="-3" upper="3" effort="100" velocity="3"/>\n  </joint>')
            parent = f"{name}link{k + 1}"
    return "\n".join([*text, "</robot>"]) + "\n"


# --- what people get wrong -------------------------------------------------------------------------------------------


def put(node, mass=None, xyz=None, inertia=None):
    if mass is not None:
        node.find("mass").set("value", f"{mass:.9g}")
    if xyz is not None:
        origin = node.find("origin")
        if origin is None:
            origin = ET.SubElement(node, "origin")
            origin.set("rpy", "0 0 0")
        origin.set("xyz", " ".join(f"{v:.9g}" for v in xyz))
    if inertia is not None:
        for k, v in zip(KEYS, inertia, strict=True):
            node.find("inertia").set(k, f"{v:.9g}")


def raw(node):
    origin = node.find("origin")
    xyz = numbers(origin.get("xyz")) if origin is not None else np.zeros(3)
    rpy = numbers(origin.get("rpy")) if origin is not None else np.zeros(3)
    return (
        float(node.find("mass").get("value")),
        xyz,
        rpy,
        np.array([float(node.find("inertia").get(k)) for k in KEYS]),
    )


def negative(rng, links):
    _, _, _, i = raw(node := pick(rng, links).find("inertial"))
    k = rng.choice([0, 3, 5])
    i[k] = -i[k]
    put(node, inertia=i)
    return "sign of a moment"


def slip(rng, links):
    node = pick(rng, links).find("inertial")
    _, _, _, i = raw(node)
    k = rng.choice([0, 3, 5])
    i[k] *= rng.choice([10.0, 100.0])
    put(node, inertia=i)
    return "decimal slip in a moment"


def swapped(rng, links):
    node = pick(rng, links).find("inertial")
    i = raw(node)[3]
    a, b = [(1, 2), (1, 4), (2, 4)][rng.integers(3)]
    i[[a, b]] = i[[b, a]]
    put(node, inertia=i)
    return f"{KEYS[a]} and {KEYS[b]} swapped"


def signs(rng, links):
    chosen = links if rng.random() < 0.5 else [pick(rng, links)]
    for link in chosen:
        i = raw(node := link.find("inertial"))[3]
        i[[1, 2, 4]] *= -1
        put(node, inertia=i)
    return f"sign of all products, {len(chosen)} link(s)"


def millimetres(rng, links):
    chosen, how = (links if rng.random() < 0.5 else [pick(rng, links)]), rng.integers(3)
    for link in chosen:
        _, xyz, _, i = raw(node := link.find("inertial"))
        put(node, xyz=xyz * 1e3 if how != 1 else None, inertia=i * 1e6 if how != 0 else None)
    return f"{['centre in mm', 'inertia in kg mm^2', 'both in mm'][how]}, {len(chosen)} link(s)"


def grams(rng, links):
    chosen, how = (links if rng.random() < 0.5 else [pick(rng, links)]), rng.integers(3)
    for link in chosen:
        mass, _, _, i = raw(node := link.find("inertial"))
        put(node, mass=mass * 1e3 if how != 1 else None, inertia=i * 1e3 if how != 0 else None)
    return f"{['mass in g', 'inertia in g m^2', 'both in g'][how]}, {len(chosen)} link(s)"


def about_the_frame(rng, links):
    chosen = links if rng.random() < 0.5 else [pick(rng, links)]
    for link in chosen:
        mass, xyz, rpy, i = raw(node := link.find("inertial"))
        c = Rotation.from_euler("xyz", rpy).as_matrix().T @ xyz
        put(node, inertia=i + six(mass * (c @ c * np.eye(3) - np.outer(c, c))))
    return f"inertia about the link's frame, {len(chosen)} link(s)"


def missing(rng, links):
    link = pick(rng, links)
    link.remove(link.find("inertial"))
    return "no inertial"


def mirrored(rng, links):
    pairs = [
        link
        for link in links
        if re.search(r"left|right|(^|_)[lr]_|_[lr]$", link.get("name").lower())
    ]
    node = pick(rng, pairs or links).find("inertial")
    _, xyz, _, i = raw(node)
    i[[1, 4]] *= -1
    put(node, xyz=xyz * [1, -1, 1], inertia=i)
    return "mirrored in y" + (" (a side)" if pairs else "")


def pick(rng, links):
    return links[rng.integers(len(links))]


KINDS = (negative, slip, swapped, signs, millimetres, grams, about_the_frame, missing, mirrored)


def moving(root):
    return {j.find("child").get("link") for j in root.findall("joint") if j.get("type") != "fixed"}


def models(rng, folder):
    """(name, text) of the sound models, and the names of the files left out."""
    found, left = [("ur5e", OWN.read_text())], []
    for n, sides in ((6, False), (3, True), (4, False)):
        found.append(
            (
                f"made of parts, {n} links{', two sides' if sides else ''}",
                arm_of_parts(rng, n, sides),
            )
        )
    for path in sorted(Path(folder).rglob("*.urdf")) if folder else ():
        text = path.read_text()
        try:
            root = ET.fromstring(text)  # noqa: S314 - files of ours
            sound = all(b is None or possible(b) for b in bodies(root).values()) and moving(root)
        except (ET.ParseError, ValueError, TypeError, AttributeError):
            sound = False
        (found if sound else left).append((path.stem, text) if sound else path.stem)
    return found, left


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=18)
    parser.add_argument("--files", type=int, default=50)
    parser.add_argument(
        "--robots", default=None, help="share/example-robot-data/robots of the package"
    )
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    sound, left = models(rng, options.robots)
    print(
        f"seed {options.seed}; {len(sound)} models, {len(left)} left out with an inertial that no"
        " body has"
    )
    table = collections.defaultdict(lambda: [0, 0, 0, 0])
    with tempfile.TemporaryDirectory() as folder:
        path, target = Path(folder, "robot.urdf"), Path(folder, "repaired.urdf")
        alarms = 0
        for name, text in sound:
            path.write_text(text)
            check = check_model(path)
            alarms += not check.ok and name not in SHOWN
            if not check.ok:
                print(
                    f"alarm on {name}: {check}"
                    + (f" (right: {SHOWN[name]})" if name in SHOWN else "")
                )
        sound = [each for each in sound if each[0] not in SHOWN]
        print(f"false alarms on {alarms} of {len(sound)} sound models")
        done = 0
        while done < options.files:
            name, text = sound[rng.integers(4) if rng.random() < 0.4 else rng.integers(len(sound))]
            root = ET.fromstring(text)  # noqa: S314 - files of ours
            truth = bodies(copy.deepcopy(root))
            names = moving(root)
            links = [
                k
                for k in root.findall("link")
                if k.get("name") in names and truth[k.get("name")] is not None
            ]
            kind = KINDS[done % len(KINDS)]
            what = kind(rng, links)
            if all(same(b, truth[k]) for k, b in bodies(root).items()):
                continue  # nothing was changed that counts
            path.write_text(ET.tostring(root, encoding="unicode"))
            check = check_model(path)
            check.write(target, overwrite=True)
            got = bodies(ET.parse(target).getroot())  # noqa: S314 - files of ours
            right = all(same(b, truth[k]) for k, b in got.items())
            row = table[kind.__name__]
            row[0] += 1
            row[1] += right
            row[2] += not right and not check.ok
            row[3] += check.ok
            done += 1
            if options.verbose:
                print(
                    f"{done:3d} {name}: {what}:"
                    f" {'right' if right else 'unnoticed' if check.ok else 'not right'}"
                )
                if not right and not check.ok:
                    print("     " + str(check).replace("\n", "\n     ")[:600])
    print(f"\n{'broken':20}{'files':>7}{'right':>7}{'said, not right':>17}{'unnoticed':>11}")
    for kind, row in table.items():
        print(f"{kind:20}{row[0]:7}{row[1]:7}{row[2]:17}{row[3]:11}")
    total = np.sum(list(table.values()), axis=0)
    print(f"{'all':20}{total[0]:7}{total[1]:7}{total[2]:17}{total[3]:11}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
