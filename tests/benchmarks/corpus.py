"""The logs of the corpus of `verdicts.py`: each has a key, law/arm/cause/number, and a draw.

Causes of `causes.py` in MuJoCo under three laws, the mistakes of `silent_mistakes.py`, seven joints, the real bags in
CTC_DATA, and right logs: fine encoders, slow clocks, creeping and resting joints, fast starts, public arms.
"""

import dataclasses
import functools
import os
import warnings
from pathlib import Path

import causes
import model_files
import mujoco_odd
import numpy as np
import silent_mistakes as silent
from healthy import first
from healthy import gains as p_gains_of

from plant import (
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    LoggedTorque,
    Record,
    Rig,
    Spline,
    puma560,
    read_robot,
    read_table,
    simulate,
)

mujoco_odd.STEPS = 72
"""Steps of MuJoCo in a sample: finer than those of the benchmark, for logs that are kept."""

RIGHT_LOGS = 20
"""Logs of each kind of right ones."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A log, what its owner has of the arm, and which labels name its mistakes."""

    records: list
    dynamics: object
    right: list
    """Labels that name it, mistake by mistake; "" among them where silence is right."""
    reading: str = ""


def entries(logs, laws):
    """Yield key and draw of every log, the numbers 0 to `logs` - 1 of each cause."""
    if "P" in laws:
        yield from right_logs(logs)
        yield from silent_entries(logs)
        yield from bags(logs)
        yield from of_seven(logs)
    for law in laws:
        for arm in causes.ARMS:
            for seed in range(logs):
                # one right log serves all causes that need no other machine
                for name in sorted(causes.CAUSES, key=lambda x: causes.CAUSES[x].other_machine):
                    key = f"{law}/{arm}/{name.replace('/', ' for ')}/{seed}"
                    yield key, functools.partial(of_cause, name, arm, seed, law)
                yield f"{law}/{arm}/two at once/{seed}", functools.partial(two, arm, seed, law)


# -- of causes.py --------------------------------------------------------------------------------
def labels(name, law="P"):
    """The labels that name a cause."""
    cause = causes.CAUSES[name]
    return list(cause.right + (cause.sampled if law != "P" else ()))


def of_cause(name, arm, seed, law):
    """A log of `causes.py`."""
    given = causes.drawn(name, arm, seed, law)
    dynamics = Dynamics.from_chain(given.chain)
    right = labels(name, law) + [""] * causes.is_hidden(name, given)
    return Case(given.records, dynamics, [right], causes.CAUSES[name].reading)


TWO = (
    "gear", "gain", "sign of a joint", "swapped columns", "late log", "lost rows", "fix/round",
    "jittered stamps",
)  # fmt: skip
"""Causes of which two are drawn at once, in the order in which they spoil a log."""


def two(arm, seed, law):
    """A log with two mistakes at once."""
    random = np.random.default_rng([seed, *map(ord, arm)])
    names = random.choice(TWO, 2, replace=False)
    given = causes.drawn("healthy", arm, seed, law)
    for name in sorted(names, key=TWO.index):
        causes.CAUSES[name].stated(given)
    dynamics = Dynamics.from_chain(given.chain)
    return Case(given.records, dynamics, [labels(name, law) for name in names])


# -- of silent_mistakes.py -----------------------------------------------------------------------
SILENT = {
    "gain 1.5": labels("gain"),
    "sign of the error": ["wrong sign"],
    "length 0.45 for 0.35 m": labels("length"),
    "gain 1.1": labels("gain"),
    "resolution per radian": labels("degrees"),
    "gear 120 for 100": labels("gear"),
    "viscous joint side": ["friction"],
    "path in degrees": labels("degrees"),
}


def silent_entries(logs):
    for kind in SILENT:
        for seed in range(2 * logs):
            yield f"P/paper/{kind}/{seed}", functools.partial(silent_case, kind, seed)


def silent_case(kind, seed):
    """Log and torque are drawn as there; every second log has no torque."""
    random, dynamics = np.random.default_rng(seed), puma560.dynamics()
    if kind == "path in degrees":
        record = silent.in_degrees(random)
    elif kind == "length 0.45 for 0.35 m":
        record, dynamics = silent.right(random, silent.LONG[0]), silent.of_length(0.45)
    else:
        record = silent.KINDS[kind](silent.right(random))
    if seed % 2:
        record = dataclasses.replace(record, torque=None, current=None)
    return Case([record], dynamics, [SILENT[kind]])


# -- right logs ----------------------------------------------------------------------------------
def right_logs(logs):
    number = min(RIGHT_LOGS, 4 * logs)
    for name, draw in {
        "fine encoder": fine,
        "slow": slow,
        "creeping": creeping,
        "fast start": fast_start,
    }.items():
        for seed in range(number):
            yield f"P/right/{name}/{seed}", functools.partial(draw, seed)
    yield from ((f"P/right/public arm/{k}", functools.partial(public, k)) for k in range(number))


def drawn(seed):
    """Truth, chain, rig, gains and random numbers of one of two arms, its friction drawn."""
    random = np.random.default_rng([seed, 58])
    truth, chain, rig, gain = list(causes.ARMS.values())[seed % 2](seed // 2 % 2)
    drive = dataclasses.replace(
        rig.drive,
        coulomb=rig.drive.coulomb * random.uniform(0.5, 1.5, 2),
        viscous=rig.drive.viscous * random.uniform(0.5, 1.5, 2),
    )
    return truth, chain, dataclasses.replace(rig, drive=drive), np.array(gain), random


def logged(truth, chain, rig, gain, path, seed, labels=(), duration=4.0):
    """A right log; of four in turn one has neither reference nor law, and two no torque."""
    record = simulate(truth, rig, causes.P(gain=gain), path, duration=duration, steps_per_sample=64)
    record = dataclasses.replace(record, true_q=None, true_qd=None)
    if seed % 4 == 3:
        record = without_reference(record)
    elif seed % 4 in (1, 2):
        record = dataclasses.replace(record, torque=None)
    return Case([record], Dynamics.from_chain(chain), [["", *labels]])


def without_reference(record):
    return Record(
        t=record.t, error_pulses=-record.counts, torque=record.torque, rig=record.rig,
        law=LoggedTorque(),
    )  # fmt: skip


def fine(seed):
    """65,536 counts and more in a turn of the motor; of every fourth the joint's of a UR5e."""
    if seed % 4 == 3:
        robot, random = read_robot("ur5e"), np.random.default_rng(seed)
        cosine, sine = 0.12 * random.standard_normal((2, 6, 5))
        offset = (0.2, -1.3, 1.2, -0.6, 0.5, 0.1)
        path = Harmonics(period=8.0, offset=offset, cosine=cosine, sine=sine)
        record = simulate(robot.arm, robot.rig, robot.law, path, duration=8.0)
        record = dataclasses.replace(record, true_q=None, true_qd=None)
        record = without_reference(record) if seed % 8 == 3 else record
        return Case([record], robot.dynamics, [[""]])
    truth, chain, rig, gain, random = drawn(seed)
    finer = 2.0 ** random.integers(4, 9)
    encoder = dataclasses.replace(rig.encoder, resolution=rig.encoder.resolution * finer)
    rig = dataclasses.replace(rig, encoder=encoder)
    return logged(truth, chain, rig, gain / finer, causes.path_of(random), seed)


def slow(seed):
    """Samples of 10, 5 and 2.5 ms."""
    truth, chain, rig, gain, random = drawn(seed)
    rig = dataclasses.replace(rig, period=(10e-3, 5e-3, 2.5e-3)[seed % 3])
    return logged(truth, chain, rig, gain, causes.path_of(random), seed, duration=12.0)


def creeping(seed):
    """A joint that creeps or rests, fine or coarse, while the other one moves."""
    truth, chain, rig, gain, random = drawn(seed)
    path = causes.path_of(random)
    scale = np.ones(2)
    scale[random.integers(2)] = random.choice([0.0, 0.003, 0.02, 0.1])
    path = Harmonics(
        period=path.period,
        offset=path.offset,
        cosine=path.cosine * scale[:, None],
        sine=path.sine * scale[:, None],
    )
    # that a joint moves too little to be identified is no accusation
    return logged(truth, chain, rig, gain, path, seed, labels=("little motion",))


def fast_start(seed):
    """From rest to rest within some tenths of a second, on encoders of all kinds."""
    truth, chain, rig, gain, random = drawn(seed)
    finer = 2.0 ** random.choice([0, 2, 4, 6])
    encoder = dataclasses.replace(rig.encoder, resolution=rig.encoder.resolution * finer)
    rig = dataclasses.replace(rig, encoder=encoder)
    start = random.uniform(-0.5, 0.5, 2)
    moves = random.choice((-1, 1), (2, 2)) * random.uniform(0.2, 0.6, (2, 2))
    points = np.cumsum([start, *moves], axis=0)
    path = Spline(times=(0.0, 0.4, 0.4 + random.uniform(0.3, 0.8)), points=points)
    return logged(truth, chain, rig, gain / finer, path, seed, duration=2.0)


@functools.lru_cache(maxsize=1)
def _public():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return {
            name: first(
                Chain.from_urdf(
                    model_files.file_of(name),
                    base=model_files.ARMS[name][1],
                    tip=model_files.ARMS[name][2],
                ),
                3,
            )
            for name in model_files.ARMS
        }


def public(seed):
    """A log of `healthy.py`, of the first three joints of a public arm."""
    arms = _public()
    chain, random = list(arms.values())[seed % len(arms)], np.random.default_rng(seed)
    path = model_files.path_of(chain, seed)
    rig = model_files.rig_of(chain, path)
    drive = dataclasses.replace(
        rig.drive,
        coulomb=rig.drive.coulomb * random.uniform(0.5, 2, 3),
        viscous=rig.drive.viscous * random.uniform(0.5, 2, 3),
    )
    rig = dataclasses.replace(rig, drive=drive)
    dynamics = Dynamics.from_chain(chain.with_rotors(drive))
    truth = dynamics.arm(dynamics.f())
    law = p_gains_of(truth, rig, path, int(random.integers(3)))
    record = simulate(truth, rig, law, path, duration=4.0, steps_per_sample=16)
    record = dataclasses.replace(record, true_q=None, true_qd=None)
    return Case([record], dynamics, [[""]])


# -- seven joints --------------------------------------------------------------------------------
SEVEN = ("healthy", "swapped columns", "exchanged references", "exchanged torques")


def of_seven(logs):
    for seed in range(logs):
        for name in SEVEN:
            yield f"P/Panda/{name}/{seed}", functools.partial(seven, name, seed)


@functools.lru_cache(maxsize=1)
def _panda(seed):
    chain = Chain.from_urdf(model_files.file_of("Panda"), tip=model_files.ARMS["Panda"][2])
    path = model_files.path_of(chain, seed)
    rig = model_files.rig_of(chain, path)
    dynamics = Dynamics.from_chain(chain.with_rotors(rig.drive))
    law = p_gains_of(dynamics.arm(dynamics.f()), rig, path, 2)
    record = model_files.mujoco_log("Panda", chain, rig, law, path, 4.0)
    torque = rig.drive.limited(rig.drive.gear * law.gain * record.error_pulses)
    return dataclasses.replace(record, torque=torque), dynamics


def seven(name, seed):
    """One pair of columns exchanged among seven."""
    record, dynamics = _panda(seed)
    given = causes.Given([record], dynamics.chain, np.random.default_rng(seed))
    spoil = causes.CAUSES[name].stated if name != "swapped columns" else causes.exchanged("counts")
    if spoil:
        spoil(given)
    # its light wrist hunts within a count, which is so
    right = labels(name) + ["oscillates"] * (name == "healthy")
    return Case(given.records, dynamics, [right])


# -- real bags -----------------------------------------------------------------------------------
def _sign_of_one(given):
    n = given.records[0].n
    sign = np.where(np.arange(n) == given.random.integers(n), -1.0, 1.0)
    given.each(torque=lambda record: sign * record.torque)


def _late(given):
    """The torque 40 ms late."""
    given.each(
        torque=lambda r: np.column_stack(
            [np.interp(r.t - 0.04, r.t, column) for column in r.torque.T]
        )
    )


def _degrees(given):
    given.each(error_pulses=lambda r: 180 / np.pi * r.error_pulses)


OF_BAGS = {
    # the bags move some joints in step
    "healthy": (["", "little motion"], None),
    "swapped columns": (["swapped"], causes.exchanged("counts")),
    "exchanged torques": (["exchanged torques"], causes.exchanged("torque")),
    "sign of one torque": (["wrong sign"], _sign_of_one),
    "torque that the joint feels": (["wrong sign"], None),
    "torque late": (["late counts"], _late),
    "lost rows": (["lost rows"], None),
    "degrees": (["scale of counts"], _degrees),
    "zero off": (["zero of a joint"], None),
    "tilted base": (["gravity's direction", "sign of gravity"], None),
    "torque 1.96": (["torque scale"], None),
    "torque 4": (["torque scale"], None),
    "per mille": (["torque scale"], None),
    "without gravity": (["without gravity"], None),
    "torque of a model": (["of a model"], None),
    "jittered stamps": (["stamps"], None),
}
"""Labels, and how it is spoiled where `causes.CAUSES` does not say it."""

BAGS = {
    "UR10": ("ur10_exciting_trajectory.db3", 6),
    "Panda bag": ("panda_exciting_trajectory.db3", 7),
}


def bags(logs):
    folder = Path(os.environ.get("CTC_DATA", "")) / "ur10_panda_bags"
    if not os.environ.get("CTC_DATA") or not folder.is_dir():
        print("CTC_DATA has no ur10_panda_bags: no real bags in the corpus")
        return
    for name in BAGS:
        for cause in OF_BAGS:
            # nothing is drawn of some: one log
            for seed in range(logs if cause in DRAWN else 1):
                key = f"logged/{name}/{cause}/{seed}"
                yield key, functools.partial(bag, folder, name, cause, seed)


DRAWN = (
    "swapped columns", "exchanged torques", "sign of one torque", "lost rows", "zero off",
    "tilted base", "torque of a model", "jittered stamps",
)  # fmt: skip


@functools.lru_cache(maxsize=1)
def _table(file):
    """Columns of a bag, without the rows that repeat others."""
    table = read_table(file)
    table = {key.rpartition(".")[2]: column for key, column in table.items()}
    # Some rows of the Panda repeat the one before, and the motion goes on one row later.
    new = np.append(True, np.diff(table["position"], axis=0).any(axis=1))
    stamps = np.arange(new.sum()) * np.median(np.diff(table["stamp"]))
    return {key: table[key][new] for key in ("position", "effort")} | {"stamp": stamps}


def bag(folder, name, cause, seed):
    """A real log, spoiled; its model is that of the public robot file, without rotors."""
    file, n = BAGS[name]
    table = _table(folder / file)
    one = np.ones(n)
    drive = Drive(
        gear=one, motor_inertia=0 * one, viscous=None, coulomb=None, motor_gain=one,
        current_limit=np.inf * one,
    )  # fmt: skip
    period = 1e-9 * float(np.median(np.diff(table["stamp"])))
    rig = Rig(
        drive=drive, encoder=Encoder(resolution=2.0**16 * one, rounding="round"), period=period
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        record = Record.from_table(
            table,
            rig=rig,
            columns={"t": "stamp", "position": "position", "torque": "effort"},
            units={"t": "ns", "position": "rad", "torque": "N m"},
            law=LoggedTorque(),
        )
        model = name.split()[0]
        chain = Chain.from_urdf(model_files.file_of(model), tip=model_files.ARMS[model][2])
    dynamics = Dynamics.from_chain(chain, rotors=False)
    truth = dynamics.arm(dynamics.f())
    given = causes.Given([record], chain, np.random.default_rng(seed), truth)
    right, spoil = OF_BAGS[cause]
    spoil = spoil or causes.CAUSES[cause].stated
    if spoil:
        spoil(given)
    return Case(given.records, Dynamics.from_chain(given.chain, rotors=False), [right])
