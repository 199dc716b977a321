"""Random bodies, placements, chains and arms, drawn from a seed."""

from functools import cache

import numpy as np

from plant import Body, Chain, Dynamics, Link, Lumping, Placement


def random_body(random):
    """A body that can exist: its inertia is that of a cloud of ten mass points."""
    points, masses = random.uniform(-0.3, 0.3, (10, 3)), random.uniform(0.1, 1.0, 10)
    mass, com = masses.sum(), masses @ points / masses.sum()
    second = np.einsum("k,ki,kj->ij", masses, points - com, points - com)
    inertia = np.trace(second) * np.eye(3) - second
    return Body(
        mass=mass, com=com, inertia=inertia[np.triu_indices(3)], rotor=random.uniform(0.01, 0.5)
    )


def random_placement(random):
    return Placement.of_angles(*random.uniform(-3, 3, 3), random.uniform(-0.5, 0.5, 3))


def random_chain(n, seed, *, frames):
    """Every second joint may slide; with free frames before the rows and for the bodies, or
    without.
    """
    random = np.random.default_rng(seed)
    links = []
    for i in range(n):
        alpha, theta = random.uniform(-np.pi, np.pi, 2)
        extra = (
            {"before": random_placement(random), "frame": random_placement(random)}
            if frames
            else {}
        )
        a, d = random.uniform(-0.5, 0.5, 2)
        slides = bool(random.integers(2))
        links.append(
            Link(name=str(i + 1), alpha=alpha, a=a, d=d, theta=theta, prismatic=slides, **extra)
        )
    bodies = tuple(random_body(random) for _ in range(n))
    return Chain(links=tuple(links), gravity=tuple(random.normal(size=3) * 6), bodies=bodies)


@cache
def random_arm(n, seed):
    """A chain with random geometry and tilted gravity, its bodies, and its dynamics in standard
    parameters.
    """
    random = np.random.default_rng(seed)
    rows = np.column_stack([random.uniform(-np.pi, np.pi, n), random.uniform(-0.6, 0.6, (n, 3))])
    links = tuple(
        Link(name=str(i), alpha=r[0], a=r[1], d=r[2], theta=r[3])
        for i, r in enumerate(rows.tolist())
    )
    chain = Chain(links=links, gravity=tuple(random.normal(size=3) * 6))
    return (
        chain,
        tuple(random_body(random) for _ in range(n)),
        Dynamics(chain=chain, lumping=Lumping.standard(chain)),
    )
