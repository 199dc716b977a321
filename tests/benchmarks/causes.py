"""Causes, tried on another engine: is what was spoiled named first? A part of `second_reading.py`.

    python tests/benchmarks/second_reading.py causes [--logs 40] [--arms puma ur5e] [--only NAME ...] [--said]
        [--law P | PID | computed_torque]

Two arms in MuJoCo under a law with dry friction, on paths drawn from a seed. One thing is spoiled: the machine, or
what is stated of it, or the log. Of four logs in turn two have the other gain, and two the logged torque. First is what
`record.check()` finds first; where it finds nothing, the first warning of `identify`, or its refusal.
"""

import collections
import dataclasses
import re
import sys
import warnings
from pathlib import Path

import numpy as np

from ctc import ComputedTorque
from identification import identify
from plant import PID, Chain, Dynamics, Harmonics, Link, P, puma560

sys.path.insert(0, str(Path(__file__).parents[1] / "oracles"))
from mujoco_odd import run
from packaged_arms import elbow_of_a_ur5e


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

    def stated(self, **drive):
        """The rig stated wrongly; the path is as it was, and what it is in counts stands in the
        log.
        """
        for i, record in enumerate(self.records):
            rig = dataclasses.replace(
                record.rig, drive=dataclasses.replace(record.rig.drive, **drive)
            )
            # which counts leave open
            path = record.reference if isinstance(record.law, ComputedTorque) else None
            self.records[i] = dataclasses.replace(record, rig=rig, reference=path)

    def each(self, **columns):
        """Columns of the log changed, by functions of the record."""
        for i, record in enumerate(self.records):
            new = {name: change(record) for name, change in columns.items()}
            self.records[i] = dataclasses.replace(record, reference=None, **new)


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
    given.each(
        **{
            name: lambda record, name=name: sign * getattr(record, name)
            for name in ("error_pulses", "reference_pulses", "torque")
            if given.records[0].torque is not None or name != "torque"
        }
    )


def _upward(given):
    given.chain = dataclasses.replace(given.chain, gravity=tuple(-g for g in given.chain.gravity))


def _degrees(given):
    turn = 180 / np.pi
    given.each(
        reference_pulses=lambda r: turn * r.reference_pulses,
        error_pulses=lambda r: turn * r.error_pulses,
    )


def _again(given, change):
    given.records = [change(record, given.random) for record in given.records]


def _lost(given):
    from second_reading import lost_packets

    _again(given, lost_packets)


def _late(given):
    from second_reading import late

    _again(given, late)


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


LABELS = {
    "sign of a joint": r"turns the other way",
    "sign of gravity": r"gravity acts the other way",
    "lengths": r"lengths are not the chain's|in metres",
    "cogging": r"motors cog",
    "law": r"the rate of its error",
    "taken back": r"look for another cause",
    "gain or friction": r"or gains of law or motor are not",
    "gain or gear": r"check gain, motor gain and gear|its gains and period, gears",
    "rounding": r"wide cell|cell two pulses wide",
    "lost rows": r"lost|repeat(s|ed) the row|packet",
    "late counts": (
        r"counts (are|were) [\d.]+ samples|not logged at the same time|samples? late|samples? early"
    ),
    "lag of the loop": r"torques lag",
    "speed error": r"error grows with speed",
    "elastic": r"joints are elastic",
    "play": r"(has|this) backlash",
    "offset": r"have an offset",
    "friction": r"[Ff]riction is not the rig's|Coulomb friction is",
    "gain": r"times the commanded|cannot have made|gains? .*not the",
    "saturated": r"amplifier is at its limit|cut off at",
    "swapped": r"exchange the columns|belongs to the motion",
    "wrong sign": r"wrong sign|change the sign|backwards|runs? against",
    "scale of counts": (
        r"times as far|correct the resolution|resolution|unit|moved? .* turns|steps of"
    ),
    "gears, lengths": r"gears \(or lengths",
    "rotor": r"rotor of|below that of its rotor",
    "changes": r"contradict each other|changing|drift|do not hold for both",
    "oscillates": r"oscillates",
    "poor fit": r"follows the log no closer|simulated and measured errors differ",
    "pairs": r"separately identifiable",
}
"""Label -> words of a sentence, the first that fit."""

CAUSES = {
    "healthy": Cause(("",)),
    "floor/fix": Cause(("rounding",), lambda random: {"rounding": "floor"}),
    "lost rows": Cause(("lost rows",), stated=_lost),
    "late log": Cause(("late counts",), stated=_late),
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
}


def spoiled(name, arm, seed, law="P"):
    """What a user has of a cause: dynamics and records."""
    cause, random = CAUSES[name], np.random.default_rng([seed, *map(ord, name), *map(ord, arm)])
    truth, chain, rig, gain = ARMS[arm](seed % 2)
    law = LAWS[law](truth, rig, gain)
    path = path_of(random, random.choice((-1, 1)) * np.pi / 2 if cause.unloaded else 0.0)
    odd = cause.machine(random) if cause.machine else {}
    if odd.get("share") == "peak":
        healthy = run(truth, rig, law, path)
        odd["share"] = random.uniform(0.6, 0.85) * np.abs(healthy.torque).max(axis=0)
    records = [run(truth, rig, law, path)] if cause.two else []
    records.append(run(truth, rig, law, path_of(random) if cause.two else path, **odd))
    if seed % 4 in (1, 2):
        records = [dataclasses.replace(record, torque=None) for record in records]
    given = Given(records, chain, random)
    if cause.stated:
        cause.stated(given)
    return Dynamics.from_chain(given.chain), given.records


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
    return (
        next((name for name, words in LABELS.items() if re.search(words, text)), "other")
        if text
        else ""
    )


def table(logs, arms, only, said, law):
    """Print what was said first of each cause: right of all, and the labels."""
    total, right = 0, 0
    for name, cause in CAUSES.items():
        if only and name not in only:
            continue
        told, names = collections.Counter(), cause.right + (cause.sampled if law != "P" else ())
        for arm in arms:
            for seed in range(logs):
                by, text = first(name, arm, seed, law)
                told[label(text)] += 1
                if said:
                    mark = " " if label(text) in names else "!"
                    print(
                        f"  {mark} {name}, {arm} {seed}: {by} [{label(text)}] {text[:260]}",
                        flush=True,
                    )
        good = sum(told[each] for each in names)
        total, right = (
            total + sum(told.values()) * (name != "healthy"),
            right + good * (name != "healthy"),
        )
        rest = ", ".join(f"{each or 'nothing'} {count}" for each, count in told.most_common())
        print(f"| {name} | {good} of {sum(told.values())} | {rest} |", flush=True)
    if total:
        print(f"the right cause first: {right} of {total} ({right / total:.0%})")
