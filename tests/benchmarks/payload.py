"""On-line identification of a load: every number that docs/tutorials/payload.md quotes.

``python tests/benchmarks/payload.py [section ...] [--runs 200]``; sections: kilograms, restored,
bare, swap, genetic, detection, alarms, paced, elastic. Loads appear at a random instant of (6),
which goes on after its period.
"""

import argparse
import dataclasses
import functools
import itertools
import time

import casadi as ca
import numpy as np

from ctc import ComputedTorque, ComputedTorquePID, PayloadEstimator
from identification import identify
from identification.payload import Window
from plant import Body, Elasticity, SteppedArm, puma560, simulate

RIG, PATH = puma560.rig(), puma560.reference()
PERIOD = RIG.period
ARMS = {"published f": puma560.arm(), "literature arm": puma560.literature_arm()}
FIRST, LAST = 0.5, 0.5 + PATH.period
"""A load appears between these times [s]: the load at the start, none, is known by then in
nearly all runs.
"""

BEFORE, AFTER, LIMIT = 1.0, 0.8, 0.28
"""How long a run begins before the change and goes on after it, and by when an answer counts
[s].
"""


def lead(change):
    """First sample of a run, in samples of (6)."""
    return max(0, change - round(BEFORE / PERIOD))


def run(controller, stepped, samples, change=None, load=None, first=0):
    """Errors [pulses], torque [N m] and the change statistic of samples of a loop; a load comes
    at a sample.
    """
    motion = PATH((first + np.arange(samples)) * PERIOD)
    errors, torques, change_statistic = (
        np.zeros((samples, 2)),
        np.zeros((samples, 2)),
        np.zeros(samples),
    )
    counts, pulses = RIG.counts(motion.q), stepped.pulses
    for k in range(samples):
        if k == change:
            stepped.carry(load)
        errors[k] = counts[k] - pulses
        torques[k] = controller.step(pulses, motion.q[k], motion.qd[k], motion.qdd[k])
        change_statistic[k] = getattr(controller, "change", 0.0)
        pulses = stepped.step(torques[k])
    return errors, torques, change_statistic


def started(law, arm, rig=RIG, first=0):
    """An arm on (6) at a sample of it, and the controller of a law or of an estimator."""
    start = PATH(np.array([first * PERIOD]))
    stepped = SteppedArm(arm, rig, start.q[0], start.qd[0])
    return law.start(rig, stepped.pulses, guards=None), stepped


@functools.cache
def identified(name, log):
    """Arm and friction from one log under P control."""
    friction = tuple(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(2))
    law = puma560.p_law(((0.20, 0.15), (0.19, 0.16), (0.21, 0.14), (0.20, 0.16))[log])
    record = simulate(ARMS[name], RIG, law, PATH)
    return identify(
        puma560.dynamics(), record, unknown=(*puma560.dynamics().names, *friction), progress=False
    )


def drawn(random, mass=None, farthest=0.5):
    mass = random.uniform(1, 5) if mass is None else mass
    return Body(mass=mass, com=(0.0, -random.uniform(0.2, farthest), 0.0)), round(
        random.uniform(FIRST, LAST) / PERIOD
    )


def shown(arm, change, estimate, body):
    """Relative error of the increments' torque along the window of 200 ms."""
    motion = PATH((change + np.arange(0, 400, 20)) * PERIOD)
    regressor = np.vstack([arm.dynamics.Y(*state).full() for state in zip(*motion, strict=True)])
    regressor = regressor @ arm.dynamics.load_matrix()
    true = body.standard_parameters
    return np.linalg.norm(regressor @ (estimate - true)) / np.linalg.norm(regressor @ true)


def one(name, known, place, random, log=0, mass=None, bandwidth=150.0, **options):
    """One load under an estimator; None where no answer came in time."""
    body, change = drawn(random, mass)
    if known:
        law = ComputedTorque(ARMS[name], RIG, bandwidth=bandwidth)
    else:
        found = identified(name, log)
        law, options = ComputedTorque(found, bandwidth=bandwidth), {"found": found, **options}
    position = body.com if place else None
    estimator, first = (
        PayloadEstimator(law, position=position, beside=False, **options),
        lead(change),
    )
    controller, stepped = started(estimator, ARMS[name], first=first)
    change, estimates = change - first, []
    take = controller._identified
    controller._identified = lambda estimate: (
        estimates.append((controller._calls, estimate)),
        take(estimate),
    )
    errors, torques, _ = run(
        controller, stepped, change + round(AFTER / PERIOD), change, body, first
    )
    events = [event for event in controller.events if event.time > (change - 1) * PERIOD]
    early = [event for event in controller.events[1:] if event.time <= (change - 1) * PERIOD]
    answer = next(((k, e) for k, e in estimates if e.sufficient and k > change), None)
    return {"body": body, "change": change, "first": first, "event": events[0] if events else None,
            "errors": errors, "early": early,
            "answer": answer, "controller": controller, "torques": torques}  # fmt: skip


def percent(values, share=95):
    return np.percentile(values, share) if len(values) else np.nan


def kilograms(runs):
    """Mass errors and intervals at the swap."""
    print(
        f"kilograms: {runs} loads of 1-5 kg each; error of the mass at the swap, 95 %; interval of"
        " 95 %"
    )
    for name, known, place in itertools.product(ARMS, (True, False), (True, False)):
        random, rows, late, early = np.random.default_rng(16), [], 0, 0
        for i in range(runs):
            result = one(name, known, place, random, log=i % 4)
            early += len(result["early"])
            if result["event"] is None or result["answer"] is None:
                late += 1
                continue
            swap, estimate = result["answer"]
            if (swap - result["change"]) * PERIOD > LIMIT:
                late += 1
                continue
            mass, (low, high) = result["body"].mass, estimate.interval
            rows.append(
                (
                    abs(estimate.mass - mass),
                    low <= mass <= high,
                    (high - low) / 2,
                    shown(
                        ARMS[name],
                        result["first"] + result["change"],
                        estimate.parameters,
                        result["body"],
                    ),
                    (swap - result["change"]) * PERIOD * 1e3,
                )
            )
        error, inside, half, increments, times = np.array(rows).T
        print(
            f"  {name}, {'known' if known else 'identified'},"
            f" {'place known' if place else 'place on a line'}: {percent(error):.3f} kg (median"
            f" {np.median(error):.3f}), intervals hold {inside.mean():.1%}, half-width"
            f" {np.median(half):.3f} kg, increments {percent(increments):.1%}, swap after"
            f" {np.median(times):.0f} ms, at most {times.max():.0f}; no answer {late / runs:.1%},"
            f" early events {early}"
        )


def restored(runs):
    """A load of 5 kg at bandwidth 150, with the estimator and without."""
    for name in ARMS:
        random, law = np.random.default_rng(5), ComputedTorque(ARMS[name], RIG, bandwidth=150.0)
        rows, without, lasting = [], [], []
        for _ in range(runs):
            result = one(name, True, True, random, mass=5.0)
            change, event = result["change"], result["event"]
            if event is None or not np.isfinite(event.swapped):
                continue
            swap, worst = round(event.swapped / PERIOD), np.abs(result["errors"]).max(axis=1)
            outside = np.flatnonzero(worst[change:] > 1)
            lasting.append(outside[-1] * PERIOD * 1e3 if len(outside) else 0.0)
            rows.append((worst[swap:].max(), worst[change:].max()))
            first = result["first"]
            controller, stepped = started(law, ARMS[name], first=first)
            errors = run(
                controller, stepped, change + round(AFTER / PERIOD), change, result["body"], first
            )[0]
            errors = np.abs(errors)
            without.append((errors[change:].max(), (errors[change:].max(axis=1) > 1).mean(),
                            errors[swap:].max()))  # fmt: skip
        after, peak = np.array(rows).T
        bare, share, later = np.array(without).T
        print(
            f"restored, {name}: {len(rows)} of {runs} answered; every sample within 1 from the swap"
            f" on in {np.mean(after <= 1):.1%} (without the estimator from the same instant"
            f" {np.mean(later <= 1):.1%}); peak of the transient {np.median(peak):.0f}, at most"
            f" {peak.max():.0f} pulses, over after {np.median(lasting):.0f} ms, at most"
            f" {max(lasting):.0f}; without: peak {np.median(bare):.0f}, at most {bare.max():.0f},"
            f" {share.mean():.1%} of the samples outside"
        )


def bare(runs):
    """A load of 1.5 kg under the default controller of an identification, without the estimator."""
    random, law = np.random.default_rng(5), ComputedTorque(identified("literature arm", 0))
    peaks, back, lasting = [], [], round(0.1 / PERIOD)
    for _ in range(runs):
        body, change = drawn(random, 1.5)
        first = lead(change)
        controller, stepped = started(law, ARMS["literature arm"], first=first)
        count = change - first + round(2 / PERIOD)
        errors = np.abs(
            run(controller, stepped, count, change - first, body, first)[0][change - first :]
        ).max(axis=1)
        outside = np.flatnonzero(errors > 1)
        within = np.diff([*outside, len(errors)]) > lasting
        peaks.append(errors.max())
        back.append(1e3 * PERIOD * (outside[within.argmax()] + 1) if len(outside) else 0.0)
    for what, each in (("peak [pulses]", peaks), ("within a pulse, for 0.1 s, after [ms]", back)):
        print(
            f"bare, {what}: median {np.median(each):.0f}, 95 % {percent(each):.0f}, at most"
            f" {max(each):.0f}"
        )


def swap(runs):
    """Torque of the swap's sample against an unswapped twin's."""
    random, rows, arm = np.random.default_rng(7), [], ARMS["published f"]
    matrix = arm.dynamics.load_matrix()
    for _ in range(runs):
        body, change = drawn(random)
        law = ComputedTorque(arm, RIG, bandwidth=150.0)
        estimator = PayloadEstimator(law, position=body.com, beside=False)
        (first, plant), (twin, _) = started(estimator, arm), started(estimator, arm)
        motion, pulses, where = (
            PATH(np.arange(change + 420) * PERIOD),
            plant.pulses,
            estimator.loop_law.places(2),
        )
        for k, state in enumerate(zip(*motion, strict=True)):
            if k == change:
                plant.carry(body)
            twin.running.core.memory[:] = first.running.core.memory
            loaded, wanted = first.running.state[where["load"]], first._wanted.copy()
            torque = (
                first.running.step(pulses, *state) if k > change else first.step(pulses, *state)
            )
            if k > change:
                if np.abs(wanted - loaded).max() > 0 and first.stage == "holding":
                    twin._wanted[:] = loaded
                    lacking = twin.running.state[4:6]
                    other = twin.running.step(pulses, *state)
                    more = [
                        arm.dynamics.D(state[0], arm.f + matrix @ phi).full()
                        for phi in (wanted, loaded)
                    ]
                    feedback = (more[0] - more[1]) @ (twin.running.state[6:8] - lacking)
                    whole = arm.dynamics.Y(*state).full() @ matrix @ (wanted - loaded)
                    rows.append(
                        [
                            np.linalg.norm(x)
                            for x in (torque - other, torque - other - feedback, whole)
                        ]
                    )
                first.running.step, step = lambda *_, given=torque: given, first.running.step
                first.step(pulses, *state)
                first.running.step = step
            pulses = plant.step(torque)
    jump, rest, whole = np.array(rows).T
    print(
        f"swap: {len(rows)} swaps; the model changes by {np.median(whole):.1f} N m along the"
        f" reference, the torque jumps by {np.median(jump):.2f} (at most {jump.max():.2f};"
        f" {np.median(jump / whole):.1%} of it, at most {(jump / whole).max():.1%}); that is the"
        f" model's change on the feedback, but for {np.max(rest / whole):.1%} of the change"
    )


def windows(runs, place):
    """Windows of loads, with shapes: (window, body, specification of the kernel estimator)."""
    random, arm = np.random.default_rng(9), ARMS["published f"]
    for _ in range(runs):
        body, start = drawn(random)
        law = ComputedTorque(arm, RIG, bandwidth=150.0)
        estimator = PayloadEstimator(law, position=body.com if place else None, beside=False)
        loaded = arm.dynamics.arm(arm.f + arm.dynamics.load_matrix() @ body.standard_parameters)
        held = ComputedTorque(
            arm.dynamics.arm(arm.f + arm.dynamics.load_matrix() @ estimator.prior.parameters),
            RIG,
            bandwidth=150.0,
        )
        record = simulate(loaded, RIG, held, PATH, duration=(start + 290) * PERIOD)
        some = slice(start, start + 286)
        yield (
            Window(record.counts[some], record.torque[some], record.torque[start - 1]),
            body,
            estimator.specification,
        )


def genetic(runs):
    """The genetic algorithm and the kernel estimator on the same windows of 200 ms."""
    for place in (True, False):
        rows = []
        for window, body, specification in windows(runs, place):
            made: dict[str, tuple[float, float, float]] = {}
            for method in ("kernel", "genetic"):
                estimator = dataclasses.replace(specification, method=method).made()
                begun, own = time.perf_counter(), time.thread_time()
                found = estimator(window)
                made[method] = (
                    found.mass - body.mass,
                    time.thread_time() - own,
                    time.perf_counter() - begun,
                )
            rows.append((*made["kernel"], *made["genetic"]))
        kernel, cpu, wall, slow, slow_cpu, slow_wall = np.array(rows).T
        print(
            f"genetic, {'place known' if place else 'place on a line'}: error 95 %"
            f" {percent(abs(slow)):.3f} kg against {percent(abs(kernel)):.3f} of the kernel"
            f" estimator; {np.median(slow_cpu) * 1e3:.0f} ms of one core (wall"
            f" {np.median(slow_wall) * 1e3:.0f}) against {np.median(cpu) * 1e3:.2f} ms (wall"
            f" {np.median(wall) * 1e3:.2f})"
        )


def other_friction(share, signs):
    """The rig with friction off by a share, levels in the order viscous, Coulomb."""
    viscous, coulomb = (
        RIG.drive.viscous * (1 + share * signs[:2]),
        RIG.drive.coulomb * (1 + share * signs[2:]),
    )
    return dataclasses.replace(
        RIG, drive=dataclasses.replace(RIG.drive, viscous=viscous, coulomb=coulomb)
    )


def detection(runs):
    """Detection time of loads of 1 kg and more, friction exact and 5 % off."""
    for share in (0.0, 0.05):
        random, times = np.random.default_rng(21), []
        for _ in range(runs):
            body, change = drawn(random)
            rig = other_friction(share, random.choice([-1.0, 1.0], 4))
            law = ComputedTorque(ARMS["published f"], RIG, bandwidth=150.0)
            estimator, first = (
                PayloadEstimator(law, position=body.com, beside=False, prior=0.0),
                lead(change),
            )
            controller, stepped = started(estimator, ARMS["published f"], rig, first)
            change -= first
            run(controller, stepped, change + 180, change, body, first)
            seen = [event.time for event in controller.events[1:] if event.time >= change * PERIOD]
            times.append((seen[0] - change * PERIOD) * 1e3 if seen else np.inf)
        times = np.array(times)
        print(
            f"detection, friction {share:.0%} off: {np.mean(times <= 60):.1%} within 60 ms, median "
            f"{np.median(times):.0f} ms"
        )


def alarms(runs):
    """The largest change statistic of whole runs of (6) without a change, and of loads where
    friction is 10 % off.
    """
    law = ComputedTorque(ARMS["published f"], RIG, bandwidth=150.0)
    estimator = PayloadEstimator(law, position=(0.0, -0.35, 0.0), beside=False, prior=0.0)
    block = estimator.loop_law.block(RIG)
    state, given = ca.SX.sym("state", len(block.initial)), ca.SX.sym("given", 10)
    _, following = block.step(
        state,
        given[:2],
        given[2:4],
        given[4:6],
        ca.SX.zeros(2),
        given[6:8],
        given[8:],
        PERIOD,
        block.values,
    )
    step = ca.Function("step", [state, given], [following, following[-1]])

    def largest(record):
        motion, torque = PATH(record.t), record.torque
        given = np.column_stack([*motion, record.counts, np.vstack([torque[:1], torque[:-1]])]).T
        _, change = step.mapaccum(len(torque))(block.initial, given)
        return np.abs(change.full().ravel()[round(0.1 / PERIOD) :]).max()

    for share, count in ((0.05, runs), (0.10, max(16, runs // 10))):
        random, found = np.random.default_rng(31), []
        for i in range(count):
            signs = random.choice([-1.0, 1.0], 4) if i % 2 else random.uniform(-1, 1, 4)
            found.append(
                largest(simulate(ARMS["published f"], other_friction(share, signs), law, PATH))
            )
        rate = np.mean(np.array(found) > estimator.alarm)
        print(
            f"alarms, friction up to {share:.0%} off: {count} runs, largest change"
            f" {max(found):.2f}, limit {estimator.alarm:g}, false alarms {rate:.2%}"
        )
        if share == 0.10:
            limit = 1.1 * max(found)
            for mass in (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0):
                random, seen = np.random.default_rng(33), []
                for _ in range(40):
                    body, change = drawn(random, mass)
                    rig = other_friction(share, random.choice([-1.0, 1.0], 4))
                    tolerant = PayloadEstimator(
                        law, position=body.com, beside=False, prior=0.0, alarm=limit
                    )
                    first = lead(change)
                    controller, stepped = started(tolerant, ARMS["published f"], rig, first)
                    change -= first
                    _, _, statistic = run(controller, stepped, change + 86, change, body, first)
                    seen.append(np.abs(statistic[change:]).max() > limit)
                print(f"  {mass:g} kg, limit {limit:.2f}: {np.mean(seen):.0%} within 60 ms")
                if np.mean(seen) >= 0.95:
                    break


def paced(seconds):
    """Late steps of a loop paced by a clock, with the estimator and without, in turns of 3 s on
    a shared machine.
    """
    motion = PATH(np.arange(round(PATH.period / PERIOD)) * PERIOD)
    law = ComputedTorque(ARMS["published f"], RIG, bandwidth=150.0)
    load = Body(mass=2.5, com=(0.0, -0.4, 0.0))
    methods = ("none", "kernel", "genetic")
    late, longest, answered, long = ({method: [] for method in methods} for _ in range(4))
    for _ in range(max(1, round(seconds / 3.0))):
        for method in methods:
            made = (
                law if method == "none" else PayloadEstimator(law, position=load.com, method=method)
            )
            controller, stepped = started(made, ARMS["published f"])
            pulses, missed, own = stepped.pulses, 0, []
            begun = time.perf_counter()
            for k in range(round(3.0 / PERIOD)):
                if k % 1500 == 750:
                    stepped.carry(load if k % 3000 == 750 else None)
                due = begun + k * PERIOD
                while (now := time.perf_counter()) < due:
                    if due - now > 2e-4:
                        time.sleep(1e-4)
                if now - due > PERIOD:
                    missed += 1
                    begun = now - k * PERIOD
                i = k % len(motion.q)
                torque = controller.step(pulses, motion.q[i], motion.qd[i], motion.qdd[i])
                own.append(time.perf_counter() - now)
                pulses = stepped.step(torque)
            late[method].append(missed)
            longest[method].append(np.percentile(own, 99.9))
            long[method].append(np.sum(np.array(own) > PERIOD))
            answered[method].append(
                sum(np.isfinite(event.after) for event in getattr(controller, "events", []))
            )
    for method in methods:
        print(
            f"paced, {3 * len(late[method])} s, {method}: {sum(late[method])} late steps (per turn"
            f" median {np.median(late[method]):.0f}, least {min(late[method])}), calls longer than"
            f" a period {sum(long[method])}, 99.9 % of the calls within"
            f" {np.median(longest[method]) * 1e6:.0f} us, {sum(answered[method])} loads found"
        )


def elastic(runs):
    """A load of 5 kg on gears of 60 Hz (empty), under a law tuned for gears and loads."""
    arm, law_of = ARMS["literature arm"], elastic_law
    gears = Elasticity.from_resonance(arm, (60.0, 60.0), 0.02)
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears))
    law = law_of(arm, rig)
    random, rows = np.random.default_rng(41), []
    for _ in range(runs):
        body, change = drawn(random, 5.0, farthest=0.4)  # as far as the law was tuned for
        first, ends = lead(change), {}
        begin = change - first
        for which, made in (
            ("with", PayloadEstimator(law, position=body.com, beside=False)),
            ("without", law),
        ):
            controller, stepped = started(made, arm, rig, first)
            errors, _, _ = run(
                controller, stepped, begin + round(AFTER / PERIOD), begin, body, first
            )
            worst = np.abs(errors).max(axis=1)
            if which == "with":
                event = next((e for e in controller.events[1:] if np.isfinite(e.swapped)), None)
                swapped = len(worst) if event is None else round(event.swapped / PERIOD)
            later = min(swapped + round(0.3 / PERIOD), len(worst) - 1)
            ends[which] = [
                worst[min(swapped, len(worst) - 1) :].max(),
                worst[later:].max(),
                worst[begin:].max(),
            ]
        rows.append(
            [np.nan if event is None else abs(event.after - 5.0), *ends["with"], *ends["without"]]
        )
    rows = np.array(rows)
    answered = np.isfinite(rows[:, 0])
    mass, after, settled, peak, bare, bare_settled, bare_peak = rows[answered].T
    print(
        f"elastic, 60 Hz: {answered.mean():.1%} answered, mass 95 % {percent(mass):.3f} kg; every"
        f" sample within 1 from the swap on in {np.mean(after <= 1):.1%} (without"
        f" {np.mean(bare <= 1):.1%}), from 0.3 s after it in {np.mean(settled <= 1):.1%}"
        f" ({np.mean(bare_settled <= 1):.1%}); peak {np.median(peak):.0f}, at most {peak.max():.0f}"
        f" pulses ({np.median(bare_peak):.0f}, {bare_peak.max():.0f})"
    )


def elastic_law(arm, rig):
    """What `tune` found for gears of 58 to 62 Hz (empty), loads of 0 to 5 kg at 0.4 m and friction
    within 3 %.

    ``tune(arm, RIG, PATH, resonance=(58, 62), damping_ratio=(0.02, 0.02), friction=0.03, load=(0,
    5), load_position=(0, -0.4, 0), covariance=np.zeros((9, 9)))``; 7 minutes.
    """
    numbers = {
        "bandwidth": 306.5,
        "ratio": 1.121,
        "integral": 44.73,
        "roll_off": 4041.0,
        "roll_off_damping": 0.682,
    }
    return ComputedTorquePID(arm, rig, **numbers)


if __name__ == "__main__":
    sections = {
        each.__name__: each
        for each in (kilograms, restored, bare, swap, genetic, detection, alarms, paced, elastic)
    }
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sections", nargs="*", choices=[*sections, []], default=list(sections))
    parser.add_argument("--runs", type=int, default=200)
    options = parser.parse_args()
    amounts = {
        "alarms": 5 * options.runs,
        "paced": min(60, 0.3 * options.runs),
        "swap": options.runs // 5,
        "genetic": options.runs // 2,
    }
    for each in options.sections:
        begun = time.perf_counter()
        sections[each](amounts.get(each, options.runs))
        print(f"  ({time.perf_counter() - begun:.0f} s)", flush=True)
