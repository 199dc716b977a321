"""What is wrong with the inertials of a URDF file, by what the file itself says, and the repair:
`check_model`.

Every inertial is compared with what it would be without each mistake that files have
(`hypotheses`). What speaks for one or the other: the link's own shape (where it is, how wide, how
dense), the places of its joints, the masses of the other links, and the link on the other side. A
mistake is named only where something proves it: no body can have what is stated; none within three
times the link's shape can, or none within the robot; no matter is so dense; or what is left without
the mistake is exactly the link on the other side, or exactly the shape uniformly filled, which does
not happen by chance.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from plant.mechanics.body import Body, inertia_matrix
from plant.mechanics.model_tree import MOVING
from plant.mechanics.urdf_file import INERTIA, origin_of
from plant.mechanics.xml_file import Element, numbers_of, parsed, spliced
from plant.models.agreement import (
    HEAVIEST,
    CheckedLink,
    agrees,
    apart,
    coincides,
    cost_of,
    impossible,
    mirrored,
)
from plant.models.edits import body_of, guess, only, urdf_inertial
from plant.models.hypotheses import (
    Stated,
    joint_places,
    mirrors,
    partner_of,
    shape_of,
    without_mistakes,
)
from plant.parts.arguments import known_options
from plant.parts.files import require_new, write_whole
from plant.parts.shown import Piece, Shown, Verdict

_MARGIN = 6.0
# Relative difference of a link from its repair below which nothing is said: CAD models of two sides
# differ as much.
_COUNTS = 0.006

_RARE = 4.0  # a mistake is e^4 times rarer than none


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class ModelFinding(Shown):
    """A mistake in the inertial of a link, and its repair in the link's frame; None where the file
    does not tell.

    `evidence`: how much better the repair agrees with the file, in logarithms of odds; infinite
    where no body can have what is stated.
    """

    link: str
    mistake: str
    evidence: float
    repair: Body | None

    def _short(self) -> str:
        return f"link {self.link}{', repaired' * (self.repair is not None)}"

    def _shown(self) -> Iterator[Piece]:
        what = (
            "no repair is certain"
            if self.repair is None
            else f"repaired: mass {self.repair.mass:.4g} kg"
        )
        yield f"link {self.link}: {self.mistake}; {what}"


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class ModelCheck(Shown):
    """What `check_model` found."""

    path: Path
    findings: tuple[ModelFinding, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing was found."""
        return not self.findings

    def _short(self) -> str:
        return f"{self.path.name}: {len(self.findings)} finding(s)"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(self._short(), self.ok)
        for finding in self.findings:
            yield from finding._shown()

    @known_options
    def write(self, target: str | Path, *, overwrite: bool = False) -> None:
        """Write the file with the repairs, a new one; every byte of what is not repaired stays."""
        path = require_new(target, overwrite)
        robot, data = parsed(self.path, "robot", "URDF")
        links = {link.attributes.get("name", ""): link for link in robot.all("link")}
        edits = []
        for finding in self.findings:
            if finding.repair is not None:
                edits += urdf_inertial(data, links[finding.link], finding.repair)
        write_whole(path, [spliced(data, edits)])


def check_model(path: str | Path) -> ModelCheck:
    """What is wrong with the inertials of a URDF file, and the repair.

    Units (g for kg, mm for m), signs and order of the products of inertia, inertia about the link's
    frame, mirrored links, missing inertials, and what no body can have. Meshes are not read: links
    whose geometry is not made of boxes, cylinders and spheres are judged by their joints and the
    other links alone.

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

    See Also
    --------
    identification.write_model

    Examples
    --------
    >>> from pathlib import Path
    >>> from plant import check_model
    >>> link = '<link name="arm"><inertial><mass value="-2"/></inertial></link>'
    >>> text = f'<robot name="r"><link name="base"/>{link}</robot>'
    >>> _ = Path("arm.urdf").write_text(text)
    >>> check_model("arm.urdf").ok
    False
    """
    robot, _ = parsed(path, "robot", "URDF")
    elements = {link.attributes.get("name", ""): link for link in robot.all("link")}
    links = {
        name: CheckedLink(
            name, _stated(element, name), shape_of(element), joint_places(robot, name)
        )
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
        finding = (
            _missing(link, links)
            if link.stated is None and name in moving
            else _judged(link, links)
        )
        if finding is not None:
            found[name] = finding
    for name in list(found):  # of two sides that differ, one is wrong
        other = partner_of(name, list(links))
        if (
            name in found
            and other in found
            and np.isfinite([found[name].evidence, found[other].evidence]).all()
        ):
            if found[name].mistake == found[other].mistake and _alike(links[name]):
                continue  # the same mistake in both
            del found[
                min((name, other), key=lambda each: _own_gain(links[each], found[each], links))
            ]
    return ModelCheck(path=Path(path), findings=tuple(found.values()))


def _alike(link: CheckedLink) -> bool:
    """Whether a link states what the other side states, mirrored."""
    own = link.stated
    return own is not None and any(
        agrees(own, mirrored(partner, plane)) for partner, plane in link.partners
    )


def _own_gain(link: CheckedLink, finding: ModelFinding, links: dict[str, CheckedLink]) -> float:
    """What speaks for a repair without the link on the other side."""
    alone = dataclasses.replace(link, partners=())
    if link.stated is None or finding.repair is None:
        return 0.0
    repaired = Stated(
        finding.repair.mass, finding.repair.com, np.eye(3), inertia_matrix(finding.repair.inertia)
    )
    return cost_of(link.stated, alone, links) - cost_of(repaired, alone, links)


def _stated(link: Element, name: str) -> Stated | None:
    """The inertial as it stands, without a judgement; None where there is none, or nothing in
    it.
    """
    inertial = link.find("inertial")
    if inertial is None:
        return None
    where = f"link {name}"
    pose = origin_of(inertial, f"link {name}")
    mass = numbers_of(inertial.find("mass"), "value", 1, "0", where)[0]
    entries = [numbers_of(inertial.find("inertia"), key, 1, "0", where)[0] for key in INERTIA]
    inertia = inertia_matrix(entries)
    if not mass and not inertia.any():
        return None
    return Stated(float(mass), np.array(pose.position), np.array(pose.rotation), inertia)


def _judged(link: CheckedLink, links: dict[str, CheckedLink]) -> ModelFinding | None:
    """The mistake that explains the inertial better than none, if there is one."""
    if link.stated is None:
        return None
    now = cost_of(link.stated, link, links)
    trials = [
        (cost_of(other, link, links) + _RARE, words, other)
        for words, other in without_mistakes(link.stated)
    ]
    best, words, other = min(trials, key=lambda trial: trial[0])
    exact = np.isfinite(best) and coincides(other, link)
    dense = link.stated.physical() and link.stated.density() > HEAVIEST
    if dense:
        left = [
            trial
            for trial in trials
            if np.isfinite(trial[0]) and not impossible(trial[2], link, links)
        ]
        best, words, other = min(left, key=lambda trial: trial[0], default=(np.inf, "", other))
        exact = bool(left) and coincides(other, link)
        trials = left or trials
    if dense or not link.stated.physical():
        sure = (
            exact or (np.isfinite(best) and words.startswith("a negative")) or only(trials, other)
        )
        mistake = (
            words if sure else "denser than any matter" if dense else "an inertia that no body has"
        )
        repair = body_of(other) if sure else guess(link, links)
        return ModelFinding(link=link.name, mistake=mistake, evidence=np.inf, repair=repair)
    proven = (exact and not coincides(link.stated, link)) or impossible(link.stated, link, links)
    counts = apart(link.stated, other) > _COUNTS and not impossible(other, link, links)
    if proven and counts and now - best > _MARGIN:
        return ModelFinding(
            link=link.name, mistake=words, evidence=now - best, repair=body_of(other)
        )
    return None


def _missing(link: CheckedLink, links: dict[str, CheckedLink]) -> ModelFinding | None:
    """A link that moves and has a shape, or a partner with an inertial, and no inertial of its
    own.
    """
    if link.shape is None and not link.partners:
        return None
    return ModelFinding(
        link=link.name, mistake="no inertial", evidence=np.inf, repair=guess(link, links)
    )
