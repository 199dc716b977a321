"""Mistakes in the inertials of a URDF file, found by what the file itself says: `check_model`.

The check compares every inertial with what it would be without each mistake that files have
(`hypotheses`). The evidence for one or the other (`agreement`) is the link's own shape (its
position, width and density), the positions of its joints, the masses of the other links, and the
link on the other side. Missing inertials, placeholders, and the mass of the whole robot on one link
are findings by themselves. Any other mistake of an inertial that can be read is a finding only with
a proof: no body can have the stated inertial; none
within three times the link's shape can, or none within the robot; no matter is so dense; or the
inertial without the mistake is exactly the link on the other side, or exactly the shape uniformly
filled, which does not happen by chance.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from plant.mechanics import (
    INERTIA,
    MOVING,
    Body,
    Element,
    deferred,
    expanded,
    inertia_matrix,
    is_xacro,
    numbers_of,
    origin_of,
    parsed,
    spliced,
)
from plant.models.agreement import (
    NO_BODY,
    STEEL,
    CheckedLink,
    Links,
    coincides,
    cost_of,
    distance,
    impossible,
    lacks_products,
    mirrored,
    proof_of,
    thinner,
    uniform,
    zero,
)
from plant.models.edits import urdf_inertial
from plant.models.hypotheses import (
    DECIMAL_POINT,
    PARALLEL_AXIS,
    Inertial,
    joint_positions,
    mirrors,
    partner_of,
    primitive,
    shape_of,
    symmetric,
    ways,
    without_mistakes,
)
from plant.models.joints_stated import mistakes_of_joints
from plant.parts import (
    Piece,
    Shown,
    Verdict,
    frozen_settings,
    known_options,
    require_new,
    write_whole,
)


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
        Evidence that a repair needs against every other one: odds of e^4.
    difference : float
        Relative difference of a link from its repair below which there is no finding: CAD models of
        two sides differ as much.
    alike : float
        Relative difference up to which inertias that the other side leaves open are one.
    negligible : float
        Share of the file's larger masses and inertias (the upper tenth) below which a link
        does no harm.
    heavy : tuple of float
        A link has the mass of the whole robot if the ratio of its mass to that of all other links
        is between these: least, most.
    denser : float
        Least ratio of such a link's density to the median of the others; the density of steel is
        always enough.
    """

    rare: float = 4.0
    margin: float = 6.0
    likely: float = 4.0
    difference: float = 0.006
    alike: float = 0.03
    negligible: float = 1e-3
    heavy: tuple[float, float] = (0.97, 1.5)
    denser: float = 3.0


SETTINGS = RepairSettings()


@dataclass(frozen=True, kw_only=True, repr=False)
class ModelFinding(Shown):
    """A mistake in the inertial of a link, and its repair in the link's frame, if one is certain.

    `evidence`: logarithm of the odds of the repair against the stated inertial; where these odds
    are not computed, it is infinite or `RepairSettings.margin`. `joint`: the joint that carries the
    link, if the mistake is in the joint's numbers.
    """

    link: str
    mistake: str
    evidence: float
    repair: Body | None
    joint: str = ""

    def _short(self) -> str:
        return f"link {self.link}{', repaired' * (self.repair is not None)}"

    def _shown(self) -> Iterator[Piece]:
        repair = "no repair is certain"
        if self.repair is not None:
            repair = f"repaired: mass {self.repair.mass:.4g} kg"
        place = f"joint {self.joint}" if self.joint else f"link {self.link}"
        yield f"{place}: {self.mistake}; {repair}"


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
        if is_xacro(robot):
            raise ValueError(f"path must be a URDF file; {self.path} is xacro. Expand it first.")
        links = {link.attributes.get("name", ""): link for link in robot.all("link")}
        edits = []
        for finding in self.findings:
            # A finding without a certain repair leaves the link as it is.
            if finding.repair is not None:
                edits += urdf_inertial(data, links[finding.link], finding.repair)
        write_whole(path, [spliced(data, edits)])


def check_model(path: str | Path) -> ModelCheck:
    """Find the mistakes in the inertials and joints of a URDF file, and repairs of inertials.

    The check finds wrong units (g for kg, mm for m, degrees), wrong signs and order of the products
    of inertia, inertia about the link's frame, wrongly mirrored links, missing inertials,
    placeholders, the mass of the whole robot on one link, and inertials that no body can have. A
    mistake in stated numbers has a repair only if it explains all that the file states of the link,
    and every other mistake is more than e^4 times less likely. The repair of a missing or zero
    inertial is that of the link on the other side, or that of the filled shape. Meshes are
    not read: links whose geometry is not made of boxes, cylinders and spheres are judged by their
    joints and the other links alone.

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
        A file that is malformed, too large, or declares entities; xacro without its expander.

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
    if is_xacro(robot):
        # The expansion is judged; only a plain file can be written back.
        robot, _ = parsed(path, "robot", "URDF", expanded(Path(path)))
    # 1. What the file states of each link, and what of it cannot be read.
    links, unread = _checked_links(robot)
    joints = [joint for joint in robot.all("joint") if joint.attributes.get("type") in MOVING]
    moving = {end.attributes.get("link", "") for joint in joints for end in joint.all("child")}
    # 2. Each link by itself, beside its partner.
    placeholders = _placeholders(links)
    findings: dict[str, ModelFinding] = {}
    for name, link in links.items():
        if name in placeholders or name in unread or _negligible(link, links):
            continue
        # A link that moves needs an inertial; a fixed one may do without.
        missing = link.stated is None and name in moving
        finding = _missing(link, links) if missing else None
        finding = finding or _of_all(link, links, moving) or _judged(link, links)
        if finding is not None:
            findings[name] = finding
    # 3. A mistake on one side makes the other side look wrong, too; one mistake in several links
    # explains them all.
    _keep_one_side(findings, links)
    _name_common(findings, links)
    # Placeholders and unreadable links were not judged above, so no finding is replaced.
    findings |= placeholders | {
        name: _unrepaired(name, why, np.inf) for name, why in unread.items()
    }
    of_joints = [
        ModelFinding(link=link, mistake=mistake, evidence=np.inf, repair=None, joint=joint)
        for link, joint, mistake in mistakes_of_joints(robot)
    ]
    # In the order of the file.
    of_links = [findings[name] for name in links if name in findings]
    return ModelCheck(path=Path(path), findings=(*of_links, *of_joints))


def _unrepaired(link: str, mistake: str, evidence: float) -> ModelFinding:
    return ModelFinding(link=link, mistake=mistake, evidence=evidence, repair=None)


def _checked_links(robot: Element) -> tuple[Links, dict[str, str]]:
    """The links of a file by name, each with its partner on the other side; what is unreadable."""
    links = Links()
    joints = joint_positions(robot)
    unread: dict[str, str] = {}
    for element in robot.all("link"):
        name = element.attributes.get("name", "")
        # One link that cannot be read must not hide the mistakes of the others.
        stated, reason = deferred(None, _stated, element, name)
        if reason:
            unread[name] = reason
        shape, _ = deferred(None, shape_of, element)
        # A link with a geometry, of whatever kind, is a thing that weighs.
        formed = any(element.find(tag) is not None for tag in ("visual", "collision"))
        whole = all(primitive(visual) for visual in element.all("visual"))
        links[name] = CheckedLink(
            name, stated, shape, joints.get(name, np.empty((0, 3))), formed=formed, whole=whole
        )
    for name, way in ways(robot).items():
        if name in links:
            links[name].way = way
    # A link that no body can be is no evidence about the other side.
    sound = {name for name, link in links.items() if not proof_of(link, links)}
    for name, link in links.items():
        # Partners need the links of the whole file, hence a second pass.
        partner_name = partner_of(name, links)
        if partner_name is None:
            continue
        partner = links[partner_name]
        if partner.stated is not None and partner_name in sound:
            motions = mirrors((link.shape, partner.shape), (link.joints, partner.joints))
            link.partners = [(partner.stated, motion) for motion in motions]
    return links, unread


def _keep_one_side(findings: dict[str, ModelFinding], links: Links) -> None:
    """Of two sides that differ only one is wrong: remove the less likely finding."""
    for name in list(findings):
        partner = partner_of(name, links)
        if partner is None or name not in findings or partner not in findings:
            continue
        # What has a proof of its own, or no inertial, is wrong whatever the other side states.
        sides = (links[name], links[partner])
        if any(link.stated is None or proof_of(link, links) for link in sides):
            continue
        # The finding that the link alone supports less is the one to remove. Without clear evidence
        # for one of them the two differ, and neither is repaired.
        gains = {side: _gain_alone(links[side], findings[side], links) for side in (name, partner)}
        less, more = sorted((name, partner), key=gains.__getitem__)
        del findings[less]
        if gains[more] - gains[less] < SETTINGS.likely:
            mistake = f"{findings[more].mistake}, here or in {less}"
            findings[more] = _unrepaired(more, mistake, findings[more].evidence)


def _name_common(findings: dict[str, ModelFinding], links: Links) -> None:
    """Name the one mistake that explains all links that no body can be, if there is one."""
    open_links = [
        name
        for name, finding in findings.items()
        if finding.repair is None and finding.mistake == NO_BODY
    ]
    # Copies of a link, and the two sides of a robot, come from one macro and are one witness.
    # They differ in signs at most.
    witnesses = {np.abs(links.stated[name].inertia).tobytes() for name in open_links}
    if len(witnesses) < 2:
        return
    explained = [{trial.mistake for trial in _possible(links[name], links)} for name in open_links]
    common = set.intersection(*explained)
    if len(common) == 1:
        mistake = f"{common.pop()}, as in {len(open_links)} links"
        for name in open_links:
            findings[name] = _unrepaired(name, mistake, findings[name].evidence)


def _gain_alone(link: CheckedLink, finding: ModelFinding, links: Links) -> float:
    """Evidence for a repair without the link on the other side."""
    # The other side is what is in question.
    alone = replace(link, partners=())
    body = finding.repair
    if link.stated is None or body is None:
        return 0.0
    # A repair is in the axes of its link: no rotation.
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
    """An inertial with one mistake undone; `cost` includes the rarity of that mistake."""

    cost: float
    mistake: str
    inertial: Inertial


def _possible(link: CheckedLink, links: Links) -> list[_Trial]:
    """The inertials without one mistake that a link can have, with their costs."""
    trials = []
    stated = link.stated
    # Zeros say nothing about what they should be.
    if stated is None or zero(stated):
        return []
    for mistake, inertial in without_mistakes(stated):
        # The parallel-axis term can be added to any inertial. Only an inertial that became negative
        # shows that somebody subtracted the term.
        if mistake == PARALLEL_AXIS and (links.signs_explain or np.isfinite(stated.excess())):
            continue
        # Any mistake competes with none, which is more frequent.
        cost = cost_of(inertial, link, links) + SETTINGS.rare
        # A shape of which a mesh shows more excludes no candidate.
        alone = not link.whole
        sound = np.isfinite(cost) and not impossible(inertial, link, links, alone=alone)
        if sound and not thinner(inertial, link.shape):
            trials.append(_Trial(cost, mistake, inertial))
    return trials


def _judged(link: CheckedLink, links: Links) -> ModelFinding | None:
    """The mistake that explains the inertial better than none, if there is one with a proof."""
    stated = link.stated
    if stated is None:
        return None
    proof = proof_of(link, links)
    trials = _possible(link, links)
    best = _best(trials, stated)
    exact = best is not None and coincides(best.inertial, link)
    certain = best is not None and (
        _unrivalled(trials, best)
        and best.cost - SETTINGS.rare <= links.usual
        and cost_of(stated, link, links) > best.cost
        and (exact or not _open(best, proof))
    )
    if proof:
        if best is not None and certain:
            evidence = cost_of(stated, link, links) - best.cost
            return ModelFinding(
                link=link.name,
                mistake=best.mistake,
                evidence=evidence,
                repair=_body(best.inertial),
            )
        # A stated number that no mistake explains contradicts the other side, too. So only zeros
        # are replaced.
        guess = _guess(link, links) if zero(stated) else None
        return ModelFinding(link=link.name, mistake=proof, evidence=np.inf, repair=guess)
    # A repair that is exactly the other side, or the filled shape, is a proof by itself. A stated
    # inertial that is `impossible` among the other links is a proof only with a certain repair.
    exact = exact and not coincides(stated, link)
    if best is None or not (exact or (certain and impossible(stated, link, links))):
        return None
    evidence = cost_of(stated, link, links) - best.cost
    if evidence <= SETTINGS.margin or distance(stated, best.inertial) <= SETTINGS.difference:
        return None
    repair = _body(best.inertial) if certain else None
    return ModelFinding(link=link.name, mistake=best.mistake, evidence=evidence, repair=repair)


def _best(trials: list[_Trial], stated: Inertial) -> _Trial | None:
    """The likeliest body; of mistakes that leave the same one, that which changes fewest numbers.

    Products that are too small to tell two mistakes apart keep the signs that the file states.
    """
    best = min(trials, key=lambda trial: trial.cost, default=None)
    if best is None:
        return None
    alike = [
        trial for trial in trials if _same(trial, best) and trial.cost - best.cost < SETTINGS.likely
    ]

    def changed(trial: _Trial) -> tuple[int, float]:
        one = trial.inertial
        parts = ((one.inertia, stated.inertia), (one.com, stated.com), (one.mass, stated.mass))
        return sum(int(np.sum(np.not_equal(a, b))) for a, b in parts), trial.cost

    return min(alike, key=changed)


def _same(trial: _Trial, other: _Trial) -> bool:
    """Whether two mistakes leave one body, as far as numbers of files tell bodies apart."""
    return distance(trial.inertial, other.inertial) <= 1e-3


def _open(best: _Trial, proof: str) -> bool:
    """Whether a mistake leaves open which number is wrong, or what the right number is.

    If moments violate the triangle inequality, any of them may be wrong; if an inertia is too small
    for its centre of mass, either of the two may be wrong. A misplaced decimal point explains many
    numbers, unless the file states the right one twice.
    """
    if "triangle" in proof or best.mistake == PARALLEL_AXIS:
        return True
    return best.mistake == DECIMAL_POINT and not symmetric(best.inertial)


def _unrivalled(trials: list[_Trial], best: _Trial) -> bool:
    """Whether all other bodies that one mistake leaves agree with the file much less."""
    # Several mistakes may leave the same body. The distance in costs is the logarithm of the odds.
    rivals = [trial.cost for trial in trials if not _same(trial, best)]
    return min(rivals, default=np.inf) - best.cost > SETTINGS.likely


def _placeholders(links: Links) -> dict[str, ModelFinding]:
    """Findings about inertias that nobody computed: a power of ten, or the same in all links."""
    stated = {name: link.stated for name, link in links.items() if link.stated is not None}
    findings = {}
    for name, inertial in stated.items():
        link = links[name]
        if (
            inertial.placeholder()
            and not _negligible(link, links)
            and not uniform(inertial, link.shape)
        ):
            # All three moments are the same: one stands for them.
            moment = inertial.inertia[0, 0]
            text = f"a placeholder for the inertia ({moment:.3g} kg m^2 about every axis)"
            evidence = np.inf if proof_of(links[name], links) else SETTINGS.margin
            findings[name] = _unrepaired(name, text, evidence)
    # Links of different masses have different inertias.
    masses = {inertial.mass for inertial in stated.values()}
    inertias = {tuple(inertial.inertia.ravel()) for inertial in stated.values()}
    if len(stated) >= 3 and len(masses) >= 3 and len(inertias) == 1:
        text = f"a placeholder for the inertia (the same in all {len(stated)} links)"
        for name in stated:
            findings.setdefault(name, _unrepaired(name, text, SETTINGS.margin))
    return findings


def _negligible(link: CheckedLink, links: Links) -> bool:
    """Whether a link hardly weighs: many files have such ones for the sake of simulators."""
    if link.stated is None:
        return False
    # Half of a file may be such links, so that the scale is the file's larger masses and inertias.
    # Relative to them, the size of the robot does not matter.
    heavy, large = links.larger
    light = abs(link.stated.mass) <= SETTINGS.negligible * heavy
    return bool(light and link.stated.about_joint() <= SETTINGS.negligible * large)


def _of_all(link: CheckedLink, links: Links, moving: Collection[str]) -> ModelFinding | None:
    """The finding about a link with the mass of the whole robot, and an inertia of its own."""
    stated = link.stated
    if stated is None or link.name not in moving or not stated.physical():
        return None
    others = [inertial for name, inertial in links.stated.items() if name != link.name]
    # Magnitudes: a negative mass elsewhere is a mistake of its own.
    total = sum(abs(other.mass) for other in others)
    least, most = SETTINGS.heavy
    if len(others) < 3 or not least * total < stated.mass < most * total:
        return None
    densities = [other.density() for other in others if other.physical()]
    density = float(np.median(densities)) if densities else STEEL
    if stated.density() < min(STEEL, SETTINGS.denser * density):
        return None
    text = f"the mass of the whole robot ({stated.mass:.3g} kg; all others have {total:.3g} kg)"
    return _unrepaired(link.name, text, SETTINGS.margin)


def _missing(link: CheckedLink, links: Links) -> ModelFinding | None:
    """The finding about a link with a geometry or a partner, and without an inertial."""
    # Without them the link may be a frame, which has no mass.
    if not link.formed and not link.partners:
        return None
    return ModelFinding(
        link=link.name, mistake="no inertial", evidence=np.inf, repair=_guess(link, links)
    )


def _guess(link: CheckedLink, links: Links) -> Body | None:
    """The partner's inertia after the motion that the link states; or that of the filled shape.

    The shape is filled if all other links of the file are filled alike. What the link states of
    mass and centre stays: a body that does not have it is no repair.
    """
    stated = link.stated
    bodies = [mirrored(partner, motion) for partner, motion in link.partners if partner.physical()]
    if stated is not None:
        bodies = [body for body in bodies if _same_place(body, stated)]
    # The other side may lack what this side had.
    bodies = [body for body in bodies if not lacks_products(body, link, links)]
    filled = _filled(link, links)
    if not bodies and filled is not None and (stated is None or _same_place(filled, stated)):
        bodies = [filled]
    if not bodies:
        return None
    # Motions that differ in small products alone leave these open: they are zero on average.
    inertias = np.array([body.rotation @ body.inertia @ body.rotation.T for body in bodies])
    mean = inertias.mean(axis=0)
    if np.abs(inertias - mean).max() > SETTINGS.alike * np.abs(mean).max():
        return None
    if stated is None and np.ptp([body.com for body in bodies], axis=0).max() > 0:
        return None
    mass, com = (bodies[0].mass, bodies[0].com) if stated is None else (stated.mass, stated.com)
    return _body(Inertial(mass, com, np.eye(3), mean))


def _same_place(body: Inertial, stated: Inertial) -> bool:
    """Whether a body has the stated mass, and its centre where it is stated."""
    if abs(stated.mass - body.mass) > SETTINGS.difference * body.mass:
        return False
    size = float(np.sqrt(np.trace(body.spread) / body.mass))
    return bool(np.linalg.norm(stated.com - body.com) < SETTINGS.difference * size)


def _filled(link: CheckedLink, links: Links) -> Inertial | None:
    """The link's shape filled, if all others are filled alike."""
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
    # The median, since files round masses to a few digits.
    mass = float(np.median(densities)) * link.shape.volume
    spread = mass * link.shape.spread
    inertia = np.trace(spread) * np.eye(3) - spread
    return Inertial(mass, link.shape.centre, np.eye(3), inertia)


def _body(inertial: Inertial) -> Body:
    """The body of an inertial, in the link's frame."""
    # A body has the axes of its link: Ixx, Ixy, Ixz, Iyy, Iyz, Izz.
    in_link = inertial.rotation @ inertial.inertia @ inertial.rotation.T
    return Body(mass=inertial.mass, com=inertial.com, inertia=in_link[np.triu_indices(3)])
