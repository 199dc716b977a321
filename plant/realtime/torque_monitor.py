"""Sustained saturation and chatter of a law's torque, in casadi: measures per sample, and when they are too large.

The running controller and the exported C take both from here. All is on the shafts, which have the amplifiers' limits;
without coupling they are the joints.

*Saturation* is the time at the limit within a sliding window of `WINDOW`, kept in slots: the oldest is dropped when the
newest is full (`SLOT`), so that the window is never shorter than `WINDOW`, and at most a slot longer.

*Chatter* is the mean distance of the torque from its own running mean. What quantisation or a
sound loop adds to the torque is small against the limit, however much of it changes from one sample to the next; the
oscillation of an unstable loop grows until it is the limit itself, at whatever frequency
(`tests/benchmarks/guards.py`). A fast path moves the mean instead.
"""

from collections.abc import Sequence

import casadi as ca

from plant.machine.drive import Drive

WINDOW = 0.1
"""Length of the window in which time at the limit is counted [s]."""

SLOTS = 6
"""Slots of it, with the one that is being filled."""

HELD = 0.5e-3
"""Time for which a law without a period must stay at its limit before it counts [s]: one pulse may take it there."""

_ROUNDING = 1e-9

SLOT = (1 - _ROUNDING) * WINDOW / (SLOTS - 1)
"""Age at which the newest slot is full [s]."""

MEMORY = 0.01
"""Time constant of the mean that chatter swings about [s]: 100 rad/s, above what a path asks for."""

AVERAGED = 0.05
"""Time constant over which the swing is averaged [s]."""


def throughout(run: ca.SX, asked: ca.SX, drive: Drive, passed: ca.SX, least: ca.SX | float) -> tuple[ca.SX, ca.SX]:
    """Time without a break at the limit (n, 1), and what of the `passed` time counts: all, from a least time on [s].

    Parameters
    ----------
    run : casadi SX (n, 1)
        The first result of the sample before [s].
    asked : casadi SX (n, 1)
        Commanded torque, before the limit [N m].
    drive : Drive
    passed : casadi SX
        Time that one sample stands for [s].
    least : casadi SX
        Such a time without a break [s].
    """
    beyond = ca.fabs(drive.coupling.shaft_torque(asked)) >= drive.torque_limit()
    run = ca.if_else(beyond, run + passed, 0)
    return run, ca.if_else(beyond, ca.if_else(run >= least, passed, 0), 0)


def at_limit(slots: ca.SX, counted: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Time at the limit in the window (n, 1), and in its newest slot (n, 1) [s].

    Parameters
    ----------
    slots : casadi SX (n, k)
        Time at the limit in each slot, the newest first [s].
    counted : casadi SX (n, 1)
        Time at the limit to be added [s].
    """
    newest = slots[:, 0] + counted
    return newest + ca.sum2(slots[:, 1:]), newest


def at_the_limit(torque: ca.SX, drive: Drive) -> ca.SX:
    """Whether an applied joint torque (n, 1) [N m] is that of the limit, (n, 1)."""
    return ca.fabs(drive.coupling.shaft_torque(torque)) >= (1 - _ROUNDING) * drive.torque_limit()


def swing(
    mean: ca.SX, swing: ca.SX, torque: ca.SX, drive: Drive, age: ca.SX, passed: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Running mean of the torque (n, 1) [N m], mean swing about it on the shafts (n, 1) [N m], and the age [s].

    Parameters
    ----------
    mean, swing : casadi SX (n, 1)
        Of the sample before.
    torque : casadi SX (n, 1)
        After the limit [N m].
    drive : Drive
    age : casadi SX
        Time since the start [s]: the first torque is the first mean.
    passed : casadi SX
        Time that one sample stands for [s].
    """
    mean = mean + passed / (passed + ca.fmin(age, MEMORY)) * (torque - mean)
    distance = ca.fabs(drive.coupling.shaft_torque(torque - mean))
    return mean, swing + passed / (passed + AVERAGED) * (distance - swing), age + passed


def cause(time: ca.SX, swing: ca.SX, limits: Sequence[ca.SX], codes: tuple[int, int]) -> ca.SX:
    """Per joint (n, 1) the first of two codes where the time has reached its limit, the second for the swing, or 0."""
    return ca.if_else(time >= limits[0], codes[0], ca.if_else(swing >= limits[1], codes[1], 0))
