"""Causes, tried on another engine: is what was spoiled named first? A part of `second_reading.py`.

    python tests/benchmarks/second_reading.py causes [--logs 40] [--arms puma ur5e] [--only NAME ...] [--said]
        [--law P | PID | computed_torque]

Two arms in MuJoCo under a law with dry friction, on paths drawn from a seed. One thing is spoiled: the machine, or
what is stated of it, or the log. Of four logs in turn two have the other gain, and two the logged torque. First is what
`record.check()` finds first; where it finds nothing, the first warning of `identify`, or its refusal.
"""

import collections
import dataclasses
import functools
import re
import sys
import warnings
from pathlib import Path

import numpy as np

from ctc import ComputedTorque
from identification import identify
from plant import PID, Chain, Dynamics, Harmonics, Link, P, Record, puma560

sys.path.insert(0, str(Path(__file__).parents[1] / "oracles"))
from mujoco_odd import run
from packaged_arms import elbow_of_a_ur5e
from spoilers import glitches, late, late_stamps, lost_packets, stuck, turn


def puma(strong):
    """Truth, dynamics without values, rig and gains of P of the arm of the paper."""
    links = (Link(name="2", alpha=-np.pi / 2), Link(name="3", a=puma560.LINK_LENGTH))
    return (
        puma560.literature_arm(1.5),
        Chain(links=links),
        puma560.rig(),
        (0.20, 0.15) if strong else (0.10, 0.075),
    )


def ur5e(strong):
    """The same of shoulder lift and elbow of the UR5e: gears, encoders and friction as the tests
    have them.
    """
    chain, rig = elbow_of_a_ur5e("fix")
    chain = chain.with_rotors(rig.drive)
    dynamics = Dynamics.from_chain(chain)
    return dynamics.arm(dynamics.f()), chain, rig, (0.080, 0.0295) if strong else (0.042, 0.0153)


ARMS = {"puma": puma, "ur5e": ur5e}


def _pid(truth, rig, gain):
    gain = np.array(gain) / 2
    return PID(
        gain=gain, integral=5 * gain, derivative=0.004 * gain, filter=2000.0, period=rig.period
    )


def _computed_torque(truth, rig, gain):
    """Of f that is 5 % off, and the faster the stronger P would be."""
    f = truth.f * (1 + 0.05 * (-1.0) ** np.arange(len(truth.f)))
    return ComputedTorque(truth.dynamics.arm(f), rig, bandwidth=100.0 if gain[0] > 0.05 else 60.0)


LAWS = {
    "P": lambda truth, rig, gain: P(gain=gain),
    "PID": _pid,
    "computed_torque": _computed_torque,
}
"""By truth, rig and gains of P."""


def path_of(random, upright=0.0):
    """A smooth path whose joints pass zero; `upright`: or about this angle of the first [rad]."""
    cosine, sine = (random.normal(size=(2, 3)) * 0.35 / np.arange(1, 4) for _ in range(2))
    period, offset = random.uniform(2.5, 3.0), random.uniform(-0.2, 0.2, 2)
    return Harmonics(
        period=period, offset=offset + np.array((upright, 0.0)), cosine=cosine, sine=sine
    )


# -- what is spoiled -----------------------------------------------------------------------------
@dataclasses.dataclass
class Given:
    """What a user has: records, chain, and the draw that spoils them."""

    records: list
    chain: Chain
    random: np.random.Generator
    truth: object = None
    """The arm that moved; None where only nature knows it."""
    path: object = None

    def stated(self, encoder=None, **drive):
        """The rig stated wrongly; the path is as it was, and what it is in counts stands in the
        log.
        """
        for i, record in enumerate(self.records):
            rig = dataclasses.replace(
                record.rig,
                drive=dataclasses.replace(record.rig.drive, **drive),
                encoder=dataclasses.replace(record.rig.encoder, **(encoder or {})),
            )
            # which counts leave open
            path = record.reference if self.has_path else None
            self.records[i] = dataclasses.replace(record, rig=rig, reference=path)

    def each(self, **columns):
        """Columns of the log changed, by functions of the record."""
        for i, record in enumerate(self.records):
            new = {name: change(record) for name, change in columns.items()}
            self.records[i] = dataclasses.replace(record, **{"reference": None} | new)

    @property
    def has_path(self):
        """Whether the law needs its path, which counts leave open."""
        return isinstance(self.records[0].law, ComputedTorque)


def _links(given, change):
    first, second = given.chain.links
    given.chain = dataclasses.replace(given.chain, links=(first, change(second)))


def _longer(factor):
    def longer(link):
        x = np.array(link.before.position) * factor
        return dataclasses.replace(
            link, a=link.a * factor, before=dataclasses.replace(link.before, position=tuple(x))
        )

    return longer


def _turned(given):
    sign = np.array((1.0, -1.0))
    path = {"reference": lambda record: record.reference.moved(sign, (0.0, 0.0))}
    given.each(
        **{
            name: lambda record, name=name: sign * getattr(record, name)
            for name in ("error_pulses", "reference_pulses", "torque")
            if given.records[0].torque is not None or name != "torque"
        },
        **path if given.has_path else {},
    )


def _upward(given):
    given.chain = dataclasses.replace(given.chain, gravity=tuple(-g for g in given.chain.gravity))


def _degrees(given):
    turn = 180 / np.pi
    given.each(
        reference_pulses=lambda r: turn * r.reference_pulses,
        error_pulses=lambda r: turn * r.error_pulses,
    )


def again(change):
    """Each record spoiled by a function of `spoilers`."""

    def spoil(given):
        given.records = [change(record, given.random) for record in given.records]

    return spoil


def _gain(given):
    factor = 1 + given.random.choice((-1, 1)) * given.random.uniform(0.15, 0.4)
    name = "gain" if hasattr(given.records[0].law, "gain") else "bandwidth"
    _restated(given, **{name: factor * np.array(getattr(given.records[0].law, name))})


def _restated(given, **numbers):
    """The law stated otherwise than it ran."""
    given.records = [
        dataclasses.replace(each, law=dataclasses.replace(each.law, **numbers))
        for each in given.records
    ]


def _lacking(given):
    """Stated without the rate of its error; computed torque without its friction."""
    law = given.records[0].law
    if law.period:
        _restated(
            given, **({"derivative": (0.0, 0.0)} if isinstance(law, PID) else {"friction": False})
        )


def _gear(given):
    gear = np.array(given.records[0].rig.drive.gear)
    gear[given.random.integers(2)] *= 1 + given.random.choice((-1, 1)) * given.random.uniform(
        0.05, 0.2
    )
    given.stated(gear=gear)


def _swap(given):
    given.each(error_pulses=lambda r: r.reference_pulses - r.counts[:, ::-1])


def exchanged(field):
    """Two columns of a field exchanged, of joints drawn; of the reference, the counts stay."""

    def spoil(given):
        n = given.records[0].n
        one, two = given.random.choice(n, 2, replace=False)
        order = np.arange(n)
        order[[one, two]] = two, one
        changes = {
            "counts": {"error_pulses": lambda r: r.reference_pulses - r.counts[:, order]},
            "reference": {
                "reference_pulses": lambda r: r.reference_pulses[:, order],
                "error_pulses": lambda r: r.reference_pulses[:, order] - r.counts,
            },
            "torque": {"torque": lambda r: r.torque[:, order]},
        }
        given.each(**changes[field])

    return spoil


def _torque(change):
    """The logged torque changed, by a function of the record and what is given."""
    return lambda given: given.each(torque=lambda record: change(record, given))


def _per_mille(record, given):
    limit = record.rig.drive.torque_limit()
    # without a limit the vendor's rated torque is the largest one
    rated = np.where(np.isfinite(limit), limit, np.abs(record.torque).max(axis=0))
    return 1000 * record.torque / rated


def _without_gravity(record, given):
    still = np.zeros(record.n)
    # gravity changes slowly: every tenth sample is enough
    rows = np.append(np.arange(0, len(record) - 1, 10), len(record) - 1)
    angles = record.rig.cell_centre(record.counts)[rows]
    held = np.array([np.ravel(given.truth.inverse(q, still, still)) for q in angles])
    held = np.column_stack([np.interp(record.t, record.t[rows], column) for column in held.T])
    return record.torque - held


def _of_a_model(record, given):
    """Inverse dynamics of another arm along the path, without friction."""
    truth = given.truth
    arm = truth.dynamics.arm(truth.f * given.random.uniform(0.85, 1.15, len(truth.f)))
    if given.path is None:
        q = record.rig.cell_centre(record.counts)
        kernel = np.hanning(17)[1:-1] / 8
        q = np.column_stack([np.convolve(np.pad(x, 7, "edge"), kernel, "valid") for x in q.T])
        qd = np.gradient(q, record.t, axis=0)
        motion = q, qd, np.gradient(qd, record.t, axis=0)
    else:
        motion = given.path(record.t)
    return np.array([np.ravel(arm.inverse(*state)) for state in zip(*motion, strict=True)])


def _jittered_stamps(given):
    """Stamps within half an interval of the instants at which the counts were read."""
    for i, record in enumerate(given.records):
        period = record.rig.period
        t = record.t + period * given.random.uniform(-0.25, 0.25, len(record))
        given.records[i] = dataclasses.replace(record, t=t - t[0], reference=None)


def _zero_off(given):
    """The zero of a joint 90 degrees from that of the model."""
    rig = given.records[0].rig
    turn = np.zeros(rig.n)
    turn[given.random.integers(rig.n)] = given.random.choice((-1, 1)) * np.pi / 2
    turn = np.round(rig.position_in_pulses(turn))
    offset = rig.to_angle(turn) - rig.to_angle(0 * turn)
    path = {"reference": lambda record: record.reference.moved((1.0, 1.0), offset)}
    given.each(
        reference_pulses=lambda r: r.reference_pulses + turn * r.reference_pulses.any(),
        **path if given.has_path else {},
    )
    if not given.records[0].reference_pulses.any():
        given.each(error_pulses=lambda r: r.error_pulses - turn)


def _tilted(given):
    """Gravity stated 10 to 30 degrees off, about each axis."""
    angle, axis = np.deg2rad(given.random.uniform(10, 30)), given.random.normal(size=3)
    axis /= np.linalg.norm(axis)
    g = np.array(given.chain.gravity)
    cross = np.cross(axis, g)
    turned = g * np.cos(angle) + cross * np.sin(angle) + axis * (axis @ g) * (1 - np.cos(angle))
    given.chain = dataclasses.replace(given.chain, gravity=tuple(turned))


def is_hidden(name, given):
    """Whether no log can show what was spoiled, so that silence is right.

    The zero of a joint, or a tilt, is hidden where the stated chain with another f needs exactly the same torques. A
    constant torque is hidden where no torque was logged and the law has an integral, whose state before the log is
    unknown: both are one number.
    """
    record = given.records[0]
    if name == "asymmetric friction":
        return record.torque is None and record.law is not None and bool(record.law.period)
    if name not in ("zero off", "tilted base") or given.path is None:
        return False
    t = record.t[::20]
    motion = given.path(t)
    turned = np.median(record.rig.cell_centre(record.counts) - given.path(record.t).q, axis=0)
    stated = Dynamics.from_chain(given.chain)
    columns, torques = [], []
    for q, qd, qdd in zip(*motion, strict=True):
        columns.append(np.array(stated.Y(q + turned, qd, qdd)))
        torques.append(np.ravel(given.truth.inverse(q, qd, qdd)))
    A, b = np.concatenate(columns), np.concatenate(torques)
    left = b - A @ np.linalg.lstsq(A, b, rcond=None)[0]
    return float(np.abs(left).max()) < 1e-6 * float(np.abs(b).max())


def uniform(low, high, name, **more):
    """A machine with this number drawn."""
    return lambda random: {name: random.uniform(low, high), **more}


@dataclasses.dataclass(frozen=True)
class Cause:
    """What is spoiled, and the labels (of LABELS) that name it."""

    right: tuple[str, ...]
    machine: object = None
    stated: object = None
    two: bool = False
    """Two records, only the second is of this machine."""
    unloaded: bool = False
    """About where gravity changes sign, hanging or upright."""
    sampled: tuple[str, ...] = ()
    """What names it as well where the law reads the counts that are logged."""
    torque: bool = False
    """Only where the log has a torque."""
    reading: str = ""
    """The name of a way to read the log wrongly (READINGS)."""

    @property
    def other_machine(self):
        """Whether a right log does not serve."""
        return bool(self.machine or self.two or self.unloaded)


LABELS = {
    "sign of a joint": r"turns the other way",
    "sign of gravity": r"gravity acts the other way",
    "lengths": r"lengths are not the chain's|in metres",
    "cogging": r"motors cog",
    "law": r"the rate of its error|another variant|gives another torque than",
    "taken back": r"look for another cause",
    "gain or friction": r"or gains of law or motor are not",
    "gain or gear": r"check gain, motor gain and gear|its gains and period, gears",
    "rounding": r"wide cell|cell two pulses wide",
    "lost rows": r"lost|repeat(s|ed) the row|packet",
    "late counts": (
        r"counts (are|were) [\d.]+ samples|not logged at the same time|samples? late|samples? early"
        r"|torques are late"
    ),
    "lag of the loop": r"torques lag",
    "speed error": r"error grows with speed",
    "elastic": r"joints are elastic",
    "play": r"(has|this) backlash",
    "offset": r"have an offset",
    "friction": r"[Ff]riction is not the rig's|Coulomb friction is",
    "gain": r"times the commanded|cannot have made|gains? .*not the|law's gain .*times what the log",
    "saturated": r"amplifier is at its limit|cut off at",
    "swapped": r"exchange the columns|belongs to the motion",
    "wrong sign": r"wrong sign|change the sign|backwards|runs? against",
    "scale of counts": (
        r"times as far|correct the resolution|resolution|unit|moved? .* turns|steps of"
    ),
    "gears, lengths": r"gears \(or (lengths|counts per turn)",
    "rotor": r"rotor of|below that of its rotor",
    "changes": r"contradict each other|changing|drift|do not hold for both",
    "oscillates": r"oscillates",
    "poor fit": r"follows the log no closer|simulated and measured errors differ",
    "pairs": r"separately identifiable",
}
"""Label -> words of a sentence, the first that fit."""

WORDS = {
    "exchanged references": r"references? .*(are|is) exchanged|[Ee]xchange the .*reference",
    "exchanged torques": r"torques? .*(are|is) exchanged|[Ee]xchange the .*torque",
    "turns": r"in '?turns|revolutions",
    "normalised": r"normalised|share of (its|the|each joint's) range",
    "torque scale": (
        r"times the commanded|in mN m|in kN m|in A\b|crossed the gear|the motor's torque, not"
        r"|rated torque|per mille|torque .*is .*times|torques are [\d.e+]+ times"
    ),
    "without gravity": r"gravity (is|was|has been) (removed|taken out|subtracted|compensated)",
    "of a model": r"torque (is|of|is that of) a model|not measured but",
    "stuck samples": r"Counts of a joint repeat",
    "glitches": r"Single counts are off",
    "lost turn": r"The counts jump by",
    "stamps": r"Stamps are late or early|[Ii]ntervals jitter|stamps jitter|At odd intervals|[Ss]tamps are late",
    "play": r"(has|this) backlash",
    "little motion": r"^motion: |log a motion of all joints",
    "zero of a joint": r"zero of|zero is|offset by .*degrees",
    "gravity's direction": r"base is tilted|direction of gravity|tilted",
}
"""The same of what sentences of other labels may say, too."""

CAUSES = {
    "healthy": Cause(("",)),
    "floor/fix": Cause(("rounding",), lambda random: {"rounding": "floor"}),
    "lost rows": Cause(("lost rows",), stated=again(lost_packets)),
    "late log": Cause(("late counts",), stated=again(late)),
    "late loop": Cause(
        ("lag of the loop", "oscillates"), uniform(0.1, 1.0, "delay"), sampled=("late counts",)
    ),
    "asymmetric friction": Cause(("offset",), uniform(0.15, 0.5, "offset")),
    "Stribeck": Cause(("friction",), uniform(0.3, 1.0, "stribeck")),
    "elastic": Cause(("elastic",), uniform(15, 60, "hertz")),
    "play": Cause(("play",), uniform(0.001, 0.006, "play", hertz=300.0), unloaded=True),
    "gear": Cause(("gears, lengths", "rotor", "gain or gear"), stated=_gear),
    "gain": Cause(("gain", "gain or gear", "gain or friction"), stated=_gain),
    "length": Cause(
        ("gears, lengths", "lengths"),
        stated=lambda g: _links(g, _longer(g.random.choice((0.8, 0.9, 1.1, 1.25)))),
    ),
    "sign of a joint": Cause(("sign of a joint",), stated=_turned),
    "sign of gravity": Cause(("sign of gravity",), stated=_upward),
    "swapped columns": Cause(("swapped",), stated=_swap),
    "degrees": Cause(("scale of counts",), stated=_degrees),
    "mm": Cause(("gears, lengths", "lengths"), stated=lambda g: _links(g, _longer(1000.0))),
    "saturation": Cause(("saturated",), lambda random: {"share": "peak"}),
    "PD for P": Cause(
        ("gain", "gain or gear", "law"), uniform(0.005, 0.02, "derivative"), stated=_lacking
    ),
    "load": Cause(("changes",), uniform(1.0, 3.0, "load"), two=True),
    "cogging": Cause(("cogging",), uniform(0.1, 0.4, "cogging")),
    "friction drifts": Cause(("friction", "changes"), uniform(0.3, 0.8, "drift")),
    "exchanged references": Cause(("exchanged references",), stated=exchanged("reference")),
    "exchanged torques": Cause(("exchanged torques",), stated=exchanged("torque"), torque=True),
    "turns": Cause(("scale of counts", "turns"), reading="turns"),
    "normalised": Cause(("scale of counts", "normalised"), reading="normalised"),
    "ampere": Cause(
        ("torque scale",), stated=_torque(lambda r, g: r.rig.drive.current(r.torque)), torque=True
    ),
    "per mille": Cause(("torque scale",), stated=_torque(_per_mille), torque=True),
    "torque 1.96": Cause(
        ("torque scale", "gain"), stated=_torque(lambda r, g: 1.96 * r.torque), torque=True
    ),
    "torque 4": Cause(
        ("torque scale", "gain"), stated=_torque(lambda r, g: 4 * r.torque), torque=True
    ),
    "torque that the joint feels": Cause(
        ("wrong sign",), stated=_torque(lambda r, g: -r.torque), torque=True
    ),
    "without gravity": Cause(("without gravity",), stated=_torque(_without_gravity), torque=True),
    "torque of a model": Cause(("of a model",), stated=_torque(_of_a_model), torque=True),
    "fix/floor": Cause(("rounding",), stated=lambda g: g.stated(encoder={"rounding": "floor"})),
    "fix/round": Cause(("rounding",), stated=lambda g: g.stated(encoder={"rounding": "round"})),
    "jittered stamps": Cause(("stamps",), stated=_jittered_stamps),
    "stuck samples": Cause(("stuck samples", "lost rows"), stated=again(stuck)),
    "glitches": Cause(("glitches",), stated=again(glitches)),
    "lost turn": Cause(("lost turn",), stated=again(turn)),
    "late stamps": Cause(("stamps",), stated=again(late_stamps)),
    "zero off": Cause(("zero of a joint", "sign of gravity"), stated=_zero_off),
    "tilted base": Cause(("gravity's direction", "sign of gravity"), stated=_tilted),
}


def turns(record):
    """Positions in turns, stated in radians."""
    return _read_again(record, "rad", lambda q: q / (2 * np.pi))


def normalised(record):
    """Positions from -100 to 100 in a joint's range, stated in degrees."""

    def scaled(q):
        low, high = q.min(axis=0), q.max(axis=0)
        # the joints were moved by hand somewhat beyond the range of the log
        room = np.array([0.35, 0.2, 0.5, 0.1, 0.3, 0.25, 0.4])[: q.shape[1]]
        low, high = low - room, high + room
        return -100 + 200 * (q - low) / (high - low)

    return _read_again(record, "deg", scaled)


def _read_again(record, unit, change):
    table = {"t": record.t, "q": change(record.rig.cell_centre(record.counts))}
    columns, units = {"t": "t", "position": "q"}, {"t": "s", "position": unit}
    if record.reference_pulses.any():
        table["r"] = change(record.rig.to_angle(record.reference_pulses))
        columns["reference_position"], units["reference_position"] = "r", unit
    if record.torque is not None:
        table["tau"] = record.torque
        columns["torque"], units["torque"] = "tau", "N m"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Record.from_table(
            table, rig=record.rig, law=record.law, columns=columns, units=units
        )


READINGS = {"turns": turns, "normalised": normalised}
"""Ways to read a log wrongly, by functions of the right record."""


@functools.lru_cache(maxsize=8)
def healthy(arm, seed, law):
    """A right log of an arm on a path drawn from the seed; with truth, chain and path."""
    truth, chain, rig, gain = ARMS[arm](seed % 2)
    path = path_of(np.random.default_rng([seed, *map(ord, arm)]))
    return run(truth, rig, LAWS[law](truth, rig, gain), path), truth, chain, path


def drawn(name, arm, seed, law="P"):
    """What is given where this cause spoils the log, but for its reading."""
    cause, random = CAUSES[name], np.random.default_rng([seed, *map(ord, name), *map(ord, arm)])
    if cause.other_machine:
        truth, chain, rig, gain = ARMS[arm](seed % 2)
        stated = LAWS[law](truth, rig, gain)
        path = path_of(random, random.choice((-1, 1)) * np.pi / 2 if cause.unloaded else 0.0)
        odd = cause.machine(random) if cause.machine else {}
        if odd.get("share") == "peak":
            right = run(truth, rig, stated, path)
            odd["share"] = random.uniform(0.6, 0.85) * np.abs(right.torque).max(axis=0)
        records = [run(truth, rig, stated, path)] if cause.two else []
        records.append(run(truth, rig, stated, path_of(random) if cause.two else path, **odd))
    else:
        record, truth, chain, path = healthy(arm, seed, law)
        records = [record]
    if seed % 4 in (1, 2) and not cause.torque:
        records = [dataclasses.replace(record, torque=None) for record in records]
    given = Given(records, chain, random, truth, path)
    if cause.stated:
        cause.stated(given)
    return given


def spoiled(name, arm, seed, law="P"):
    """What a user has of a cause: dynamics and records."""
    given, reading = drawn(name, arm, seed, law), CAUSES[name].reading
    records = [READINGS[reading](each) for each in given.records] if reading else given.records
    return Dynamics.from_chain(given.chain), records


def first(name, arm, seed, law="P"):
    """What is said first, "" where nothing is; and by whom."""
    try:
        dynamics, records = spoiled(name, arm, seed, law)
    except ValueError as refusal:
        return "refusal", str(refusal)
    for record in records:
        for finding in record.check().problems:
            return "check", f"{finding.check}: {finding.advice}"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = identify(dynamics, records, progress=False)
    except ValueError as refusal:
        return "refusal", str(refusal) or repr(refusal)
    return ("identify", found.warnings[0]) if found.warnings else ("", "")


def label(text):
    """The label of a sentence."""
    words = (LABELS | WORDS).items()
    return (
        next((name for name, word in words if re.search(word, text, re.IGNORECASE)), "other")
        if text
        else ""
    )


def names_it(text, labels):
    """Whether a sentence, or silence, is that of one of these labels."""
    return label(text) in labels or any(
        re.search(WORDS[name], text, re.IGNORECASE) for name in labels if name in WORDS
    )


def table(logs, arms, only, said, law):
    """Print what was said first of each cause: right of all, and the labels."""
    total, right = 0, 0
    for name, cause in CAUSES.items():
        if only and name not in only:
            continue
        told, good, names = (
            collections.Counter(),
            0,
            cause.right + (cause.sampled if law != "P" else ()),
        )
        for arm in arms:
            for seed in range(logs):
                by, text = first(name, arm, seed, law)
                told[label(text)] += 1
                good += names_it(text, names)
                if said:
                    mark = " " if names_it(text, names) else "!"
                    print(
                        f"  {mark} {name}, {arm} {seed}: {by} [{label(text)}] {text[:260]}",
                        flush=True,
                    )
        total, right = (
            total + sum(told.values()) * (name != "healthy"),
            right + good * (name != "healthy"),
        )
        rest = ", ".join(f"{each or 'nothing'} {count}" for each, count in told.most_common())
        print(f"| {name} | {good} of {sum(told.values())} | {rest} |", flush=True)
    if total:
        print(f"the right cause first: {right} of {total} ({right / total:.0%})")
