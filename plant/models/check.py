"""What is wrong with the inertials of a URDF file, by what the file itself says, and the repair: `check_model`.

Every inertial is compared with what it would be without each mistake that files have (`hypotheses`). What speaks for
one or the other: the link's own shape (where it is, how wide, how dense), the places of its joints, the masses of the
other links, and the link on the other side. A mistake is named only where something proves it: no body can have what is
stated; none within three times the link's shape can, or none within the robot; no matter is so dense; or what is left
without the mistake is exactly the link on the other side, or exactly the shape uniformly filled, which does not happen
by chance.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plant.mechanics.body import Body
from plant.mechanics.model_tree import MOVING
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

_SLACK, _OUTSIDE = 0.05, 15.0
"""Share by which a link may be larger than its shape in the file, and what a body says that needs more."""

_FAR = 1.0
"""The same share, for a proof: shapes for collisions leave parts out."""

_LIGHTEST, _HEAVIEST = 1.0, 23000.0
"""Density [kg/m^3] of nothing that links are made of: above that of osmium."""

_SAME, _UNIFORM, _COINCIDENCE = 1e-4, 2e-3, 15.0
"""Relative differences at which a link is its partner mirrored, or its shape uniformly filled, and what that says."""

_APART = 20.0
"""What a whole difference from the link on the other side says."""

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

    Units (g for kg, mm for m), signs and order of the products of inertia, inertia about the link's frame, mirrored
    links, missing inertials, and what no body can have. Meshes are not read: links whose
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
    joints = [joint for joint in robot.all("joint") if joint.attributes.get("type") in MOVING]
    moving = {end.attributes.get("link") for joint in joints for end in joint.all("child")}
    for name, link in links.items():
        other = partner_of(name, list(links))
        if other is not None and links[other].stated is not None:
            partner = links[other]
            planes = mirrors((link.shape, partner.shape), (link.places, partner.places))
            if partner.stated is not None:
                link.partners = [(partner.stated, plane) for plane in planes]
    found: dict[str, ModelFinding] = {}
    for name, link in links.items():
        finding = _missing(link, links) if link.stated is None and name in moving else _judged(link, links)
        if finding is not None:
            found[name] = finding
    for name in list(found):  # of two sides that differ, one is wrong
        other = partner_of(name, list(links))
        if name in found and other in found and np.isfinite([found[name].evidence, found[other].evidence]).all():
            del found[min((name, other), key=lambda each: _own_gain(links[each], found[each], links))]
    return ModelCheck(path=Path(path), findings=tuple(found.values()))


def _own_gain(link: _Link, finding: ModelFinding, links: dict[str, _Link]) -> float:
    """What speaks for a repair without the link on the other side."""
    alone = dataclasses.replace(link, partners=())
    if link.stated is None or finding.repair is None:
        return 0.0
    inertia = np.zeros((3, 3))
    inertia[np.triu_indices(3)] = finding.repair.inertia
    repaired = Stated(finding.repair.mass, finding.repair.com, np.eye(3), inertia + np.triu(inertia, 1).T)
    return _cost(link.stated, alone, links) - _cost(repaired, alone, links)


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
    exact = np.isfinite(best) and _coincides(other, link)
    if not link.stated.physical():
        sure = exact or (np.isfinite(best) and words.startswith("a negative"))
        mistake = words if sure else "an inertia that no body has"
        repair = _body(other) if sure else _guess(link, links)
        return ModelFinding(link=link.name, mistake=mistake, evidence=np.inf, repair=repair)
    proven = (exact and not _coincides(link.stated, link)) or _impossible(link.stated, link, links)
    if proven and now - best > _MARGIN:
        return ModelFinding(link=link.name, mistake=words, evidence=now - best, repair=_body(other))
    return None


def _coincides(given: Stated, link: _Link) -> bool:
    """Whether an inertial is exactly that of the other side, or that of the shape uniformly filled."""
    apart = [_apart(given, _mirrored(partner, plane)) for partner, plane in link.partners if partner.physical()]
    return bool(apart and min(apart) < _APART * _SAME) or _uniform(given, link.shape)


def _uniform(given: Stated, shape: Shape | None) -> bool:
    if shape is None:
        return False
    size = float(np.trace(shape.spread))
    spread = np.abs(given.spread / given.mass - shape.spread).max() < _UNIFORM * size
    return bool(spread and np.linalg.norm(given.com - shape.centre) < _UNIFORM * np.sqrt(size))


def _impossible(given: Stated, link: _Link, links: dict[str, _Link]) -> bool:
    """Whether no body within the robot, or within three times the link's shape, can have this inertial."""
    spread = given.spread / given.mass
    if link.shape is not None:
        dense = not _LIGHTEST < given.mass / link.shape.volume < _HEAVIEST
        return dense or not link.shape.holds(given.com, spread, _FAR)
    whole = sum(float(np.linalg.norm(each.places, axis=1).max()) for each in links.values() if len(each.places))
    return bool(whole) and bool(max(np.linalg.norm(given.com), np.sqrt(np.trace(spread))) > 2.0 * whole)


def _missing(link: _Link, links: dict[str, _Link]) -> ModelFinding | None:
    """A link that moves and has a shape, or a partner with an inertial, and no inertial of its own."""
    if link.shape is None and not link.partners:
        return None
    return ModelFinding(link=link.name, mistake="no inertial", evidence=np.inf, repair=_guess(link, links))


def _guess(link: _Link, links: dict[str, _Link]) -> Body | None:
    """The partner's body mirrored; or the link's shape filled, where all others are filled alike."""
    for partner, plane in link.partners:
        if partner.physical():
            return _body(_mirrored(partner, plane))
    others = [other for other in links.values() if other is not link and other.stated is not None and other.shape]
    densities = [
        other.stated.mass / other.shape.volume
        for other in others
        if other.stated is not None and other.shape is not None and _uniform(other.stated, other.shape)
    ]
    alike = len(densities) > 1 and len(densities) == len(others) and np.ptp(densities) < 0.01 * min(densities)
    if link.shape is None or not alike:
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
        cost += 0.0 if link.shape.holds(given.com, spread, _SLACK) else _OUTSIDE
        cost -= _COINCIDENCE if _uniform(given, link.shape) else 0.0
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
        cost -= _COINCIDENCE if apart and min(apart) < _APART * _SAME else 0.0
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
    return _APART * float(np.sqrt(mass + where + spread**2))
