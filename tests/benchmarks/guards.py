"""Guards of the torque: how soon they stop an unstable loop, and how far healthy loops stay from
their limits.

    python tests/benchmarks/guards.py [--write] [--seeds 3]

With --write the tables replace those in docs/guides/faults.md.

Onset: the sampled laws of docs/guides/laws.md, with the f of a rigid arm, on elastic gears, each
link swinging at so many Hz against its locked motor; the same loop without guards says when its
torque is lost. Saturation: the first 20 ms in which half of the samples of a joint are at the
limit; chatter: the first 20 ms in which a torque swings by three quarters of its limit about their
middle, and does so in all of the next 30 ms.

Margins: every run of README, tutorials and docs/guides/laws.md, its counts through the running
controller; laws with a model hold what was identified, by so many seeds.
"""

import argparse
import itertools
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "oracles"))
from guarded_loops import COLD, LAWS, LIMIT, RIG, closed, elastic, margin
from tuned_laws import MOTIONS, pd

from ctc import ComputedTorque, ComputedTorquePID, FeedForward
from identification import identify
from plant import (
    Body,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Guards,
    Harmonics,
    Link,
    Rig,
    p_gains,
    puma560,
    simulate,
)

PAGE = Path(__file__).resolve().parents[2] / "docs" / "guides" / "faults.md"
ROBOT, LOADED, PATH = puma560.arm(), puma560.literature_arm(1.5), puma560.reference()
RESONANCES = (150, 100, 80, 60, 40, 25)
SAMPLES = 2000
"""Of a loop that is watched for its onset: 1.4 s."""

WINDOW = round(0.02 / RIG.period)
LASTING = round(0.03 / RIG.period)
SWING = 0.75
"""Of the limit, about the middle of a window: where chatter begins."""

ALONE = {"both": Guards(), "saturation": Guards(chatter=None), "chatter": Guards(saturation=None)}


# -- how soon ------------------------------------------------------------------------------------
def chattering(torque):
    """Last sample of the first window in which a joint's torque swings by so much, and goes on;
    None without one.
    """
    windows = np.lib.stride_tricks.sliding_window_view(torque, WINDOW, axis=0)
    swings = (windows.max(axis=2) - windows.min(axis=2)) / 2 >= SWING * LIMIT
    lasting = (
        np.lib.stride_tricks.sliding_window_view(swings, LASTING, axis=0).all(axis=2).any(axis=1)
    )
    return int(lasting.argmax()) + WINDOW - 1 if lasting.any() else None


def onsets():
    """One row per law and resonance: onset of saturation and of chatter [ms], and what the
    guards make of it.
    """
    yield (
        "| law | gears [Hz] | half of 20 ms saturated after [ms] | stop by saturation, later [ms] |"
        " swings by 3/4 of the limit after [ms] | stop by chatter, later [ms] | both guards: stop"
        " [ms] |"
    )
    yield "|---|---|---|---|---|---|---|"
    late, quiet = {"saturation": [], "chatter": []}, {}
    for (name, (fast, make)), hz in itertools.product(LAWS.items(), RESONANCES):
        if fast:
            continue
        law, rig = make(LOADED, RIG), elastic(LOADED, hz)
        options = {"samples": SAMPLES}
        free = closed(LOADED, rig, law, PATH, guards=None, **options)
        begun = {"saturation": free.first(0.02), "chatter": chattering(free.torque)}
        stop = {
            which: closed(LOADED, rig, law, PATH, guards=each, **options).stop
            for which, each in ALONE.items()
        }
        if all(each is None for each in (*begun.values(), *stop.values())):
            quiet.setdefault(name, []).append(f"{hz}")
            continue
        cells = []
        for which, onset in begun.items():
            cells += ["-" if onset is None else f"{milliseconds(onset)}", delay(onset, stop[which])]
            late[which] += [] if onset is None or stop[which] is None else [stop[which] - onset]
        yield f"| {title(name)} | {hz} | {' | '.join(cells)} | {milliseconds(stop['both'])} |"
    yield ""
    worst = {which: milliseconds(max(each)) for which, each in late.items()}
    yield (
        f"The latest stops are {worst['saturation']} ms and {worst['chatter']} ms after the onset."
    )
    quietly = "; ".join(
        title(name) if len(each) == len(RESONANCES) else f"{title(name)} at {', '.join(each)} Hz"
        for name, each in quiet.items()
    )
    yield f"Neither onset nor stop in {1e3 * SAMPLES * RIG.period:.0f} ms: {quietly}."


def title(name):
    return name.replace("the same,", "feed-forward + PD,")


def milliseconds(samples):
    return "never" if samples is None else f"{1e3 * RIG.period * samples:.0f}"


def delay(onset, stop):
    if onset is None and stop is None:
        return "-"
    return "never" if onset is None or stop is None else milliseconds(stop - onset)


# -- how far -------------------------------------------------------------------------------------
def readme():
    """The block of the README, and the tutorial CTC against P: what was identified from one log,
    on the true arm.
    """
    found = default(1)
    laws = {
        "P": "P of the README",
        "computed torque of the README": ComputedTorque(found.arm, found.rig),
        "computed torque of the tutorial CTC against P": ComputedTorque(found),
    }
    for (name, law), motion in itertools.product(laws.items(), list(MOTIONS)[:3]):
        yield name, margin(ROBOT, RIG, law, MOTIONS[motion])


def own_arm():
    """The tutorial Your own arm."""
    upper, fore = Link(name="1", alpha=np.pi / 2), Link(name="2", a=0.4)
    rod = Body(mass=2.0, com=(0.2, 0, 0), inertia=(0, 0, 0, 0.027, 0, 0.027), rotor=0.5)
    dynamics = Dynamics.from_chain(Chain(links=(upper, fore), bodies=(rod, rod)))
    drive = Drive(
        gear=(80, -60),
        motor_inertia=(2e-4, 2e-4),
        viscous=(1e-3, 1e-3),
        coulomb=(0.1, 0.1),
        motor_gain=(0.2, 0.2),
        current_limit=(20, 20),
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=(1000, 1000)), period=0.7e-3)
    path = Harmonics(
        period=3.0,
        offset=(0.3, -0.2),
        cosine=((-0.5, -0.1), (0.4, -0.5)),
        sine=((0.3, 0.2), (-0.4, 0.3)),
    )
    truth = dynamics.arm(dynamics.f())
    measured = simulate(truth, rig, p_gains(truth, rig, path, peak=12), path)
    width = np.maximum(0.5 * abs(truth.f), 0.1)
    ranges = np.column_stack([truth.f - width, truth.f + width])
    found = identify(dynamics, measured, ranges=ranges, seed=1, progress=False)
    yield (
        "computed torque of the tutorial Your own arm",
        margin(truth, rig, ComputedTorque(found), path),
    )


def on_gears():
    """The tutorial Will it hold on my gears?: its laws on rigid gears, and at 40 to 80 Hz those
    that hold there.
    """
    measured = simulate(LOADED, RIG, puma560.p_law(), PATH, steps_per_sample=16)
    found = identify(LOADED.dynamics, measured, seed=1, progress=False)
    holding = {
        "feed-forward + PD": FeedForward(found, feedback=pd(0.5, 4e-3, 3000, RIG.period)),
        "PID that rolls off": ComputedTorquePID(
            found, bandwidth=206, ratio=1.28, integral=24, roll_off=2124, roll_off_damping=0.96
        ),
    }
    for bandwidth in (60, 150, 250):
        yield (
            f"computed torque {bandwidth}, 1.5 kg",
            margin(LOADED, RIG, ComputedTorque(found, bandwidth=bandwidth), PATH),
        )
    for (name, law), hz in itertools.product(holding.items(), (None, 80, 60, 40)):
        gears = "rigid" if hz is None else "40 to 80 Hz"
        yield f"{name}, 1.5 kg, {gears} gears", margin(LOADED, elastic(LOADED, hz), law, PATH)


def table_of(laws, found):
    """The laws of a table of docs/guides/laws.md over its five motions."""
    arms = [each.arm for each in found]
    for name, motion in itertools.product(laws, MOTIONS.values()):
        for arm in arms[:1] if name in ("P of the README", "P", "PD", "PID", "cascade") else arms:
            yield f"laws.md: {name}", margin(ROBOT, RIG, name, motion, model=arm)


def default(seed, **options):
    log = simulate(ROBOT, RIG, puma560.p_law(), PATH, steps_per_sample=16)
    return identify(puma560.dynamics(), log, seed=seed, progress=False, **options)


def margins(seeds):
    """One row per law: of all its runs the largest saturation and chatter, beside the limits."""
    default_table = table_of(LAWS, [default(seed) for seed in range(seeds)])
    paper_table = table_of(COLD, [default(seed, method="paper") for seed in range(seeds)])
    runs = {}
    for name, found in itertools.chain(readme(), own_arm(), on_gears(), default_table, paper_table):
        runs.setdefault(name, []).append(found)
    guards = Guards()
    yield (
        "| law | runs | at the limit, largest share of 100 ms | chatter, largest share of the limit"
        " | stopped |"
    )
    yield "|---|---|---|---|---|"
    for name, each in runs.items():
        saturation, chatter = (
            max(getattr(run, which) for run in each) for which in ("saturation", "chatter")
        )
        stopped = sum(run.status != "running" for run in each)
        share = f"{saturation * guards.saturation:.1%} | {chatter * guards.chatter:.1%}"
        yield f"| {title(name)} | {len(each)} | {share} | {stopped} |"
    yield f"| limits of the guards | | {guards.saturation:.0%} | {guards.chatter:.0%} | |"


def main():
    """Print, and replace the tables of the page if asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--write", action="store_true", help="put the tables into docs/guides/faults.md"
    )
    parser.add_argument(
        "--seeds", type=int, default=3, help="identifications that each law of a table holds"
    )
    given = parser.parse_args()
    for mark, lines in (("onsets", onsets()), ("margins", margins(given.seeds))):
        text = []
        for line in lines:
            print(line, flush=True)
            text.append(line)
        if given.write:
            before, rest = PAGE.read_text(encoding="utf-8").split(f"<!-- {mark} -->\n")
            after = rest.split(f"<!-- end of {mark} -->")[1]
            page = f"{before}<!-- {mark} -->\n{chr(10).join(text)}\n<!-- end of {mark} -->{after}"
            PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
