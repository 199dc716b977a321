"""How well an inertial agrees with the rest of a model file; what is impossible or exact in it.

The costs are negative logarithms of likelihoods: a difference of 6 means odds of e^6.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plant.mechanics import SLIP
from plant.models.hypotheses import Inertial, Shape, without_mistakes
from plant.parts import Floats, frozen_settings

HEAVIEST = 23000.0
"""Density [kg/m^3] of nothing that links are made of: above that of osmium."""

STEEL = 8000.0
"""Density [kg/m^3] that no whole link has."""


@frozen_settings
class AgreementSettings:
    """Weights of the evidence for an inertial, chosen by hand.

    ``tests/benchmarks/broken_models.py`` counts the broken files that are repaired with them.

    Parameters
    ----------
    density, density_factor : float
        Usual density [kg/m^3] of a link over the volume of its primitives, and the factor of one
        standard deviation of its logarithm.
    lightest : float
        Density [kg/m^3] below which nothing is a link.
    slack : float
        A link may be ``1 + 2 * slack`` times as large as its shape in the file.
    slack_of_proof : float
        The same for a proof beside a repair, since shapes for collisions leave parts out.
    slack_alone : float
        The same for a proof without a repair: nine times, since some files give the balls under
        a foot as the shape of the foot.
    thinnest : float
        Least share of its shape's second moments (their trace) that a link may have after a
        repair; motors in a shell have a third.
    smallest : float
        Radius of gyration [m] that any link may have.
    farthest : float
        Distance of a centre of mass from the joint [m] that any link may have.
    faithful : int
        Links that have to fit their shapes before shapes are taken for the links themselves.
    outside : float
        Cost of a body that needs more than the slack.
    same : float
        Relative difference of two inertials that are the same.
    uniform : float
        Relative difference from a uniformly filled shape.
    coincidence : float
        Gain of an inertial that is exactly its partner's, or its shape's.
    apart : float
        Cost of a relative difference of 1 from the link on the other side.
    usual : float
        Limit for the cost of a repair; the costs of the links without a proof may raise it.
    unusual : float
        Largest value of that limit: dummy shapes give every link of a file a high cost.
    rounding : float
        Share by which moments may miss the triangle inequality without a finding.
    dust : float
        Radius of gyration [m] below which the inertia is zero.
    signs : int
        Least number of links with negative moments that turned signs explain by more than chance:
        3^-4 are odds of e^-4.4.
    cap : float
        Largest value of one piece of evidence, before its weight in the cost.
    """

    density: float = 1500.0
    density_factor: float = 1.2
    lightest: float = 1.0
    slack: float = 0.05
    slack_of_proof: float = 1.0
    slack_alone: float = 4.0
    thinnest: float = 0.1
    smallest: float = 0.3
    farthest: float = 1.0
    faithful: int = 3
    outside: float = 15.0
    same: float = 1e-4
    uniform: float = 2e-3
    coincidence: float = 15.0
    apart: float = 20.0
    usual: float = 6.0
    unusual: float = 15.0
    rounding: float = 1e-3
    dust: float = 1e-5
    signs: int = 4
    cap: float = 40.0


SETTINGS = AgreementSettings()


@dataclass
class CheckedLink:
    """A link: its inertial in the file (or None), its shape, its joints and its partners.

    `joints` (k, 3) are the positions of the joints that it carries, from its own joint. A partner
    is the inertial of the link on the other side, with the reflection or rotation onto this link.
    """

    name: str
    stated: Inertial | None
    shape: Shape | None
    joints: Floats
    partners: Sequence[tuple[Inertial, Floats]] = ()
    way: float = 0.0
    """Sum of the lengths of the links from the base to this one [m]."""
    formed: bool = False
    """Whether the file has a geometry of the link."""
    whole: bool = True
    """Whether no mesh shows more of the link than its shape."""


class Links(dict[str, CheckedLink]):
    """The links of a file by name, and what they say together.

    Each property is computed once, so all links must be added before.
    """

    @cached_property
    def stated(self) -> dict[str, Inertial]:
        """The inertials that the file states."""
        return {name: link.stated for name, link in self.items() if link.stated is not None}

    @cached_property
    def masses(self) -> Floats:
        """Magnitudes of the masses, sorted [kg]."""
        # Magnitudes: a negative mass is a slip of the sign, not of the size.
        return np.sort([abs(inertial.mass) for inertial in self.stated.values()])

    @cached_property
    def larger(self) -> tuple[float, float]:
        """Mass and inertia that the upper tenth of the links exceeds."""
        # About the joint, since an inertia about the centre hides a distant mass.
        sizes = [inertial.about_joint() for inertial in self.stated.values()]
        return float(np.quantile(self.masses, 0.9)), float(np.quantile(sizes, 0.9))

    @cached_property
    def reach(self) -> float:
        """The longest distance of a carried joint from its link's own joint [m]; 0.1 m if none."""
        return max((_length(link) for link in self.values() if len(link.joints)), default=0.1)

    @cached_property
    def way(self) -> float:
        """The longest way from the base to a joint, from joint to joint [m]."""
        return max(link.way for link in self.values())

    @cached_property
    def without_products(self) -> bool:
        """Whether most links state no products of inertia, so that zeros say nothing of one."""
        # Products with an axis of symmetry are zero; a file without any leaves them out.
        stating = [one for one in self.stated.values() if one.spread[np.triu_indices(3, 1)].any()]
        return 2 * len(stating) < len(self.stated)

    @cached_property
    def fits(self) -> dict[str, bool]:
        """Whether each link that has a shape and an inertial fits into its shape."""
        return {
            # What no body has does not fit either, and says nothing of the others.
            name: inertial.physical()
            and shape.holds(inertial.com, inertial.spread / inertial.mass, SETTINGS.slack)
            for name, inertial in self.stated.items()
            if (shape := self[name].shape) is not None
        }

    @cached_property
    def usual(self) -> float:
        """Cost up to which the inertials without a proof against them agree with the file."""
        costs = [
            cost_of(inertial, self[name], self)
            for name, inertial in self.stated.items()
            if not proof_of(self[name], self)
        ]
        finite = [cost for cost in costs if np.isfinite(cost)]
        usual = float(np.quantile(finite, 0.9)) if finite else 0.0
        return min(max(SETTINGS.usual, usual), SETTINGS.unusual)

    @cached_property
    def signs_explain(self) -> bool:
        """Whether at least `signs` links have negative moments, and turned signs repair them all.

        If the moments have another cause, turned signs repair one link of three by chance.
        """
        negative = [one for one in self.stated.values() if (np.diag(one.inertia) < 0).any()]
        # All of them: one that stays impossible shows another cause.
        turned = [dict(without_mistakes(one))["a negative moment of inertia"] for one in negative]
        return len(turned) >= SETTINGS.signs and all(one.physical() for one in turned)


def mirrored(inertial: Inertial, motion: Floats) -> Inertial:
    """The inertial after a rotation or a reflection."""
    in_link = inertial.rotation @ inertial.inertia @ inertial.rotation.T
    return Inertial(inertial.mass, motion @ inertial.com, np.eye(3), motion @ in_link @ motion.T)


def thinner(inertial: Inertial, shape: Shape | None) -> bool:
    """Whether a body is much thinner than its shape."""
    if shape is None:
        return False
    return bool(
        # The trace has no direction: a plate is no thinner than its shape because it is flat.
        np.trace(inertial.spread / inertial.mass) < SETTINGS.thinnest * np.trace(shape.spread)
    )


def coincides(inertial: Inertial, link: CheckedLink) -> bool:
    """Whether an inertial is exactly that of the other side, or of the shape uniformly filled."""
    for partner, plane in link.partners:
        # A partner with a mistake of its own is no evidence.
        if partner.physical() and same(inertial, mirrored(partner, plane)):
            return True
    return uniform(inertial, link.shape)


def same(inertial: Inertial, reference: Inertial) -> bool:
    """Whether two inertials are the same."""
    return distance(inertial, reference) < SETTINGS.same


def uniform(inertial: Inertial, shape: Shape | None) -> bool:
    """Whether an inertial is that of the shape uniformly filled."""
    if shape is None:
        return False
    # Relative to the size of the shape.
    size = float(np.trace(shape.spread))
    off = np.abs(inertial.spread / inertial.mass - shape.spread).max()
    shift = np.linalg.norm(inertial.com - shape.centre)
    return bool(off < SETTINGS.uniform * size and shift < SETTINGS.uniform * np.sqrt(size))


def lacks_products(inertial: Inertial, link: CheckedLink, links: Links) -> bool:
    """Whether products of inertia were left out, in a file that states those of most links.

    A body beside its axes has none by chance only, unless it is its shape, filled.
    """
    if links.without_products or inertial.spread[np.triu_indices(3, 1)].any():
        return False
    # Two coordinates of the centre at least: with one the body may be symmetric about an axis.
    beside = np.count_nonzero(np.abs(inertial.com) > SETTINGS.dust) >= 2
    return bool(beside) and not uniform(inertial, link.shape)


def impossible(inertial: Inertial, link: CheckedLink, links: Links, *, alone: bool = False) -> bool:
    """Whether no body within the robot, or within the link's shape, can have this inertial.

    A link may be three times as large as its shape, since shapes for collisions leave parts out.
    It may be hardly larger if all other links with a shape and an inertial (at least `faithful`)
    fit their shapes. With `alone` there is no other evidence: the link may be nine times as large,
    and its shape is ignored unless the link is `whole`.
    """
    spread = inertial.spread / inertial.mass
    # No matter is so dense: that needs no shape.
    if inertial.density() > HEAVIEST:
        return True
    if link.shape is None or (alone and not link.whole):
        # Without a shape a link is no wider than the longest one of the robot, or half of the
        # longest way through it; and its mass is not farther away than that way.
        longest = links.reach
        if not links.way:
            return False
        width = float(np.sqrt(np.trace(spread)))
        too_wide = width > max(SETTINGS.smallest, longest, links.way / 2)
        far = max(SETTINGS.farthest, links.way)
        return too_wide or bool(np.linalg.norm(inertial.com) > far)
    slack = SETTINGS.slack_alone if alone else _slack(link, links)
    # All of the link is in the larger shape.
    volume = link.shape.volume * (1 + 2 * slack) ** 3
    if inertial.mass < SETTINGS.lightest * link.shape.volume or inertial.mass > HEAVIEST * volume:
        return True
    return not link.shape.holds(inertial.com, spread, slack)


NO_BODY = "an inertia that no body has"
"""What is said of a link whose inertia is impossible by itself."""


def proof_of(link: CheckedLink, links: Links) -> str:
    """Why no link can have the stated inertial, in words; empty if one can."""
    stated = link.stated
    if stated is None:
        return ""
    if not stated.mass > 0:
        return "no mass" if not stated.mass else "a negative mass"
    if zero(stated):
        return "no inertia"
    if not stated.physical():
        excess = stated.excess()
        if excess > SLIP:
            return NO_BODY
        # Below this, numbers of few digits are rounded.
        if excess > SETTINGS.rounding:
            return f"an inertia that misses the triangle inequality by {100 * excess:.2g} %"
    if stated.density() > HEAVIEST:
        return "denser than any matter"
    if impossible(stated, link, links, alone=True):
        # Any of the three may be the wrong one.
        size = float(np.sqrt(np.trace(stated.spread) / stated.mass))
        away = float(np.linalg.norm(stated.com))
        return (
            f"an inertial that does not fit the link (mass {stated.mass:.2g} kg, radius of gyration"
            f" {size:.2g} m, centre of mass {away:.2g} m from the frame)"
        )
    return ""


def zero(inertial: Inertial) -> bool:
    """Whether an inertia is zero; programs write dust of 1e-20 for it."""
    return bool(np.abs(inertial.inertia).max() <= SETTINGS.dust**2 * abs(inertial.mass))


def _slack(link: CheckedLink, links: Links) -> float:
    """Share of its shape by which a link may be larger, from how the other links fit theirs."""
    # The link itself is what is in question.
    others = [fit for name, fit in links.fits.items() if name != link.name]
    faithful = len(others) >= SETTINGS.faithful and all(others)
    return 2 * SETTINGS.slack if faithful else SETTINGS.slack_of_proof


def cost_of(inertial: Inertial, link: CheckedLink, links: Links) -> float:
    """Disagreement of an inertial with the rest of the file; infinite if no body can have it."""
    if not inertial.physical():
        return np.inf
    if link.shape is not None:
        # A shape says more than the joints.
        cost = _cost_of_shape(inertial, link.shape)
    else:
        cost = _cost_of_joints(inertial, link, links)
    # A partner without a mass is no evidence.
    distances = [
        distance(inertial, mirrored(partner, plane))
        for partner, plane in link.partners
        if partner.mass > 0
    ]
    if distances:
        # The two sides may differ by design, so this evidence has half of the cap.
        cost += min(SETTINGS.cap / 2, SETTINGS.apart * min(distances))
        # Exactly the same numbers do not come about by chance.
        if min(distances) < SETTINGS.same:
            cost -= SETTINGS.coincidence
    return cost


def _capped(evidence):
    """Limit a piece of evidence, so that one wrong number of the file does not decide alone."""
    return min(SETTINGS.cap, evidence)


def _cost_of_shape(inertial, shape):
    spread = inertial.spread / inertial.mass
    scale = shape.spread
    shift = inertial.com - shape.centre
    # Position in units of the shape's own spread, widths by their divergence, and density.
    cost = 0.5 * _capped(float(shift @ np.linalg.solve(scale, shift)))
    cost += 2.0 * _capped(_divergence(spread, scale))
    density = np.log(inertial.mass / shape.volume / SETTINGS.density) / SETTINGS.density_factor
    cost += 0.5 * _capped(density**2)
    if not shape.holds(inertial.com, spread, SETTINGS.slack):
        cost += SETTINGS.outside
    # CAD programs write the inertial of a uniform body.
    if uniform(inertial, shape):
        cost -= SETTINGS.coincidence
    return cost


def _cost_of_joints(inertial, link, links):
    spread = inertial.spread / inertial.mass
    # The mass of a link is like those of the others, within a factor of e^1.5.
    others = links.masses
    if link.stated is not None:
        others = np.delete(others, np.searchsorted(others, abs(link.stated.mass)))
    median = float(np.median(others)) if len(others) else inertial.mass
    cost = 0.5 * _capped((np.log(inertial.mass / max(median, 1e-9)) / 1.5) ** 2)
    # Its centre is halfway to its joints, and its width a third of its length.
    lengths = np.linalg.norm(link.joints, axis=1)
    size = max([*lengths, 0.1 * links.reach, 1e-3])
    middle = inertial.com - (link.joints.mean(axis=0) / 2 if len(link.joints) else 0.0)
    cost += 0.5 * _capped(float(middle @ middle) / size**2)
    cost += 0.5 * _capped((np.log(np.trace(spread) / (0.3 * size) ** 2) / 2.0) ** 2)
    return cost


def _length(link):
    """Largest distance of a joint that a link carries from its own joint [m]."""
    return float(np.linalg.norm(link.joints, axis=1).max())


def _divergence(spread, scale):
    """Log-det divergence of second moments from those of a shape."""
    ratio = np.linalg.solve(scale, spread)
    # A flat body counts as thick as a hundredth of the shape, so that its logarithm is finite.
    sign, logarithm = np.linalg.slogdet(ratio + 1e-4 * np.eye(3))
    return float(np.trace(ratio) - logarithm - 3) if sign > 0 else SETTINGS.cap


def distance(inertial: Inertial, reference: Inertial) -> float:
    """Distance of two bodies relative to their own size."""
    # The reference may be impossible, hence the magnitudes.
    size = max(
        np.trace(inertial.spread) / inertial.mass,
        np.trace(np.abs(reference.spread)) / abs(reference.mass),
        1e-12,
    )
    # Masses by their ratio, centres and widths relative to the size of the bodies.
    mass = np.log(inertial.mass / abs(reference.mass)) ** 2
    shift = inertial.com - reference.com
    widths = inertial.spread / inertial.mass - reference.spread / reference.mass
    spread = float(np.abs(widths).max()) / size
    return float(np.sqrt(mass + float(shift @ shift) / size + spread**2))
