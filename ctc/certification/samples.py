"""Monte Carlo samples of arm and rig from an `Uncertainty`. A certificate covers nothing else."""

import dataclasses
import re
from typing import Any, NamedTuple

import numpy as np

from ctc.certification.identified import Identified, identified
from ctc.certification.imperfections import IMPERFECTIONS, Drawn, drawn_of, placed_in
from ctc.certification.plants import Plants
from ctc.certification.uncertainty import Uncertainty, spread
from ctc.verdict import with_gears
from identification import Identification
from plant import Arm, Body, Elasticity, Phase, Rig, Transport
from plant.machine import gears, least_inertia_margin, shaft_inertias
from plant.parts import Bools, Checkpoint, Integers, array, frozen_settings, instance, product


@frozen_settings
class RejectionSettings:
    """Numbers of the rejection of samples that are no arms, all chosen by hand.

    Parameters
    ----------
    draws : int
        Draws per sample, on average, after which those that are no arm yet are projected.
    shrink : float
        Factor by which each step of the projection shortens the way to the identified arm.
    nearest : float
        Share of that way at which the projection ends.
    """

    draws: int = 20
    shrink: float = 0.9
    nearest: float = 1e-4


SETTINGS = RejectionSettings()

_FRICTION = ("drive.viscous", "drive.coulomb")

# Numbers of a rig that are negative in no machine.
_NOT_NEGATIVE = re.compile(
    r"drive\.(viscous|coulomb|curve\.(breakaway|speed|saturation|rise)|elasticity|motor_inertia"
    r"|load_friction|presliding|current_lag|ripple\.amplitude)|encoder\.quadrature\.amplitude"
    r"|springs(\[\d+\])?\.stiffness"
)


def draw(
    uncertainty: Uncertainty,
    found: Identification | Arm,
    rig: Rig,
    samples: int,
    seed: int,
    pose: Any = None,
    progress: bool = False,
    checkpoint: Checkpoint | None = None,
    normals: Any = None,
) -> Plants:
    """Monte Carlo samples of the arm `found` and its rig, as an `Uncertainty` states them.

    Sampled are the identified numbers (from their covariance, or from given arms), friction that
    was not identified, and all stated effects. Resonances are those of the gears at `pose` (n,)
    [rad], zeros by default. `progress` and `checkpoint` are for the fits of the records on elastic
    gears. `normals` replaces the random generator and makes the samples a function of its numbers
    (`ctc.certification.rare.Normals`).
    """
    instance("rig", rig, Rig, "The order is found, rig, law, reference.")
    # Joints at zero where nobody stated a pose.
    pose = np.zeros(rig.n) if pose is None else pose
    _require_possible(uncertainty, rig)
    # 1. The distribution, with the rig's identified numbers in place of the given ones.
    distribution = identified(uncertainty, found, pose, progress, checkpoint)
    arm = distribution.arm
    random = normals or np.random.default_rng(seed)
    # Places in the ranges have a stream of their own, so that they do not depend on rejections.
    places_random = normals or np.random.default_rng((seed, 2))
    shape = samples, 1 + len(uncertainty.resonance or ())
    places = places_random.uniform(0, 1, shape)
    rig = _with_identified(rig, distribution.of_rig)
    # 2. Draw. The order of the draws is part of the result: it decides all bits of a seed.
    arms = _arms(uncertainty, distribution, rig, pose, random, places)
    nominal, of_hardware, hardware = _hardware(uncertainty, random, rig, samples)
    rig = placed_in(_with_middle(uncertainty, arm, nominal, pose), uncertainty.imperfections)
    gears = _gears(uncertainty, random, arm, rig, arms.f, pose, places)
    # 3. Collect the columns of all numbers.
    names = (*arms.names, *of_hardware, *gears.names)
    values = np.hstack([arms.values, hardware, gears.values])
    # Sensitivities are asked of numbers that differ alone. A single sample has no other to differ
    # from, but it differs from the nominal plant.
    varying = np.flatnonzero((np.ptp(values, axis=0) > 0) | (samples == 1))
    expected = np.zeros_like(values)
    # A sensitivity counts a refitted number by its deviation from the fit at that resonance.
    if distribution.refits is not None:
        columns = [names.index(name) for name in distribution.names]
        expected[:, columns] = distribution.centres(places[:, :-1])
    return Plants(
        arm=arm,
        rig=rig,
        f=arms.f,
        names=tuple(names[i] for i in varying),
        values=values[:, varying],
        dropped=float(uncertainty.dropped),
        redrawn=int(arms.redraws.sum()),
        projected=int(arms.moved.sum()),
        redraws=arms.redraws,
        moved=arms.moved,
        seed=seed,
        own=nominal,
        uncertainty=uncertainty,
        derived_names=gears.derived_names,
        derived=gears.derived,
        said=statement(uncertainty, nominal, distribution),
        expected=expected[:, varying],
    )


def _require_possible(uncertainty: Uncertainty, rig: Rig) -> None:
    """Refuse what this rig cannot have, before anything is fitted or sampled."""
    if uncertainty.resonance is not None:
        pairs = len(uncertainty.resonance)
        if pairs not in (1, rig.n):
            raise ValueError(
                f"resonance must be one pair, or {rig.n}; got {pairs}. Give (low, high)."
            )
        # Gears of unit stiffness stand for any: only their presence is checked.
        rig = with_gears(rig, Elasticity(stiffness=np.ones(rig.n), damping=np.zeros(rig.n)))
    elif uncertainty.damping_ratio is not None and rig.drive.elasticity is not None:
        # Elastic gears of the rig have a damping of their own, which is not sampled.
        raise ValueError(
            "damping_ratio must be given with a resonance, since the rig's gears have one; got"
            f" {spread(uncertainty.damping_ratio)} alone. Give resonance=(lowest, highest) [Hz]."
        )
    # The parts themselves refuse values out of their ranges: both ends are tried.
    ranges = uncertainty.imperfections
    for ends in zip(*ranges.values(), strict=True):
        placed_in(rig, {name: (0.0, end) for name, end in zip(ranges, ends, strict=True)})


class _Arms(NamedTuple):
    """Sampled arms, with their numbers and inertial parameters.

    `names` (K) and `values` (P, K) are the numbers, and `f` (P, p) includes the load. `redraws`
    (P,) counts the rejected draws of each arm; `moved` (P,) tells whether it was projected.
    """

    names: tuple[str, ...]
    values: Any
    f: Any
    redraws: Integers
    moved: Bools


def _arms(uncertainty, distribution, rig, pose, random, places):
    """`_Arms` whose resonances are at these places (P, m + 1) of their ranges."""
    dynamics = distribution.arm.dynamics
    samples = len(places)
    stated = None if uncertainty.plants is None else _possible(dynamics, rig, uncertainty.plants)
    direction = _load_direction(uncertainty, dynamics)
    friction = _friction(rig, distribution.names) if uncertainty.friction else {}

    def drawn(rows):
        """New values of these samples, name -> (count,)."""
        count = len(rows)
        values = dict(
            zip(distribution.names, distribution.draw(random, places[rows, :-1]).T, strict=True)
        )
        # Stated arms are taken in turn, so that each has as many samples.
        if stated is not None:
            values = dict(zip(dynamics.names, stated[rows % len(stated)].T, strict=True))
        # Relative to its own level, since levels differ by orders of magnitude between joints.
        for name, level in friction.items():
            values[name] = level * (1 + uncertainty.friction * random.standard_normal(count))
        return values | {"load": random.uniform(*uncertainty.load, count)}

    def arms(values):
        """Their f with the load (count, p), and whether each is an arm."""
        # Parameters that were not identified are those of the arm.
        f = np.tile(distribution.arm.f, (len(values["load"]), 1))
        for i, name in enumerate(dynamics.names):
            f[:, i] = values.get(name, f[:, i])
        f = f + values["load"][:, None] * direction
        # No arm has a D(q) that is below its rotors' inertia at some pose.
        sound = least_inertia_margin(dynamics, rig, f) >= 0
        for name in values:
            sound &= not _NOT_NEGATIVE.match(name) or values[name] >= 0
        # No gear has a resonance with links that have no inertia.
        if uncertainty.resonance is not None:
            sound &= (_links(dynamics, rig, pose, f) > 0).all(axis=1)
        return f, sound

    redraws = np.zeros(samples, np.intp)
    moved = np.zeros(samples, bool)
    # 1. A first draw of all samples.
    values = drawn(np.arange(samples))
    f, sound = arms(values)
    # Samples that are a function of given numbers are not drawn again. The first arm takes the
    # place of those that are none; `sound` tells which these are.
    if not isinstance(random, np.random.Generator):
        random.sound = sound
        rows = np.where(sound, np.arange(len(f)), sound.argmax())
        columns = np.column_stack([*values.values()])
        return _Arms(tuple(values), columns[rows], f[rows], redraws, moved)
    # 2. Others in place of those that are no arms, until all are.
    # Friction that was not identified moves towards its nominal level.
    middle = dict(zip(distribution.names, distribution.values, strict=True)) | friction
    while not sound.all():
        rejected = np.flatnonzero(~sound)
        redraws[rejected] += 1
        replacements = drawn(rejected)
        # Where hardly any draw is an arm, rejection would not end.
        if redraws.sum() > SETTINGS.draws * samples:
            replacements = _projected(replacements, middle, arms)
            moved[rejected] = True
        for name, column in replacements.items():
            values[name][rejected] = column
        f[rejected], sound[rejected] = arms(replacements)
        # Not even the identified arm is one: nothing is left to move towards.
        if moved.any() and not sound.all():
            reason = (
                f"{redraws.sum()} were not (D(q) indefinite, links without inertia, or negative"
                " friction), nor is the one identified"
            )
            raise ValueError(
                f"samples must be arms; {reason}. Give a smaller covariance, or a better"
                " experiment."
            )
    return _Arms(tuple(values), np.column_stack([*values.values()]), f, redraws, moved)


def _projected(values, middle, arms):
    """Draws, name -> (count,), projected to arms.

    Each draw moves on a straight line towards the identified arm until it is an arm.
    """
    # All numbers move together, so that a projected sample keeps their correlation.
    share = 1.0
    values = dict(values)
    sound = arms(values)[1]
    while share > SETTINGS.nearest and not sound.all():
        share *= SETTINGS.shrink
        for name in middle.keys() & values.keys():
            closer = middle[name] + SETTINGS.shrink * (values[name] - middle[name])
            # A sample that is an arm stays where it is.
            values[name] = np.where(sound, values[name], closer)
        sound = arms(values)[1]
    return values


def _hardware(uncertainty, random, rig, samples):
    """The rig with fields for encoder offsets and delay, names (K) and values (P, K) of both."""
    names = []
    values = [np.empty((samples, 0))]
    changes = {}
    if uncertainty.phase:
        names += [f"encoder.phase.shift[{i}]" for i in range(rig.n)]
        # The counter's zero lies anywhere within its pulse.
        values.append(random.uniform(-0.5, 0.5, (samples, rig.n)))
        changes["encoder"] = dataclasses.replace(rig.encoder, phase=Phase(shift=(0.0,) * rig.n))
    # Lost counts, too, are a property of the transport.
    if uncertainty.delay[1] or uncertainty.dropped:
        own = rig.transport or Transport()
        # A delay of the rig itself stays unless another is stated.
        ends = uncertainty.delay if uncertainty.delay[1] else (own.delay, own.delay)
        names.append("transport.delay")
        values.append(random.uniform(*ends, (samples, 1)))
        # The rig has the longest delay; each sample has its own number.
        changes["transport"] = dataclasses.replace(own, delay=ends[1])
    return dataclasses.replace(rig, **changes), names, np.hstack(values)


def _with_middle(uncertainty, arm, rig, pose):
    """The rig with elastic gears in the (geometric) middle of the stated range."""
    if uncertainty.resonance is None:
        return rig
    middle = np.sqrt(np.prod(uncertainty.resonance, axis=1))
    # The damping is stated on a linear scale, so its middle is the mean.
    damping = np.mean(uncertainty.damping_ratio)
    # The range replaces stiffness and damping; backlash of the rig itself stays.
    own = rig.drive.elasticity
    backlash = None if own is None else own.backlash
    gears = Elasticity.from_resonance(
        arm, middle, damping, drive=rig.drive, q=pose, backlash=backlash
    )
    return with_gears(rig, gears)


def _gears(uncertainty, random, arm, rig, f, pose, places):
    """Gears and drives of arms with these f (P, p).

    Their places (P, m + 1) are those in the ranges of resonance and damping.
    """
    count = len(f)
    n = rig.n
    # Drawn in any case, and first: they do not depend on a stated resonance.
    imperfections = drawn_of(uncertainty.imperfections, random, count, n)
    if uncertainty.resonance is None:
        return imperfections
    low, high = np.log(uncertainty.resonance).T
    # Uniform in the logarithm, as the cells of the bounds are.
    hz = np.exp(low + places[:, :-1] * (high - low))
    ratio = uncertainty.damping_ratio[0] + places[:, -1:] * np.ptp(uncertainty.damping_ratio)
    # Resonances are stated; the stiffness of each sample follows from the inertia of its links.
    links = _links(arm.dynamics, rig, pose, f)
    stiffness_damping = gears(np.broadcast_to(hz, (count, n)), ratio, links)
    names = ["resonance"] if len(low) == 1 else [f"resonance[{i}]" for i in range(n)]
    derived = [
        f"drive.elasticity.{name}[{i}]" for name in ("stiffness", "damping") for i in range(n)
    ]
    return Drawn(
        names=(*names, "damping_ratio", *imperfections.names),
        values=np.hstack([hz, ratio, imperfections.values]),
        derived_names=(*derived, *imperfections.derived_names),
        derived=np.hstack([*stiffness_damping, imperfections.derived]),
    )


def _links(dynamics, rig, pose, f):
    """Inertia (P, n) of the links behind each gear at a pose, without the motors'."""
    return product(f, shaft_inertias(dynamics, rig, pose)) - rig.drive.reflected_inertia()


def _friction(rig, unknown):
    """Name -> value of the friction that was not identified."""
    # A level of zero has no share to vary by.
    return {
        name: value
        for name, value in rig.numbers().items()
        if name.startswith(_FRICTION) and name not in unknown and value > 0
    }


def _load_direction(uncertainty, dynamics):
    """Change (p,) of f per kg in the gripper."""
    if uncertainty.load[1] == 0:
        return np.zeros(dynamics.p)
    # f is linear in the bodies: that of 1 kg on massless links is the change per kg.
    massless = [Body(mass=0.0, com=(0, 0, 0)) for _ in range(dynamics.n - 1)]
    return dynamics.f([*massless, Body(mass=1.0, com=uncertainty.load_position)])


def _with_identified(rig, values):
    """The rig with the identified values of its numbers."""
    # An elastic drive, for example, may have been identified, and another rig be given.
    missing = [name for name in values if name not in rig.number_names()]
    if missing:
        raise ValueError(
            f"rig must have {missing[0]}, which was identified; it has no such number. Pass"
            " found.rig."
        )
    return rig.filled(values)


def _possible(dynamics, rig, plants):
    """Given arms (M, p), all validated."""
    advice = f"Give f of one arm per row: {', '.join(dynamics.names)}."
    plants = array("plants", plants, ("M", dynamics.p), advice=advice)
    if not len(plants):
        raise ValueError("plants must hold at least one arm; got none. Give f of one arm per row.")
    # One wrong row would make its samples fail under any controller.
    wrong = np.flatnonzero(least_inertia_margin(dynamics, rig, plants) < 0)
    if len(wrong):
        row = f"row {wrong[0]} has D(q) below the motors' own inertia"
        raise ValueError(f"plants must all be arms; {row}. Leave it out.")
    return plants


def statement(
    uncertainty: Uncertainty, rig: Rig, distribution: Identified
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Effects of an `Uncertainty` that are sampled, and effects that are not.

    A number that was identified needs no stated spread.
    """
    # 1. What stands for the arm.
    u = uncertainty
    sampled = []
    friction_names = [name for name in distribution.names if name.startswith(_FRICTION)]
    left = _friction(rig, distribution.names)
    complete = bool(friction_names) and not left
    friction = (
        f"friction{' that was not identified' * bool(friction_names)} ±{100 * u.friction:.3g} %"
        " (standard deviation)"
    )
    # Nothing remains for the stated share.
    if complete:
        friction = "friction as identified (friction= is of what was not)"
    if u.plants is not None:
        sampled.append("f of given arms")
    elif distribution.refits is not None:
        resonances = len(distribution.refits.places)
        sampled.append(f"what the log says on gears of {resonances} resonances of the range")
    elif distribution.names:
        sampled.append("what was identified")
    # 2. The other effects: each is in one of the two lists.
    pairs = u.resonance or ()
    hz = ", ".join(f"{low:g} to {high:g}" for low, high in pairs)
    alike = "all joints alike" if len(pairs) == 1 else "of each joint"
    gears = f"resonance {hz} Hz ({alike}), damping ratio {spread(u.damping_ratio or (0.0, 0.0))}"
    # Elastic gears and a delay of the rig itself are in all samples, with no spread.
    stiff = "elasticity" if rig.drive.elasticity is None else "resonance (as the rig has it)"
    late = rig.transport is not None and rig.transport.delay > 0
    # Rows: whether it is sampled, its words if so, and its words if not.
    rows = [
        (u.resonance is not None, gears, stiff),
        (complete or (bool(left) and u.friction > 0), friction, "friction"),
        (u.load[1] > 0, f"load {spread(u.load)} kg", "load"),
        (u.phase, "encoder zeros", "encoder zeros"),
        (u.delay[1] > 0, f"delay {spread(u.delay)} s", f"delay{' (as the rig has it)' * late}"),
        (u.dropped > 0, f"lost counts {100 * u.dropped:g} %", "lost counts"),
    ]
    for name, row in IMPERFECTIONS.items():
        ends = getattr(u, name)
        if not row.applies(rig):
            continue
        # An imperfection of the rig itself is in all samples, too.
        of_rig = "" if row.own(rig) is None else " (as the rig has it)"
        rows.append((any(ends), f"{row.words} {spread(ends)} {row.unit}", f"{row.words}{of_rig}"))
    sampled += [words for varies, words, _ in rows if varies]
    return tuple(sampled), tuple(words for varies, _, words in rows if not varies)
