"""Everyday motions of an arm, inside its limits and the torque available; sets of motions by name.

Gravity, friction and limits decide what an arm can do, so each motion is planned for the arm:
shortened where a joint would exceed its limits, or where its drive could not hold the arm; slowed
down where speed or torque would not do.
"""

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from plant.machine.rig import Rig
from plant.mechanics.arm import Arm
from plant.mechanics.link import Limits
from plant.motion.demand import demand, sampled_demand, shortest_duration
from plant.motion.fastest import require_inside
from plant.motion.reference import Motion, Reference, Scaled
from plant.motion.smooth import Harmonics, PointToPoint
from plant.parts.arguments import instance, known_options, near

T = TypeVar("T")

# Share of torque and speed limits that a motion takes at most, and of the way to the limit of a
# joint's position.
_SHARE = 0.8
_ROOM = 0.9

# Poses of which the first is taken whose holding torques are such a share of their largest, as near
# as that.
_POSES = 1024
_HALF = 0.5
_NEAR = 0.25

_ASIDE = 0.4  # share of the way between two limits by which a pose may be off their middle

_LOADED = 0.1  # share of the largest holding torque of any joint above which gravity loads a joint

# part of a motion that is left at least where the drives cannot hold the arm along all of it
_SHORTEST = 0.1

_LEAST = 1e-9  # speed limit [rad/s] of a joint that has zero

_METRES = 0.2  # travel of a prismatic joint [m] where others turn by 1 rad


@known_options
def everyday_motions(arm: Arm, rig: Rig, *, limits: Limits | None = None) -> dict[str, Reference]:
    """What an arm does all day: motions for `certify`, `evaluate` and `tune`, which take a mapping
    of references.

    Each joint alone, all joints slowly, creep (1 degree/s), far and fast, ten pulses, there and
    back (one smooth oscillation), move and hold (as long at rest as it moved before). All begin and
    end at rest, and at one pose.

    Parameters
    ----------
    arm, rig : Arm, Rig
        As identified, ``found.arm`` and ``found.rig``.
    limits : Limits, optional
        Of positions, speeds and efforts; by default those of the arm's chain, if it has some.

    Returns
    -------
    dict of str -> Reference
        Each with its ``duration``; a path of your own is added by ``everyday_motions(arm, rig) |
        {"mine": path}``.

    Raises
    ------
    ValueError
        Bad input, or an arm that its drives cannot hold.

    Notes
    -----
    The pose at which they begin is the middle of a joint's limits. Of joints without limits, or
    that may turn once around or more, 1,024 poses within a right angle of zero are tried, those
    near zero first, until the holding torque of each joint that carries a weight is a quarter to
    three quarters of its largest: no drive is without load, and none at its extreme. No motion
    takes more than 80 % of the torque and of the speed, nor 90 % of the way to the limit of a
    position.

    See Also
    --------
    ctc.certify, ctc.evaluate, plant.fastest

    Examples
    --------
    >>> from plant import everyday_motions, puma560
    >>> motions = everyday_motions(puma560.arm(), puma560.rig())
    >>> list(motions)[:3]
    ['joint 2 (q[0]) alone', 'joint 3 (q[1]) alone', 'all slowly']
    >>> motions["creep"].duration
    2.0
    """
    chain = instance("arm", arm, Arm, "The order is arm, rig.").dynamics.chain
    instance("rig", rig, Rig, "The order is arm, rig.").require_fit(chain)
    n = rig.n
    limits = chain.limits if limits is None else limits
    if limits is None:
        none = np.full(n, np.inf)
        limits = Limits(lower=-none, upper=none, velocity=none, effort=none)
    if instance("limits", limits, Limits, "Pass chain.limits.").n != n:
        raise ValueError(
            f"limits must have {n} joints like the rig; got {limits.n}. Use those of its chain."
        )
    rig = dataclasses.replace(rig, drive=rig.drive.limited_to(limits.effort))
    unit = np.where([link.prismatic for link in chain.links], _METRES, 1.0)
    at, turns = _pose(arm, rig, limits), np.where(np.arange(n) % 2, -1.0, 1.0)
    room = _ROOM * np.minimum(limits.upper - at, at - limits.lower)
    degree = np.pi / 180
    pulses = rig.to_angle(10 * turns) - rig.to_angle(np.zeros(n))

    def move(by: Any, duration: float) -> Callable[[float], Reference]:
        goal = np.clip(by, -room, room)
        return lambda part: PointToPoint(start=at, goal=at + part * goal, duration=duration)

    def back(part: float) -> Reference:
        # of (1 - cos)^2 / 4, whose acceleration begins at zero
        peak = part * np.clip(0.3 * unit * turns, -room, room)
        waves = {"cosine": np.outer(peak, (-0.5, 0.125)), "sine": np.zeros((n, 2))}
        return Harmonics(period=3.0, offset=at + 0.375 * peak, **waves)

    def hold(part: float) -> Reference:
        path = move(0.6 * unit * turns, 1.5)(part)
        span = (0.0, 3.0)
        return Scaled(
            path=path, times=span, places=span, speeds=(1.0, 1.0), accelerations=(0.0, 0.0)
        )

    alone = zip(chain.joint_labels, 0.5 * np.diag(unit), strict=True)
    planned = {f"{label} alone": move(by, 3.0) for label, by in alone} | {
        "all slowly": move(0.3 * unit * turns, 4.5),
        "creep": move(2 * degree * unit * turns, 2.0),
        "far and fast": move(1.2 * unit * turns, 1.5),
        "ten pulses": move(pulses, 0.5),
        "there and back": back,
        "move and hold": hold,
    }
    return {name: _possible(name, arm, rig, limits, made) for name, made in planned.items()}


def _pose(arm: Arm, rig: Rig, limits: Limits) -> NDArray[np.float64]:
    """Where the motions begin (n,): in the middle of limits, or where holding torques are neither
    none nor largest.

    Where the drives cannot hold the arm in the middle, anywhere inside the limits.
    """
    span = limits.upper - limits.lower
    prismatic = np.array([link.prismatic for link in arm.dynamics.chain.links])
    known = np.where(prismatic, np.isfinite(span), span < 2 * np.pi)
    middle = np.zeros(rig.n)
    middle[known] = (limits.lower[known] + limits.upper[known]) / 2
    free = np.where(prismatic, 0.0, np.pi / 2)
    inside = np.where(known, _ASIDE * np.where(known, span, 0.0), free)
    for spread in (np.where(known, 0.0, free), inside):
        poses, beyond, away = _held(arm, rig, middle, spread, limits)
        if not beyond.min():
            break
    return poses[(away + rig.n * beyond).argmin()]


def _held(arm: Arm, rig: Rig, middle: Any, spread: Any, limits: Limits) -> tuple[Any, Any, Any]:
    """Poses (P, n) around the middle, how many joints cannot hold the arm there, and how far
    from half their load.
    """
    poses = middle + np.random.default_rng(0).uniform(-1, 1, (_POSES, rig.n)).round(2) * spread
    poses = np.clip(poses[np.square(poses).sum(axis=1).argsort()], limits.lower, limits.upper)
    needed = demand(arm, rig, (poses, np.ones_like(poses), np.zeros_like(poses)))
    holding = np.abs(needed.holding)
    dry = np.abs(needed.dry_friction())
    largest = holding.max(axis=0)
    allowed = _SHARE * rig.drive.torque_limit()
    loaded = largest > _LOADED * largest.max()
    share = holding[:, loaded] / largest[loaded]
    return (
        poses,
        (holding + dry > allowed).sum(axis=1),
        np.maximum(np.abs(share - _HALF), _NEAR).sum(axis=1),
    )


def _possible(
    name: str,
    arm: Arm,
    rig: Rig,
    limits: Limits,
    made: Callable[[float], Reference],
    part: float = 1.0,
) -> Reference:
    """A motion, or so small a part of it that the drives hold the arm along it, as slow as speed
    and torque ask for.
    """
    motion = made(part)
    try:
        with naming(name):
            factor = slowing(arm, rig, motion, limits, _SHARE)
    except ValueError:
        if part > _SHORTEST:
            return _possible(name, arm, rig, limits, made, part / 2)
        raise
    return motion if factor == 1 else motion.slowed(factor)


def slowing(
    arm: Arm, rig: Rig, motion: Reference, limits: Limits | None = None, share: float = 1.0
) -> float:
    """Factor, 1 or more, by which a motion is to be slowed down for this share of speed limits and
    amplifiers.

    One that exceeds limits of positions, or that no factor would make possible, is refused.
    """
    _, sampled, needed = sampled_demand(arm, rig, motion)
    factor = 1.0
    if not (needed.share(1.0) <= share).all():
        factor = shortest_duration(arm, rig, motion, share) / motion.duration
    if limits is not None:
        require_inside(Motion(*sampled), limits, arm.dynamics.chain.joint_labels)
        factor = max(
            factor, float((np.abs(sampled[1]) / np.maximum(share * limits.velocity, _LEAST)).max())
        )
    return factor


def of_motion(each: Mapping[str, T], name: str) -> T:
    """What belongs to one motion of a set; a KeyError that knows the others."""
    if name in each:
        return each[name]
    others = near(name, each, f"It has {', '.join(each)}.")
    raise KeyError(f"{name!r} is no motion of this set. {others}")


@contextlib.contextmanager
def naming(name: str) -> Iterator[None]:
    """Errors of one motion of a set begin with its name."""
    try:
        yield
    except ValueError as error:
        raise type(error)(f"motion {name!r}: {error}" if name else str(error)) from None


def motions_of(arm: Any, rig: Rig, reference: Any, order: str) -> dict[str, Reference]:
    """A mapping of motions, or a reference alone, whose name is empty: by name, each one that
    the arm can make.
    """
    if not isinstance(reference, Mapping):
        return {"": instance("reference", reference, Reference, order)}
    motions = dict(reference)
    nameless = [repr(name) for name in motions if not (isinstance(name, str) and name)] or [
        "none"
    ] * (not motions)
    if nameless:
        raise ValueError(
            f"motions must have texts as names; got {nameless[0]:.60}. Give {{'mine': path, ...}}."
        )
    for name, motion in motions.items():
        instance(f"motion {name!r}", motion, Reference, "Give {'mine': path, ...}.")
        with naming(name):
            factor = slowing(
                arm, rig, motion, instance("arm", arm, Arm, order).dynamics.chain.limits
            )
        if factor > 1:
            factor = math.ceil(1000 * factor) / 1000
            raise ValueError(
                f"motion {name!r} must be one that speed limits and amplifiers allow; it is too"
                f" fast by a factor of {factor:g}. Slow it down by .slowed({factor:g})."
            )
    return motions
