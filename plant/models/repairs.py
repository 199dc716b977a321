"""Repairs of an inertial that nothing can have: the one likely repair, the other side, or the shape filled."""

import numpy as np

from plant.mechanics.body import Body
from plant.models.agreement import CheckedLink, mirrored, uniform
from plant.models.hypotheses import Stated

_LIKELY = 3.0
"""Of two repairs of what no body can have, the likelier by e^3 is taken."""


def only(trials: list[tuple[float, str, Stated]], best: Stated) -> bool:
    """Whether all other bodies that one mistake leaves agree with the file much less."""
    costs = [cost for cost, _, other in trials if not np.allclose(other.spread, best.spread, rtol=1e-3, atol=0)]
    least = min(cost for cost, _, _ in trials)
    return bool(np.isfinite(least) and min(costs, default=np.inf) - least > _LIKELY)


def guess(link: CheckedLink, links: dict[str, CheckedLink]) -> Body | None:
    """The partner's body mirrored; or the link's shape filled, where all others are filled alike."""
    for partner, plane in link.partners:
        if partner.physical():
            return body_of(mirrored(partner, plane))
    others = [other for other in links.values() if other is not link and other.stated is not None and other.shape]
    densities = [
        other.stated.mass / other.shape.volume
        for other in others
        if other.stated is not None and other.shape is not None and uniform(other.stated, other.shape)
    ]
    alike = len(densities) > 1 and len(densities) == len(others) and np.ptp(densities) < 0.01 * min(densities)
    if link.shape is None or not alike:
        return None
    mass = float(np.median(densities)) * link.shape.volume
    spread = mass * link.shape.spread
    return body_of(Stated(mass, link.shape.centre, np.eye(3), np.trace(spread) * np.eye(3) - spread))


def body_of(given: Stated) -> Body:
    """As a body in the link's frame."""
    turned = given.rotation @ given.inertia @ given.rotation.T
    return Body(mass=given.mass, com=given.com, inertia=turned[np.triu_indices(3)])
