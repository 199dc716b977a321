"""How many of 50 broken URDF files does `check_model` name, repair within 1 %, and repair wrongly?
`python tests/benchmarks/broken_models.py`.

Robots with two equal sides, links of boxes and cylinders that are neither uniform nor aligned with
their shapes; one mistake each. With folders as arguments: the alarms on the URDF files there, such
as those of example-robot-data.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from plant import check_model

KINDS = (
    "negative", "sign", "order", "mm", "grams", "inertia mm", "frame", "missing", "mirrored",
)  # fmt: skip
KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
PLACES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def text(values):
    return " ".join(repr(float(x) + 0.0) for x in np.atleast_1d(values))


def body(random, edges, centre):
    """Mass, centre of mass and inertia of something in a box: a cloud of points, denser at one
    end.
    """
    points = centre + random.uniform(-0.5, 0.5, (200, 3)) * edges * random.uniform(0.75, 1.0)
    weights = 1 + random.uniform(0, 1.5) * (points - centre) @ (random.normal(size=3) / edges)
    weights = np.clip(weights, 0.1, None) / np.clip(weights, 0.1, None).sum()
    mass = np.prod(edges) * np.exp(random.normal(np.log(1500), 0.6))
    com = weights @ points
    turn, _ = np.linalg.qr(np.eye(3) + 0.25 * random.normal(size=(3, 3)))
    apart = (points - com) @ turn
    spread = mass * (apart * weights[:, None]).T @ apart
    return mass, com, np.trace(spread) * np.eye(3) - spread


def robot(random):
    """Two equal arms of three links, mirrored in y, on a base: link -> (edges, centre, joint,
    mass, com, inertia).
    """
    links, mirror = {}, np.diag([1.0, -1.0, 1.0])
    for i in range(3):
        length = random.uniform(0.15, 0.5)
        edges = np.array([length, *(length * random.uniform(0.2, 0.5, 2))])
        centre = np.array([length / 2, random.uniform(0.01, 0.05), random.uniform(-0.02, 0.02)])
        mass, com, inertia = body(random, edges, centre)
        joint = (
            np.array([0.1, 0.2, 0.3])
            if i == 0
            else np.array([links[f"left_{i - 1}"][0][0], 0.03, 0.0])
        )
        links[f"left_{i}"] = (edges, centre, joint, mass, com, inertia)
        links[f"right_{i}"] = (
            edges,
            mirror @ centre,
            mirror @ joint,
            mass,
            mirror @ com,
            mirror @ inertia @ mirror,
        )
    return links


def alone(links):
    """One of the two arms: no link has another side."""
    return {name: link for name, link in links.items() if name.startswith("left")}


def broken(random, kind, mass, com, inertia):
    """An inertial with a mistake; None for none at all."""
    inertia = inertia.copy()
    if kind == "negative":
        axis = random.integers(3)
        inertia[axis, axis] *= -1
    elif kind == "sign":
        inertia = 2 * np.diag(np.diag(inertia)) - inertia
    elif kind == "order":
        (a, b), (c, d) = (0, 1), (1, 2)
        inertia[a, b], inertia[c, d] = inertia[c, d], inertia[a, b]
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
    elif kind == "mm":
        com = com * 1000
    elif kind == "grams":
        mass = mass * 1000
    elif kind == "inertia mm":
        inertia = inertia * 1e6
    elif kind == "frame":
        inertia = inertia + mass * (com @ com * np.eye(3) - np.outer(com, com))
    elif kind == "mirrored":
        plane = np.diag([1.0, -1.0, 1.0])
        com, inertia = plane @ com, plane @ inertia @ plane
    return None if kind == "missing" else (mass, com, inertia)


def written(links, wrong=None, stated=None):
    """The file; of one link what is stated instead."""
    lines = ['<robot name="r">', '  <link name="base"/>']
    for name, (edges, centre, joint, *own) in links.items():
        given = stated if name == wrong else own
        lines.append(f'  <link name="{name}">')
        if given is not None:
            mass, com, inertia = given
            matrix = " ".join(
                f'{key}="{text(inertia[place])}"' for key, place in zip(KEYS, PLACES, strict=True)
            )
            lines.append(
                f'    <inertial><origin xyz="{text(com)}"/><mass value="{text(mass)}"/><inertia'
                f" {matrix}/></inertial>"
            )
        lines.append(
            f'    <collision><origin xyz="{text(centre)}"/><geometry><box'
            f' size="{text(edges)}"/></geometry></collision>'
        )
        side, _, number = name.partition("_")
        parent = "base" if number == "0" else f"{side}_{int(number) - 1}"
        lines += [
            "  </link>",
            (
                f'  <joint name="j_{name}" type="revolute"><parent link="{parent}"/><child'
                f' link="{name}"/>'
            ),
            f'    <origin xyz="{text(joint)}"/><axis xyz="0 0 1"/></joint>',
        ]
    return "\n".join([*lines, "</robot>"])


def named(check, name):
    """Whether there is one finding, about this link, or about which of the two sides it is."""
    (finding,) = check.findings if len(check.findings) == 1 else (None,)
    return finding is not None and (finding.link == name or f"in {name}" in finding.mistake)


def right(repair, mass, com, inertia):
    """Whether a repair is within 1 %."""
    six = np.array([inertia[place] for place in PLACES])
    near = abs(repair.mass / mass - 1) < 0.01 and np.abs(
        repair.com - com
    ).max() < 0.01 * np.linalg.norm(com)
    return near and np.abs(repair.inertia - six).max() < 0.01 * np.abs(six).max()


def study(count=50, seed=0, pairs=True):
    """Named, rightly and wrongly repaired files of `count`, false alarms on the files before they
    were broken, and what was not named or wrongly repaired.
    """
    random, failed = np.random.default_rng(seed), []
    found = repaired = wrong = alarms = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        for i in range(count):
            links = robot(random) if pairs else alone(robot(random))
            path.write_text(written(links))
            alarms += len(check_model(path).findings)
            kind, name = KINDS[i % len(KINDS)], str(random.choice(list(links)))
            path.write_text(written(links, name, broken(random, kind, *links[name][3:])))
            check = check_model(path)
            repairs = [f for f in check.findings if f.repair is not None]
            good = [right(finding.repair, *links[finding.link][3:]) for finding in repairs]
            found += named(check, name)
            repaired += sum(good)
            wrong += len(good) - sum(good)
            if not named(check, name) or not all(good):
                failed.append((kind, name, [str(finding) for finding in check.findings]))
    return found, repaired, wrong, alarms, failed


if __name__ == "__main__":
    if sys.argv[1:]:
        for file in sorted(
            path for folder in sys.argv[1:] for path in Path(folder).rglob("*.urdf")
        ):
            try:
                print(check_model(file))
            except ValueError as error:
                print(f"{file.name}: not read: {error}")
        sys.exit()
    for pairs in (True, False):
        found, repaired, wrong, alarms, failed = study(pairs=pairs)
        sides = "two sides" if pairs else "one side"
        print(
            f"{sides}: {found} of 50 named, {repaired} repaired within 1 %, {wrong} wrongly; {alarms}"
            " false alarms on 50 sound files"
        )
        for row in failed:
            print("   ", *row)
