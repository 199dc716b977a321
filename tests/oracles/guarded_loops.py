"""Loops under a running controller, healthy and unstable: the laws of README and
docs/guides/laws.md as they stand.

A healthy loop is simulated, and its counts go through the running controller: as long as that gives
the torques of the simulation, it is the loop. An unstable one is closed sample by sample, since a
stop changes what follows.
"""

import dataclasses

import numba
import numpy as np
from faults import SimulatedArm
from tuned_laws import GAIN, adaptive, pd

from ctc import ComputedTorque, FeedForward, PDGravity, SlidingMode
from plant import PID, Cascade, Elasticity, Guards, P, puma560, simulate
from plant.realtime import Layout

RIG = puma560.rig()
LIMIT = RIG.drive.torque_limit()
FAST = 16
"""Calls per sample of the rig of a law that has no period."""

LAWS = {
    "P of the README": (True, lambda arm, rig: puma560.p_law()),
    "P": (True, lambda arm, rig: P(gain=4 * GAIN)),
    "PD": (True, lambda arm, rig: pd(2.8, 0.5e-3, 1000)),
    "PID": (
        True,
        lambda arm, rig: PID(
            gain=4 * GAIN, derivative=4e-3 * GAIN, filter=1000, integral=160 * GAIN
        ),
    ),
    "cascade": (
        True,
        lambda arm, rig: Cascade(
            position=(800, 800), speed=0.0006 * GAIN, integral=0.006 * GAIN, filter=1000
        ),
    ),
    "PD + gravity": (True, lambda arm, rig: PDGravity(arm, rig, feedback=pd(2.8, 0.5e-3, 1000))),
    "feed-forward + PD": (
        True,
        lambda arm, rig: FeedForward(arm, rig, feedback=pd(0.5, 8e-3, 1000)),
    ),
    "the same, every 0.7 ms": (
        False,
        lambda arm, rig: FeedForward(arm, rig, feedback=pd(0.5, 4e-3, 3000, rig.period)),
    ),
    "adaptive": (False, lambda arm, rig: adaptive(arm, rig, 100, 80, 0.1, 800)),
    "sliding mode": (
        False,
        lambda arm, rig: SlidingMode(arm, rig, bandwidth=60, reach=10, layer=0.1, filter=800),
    ),
    "computed torque": (False, lambda arm, rig: ComputedTorque(arm, rig)),
    "computed torque, 150 rad/s": (False, lambda arm, rig: ComputedTorque(arm, rig, bandwidth=150)),
}
"""Name -> whether it is fast hardware, and the law of an arm and a rig, as tuned in
docs/guides/laws.md.
"""

COLD = {
    "PD + gravity, other f": (
        True,
        lambda arm, rig: PDGravity(arm, rig, feedback=pd(2, 1e-3, 1000)),
    ),
    "feed-forward + PD, other f": (
        True,
        lambda arm, rig: FeedForward(arm, rig, feedback=pd(2.8, 0.5e-3, 1000)),
    ),
    "the same, every 0.7 ms, other f": (
        False,
        lambda arm, rig: FeedForward(arm, rig, feedback=pd(1.4, 1e-3, 1000, rig.period)),
    ),
    "adaptive, other f": (False, lambda arm, rig: adaptive(arm, rig, 150, 160, 100, 400)),
    "sliding mode, other f": (
        False,
        lambda arm, rig: SlidingMode(arm, rig, bandwidth=150, reach=75, layer=0.5, filter=400),
    ),
    "computed torque, other f": LAWS["computed torque"],
    "computed torque, 150 rad/s, other f": LAWS["computed torque, 150 rad/s"],
}
"""The same, tuned there for the f of the paper's forty generations."""


def elastic(arm, hz, damping_ratio=0.02, rig=RIG):
    """The rig, each link swinging at so many Hz against its locked motor; None for rigid gears."""
    gears = (
        None if hz is None else Elasticity.from_resonance(arm, hz, damping_ratio, drive=rig.drive)
    )
    return dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=gears))


@dataclasses.dataclass(frozen=True)
class Margin:
    """How near a loop came to its guards: the status, and the largest of each quantity relative
    to its limit.
    """

    status: str
    saturation: float
    chatter: float


@numba.njit
def _replayed(step, memory, counts, q, qd, qdd, now, torque, places, largest):
    for k in range(len(counts)):
        if step(counts[k], q[k], qd[k], qdd[k], now[k], memory, torque[k]):
            return k
        for row in range(len(largest)):
            for i in range(torque.shape[1]):
                largest[row, i] = max(largest[row, i], memory[places[row, i]])
    return len(counts)


# frozen
def margin(arm, rig, law, motion, *, duration=None, guards=Guards(), model=None):  # noqa: B008
    """Margin of a sampled law, or of one of `LAWS` by its name, which then holds the `model`, by
    default the arm.

    The simulated counts go through the running controller, which must give the same torques. Fast
    hardware without a state, as P, is simulated with its torque at every instant; with one, its
    torque is held from call to call.
    """
    fast = False
    if isinstance(law, str):
        fast, make = (LAWS | COLD)[law]
        rig = dataclasses.replace(rig, period=rig.period / FAST) if fast else rig
        law = make(arm if model is None else model, elastic(arm, None, rig=rig))
    own = elastic(arm, None, rig=rig)
    held = _held(law, rig.period) if fast and len(law.initial_state(rig.n)) else law
    record = simulate(arm, rig, held, motion, duration=duration, steps_per_sample=1 if fast else 8)
    counts = record.reference_pulses - record.error_pulses
    running = law.start(own, counts[0], guards=guards)
    n, torque, largest = rig.n, np.empty(counts.shape), np.zeros((2, rig.n))
    now = record.t if fast else np.full(len(counts), np.nan)
    layout = Layout.of(law.block(own), n)
    places = np.array(
        [[at for at, _ in layout.components(name)] for name in ("limit_window", "swing")]
    )
    done = _replayed(
        running.core.step,
        running.core.memory,
        counts,
        *motion(record.t),
        now,
        torque,
        places,
        largest,
    )
    if done < len(counts) or not (
        running.stopped or np.abs(torque - record.torque).max() < 1e-6 * LIMIT[0]
    ):
        raise RuntimeError("the running controller is not the simulated one")
    return Margin(running.status, *(largest / guards.torque_limits(rig)).max(axis=1))


def _held(law, period):
    """Fast hardware that holds its torque for such a period."""
    if hasattr(law, "feedback"):
        return dataclasses.replace(law, feedback=dataclasses.replace(law.feedback, period=period))
    return dataclasses.replace(law, period=period)


@dataclasses.dataclass(frozen=True)
class Closed:
    """A loop closed sample by sample: applied torques, speeds of motors and links (N, n),
    counts, the stop's sample.
    """

    torque: np.ndarray
    motor_speed: np.ndarray
    link_speed: np.ndarray
    counts: np.ndarray
    stop: int | None
    margin: Margin

    def first(self, window, period=RIG.period):
        """Last sample of the first window [s] in which half of the samples of a joint are at the
        limit, or None.
        """
        at = np.abs(self.torque) >= LIMIT * (1 - 1e-12)
        total, length = np.vstack([np.zeros(2), at.cumsum(axis=0)]), round(window / period)
        full = np.flatnonzero(((total[length:] - total[:-length]) >= length / 2).any(axis=1))
        return int(full[0]) + length - 1 if len(full) else None


# frozen
def closed(arm, rig, law, motion, *, samples, guards=Guards(), steps=8, clock=False):  # noqa: B008
    """The law, which knows nothing of gears, on an arm that may have elastic ones."""
    path = motion(np.arange(samples) * rig.period)
    robot = SimulatedArm(arm, rig, path.q[0], path.qd[0], steps)
    running = law.start(elastic(arm, None, rig=rig), robot.counts(), guards=guards)
    torque, motors, links, counts = (np.empty((samples, rig.n)) for _ in range(4))
    names, largest, stop = ("limit_window", "swing"), np.zeros((2, rig.n)), None
    for k in range(samples):
        counts[k], motors[k], links[k] = robot.counts(), robot.qd, robot.link_speed
        now = {"now": k * rig.period} if clock else {}
        torque[k] = running.step(counts[k], path.q[k], path.qd[k], path.qdd[k], **now)
        largest = np.maximum(largest, [running._row(name) for name in names])
        stop = k if stop is None and running.stopped else stop
        robot.push(torque[k])
    limits = (Guards() if guards is None else guards).torque_limits(rig)
    return Closed(
        torque, motors, links, counts, stop, Margin(running.status, *(largest / limits).max(axis=1))
    )
