"""What is wrong with the inertials of a URDF file, by what the file itself says, and the repair: `check_model`.

Every inertial is compared with what it would be without each mistake that files have (`hypotheses`). What speaks for
one or the other: whether a body can have it, the link's own shape (where it is, how wide, how dense), the places of its
joints, the masses of the other links, and the link on the other side. A mistake is named only where it explains far
more than a plain inertial; the least evidence for that is `_MARGIN`, in natural logarithms of odds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plant.mechanics.body import Body
from plant.mechanics.urdf_file import INERTIA, origin_of
from plant.mechanics.xml_file import Element, numbers_of, parsed, spliced
from plant.models.edits import require_new, urdf_inertial, write_whole
from plant.models.evidence import Shape, joint_places, mirrors, partner_of, shape_of
from plant.models.hypotheses import Stated, without_mistakes
from plant.parts.arguments import known_options

__all__ = ["ModelCheck", "ModelFinding", "check_model"]

_MARGIN = 6.0
_RARE = 4.0
"""A mistake is e^4 times rarer than none."""

_DENSITY, _TIMES = 1500.0, 1.2
"""Usual density [kg/m^3] of a link over the volume of its primitives, and the deviation of its logarithm."""

_CAP = 40.0
"""Most that one piece of evidence may say."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ModelFinding:
    """Something wrong with the inertial of a link.

    Attributes
    ----------
    link : str
    mistake : str
    evidence : float
        How much better the repair agrees with the file, in logarithms of odds; infinite where no body can have what is
        stated.
    repair : Body or None
        In the link's frame; None where the file does not tell.
    """

    link: str
    mistake: str
    evidence: float
    repair: Body | None

    def __str__(self) -> str:
        what = "no repair is certain" if self.repair is None else f"repaired: mass {self.repair.mass:.4g} kg"
        return f"link {self.link}: {self.mistake}; {what}"


@dataclasses.dataclass(frozen=True, kw_only=True)
class ModelCheck:
    """What `check_model` found.

    Attributes
    ----------
    path : Path
    findings : tuple of ModelFinding
    """

    path: Path
    findings: tuple[ModelFinding, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing was found."""
        return not self.findings

    def __str__(self) -> str:
        return "\n".join([f"{self.path.name}: {len(self.findings)} finding(s)", *map(str, self.findings)])

    @known_options
    def write(self, target: str | Path, *, overwrite: bool = False) -> None:
        """Write the file with the repairs; every byte of what is not repaired stays.

        Raises
        ------
        ValueError
            A target that is there.
        """
        path = require_new(target, overwrite)
        robot, data = parsed(self.path, "robot", "URDF")
        links = {link.attributes.get("name", ""): link for link in robot.all("link")}
        edits = []
        for finding in self.findings:
            if finding.repair is not None:
                edits += urdf_inertial(data, links[finding.link], finding.repair)
        write_whole(path, spliced(data, edits))


@dataclasses.dataclass
class _Link:
    """A link: what it states (None: no inertial), and what the file says beside it."""

    name: str
    stated: Stated | None
    shape: Shape | None
    places: NDArray[np.float64]
    partners: Sequence[tuple[Stated, NDArray[np.float64]]] = ()


def check_model(path: str | Path) -> ModelCheck:
    """What is wrong with the inertials of a URDF file, and the repair.

    Units (g for kg, mm for m), signs and order of the products of inertia, inertia about the link's frame instead of the
    centre of mass, mirrored links, missing inertials, and what no body can have. Meshes are not read: links whose
    geometry is not made of boxes, cylinders and spheres are judged by their joints and the other links alone.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    ModelCheck
        Print it; ``.write(target)`` writes the repaired file.

    Raises
    ------
    ValueError
        A file that is malformed, too large, or declares entities.
    """
    robot, _ = parsed(path, "robot", "URDF")
    elements = {link.attributes.get("name", ""): link for link in robot.all("link")}
    links = {
        name: _Link(name, _stated(element, name), shape_of(element), joint_places(robot, name))
        for name, element in elements.items()
    }
    moving = {end.attributes.get("link") for joint in robot.all("joint") for end in joint.all("child")}
    for name, link in links.items():
        other = partner_of(name, list(links))
        if other is not None and links[other].stated is not None:
            partner = links[other]
            planes = mirrors((link.shape, partner.shape), (link.places, partner.places))
            if partner.stated is not None:
                link.partners = [(partner.stated, plane) for plane in planes]
    findings = []
    for name, link in links.items():
        found = _missing(link, links) if link.stated is None and name in moving else _judged(link, links)
        if found is not None:
            findings.append(found)
    return ModelCheck(path=Path(path), findings=tuple(findings))


def _stated(link: Element, name: str) -> Stated | None:
    """The inertial as it stands, without a judgement; None where there is none, or nothing in it."""
    inertial = link.find("inertial")
    if inertial is None:
        return None
    where, pose = f"link {name}", origin_of(inertial, f"link {name}")
    mass = numbers_of(inertial.find("mass"), "value", 1, "0", where)[0]
    matrix, inertia = inertial.find("inertia"), np.zeros((3, 3))
    inertia[np.triu_indices(3)] = [numbers_of(matrix, key, 1, "0", where)[0] for key in INERTIA]
    inertia = inertia + np.triu(inertia, 1).T
    if not mass and not inertia.any():
        return None
    return Stated(float(mass), np.array(pose.position), np.array(pose.rotation), inertia)


def _judged(link: _Link, links: dict[str, _Link]) -> ModelFinding | None:
    """The mistake that explains the inertial better than none, if there is one."""
    if link.stated is None:
        return None
    now = _cost(link.stated, link, links)
    trials = [(_cost(other, link, links) + _RARE, words, other) for words, other in without_mistakes(link.stated)]
    best, words, other = min(trials, key=lambda trial: trial[0])
    if not link.stated.physical():
        clear = np.isfinite(best)
        mistake = words if clear else "an inertia that no body has"
        return ModelFinding(
            link=link.name, mistake=mistake, evidence=np.inf, repair=_body(other) if clear else _guess(link, links)
        )
    if now - best > _MARGIN:
        return ModelFinding(link=link.name, mistake=words, evidence=now - best, repair=_body(other))
    return None


def _missing(link: _Link, links: dict[str, _Link]) -> ModelFinding | None:
    """A link without inertial that should have one: it has a shape, or a partner with one."""
    if link.shape is None and not link.partners:
        return None
    return ModelFinding(link=link.name, mistake="no inertial", evidence=np.inf, repair=_guess(link, links))


def _guess(link: _Link, links: dict[str, _Link]) -> Body | None:
    """The partner's body mirrored; or the link's shape, as dense as the others."""
    for partner, plane in link.partners:
        if partner.physical():
            return _body(_mirrored(partner, plane))
    densities = [
        other.stated.mass / other.shape.volume
        for other in links.values()
        if other is not link and other.stated is not None and other.shape is not None and other.stated.physical()
    ]
    if link.shape is None or not densities:
        return None
    mass = float(np.median(densities)) * link.shape.volume
    spread = mass * link.shape.spread
    return _body(Stated(mass, link.shape.centre, np.eye(3), np.trace(spread) * np.eye(3) - spread))


def _mirrored(given: Stated, plane: NDArray[np.float64]) -> Stated:
    turned = given.rotation @ given.inertia @ given.rotation.T
    return Stated(given.mass, plane @ given.com, np.eye(3), plane @ turned @ plane)


def _body(given: Stated) -> Body:
    turned = given.rotation @ given.inertia @ given.rotation.T
    return Body(mass=given.mass, com=given.com, inertia=turned[np.triu_indices(3)])


def _cost(given: Stated, link: _Link, links: dict[str, _Link]) -> float:
    """How little an inertial agrees with all else that the file says."""
    if not given.physical():
        return np.inf
    spread = given.spread / given.mass
    if link.shape is not None:
        scale = link.shape.spread
        where = given.com - link.shape.centre
        cost = 0.5 * min(_CAP, float(where @ np.linalg.solve(scale, where)))
        cost += 2.0 * min(_CAP, _divergence(spread, scale))
        cost += 0.5 * min(_CAP, (np.log(given.mass / link.shape.volume / _DENSITY) / _TIMES) ** 2)
    else:
        masses = [other.stated.mass for other in links.values() if other is not link and other.stated is not None]
        median = float(np.median([abs(mass) for mass in masses])) if masses else given.mass
        cost = 0.5 * min(_CAP, (np.log(given.mass / max(median, 1e-9)) / 1.5) ** 2)
        ends = np.linalg.norm(link.places, axis=1)
        size = max([*ends, 0.1 * _reach(links), 1e-3])
        cost += 0.5 * min(_CAP, float(given.com @ given.com) / size**2)
        cost += 0.5 * min(_CAP, (np.log(np.trace(spread) / (0.3 * size) ** 2) / 2.0) ** 2)
    if link.partners:
        apart = [_apart(given, _mirrored(partner, plane)) for partner, plane in link.partners if partner.mass > 0]
        cost += min([_CAP / 2, *apart])
    return cost


def _reach(links: dict[str, _Link]) -> float:
    """The longest distance of two joints on a link [m]."""
    return max(
        (float(np.linalg.norm(link.places, axis=1).max()) for link in links.values() if len(link.places)), default=0.1
    )


def _divergence(spread: NDArray[np.float64], scale: NDArray[np.float64]) -> float:
    """Log-det divergence of second moments from those of a shape; a flat body is as thick as a hundredth of it."""
    ratio = np.linalg.solve(scale, spread)
    sign, logarithm = np.linalg.slogdet(ratio + 1e-4 * np.eye(3))
    return float(np.trace(ratio) - logarithm - 3) if sign > 0 else _CAP


def _apart(one: Stated, other: Stated) -> float:
    """How far two bodies are from each other, relative to their own size."""
    size = max(np.trace(one.spread) / one.mass, np.trace(np.abs(other.spread)) / abs(other.mass), 1e-12)
    mass = np.log(one.mass / abs(other.mass)) ** 2
    where = float((one.com - other.com) @ (one.com - other.com)) / size
    spread = float(np.abs(one.spread / one.mass - other.spread / other.mass).max()) / size
    return 20.0 * float(np.sqrt(mass + where + spread**2))
