"""Monte Carlo samples of arm and rig, from what an `Uncertainty` states. A certificate covers
nothing else.
"""

import dataclasses
import re
from typing import Any

import numpy as np

from ctc.certification.identified import Identified, identified
from ctc.certification.imperfections import IMPERFECTIONS, Drawn, drawn_of, placed_in
from ctc.certification.plants import Plants
from ctc.certification.uncertainty import Uncertainty, spread
from ctc.verdict.on_gears import with_gears
from identification import Identification
from plant import Arm, Body, Elasticity, Phase, Rig, Transport
from plant.machine.elasticity import gears
from plant.machine.motor_inertia import least_inertia_margin, shaft_inertias
from plant.parts.arguments import array, instance
from plant.parts.checkpoint import Checkpoint
from plant.parts.sums import product

_PATIENCE = 20  # draws per plant at most, until one is an arm
# steps in which a draw goes towards the identified arm, and how near it comes at most
_CLOSER = 0.9
_NEAREST = 1e-4
_NOT_NEGATIVE = re.compile(
    r"drive\.(viscous|coulomb|curve\.breakaway|elasticity)|springs(\[\d+\])?\.stiffness"
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
    was not identified, and what else is stated; resonances are those of the gears at `pose` (n,)
    [rad], zeros by default. A progress bar and the stages of a checkpoint are those of the records
    that are fitted again on elastic gears. `normals`, in place of a random generator, gives the
    samples as a function of its numbers; which of them are arms it is told.
    """
    instance("rig", rig, Rig, "The order is found, rig, law, reference.")
    pose = np.zeros(rig.n) if pose is None else pose
    _require_possible(uncertainty, rig)
    known = identified(uncertainty, found, pose, progress, checkpoint)
    arm = known.arm
    unknown = known.names
    random = normals or np.random.default_rng(seed)
    shape = samples, 1 + len(uncertainty.resonance or ())
    places = (normals or np.random.default_rng((seed, 2))).uniform(0, 1, shape)
    rig = _with_found(
        rig,
        {n: v for n, v in zip(unknown, known.values, strict=True) if n not in arm.dynamics.names},
    )
    of_arms, numbers, f, redrawn, projected = _arms(uncertainty, known, rig, random, places)
    own, of_hardware, others = _hardware(uncertainty, random, rig, samples)
    rig = placed_in(_with_middle(uncertainty, arm, own, pose), uncertainty.imperfections)
    gears = _gears(uncertainty, random, arm, rig, f, pose, places)
    names = (*of_arms, *of_hardware, *gears.names)
    values = np.hstack([numbers, others, gears.values])
    varying = np.flatnonzero(np.ptp(values, axis=0) > 0)
    expected = np.zeros_like(values)
    if known.refits is not None:
        expected[:, [names.index(name) for name in unknown]] = known.centres(places[:, :-1])
    return Plants(
        arm=arm,
        rig=rig,
        f=f,
        names=tuple(names[i] for i in varying),
        values=values[:, varying],
        dropped=float(uncertainty.dropped),
        redrawn=redrawn,
        projected=projected,
        seed=seed,
        own=own,
        uncertainty=uncertainty,
        derived_names=gears.derived_names,
        derived=gears.derived,
        said=statement(uncertainty, own, known),
        expected=expected[:, varying],
    )


def _require_possible(uncertainty: Uncertainty, rig: Rig) -> None:
    """Refuse what this rig cannot have, before anything is fitted or sampled."""
    if uncertainty.resonance is not None:
        if (given := len(uncertainty.resonance)) not in (1, rig.n):
            raise ValueError(
                f"resonance must be one pair, or {rig.n}; got {given}. Give (low, high)."
            )
        rig = with_gears(rig, Elasticity(stiffness=np.ones(rig.n), damping=np.zeros(rig.n)))
    for ends in zip(*uncertainty.imperfections.values(), strict=True):
        placed_in(
            rig,
            {name: (0.0, end) for name, end in zip(uncertainty.imperfections, ends, strict=True)},
        )


def _arms(uncertainty, known, rig, random, places):
    """Names (K), values (P, K) and f with the load (P, p) of arms; how many were drawn again,
    and projected.
    """
    dynamics, samples = known.arm.dynamics, len(places)
    given = None if uncertainty.plants is None else _possible(dynamics, rig, uncertainty.plants)
    direction, friction = (
        _load_direction(uncertainty, dynamics),
        _friction(uncertainty, rig, known.names),
    )

    def drawn(rows):
        """Names and values (K, count) of draws."""
        count = len(rows)
        values = dict(zip(known.names, known.draw(random, places[rows, :-1]).T, strict=True))
        if given is not None:
            values = dict(zip(dynamics.names, given[rows % len(given)].T, strict=True))
        for name, level in friction.items():
            values[name] = level * (1 + uncertainty.friction * random.standard_normal(count))
        return values | {"load": random.uniform(*uncertainty.load, count)}

    def arms(values):
        """Their f with the load (count, p), and whether each is an arm."""
        f = np.tile(known.arm.f, (len(values["load"]), 1))
        for i, name in enumerate(dynamics.names):
            f[:, i] = values.get(name, f[:, i])
        f = f + values["load"][:, None] * direction
        sound = least_inertia_margin(dynamics, rig, f) >= 0
        for name in values:
            sound &= not _NOT_NEGATIVE.match(name) or values[name] >= 0
        return f, sound

    values = drawn(np.arange(samples))
    (f, sound), redrawn, projected = arms(values), 0, 0
    middle = dict(zip(known.names, known.values, strict=True)) | friction
    # its numbers are given: the first arm stands where there is none
    if not isinstance(random, np.random.Generator):
        random.sound = sound
        instead = np.where(sound, np.arange(len(f)), sound.argmax())
        return (
            tuple(values),
            np.column_stack([*values.values()])[instead],
            f[instead],
            redrawn,
            projected,
        )
    while not sound.all():
        again = np.flatnonzero(~sound)
        redrawn += len(again)
        others = drawn(again)
        if redrawn > _PATIENCE * samples:
            others = _projected(others, middle, arms)
            projected = len(again)
        for name, some in others.items():
            values[name][again] = some
        f[again], sound[again] = arms(others)
        if projected and not sound.all():
            none = (
                f"{redrawn} were not (D(q) indefinite, or negative friction), nor is the one"
                " identified"
            )
            raise ValueError(
                f"samples must be arms; {none}. Give a smaller covariance, or a better experiment."
            )
    return tuple(values), np.column_stack([*values.values()]), f, redrawn, projected


def _projected(values, middle, arms):
    """Draws, name -> (count,), those that are no arms on straight lines towards the middle until
    they are.
    """
    share = 1.0
    values = dict(values)
    while share > _NEAREST and not (sound := arms(values)[1]).all():
        share *= _CLOSER
        for name in middle.keys() & values.keys():
            values[name] = np.where(
                sound, values[name], middle[name] + _CLOSER * (values[name] - middle[name])
            )
    return values


def _hardware(uncertainty, random, rig, samples):
    """The rig with a place for encoder offsets and delay, the names (K) of those sampled, and
    their values (P, K).
    """
    names = []
    values = [np.empty((samples, 0))]
    changes = {}
    if uncertainty.phase:
        names += [f"encoder.phase.shift[{i}]" for i in range(rig.n)]
        values.append(random.uniform(-0.5, 0.5, (samples, rig.n)))
        changes["encoder"] = dataclasses.replace(rig.encoder, phase=Phase(shift=(0.0,) * rig.n))
    if uncertainty.delay[1] or uncertainty.dropped:
        names.append("transport.delay")
        values.append(random.uniform(*uncertainty.delay, (samples, 1)))
        changes["transport"] = Transport(delay=uncertainty.delay[1])
    return dataclasses.replace(rig, **changes), names, np.hstack(values)


def _with_middle(uncertainty, arm, rig, pose):
    """The rig with elastic gears in the middle of the range that is stated."""
    if uncertainty.resonance is None:
        return rig
    middle = np.sqrt(np.prod(uncertainty.resonance, axis=1))
    damping = np.mean(uncertainty.damping_ratio)
    return with_gears(rig, Elasticity.from_resonance(arm, middle, damping, drive=rig.drive, q=pose))


def _gears(uncertainty, random, arm, rig, f, pose, places):
    """Gears and drives of arms with these f (P, p), at these places (P, m + 1) of the ranges of
    resonance, damping.
    """
    count = len(f)
    n = rig.n
    others = drawn_of(uncertainty.imperfections, random, count, n)
    if uncertainty.resonance is None:
        return others
    low, high = np.log(uncertainty.resonance).T
    hz = np.exp(low + places[:, :-1] * (high - low))
    ratio = uncertainty.damping_ratio[0] + places[:, -1:] * np.ptp(uncertainty.damping_ratio)
    links = product(f, shaft_inertias(arm.dynamics, rig, pose)) - rig.drive.reflected_inertia()
    found = gears(np.broadcast_to(hz, (count, n)), ratio, links)
    names = ["resonance"] if len(low) == 1 else [f"resonance[{i}]" for i in range(n)]
    own = [f"drive.elasticity.{name}[{i}]" for name in ("stiffness", "damping") for i in range(n)]
    return Drawn(
        names=(*names, "damping_ratio", *others.names),
        values=np.hstack([hz, ratio, others.values]),
        derived_names=(*own, *others.derived_names),
        derived=np.hstack([*found, others.derived]),
    )


def _friction(uncertainty, rig, unknown):
    """Name -> value of the friction that was not identified."""
    known = (
        dict(zip(rig.number_names(), rig.number_values(), strict=True))
        if uncertainty.friction > 0
        else {}
    )
    names = [name for name in known if name.startswith(("drive.viscous", "drive.coulomb"))]
    return {name: known[name] for name in names if name not in unknown and known[name] > 0}


def _load_direction(uncertainty, dynamics):
    """Change (p,) of f per kg in the gripper."""
    if uncertainty.load[1] == 0:
        return np.zeros(dynamics.p)
    nothing = [Body(mass=0.0, com=(0, 0, 0)) for _ in range(dynamics.n - 1)]
    return dynamics.f([*nothing, Body(mass=1.0, com=uncertainty.load_position)])


def _with_found(rig, values):
    """The rig with the values that were identified of its numbers."""
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
    wrong = np.flatnonzero(least_inertia_margin(dynamics, rig, plants) < 0)
    if len(wrong):
        row = f"row {wrong[0]} has D(q) below the motors' own inertia"
        raise ValueError(f"plants must all be arms; {row}. Leave it out.")
    return plants


def statement(
    uncertainty: Uncertainty, rig: Rig, known: Identified
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What is sampled of an `Uncertainty` with these identified numbers, and what is not."""
    u = uncertainty
    drawn = []
    identified = [
        name for name in known.names if name.startswith(("drive.viscous", "drive.coulomb"))
    ]
    every = len(identified) == 2 * rig.n
    friction = (
        f"friction{' that was not identified' * bool(identified)} ±{100 * u.friction:.3g} %"
        " (standard deviation)"
    )
    if every:
        friction = "friction as identified (friction= is of what was not)"
    if u.plants is not None:
        drawn.append("f of given arms")
    elif known.refits is not None:
        drawn.append(
            f"what the log says on gears of {len(known.refits.places)} resonances of the range"
        )
    elif known.names:
        drawn.append("what was identified")
    hz = ", ".join(f"{low:g} to {high:g}" for low, high in u.resonance or ())
    alike = "all joints alike" if len(u.resonance or ()) == 1 else "of each joint"
    gears = f"resonance {hz} Hz ({alike}), damping ratio {spread(u.damping_ratio or (0.0, 0.0))}"
    stiff = "elasticity" if rig.drive.elasticity is None else "resonance (as the rig has it)"
    rows = [
        (u.resonance is not None, gears, stiff),
        (every or u.friction > 0, friction, "friction"),
        (u.load[1] > 0, f"load {spread(u.load)} kg", "load"),
        (u.phase, "encoder zeros", "encoder zeros"),
        (u.delay[1] > 0, f"delay {spread(u.delay)} s", "delay"),
        (u.dropped > 0, f"lost counts {100 * u.dropped:g} %", "lost counts"),
    ]
    for name, row in IMPERFECTIONS.items():
        own = "" if row.own(rig) is None else " (as the rig has it)"
        rows.append(
            (
                any(getattr(u, name)),
                f"{row.words} {spread(getattr(u, name))} {row.unit}",
                f"{row.words}{own}",
            )
        )
    drawn += [said for there, said, _ in rows if there]
    return tuple(drawn), tuple(name for there, _, name in rows if not there)
