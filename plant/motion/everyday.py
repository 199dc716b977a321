"""Everyday motions of an arm, inside its limits and the torque available; sets of motions by name.

Gravity, friction and limits decide what an arm can do, so each motion is planned for the arm:
shortened where a joint would exceed its limits, or where its drive could not hold the arm; slowed
down where speed or torque would not do.
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from plant.machine import Rig
from plant.mechanics import Arm, Limits
from plant.motion.demand import demand, sampled_demand, shortest_duration
from plant.motion.fastest import require_inside, speed_limits, within_efforts
from plant.motion.reference import Motion, Reference, Scaled
from plant.motion.smooth import Harmonics, PointToPoint
from plant.parts import frozen_settings, instance, known_options, near

T = TypeVar("T")


@frozen_settings
class EverydaySettings:
    """Numbers of everyday motions, chosen by hand.

    Parameters
    ----------
    share : float
        Share of the torque and speed limits that a motion takes at most.
    room : float
        Share of the way to the limit of a joint's position that a motion takes at most.
    poses : int
        Poses that are tried as a start.
    load : float
        Holding torque at the start, as a share of the joint's largest, that a pose should have.
    tolerance : float
        Differences from `load` up to this count as equally good.
    offset : float
        Share of the way between two limits by which a pose may be off their middle.
    margin : float
        Least distance [rad] of a pose from the limits of a joint that has no middle; of a slide,
        times `travel`. It leaves room for each joint alone.
    loaded : float
        A joint counts as loaded if its largest holding torque exceeds this share of the largest of
        all joints.
    shortest : float
        Part of a motion above which it is halved if the drives cannot hold the arm along it.
    travel : float
        Travel of a prismatic joint [m] where others turn by 1 rad.
    """

    share: float = 0.8
    room: float = 0.9
    poses: int = 1024
    load: float = 0.5
    tolerance: float = 0.25
    offset: float = 0.4
    margin: float = 0.6
    loaded: float = 0.1
    shortest: float = 0.1
    travel: float = 0.2


SETTINGS = EverydaySettings()


@known_options
def everyday_motions(arm: Arm, rig: Rig, *, limits: Limits | None = None) -> dict[str, Reference]:
    """Everyday motions of an arm by name, for `certify`, `evaluate` and `tune`.

    Each joint alone, all joints slowly, creep (1 degree/s), far and fast, ten pulses, there and
    back (one smooth oscillation), move and hold (as long at rest as it moved before). All begin at
    one pose, and begin and end at rest.

    Parameters
    ----------
    arm, rig : Arm, Rig
        As identified, ``found.arm`` and ``found.rig``.
    limits : Limits, optional
        Of positions, speeds and efforts; by default those of the arm's chain, if it has some. The
        efforts of coupled motors' joints must be inf.

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
    that may turn once around or more, 1,024 poses within a right angle of zero, and 0.6 rad from
    their limits, are tried, those near zero first, until the holding torque of each joint that
    carries a weight is a quarter to three quarters of its largest: no drive is without load, and
    none at its extreme. No motion takes more than 80 % of the torque and of the speed, nor 90 % of
    the way to the limit of a position.

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
    # Limits that are not stated do not bind.
    limits = chain.limits if limits is None else limits
    if limits is None:
        none = np.full(n, np.inf)
        limits = Limits(lower=-none, upper=none, velocity=none, effort=none)
    # The effort of a joint limits its torque as the amplifier does.
    rig = within_efforts(rig, limits, chain.joint_labels)
    unit = np.where([link.prismatic for link in chain.links], SETTINGS.travel, 1.0)
    pose = _pose(arm, rig, limits)
    # Neighbouring joints turn in opposite directions.
    turns = np.where(np.arange(n) % 2, -1.0, 1.0)
    room = SETTINGS.room * np.minimum(limits.upper - pose, pose - limits.lower)
    room[limits.velocity == 0] = 0.0
    degree = np.pi / 180
    pulses = rig.to_angle(10 * turns) - rig.to_angle(np.zeros(n))

    # Each of these takes the part of the motion that is to be made, 0 to 1.
    def move(by: Any, duration: float) -> Callable[[float], Reference]:
        goal = np.clip(by, -room, room)
        return lambda part: PointToPoint(start=pose, goal=pose + part * goal, duration=duration)

    def back(part: float) -> Reference:
        # (1 - cos)^2 / 4, since its acceleration begins at zero.
        peak = part * np.clip(0.3 * unit * turns, -room, room)
        return Harmonics(
            period=3.0,
            offset=pose + 0.375 * peak,
            cosine=np.outer(peak, (-0.5, 0.125)),
            sine=np.zeros((n, 2)),
        )

    def hold(part: float) -> Reference:
        path = move(0.6 * unit * turns, 1.5)(part)
        # The path lasts 1.5 s, and rests at its goal for as long.
        span = (0.0, 3.0)
        return Scaled(
            path=path, times=span, places=span, speeds=(1.0, 1.0), accelerations=(0.0, 0.0)
        )

    # Each motion as a function of its part, since a part may be all that the drives can hold.
    alone = zip(chain.joint_labels, 0.5 * np.diag(unit), strict=True)
    # Distances are multiples of the unit of each joint, so that slides and turning joints move
    # alike.
    planned = {f"{label} alone": move(by, 3.0) for label, by in alone} | {
        "all slowly": move(0.3 * unit * turns, 4.5),
        "creep": move(2 * degree * unit * turns, 2.0),
        "far and fast": move(1.2 * unit * turns, 1.5),
        "ten pulses": move(pulses, 0.5),
        "there and back": back,
        "move and hold": hold,
    }
    return {name: _possible(name, arm, rig, limits, plan) for name, plan in planned.items()}


def _pose(arm: Arm, rig: Rig, limits: Limits) -> NDArray[np.float64]:
    """Pose (n,) at which the motions begin.

    It is in the middle of the limits; of a joint without limits, where its holding torque is
    neither zero nor the largest. If the drives cannot hold the arm there, anywhere inside the
    limits.
    """
    # A joint that may turn once around, or more, has no middle.
    span = limits.upper - limits.lower
    prismatic = np.array([link.prismatic for link in arm.dynamics.chain.links])
    limited = np.where(prismatic, np.isfinite(span), span < 2 * np.pi)
    middle = np.zeros(rig.n)
    middle[limited] = (limits.lower[limited] + limits.upper[limited]) / 2
    free = np.where(prismatic, 0.0, np.pi / 2)
    inside = np.where(limited, SETTINGS.offset * np.where(limited, span, 0.0), free)
    # On a limit there would be no room for motions.
    margin = SETTINGS.margin * np.where(prismatic, SETTINGS.travel, 1.0)
    margin[limited] = 0.0
    ends = (limits.lower + margin, limits.upper - margin)
    # 1. Joints with limits in their middle; 2. if that fails, all joints around it.
    for spread in (np.where(limited, 0.0, free), inside):
        poses, overloaded, distance = _tried_poses(arm, rig, middle, spread, ends)
        if not overloaded.min():
            break
    return poses[(distance + rig.n * overloaded).argmin()]


def _tried_poses(
    arm: Arm, rig: Rig, middle: Any, spread: Any, ends: tuple[Any, Any]
) -> tuple[Any, Any, Any]:
    """Poses (P, n) around the middle, overloaded joints (P,), and distance (P,) from half load."""
    # A fixed seed: the motions of an arm are the same in every call.
    draws = np.random.default_rng(0).uniform(-1, 1, (SETTINGS.poses, rig.n)).round(2)
    poses = middle + draws * spread
    # Those near zero come first: of equally good ones `argmin` takes the first.
    poses = np.clip(poses[np.square(poses).sum(axis=1).argsort()], *ends)
    needed = demand(arm, rig, (poses, np.ones_like(poses), np.zeros_like(poses)))
    holding = np.abs(needed.holding)
    dry = np.abs(needed.dry_friction())
    largest = holding.max(axis=0)
    # With its dry friction, so that the arm can leave the pose.
    allowed = SETTINGS.share * rig.drive.torque_limit()
    loaded = largest > SETTINGS.loaded * largest.max()
    share = holding[:, loaded] / largest[loaded]
    overloaded = (holding + dry > allowed).sum(axis=1)
    distance = np.maximum(np.abs(share - SETTINGS.load), SETTINGS.tolerance).sum(axis=1)
    return poses, overloaded, distance


def _possible(
    name: str,
    arm: Arm,
    rig: Rig,
    limits: Limits,
    plan: Callable[[float], Reference],
    part: float = 1.0,
) -> Reference:
    """A motion, or a part of it along which the drives hold the arm, slowed to the limits."""
    motion = plan(part)
    try:
        with naming(name):
            factor = slowing(arm, rig, motion, limits, SETTINGS.share)
    except ValueError:
        # A shorter motion stays nearer to the pose, which the drives can hold.
        if part > SETTINGS.shortest:
            return _possible(name, arm, rig, limits, plan, part / 2)
        raise
    return motion if factor == 1 else motion.slowed(factor)


def slowing(
    arm: Arm, rig: Rig, motion: Reference, limits: Limits | None = None, share: float = 1.0
) -> float:
    """Factor, 1 or more, that slows a motion down to a share of speed limits and amplifiers.

    A motion that exceeds limits of positions, that moves a joint with a speed limit of zero, or
    that no factor makes possible, is refused.
    """
    _, sampled, needed = sampled_demand(arm, rig, motion)
    factor = 1.0
    # Torque scales with no power of the speed, since friction and gravity remain; so the factor for
    # torque is found by search; the factor for speed, below, is a plain ratio.
    if not (needed.share(1.0) <= share).all():
        factor = shortest_duration(arm, rig, motion, share) / motion.duration
    if limits is None:
        return factor
    along = Motion(*sampled)
    labels = arm.dynamics.chain.joint_labels
    require_inside(along, limits, labels)
    fastest = share * speed_limits(along, limits, labels)
    for_speed = float((np.abs(along.qd) / fastest).max())
    if for_speed <= factor:
        return factor
    # Viscous friction may have carried a part of the weight.
    slow = needed.share(1 / for_speed)
    joint = int(slow.argmax())
    if slow[joint] > share:
        raise ValueError(
            "motion must need less torque than the drives give at the speed that the limits allow;"
            f" slowed by {for_speed:.3g}, {labels[joint]} needs {slow[joint] / share:.3g} times as"
            " much as it may. Raise its limit, or shorten the motion."
        )
    return for_speed


def of_motion(values: Mapping[str, T], name: str) -> T:
    """The value of one motion of a set, or a KeyError that names the others."""
    if name in values:
        return values[name]
    hint = near(name, values, f"It has {', '.join(values)}.")
    raise KeyError(f"{name!r} is no motion of this set. {hint}")


@contextlib.contextmanager
def naming(name: str) -> Iterator[None]:
    """Errors of one motion of a set begin with its name."""
    try:
        yield
    except ValueError as error:
        text = f"motion {name!r}: {error}" if name else str(error)
        # The kind of the error stays, for code that catches it, if it takes a text alone.
        try:
            named = type(error)(text)
        except TypeError:
            named = ValueError(text)
        raise named from None


def motions_of(arm: Any, rig: Rig, reference: Any, order: str) -> dict[str, Reference]:
    """Motions by name; of a set, each is one that the arm can make.

    A reference alone has an empty name; neither it nor arm and rig are tested then.
    """
    if not isinstance(reference, Mapping):
        return {"": instance("reference", reference, Reference, order)}
    motions = dict(reference)
    nameless = [repr(name) for name in motions if not (isinstance(name, str) and name)]
    if nameless or not motions:
        got = nameless[0] if nameless else "none"
        raise ValueError(
            f"motions must have texts as names; got {got:.60}. Give {{'mine': path, ...}}."
        )
    for name, motion in motions.items():
        instance(f"motion {name!r}", motion, Reference, "Give {'mine': path, ...}.")
        limits = instance("arm", arm, Arm, order).dynamics.chain.limits
        with naming(name):
            factor = slowing(arm, rig, motion, limits)
        if factor > 1:
            # Rounded upwards: the advised factor must be enough.
            factor = math.ceil(1000 * factor) / 1000
            raise ValueError(
                f"motion {name!r} must be one that speed limits and amplifiers allow; it is too"
                f" fast by a factor of {factor}. Slow it down by .slowed({factor})."
            )
    return motions
