"""Rigs, laws and logs drawn from a seed: what an ordinary machine can be, run by `own_engine`.

Turning and sliding joints, springs, constant gravity, controllers with and without an integral,
sampled and fast; logs cut at an instant, joints at rest, joints that move in line with each other.
Everything that is stated of a machine is right.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
import own_engine as engine

from plant import (
    PD,
    PID,
    Body,
    Cascade,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    JointSpring,
    Link,
    P,
    Record,
    Rig,
    simulate,
)

SUB = 24  # sub-steps of a millisecond: of second order, so a delay below 1/500 of a sample
KINDS = ("ordinary", "ordinary", "at rest", "collinear")


class Case(NamedTuple):
    """A log, the machine's dynamics, what is unknown of it, and the true values (k,) of that."""

    record: Record
    dynamics: Dynamics
    unknown: tuple[str, ...]
    truth: np.ndarray
    about: str


GAINS = ("gain", "derivative", "speed", "integral")


def driven(rig, law, arm, path, factor, limit, duration=2.0):
    """The right log of a loop with larger gains and smaller limits, simulated by the library."""
    gains = {name: factor * np.array(getattr(law, name)) for name in GAINS if hasattr(law, name)}
    limits = limit * np.array(rig.drive.current_limit)
    drive = dataclasses.replace(rig.drive, current_limit=limits)
    rig = dataclasses.replace(rig, drive=drive)
    return simulate(arm, rig, dataclasses.replace(law, **gains), path, duration=duration)


def hard_driven(seed, factor, limit):
    """The right log of a drawn machine, with larger gains and smaller limits."""
    case = drawn(seed, torque=True)
    record = case.record
    arm = case.dynamics.arm(case.truth[: len(case.dynamics.names)])
    return driven(record.rig, record.law, arm, record.reference, factor, limit)


def drawn(seed, *, torque=None, period=None):
    """The case of this seed.

    `torque` decides whether its log has one, and `period` [s] how often it is sampled; by default
    chance does.
    """
    random = np.random.default_rng([60, seed])
    chain = _chain(random)
    kind = KINDS[random.integers(len(KINDS))]
    chance = float(random.choice([5e-4, 1e-3]))
    period = chance if period is None else period
    path = _path(chain, kind, random)
    rig, springs = _rig(chain, path, period, random)
    whole = Dynamics.from_chain(chain.with_rotors(rig.drive))
    arm = whole.arm(whole.f())
    # What is identified knows nothing of the bodies.
    dynamics = Dynamics.from_chain(dataclasses.replace(chain, bodies=()))
    assert dynamics.names == whole.names
    law = _law(arm, rig, path, random)
    # A controller that runs away or swings gives no log: the case is drawn anew.
    begin = float(random.choice([0.0, 0.0, 0.83, 1.7]))
    record = log_of(chain, rig, springs, law, path, begin + float(random.choice([2.5, 4.0])))
    if not np.isfinite(record.error_pulses).all() or _swings(record):
        return drawn(seed + 1_000_000, torque=torque)
    logged = bool(random.random() < 0.3)
    logged = logged if torque is None else torque
    known = bool(random.random() < 0.7)
    record = record.cut(begin) if begin else record
    if not logged:
        record = dataclasses.replace(record, torque=None)
    if not known:
        record = dataclasses.replace(record, reference=None)
    unknown, truth = dynamics.names, arm.f
    opened = bool(random.random() < 0.5)
    if opened:
        kinds = [
            (f"drive.{name}[{i}]", name, i)
            for name in ("viscous", "coulomb")
            for i in range(chain.n)
        ]
        unknown = (*unknown, *(name for name, _, _ in kinds))
        truth = np.append(truth, [getattr(rig.drive, name)[i] for _, name, i in kinds])
        drive = dataclasses.replace(
            rig.drive, viscous=1.3 * rig.drive.viscous, coulomb=0.7 * rig.drive.coulomb
        )
        record = dataclasses.replace(record, rig=dataclasses.replace(rig, drive=drive))
    about = (
        f"{''.join('RP'[link.prismatic] for link in chain.links)} {kind}, {type(law).__name__}"
        f"{' fast' if law.period is None else ''}"
        f"{', cut' if begin else ''}{', torque' if logged else ''}"
        f"{'' if known else ', no path'}{', friction' if opened else ''}"
        f"{', spring' if springs is not None else ''}"
    )
    return Case(record, dynamics, unknown, truth, about)


def _chain(random):
    n = int(random.choice([1, 1, 2, 2, 3]))
    links = []
    bodies = []
    for i in range(n):
        alpha = float(random.choice([0.0, np.pi / 2, -np.pi / 2]))
        a, d = random.uniform(-0.4, 0.4, 2)
        theta = float(random.uniform(-1, 1))
        slides = bool(random.random() < 0.4)
        links.append(
            Link(name=f"j{i}", alpha=alpha, a=float(a), d=float(d), theta=theta, prismatic=slides)
        )
        points, masses = random.uniform(-0.3, 0.3, (8, 3)), random.uniform(0.1, 0.8, 8)
        mass, com = masses.sum(), masses @ points / masses.sum()
        second = np.einsum("k,ki,kj->ij", masses, points - com, points - com)
        tensor = np.trace(second) * np.eye(3) - second
        bodies.append(Body(mass=mass, com=com, inertia=tensor[np.triu_indices(3)]))
    # Standing, on a wall, tilted, or lying in a plane without weight.
    gravity = [(0, 0, -9.81), (0, 0, -9.81), (0, -9.81, 0), (3.0, -6.0, -7.0), (0, 0, 0)]
    chosen = gravity[random.integers(len(gravity))]
    return Chain(links=tuple(links), gravity=tuple(map(float, chosen)), bodies=tuple(bodies))


def _path(chain, kind, random):
    n = chain.n
    size = np.where([link.prismatic for link in chain.links], 0.05, 0.4)
    cosine, sine = random.normal(size=(2, n, 4)) / np.arange(1, 5) ** 1.3
    if kind == "collinear":
        scale = random.uniform(0.4, 1.2, (n, 1)) * random.choice([-1, 1], (n, 1))
        cosine, sine = scale * cosine[:1], scale * sine[:1]
    if kind == "at rest" and n > 1:
        cosine[random.integers(n)] = sine[random.integers(n)] = 0.0
        still = int(random.integers(n))
        cosine[still] = sine[still] = 0.0
    return Harmonics(
        period=float(random.choice([2.5, 4.0])),
        offset=random.uniform(-1, 1, n) * size,
        cosine=cosine * size[:, None],
        sine=sine * size[:, None],
    )


def _rig(chain, path, period, random):
    n = chain.n
    slides = np.array([link.prismatic for link in chain.links])
    gear = np.where(slides, 2 * np.pi / random.uniform(0.005, 0.02, n), random.uniform(40, 120, n))
    gear *= random.choice([-1.0, 1.0], n)
    # Inertia and torque of the links alone along the path, by the engine.
    bodies = bodies_of(chain)
    motion = path(np.linspace(0, path.period, 60))
    moments = np.array([np.diag(engine.inertia(bodies, np.zeros(n), q)) for q in motion.q])
    needed = np.array(
        [
            engine.inverse(bodies, q, qd, qdd, bodies.gravity)
            for q, qd, qdd in zip(*motion[:3], strict=True)
        ]
    )
    rotor = random.uniform(0.2, 1.5, n) * moments.max(axis=0)
    largest = np.abs(needed).max(axis=0) + rotor * np.abs(motion.qdd).max(axis=0) + 1e-3
    speed = np.maximum(np.abs(motion.qd).max(axis=0), np.where(slides, 0.02, 0.1))
    coulomb = random.uniform(0.02, 0.2, n) * largest
    viscous = random.uniform(0.02, 0.2, n) * largest / speed
    springs = None
    if random.random() < 0.3:
        springs = JointSpring(
            stiffness=random.uniform(0.1, 0.5, n) * largest / np.where(slides, 0.1, 1.0),
            angle=random.uniform(-1, 1, n) * np.where(slides, 0.05, 0.5),
        )
    gain = random.uniform(0.05, 0.5, n)
    drive = Drive(
        gear=gear,
        motor_inertia=rotor / gear**2,
        viscous=viscous / gear**2,
        coulomb=coulomb / np.abs(gear),
        motor_gain=gain,
        current_limit=random.uniform(4, 8) * largest / np.abs(gear) / gain,
    )
    encoder = Encoder(resolution=random.choice([1000.0, 2000.0, 8192.0], n))
    return Rig(drive=drive, encoder=encoder, period=period, springs=springs), springs


def _law(arm, rig, path, random):
    """A controller whose bandwidth suits the machine."""
    n = rig.n
    moment = np.diag(arm.D(path([0.0]).q[0]))
    # Motor torque per pulse and per rad/s^2 of the joint.
    pulse = np.abs(rig.encoder.resolution * rig.drive.gear) / (2 * np.pi)
    unit = moment / np.abs(rig.drive.gear) / pulse
    kind = int(random.integers(4))
    if kind == 0:
        w = random.uniform(25, 60, n)
        return P(gain=unit * w**2)
    period = None if kind < 3 and random.random() < 0.4 else rig.period
    pole = 600.0
    if kind < 3:
        w = random.uniform(30, 80, n)
        gains = {"gain": unit * w**2, "derivative": unit * 1.4 * w, "filter": pole}
        if kind == 1:
            return PD(**gains, period=period)
        return PID(**gains, integral=unit * w**3 * random.uniform(0.1, 0.3), period=period)
    w = random.uniform(50, 120, n)
    speed = (
        {"filter": pole} if random.random() < 0.5 else {"difference": int(random.integers(1, 4))}
    )
    return Cascade(
        position=random.uniform(0.1, 0.25) * w,
        speed=unit * w,
        integral=unit * w * random.uniform(3, 15, n),
        **speed,
        period=period,
    )


def bodies_of(chain):
    """The chain's bodies for the engine."""
    order = [[0, 1, 2], [1, 3, 4], [2, 4, 5]]
    return engine.Bodies(
        rows=np.array([[link.alpha, link.a, link.d, link.theta] for link in chain.links]),
        slides=np.array([link.prismatic for link in chain.links]),
        mass=np.array([body.mass for body in chain.bodies]),
        com=np.array([body.com for body in chain.bodies]),
        inertia=np.array([np.asarray(body.inertia)[order] for body in chain.bodies]),
        gravity=np.array(chain.gravity, float),
    )


def log_of(chain, rig, springs, law, path, duration):
    """The log of the engine, from the start of the controller."""
    n = chain.n
    drive, period = rig.drive, rig.period
    counts = drive.gear * rig.encoder.resolution / (2 * np.pi)
    machine = engine.Machine(
        rotor=drive.motor_inertia * drive.gear**2,
        viscous=drive.viscous * drive.gear**2,
        coulomb=drive.coulomb * np.abs(drive.gear),
        spring=np.zeros(n) if springs is None else springs.stiffness,
        rest=np.zeros(n) if springs is None else springs.angle,
        limit=np.abs(drive.gear) * drive.motor_gain * drive.current_limit,
        counts=counts,
        shift=np.zeros(n),
    )
    samples = round(duration / period)
    t = period * np.arange(samples)
    steps = SUB * max(1, round(period / 1e-3))
    between = period / steps * (np.arange(samples * steps) + 0.5)
    motion = path(t)
    reference, finer = (np.floor(q * counts) for q in (motion.q, path(between).q))
    counted, torque = engine.run(
        bodies_of(chain), machine, _controller(law, drive.gear),
        motion.q[0], motion.qd[0], reference, finer, period, steps,
    )  # fmt: skip
    return Record(
        t=t,
        reference_pulses=reference,
        error_pulses=reference - counted,
        torque=torque,
        rig=rig,
        law=law,
        reference=path,
    )


def _controller(law, gear):
    """The law's numbers in the order of the engine, on the joint."""
    zero = np.zeros(len(gear))
    kind = [P, PD, PID, Cascade].index(type(law))
    gains = [
        lambda: (law.gain, zero, zero),
        lambda: (law.gain, law.derivative, zero),
        lambda: (law.gain, law.derivative, law.integral),
        # The position gain makes a speed of pulses, no torque.
        lambda: (law.position / gear, law.speed, law.integral),
    ][kind]()
    return engine.Controller(
        kind=kind,
        gains=np.array(gains) * gear,
        pole=float(getattr(law, "filter", None) or 0.0),
        difference=int(getattr(law, "difference", 0)),
        fast=law.period is None,
    )


def _swings(record):
    """Whether the loop does not follow its path: far off, or at its limit."""
    error = np.abs(record.error_pulses)
    travel = np.ptp(record.reference_pulses, axis=0).max()
    limit = record.rig.drive.torque_limit()
    return bool((error.max() > travel) or (np.abs(record.torque) > 0.99 * limit).mean() > 0.02)
