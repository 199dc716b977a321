"""Mistakes in the inertials of a URDF file, found by what the file itself says: `check_model`.

Every inertial is compared with what it would be without each mistake that files have
(`hypotheses`). The evidence for one or the other (`agreement`): the link's own shape (its position,
width and density), the positions of its joints, the masses of the other links, and the link on the
other side. A mistake is a finding only with a proof: no body can have the stated inertial; none
within three times the link's shape can, or none within the robot; no matter is so dense; or the
inertial without the mistake is exactly the link on the other side, or exactly the shape uniformly
filled, which does not happen by chance.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from plant.mechanics.body import Body, inertia_matrix
from plant.mechanics.model_tree import MOVING
from plant.mechanics.urdf_file import INERTIA, origin_of
from plant.mechanics.xml_file import Element, numbers_of, parsed, spliced
from plant.models.agreement import (
    HEAVIEST,
    CheckedLink,
    Links,
    coincides,
    cost_of,
    distance,
    impossible,
    mirrored,
    same,
    uniform,
)
from plant.models.edits import urdf_inertial
from plant.models.hypotheses import (
    Inertial,
    joint_positions,
    mirrors,
    partner_of,
    shape_of,
    without_mistakes,
)
from plant.parts.arguments import known_options
from plant.parts.files import require_new, write_whole
from plant.parts.settings import frozen_settings
from plant.parts.shown import Piece, Shown, Verdict


@frozen_settings
class RepairSettings:
    """Evidence that a mistake or a repair needs [logarithms of odds], chosen by hand.

    ``tests/benchmarks/broken_models.py`` counts the broken files that are repaired, and the alarms
    on right ones.

    Parameters
    ----------
    rare : float
        Evidence against a mistake before the file is read: it is e^4 times rarer than none.
    margin : float
        Evidence that a mistake needs beside its proof.
    likely : float
        Evidence that a repair needs against the others, where no body can have what is stated.
    difference : float
        Relative difference of a link from its repair below which there is no finding: CAD models of
        two sides differ as much.
    """

    rare: float = 4.0
    margin: float = 6.0
    likely: float = 3.0
    difference: float = 0.006


SETTINGS = RepairSettings()


@dataclass(frozen=True, kw_only=True, repr=False)
class ModelFinding(Shown):
    """A mistake in the inertial of a link, and its repair in the link's frame, if one is certain.

    `evidence`: logarithm of the odds of the repair against the stated inertial; infinite where no
    body can have that.
    """

    link: str
    mistake: str
    evidence: float
    repair: Body | None

    def _short(self) -> str:
        return f"link {self.link}{', repaired' * (self.repair is not None)}"

    def _shown(self) -> Iterator[Piece]:
        repair = "no repair is certain"
        if self.repair is not None:
            repair = f"repaired: mass {self.repair.mass:.4g} kg"
        yield f"link {self.link}: {self.mistake}; {repair}"


@dataclass(frozen=True, kw_only=True, repr=False)
class ModelCheck(Shown):
    """The findings of `check_model` about a file."""

    path: Path
    findings: tuple[ModelFinding, ...]

    @property
    def ok(self) -> bool:
        """Whether there is no finding."""
        return not self.findings

    def _short(self) -> str:
        return f"{self.path.name}: {len(self.findings)} finding(s)"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(self._short(), self.ok)
        for finding in self.findings:
            yield from finding._shown()

    @known_options
    def write(self, target: str | Path, *, overwrite: bool = False) -> None:
        """Write a new file with the repairs; every other byte stays."""
        # Refuse the target before the file is read, and read the file anew: its bytes are edited.
        path = require_new(target, overwrite)
        robot, data = parsed(self.path, "robot", "URDF")
        links = {link.attributes.get("name", ""): link for link in robot.all("link")}
        edits = []
        for finding in self.findings:
            # A finding without a certain repair leaves the link as it is.
            if finding.repair is not None:
                edits += urdf_inertial(data, links[finding.link], finding.repair)
        write_whole(path, [spliced(data, edits)])


def check_model(path: str | Path) -> ModelCheck:
    """Find the mistakes in the inertials of a URDF file, and their repairs.

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
    # 1. What the file states of each link.
    links = _checked_links(robot)
    joints = [joint for joint in robot.all("joint") if joint.attributes.get("type") in MOVING]
    moving = {end.attributes.get("link") for joint in joints for end in joint.all("child")}
    # 2. Each link by itself, beside its partner.
    findings = {}
    for name, link in links.items():
        # A link that moves needs an inertial; a fixed one may do without.
        missing = link.stated is None and name in moving
        finding = _missing(link, links) if missing else _judged(link, links)
        if finding is not None:
            findings[name] = finding
    # 3. A mistake on one side makes the other side look wrong, too.
    _keep_one_side(findings, links)
    return ModelCheck(path=Path(path), findings=tuple(findings.values()))


def _checked_links(robot: Element) -> Links:
    """The links of a file by name, each with its partner on the other side."""
    links = {}
    for element in robot.all("link"):
        name = element.attributes.get("name", "")
        joints = joint_positions(robot, name)
        links[name] = CheckedLink(name, _stated(element, name), shape_of(element), joints)
    for name, link in links.items():
        # Partners need the links of the whole file, hence a second pass.
        partner_name = partner_of(name, list(links))
        if partner_name is None:
            continue
        partner = links[partner_name]
        if partner.stated is not None:
            planes = mirrors((link.shape, partner.shape), (link.joints, partner.joints))
            link.partners = [(partner.stated, plane) for plane in planes]
    return links


def _keep_one_side(findings: dict[str, ModelFinding], links: Links) -> None:
    """Of two sides that differ only one is wrong: remove the less likely finding."""
    for name in list(findings):
        partner = partner_of(name, list(links))
        if partner is None or name not in findings or partner not in findings:
            continue
        finding = findings[name]
        other_finding = findings[partner]
        # An impossible inertial is wrong whatever the other side states.
        if not np.isfinite([finding.evidence, other_finding.evidence]).all():
            continue
        if finding.mistake == other_finding.mistake and _alike(links[name]):
            continue  # the same mistake in both
        # The finding that the link alone supports less is the one to remove.
        gains = {side: _gain_alone(links[side], findings[side], links) for side in (name, partner)}
        del findings[min((name, partner), key=gains.__getitem__)]


def _alike(link: CheckedLink) -> bool:
    """Whether a link states what the other side states, mirrored."""
    stated = link.stated
    return stated is not None and any(
        same(stated, mirrored(partner, plane)) for partner, plane in link.partners
    )


def _gain_alone(link: CheckedLink, finding: ModelFinding, links: Links) -> float:
    """Evidence for a repair without the link on the other side."""
    # The other side is what is in question.
    alone = replace(link, partners=())
    body = finding.repair
    if link.stated is None or body is None:
        return 0.0
    repaired = Inertial(body.mass, body.com, np.eye(3), inertia_matrix(body.inertia))
    return cost_of(link.stated, alone, links) - cost_of(repaired, alone, links)


def _stated(link: Element, name: str) -> Inertial | None:
    """The inertial as it stands, without a judgement; None if there is none, or it is empty."""
    element = link.find("inertial")
    if element is None:
        return None
    label = f"link {name}"
    pose = origin_of(element, label)
    mass = numbers_of(element.find("mass"), "value", 1, "0", label)[0]
    entries = [numbers_of(element.find("inertia"), key, 1, "0", label)[0] for key in INERTIA]
    inertia = inertia_matrix(entries)
    # Exporters write empty inertials for links without a mass.
    if not mass and not inertia.any():
        return None
    return Inertial(float(mass), np.array(pose.position), np.array(pose.rotation), inertia)


class _Trial(NamedTuple):
    """An inertial without a mistake: its cost with the rarity of the mistake, and its name."""

    cost: float
    mistake: str
    inertial: Inertial


def _judged(link: CheckedLink, links: Links) -> ModelFinding | None:
    """The mistake that explains the inertial better than none, if there is one with a proof."""
    stated = link.stated
    if stated is None:
        return None
    trials = [
        # Any mistake competes with none, which is more frequent.
        _Trial(cost_of(inertial, link, links) + SETTINGS.rare, mistake, inertial)
        for mistake, inertial in without_mistakes(stated)
    ]
    if not stated.physical() or stated.density() > HEAVIEST:
        return _impossible(link, links, trials)
    best = min(trials, key=lambda trial: trial.cost)
    # A proof, a visible difference and a possible repair: evidence alone names no mistake, since
    # weights of evidence are rough.
    exact = np.isfinite(best.cost) and coincides(best.inertial, link)
    proven = (exact and not coincides(stated, link)) or impossible(stated, link, links)
    differs = distance(stated, best.inertial) > SETTINGS.difference
    evidence = cost_of(stated, link, links) - best.cost
    if not proven or not differs or impossible(best.inertial, link, links):
        return None
    if evidence <= SETTINGS.margin:
        return None
    repair = _body(best.inertial)
    return ModelFinding(link=link.name, mistake=best.mistake, evidence=evidence, repair=repair)


def _impossible(link: CheckedLink, links: Links, trials: list[_Trial]) -> ModelFinding:
    """The finding about an inertial that no body has: which mistake it is, if that is certain."""
    best = min(trials, key=lambda trial: trial.cost)
    possible = np.isfinite(best.cost)
    mistake = "an inertia that no body has"
    if link.stated is not None and link.stated.physical():
        # Only too dense: of the mistakes, those count that leave a possible body.
        mistake = "denser than any matter"
        remaining = [
            trial
            for trial in trials
            if np.isfinite(trial.cost) and not impossible(trial.inertial, link, links)
        ]
        possible = len(remaining) > 0
        trials = remaining or trials
        # If every mistake leaves a body that is too dense, none of them has a name.
        no_mistake = _Trial(np.inf, "", best.inertial)
        best = min(remaining, key=lambda trial: trial.cost, default=no_mistake)
    # A negative number is its own proof; otherwise the repair must be exact or far ahead.
    exact = possible and coincides(best.inertial, link)
    negative = possible and best.mistake.startswith("a negative")
    certain = exact or negative or _unrivalled(trials, best.inertial)
    return ModelFinding(
        link=link.name,
        mistake=best.mistake if certain else mistake,
        evidence=np.inf,
        repair=_body(best.inertial) if certain else _guess(link, links),
    )


def _unrivalled(trials: list[_Trial], best: Inertial) -> bool:
    """Whether all other bodies that one mistake leaves agree with the file much less."""
    # Several mistakes may leave the same body.
    costs = [
        trial.cost
        for trial in trials
        if not np.allclose(trial.inertial.spread, best.spread, rtol=1e-3, atol=0)
    ]
    # The distance in costs is the logarithm of the odds.
    least = min(trial.cost for trial in trials)
    return bool(np.isfinite(least) and min(costs, default=np.inf) - least > SETTINGS.likely)


def _missing(link: CheckedLink, links: Links) -> ModelFinding | None:
    """The finding about a link with a shape or a partner, and without an inertial."""
    # Without a shape or a partner the link may be a frame, which has no mass.
    if link.shape is None and not link.partners:
        return None
    return ModelFinding(
        link=link.name, mistake="no inertial", evidence=np.inf, repair=_guess(link, links)
    )


def _guess(link: CheckedLink, links: Links) -> Body | None:
    """The partner's body mirrored; or the link's shape filled, if all others are filled alike."""
    for partner, plane in link.partners:
        if partner.physical():
            # The link on the other side is better evidence than any density.
            return _body(mirrored(partner, plane))
    densities = []
    for one in links.values():
        if one is link or one.stated is None or one.shape is None:
            continue
        # One link that is not filled makes the density of this one a guess.
        if not uniform(one.stated, one.shape):
            return None
        densities.append(one.stated.mass / one.shape.volume)
    # One link alone is no rule of the file.
    if link.shape is None or len(densities) < 2 or np.ptp(densities) >= 0.01 * min(densities):
        return None
    mass = float(np.median(densities)) * link.shape.volume
    spread = mass * link.shape.spread
    inertia = np.trace(spread) * np.eye(3) - spread
    return _body(Inertial(mass, link.shape.centre, np.eye(3), inertia))


def _body(inertial: Inertial) -> Body:
    """The body of an inertial, in the link's frame."""
    # A body has the axes of its link: Ixx, Ixy, Ixz, Iyy, Iyz, Izz.
    in_link = inertial.rotation @ inertial.inertia @ inertial.rotation.T
    return Body(mass=inertial.mass, com=inertial.com, inertia=in_link[np.triu_indices(3)])
