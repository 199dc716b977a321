"""An engine of its own: arms with turning and sliding joints under sampled or fast controllers.

Nothing of it comes from the library. Newton and Euler's recursion on rows of the modified
Denavit-Hartenberg table gives the torque; its columns for unit accelerations are the inertia. A
step is of second order: positions in the middle of the step, viscous friction by the trapezoidal
rule, dry friction as an impulse inside its bounds. Controllers are difference equations, written
from the docstrings of the laws.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

P, PD, PID, CASCADE = range(4)


class Bodies(NamedTuple):
    """Rows (n, 4) alpha, a, d, theta; slides (n,); mass (n,); com (n, 3); inertia (n, 3, 3)."""

    rows: np.ndarray
    slides: np.ndarray
    mass: np.ndarray
    com: np.ndarray
    inertia: np.ndarray
    gravity: np.ndarray


class Machine(NamedTuple):
    """What stands on the joint (n,): rotor, viscous, coulomb, spring and its rest, torque limit.

    `counts` (n,): per rad or m of the joint, signed; `shift` (n,): phase of the encoder.
    """

    rotor: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    spring: np.ndarray
    rest: np.ndarray
    limit: np.ndarray
    counts: np.ndarray
    shift: np.ndarray


class Controller(NamedTuple):
    """`kind`; `gains` (3, n), joint torque per pulse of the law's own units; see `command`.

    `pole` [rad/s] of the speed's filter, or 0 and a `difference` over samples. `fast`: at every
    sub-step.
    """

    kind: int
    gains: np.ndarray
    pole: float
    difference: int
    fast: bool


@njit(cache=True)
def inverse(bodies, q, qd, qdd, gravity):
    """Joint torques (n,) by Newton and Euler; `gravity` (3,)."""
    n = len(q)
    turns = np.zeros((n, 3, 3))
    places = np.zeros((n, 3))
    forces = np.zeros((n, 3))
    moments = np.zeros((n, 3))
    w, dw, acceleration = np.zeros(3), np.zeros(3), -gravity
    for i in range(n):
        alpha, a, d, theta = bodies.rows[i]
        slides = bodies.slides[i]
        theta += 0.0 if slides else q[i]
        d += q[i] if slides else 0.0
        c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
        turn = np.array([[c, -s, 0.0], [s * ca, c * ca, -sa], [s * sa, c * sa, ca]])
        place = np.array([a, -sa * d, ca * d])
        turns[i], places[i] = turn, place
        acceleration = turn.T @ (
            acceleration + np.cross(dw, place) + np.cross(w, np.cross(w, place))
        )
        w, dw = turn.T @ w, turn.T @ dw
        axis = np.array([0.0, 0.0, 1.0])
        if slides:
            acceleration = acceleration + 2 * np.cross(w, axis * qd[i]) + axis * qdd[i]
        else:
            dw = dw + np.cross(w, axis * qd[i]) + axis * qdd[i]
            w = w + axis * qd[i]
        com = bodies.com[i]
        centre = acceleration + np.cross(dw, com) + np.cross(w, np.cross(w, com))
        forces[i] = bodies.mass[i] * centre
        moments[i] = (
            bodies.inertia[i] @ dw
            + np.cross(w, bodies.inertia[i] @ w)
            + np.cross(com, bodies.mass[i] * centre)
        )
    torque = np.zeros(n)
    force, moment = np.zeros(3), np.zeros(3)
    for i in range(n - 1, -1, -1):
        force = force + forces[i]
        moment = moment + moments[i]
        torque[i] = force[2] if bodies.slides[i] else moment[2]
        force, moment = turns[i] @ force, turns[i] @ moment + np.cross(places[i], turns[i] @ force)
    return torque


@njit(cache=True)
def inertia(bodies, rotor, q):
    """Inertia (n, n): torque of unit accelerations without gravity, and the rotors."""
    n = len(q)
    matrix = np.zeros((n, n))
    for i in range(n):
        unit = np.zeros(n)
        unit[i] = 1.0
        matrix[:, i] = inverse(bodies, q, np.zeros(n), unit, np.zeros(3))
        matrix[i, i] += rotor[i]
    return matrix


@njit(cache=True)
def rate_of(law, memory, signal, dt):
    """Speed (n,) of a signal; memory rows: smoothed or earlier readings, and whether it began."""
    n = len(signal)
    if law.difference:
        if memory[-1, 0] == 0.0:
            memory[: law.difference] = signal
        speed = (signal - memory[law.difference - 1]) / (law.difference * dt)
        for j in range(law.difference - 1, 0, -1):
            memory[j] = memory[j - 1]
        memory[0] = signal
    else:
        if memory[-1, 0] == 0.0:
            memory[0] = signal
        speed = np.zeros(n)
        for i in range(n):
            change = (1 - math.exp(-law.pole * dt)) * (signal[i] - memory[0, i])
            memory[0, i] += change
            speed[i] = change / dt
    memory[-1] = 1.0
    return speed


@njit(cache=True)
def command(law, memory, reference, counts, torque, dt):
    """Joint torque (n,); memory rows: integral, last command, and those of `rate_of`."""
    error = reference - counts
    first, second, third = law.gains
    if law.kind == 0:
        return first * error
    if law.kind == 1:
        return first * error + second * rate_of(law, memory[2:], error, dt)
    missing = torque - memory[1]
    if law.kind == 2:
        unwinding = np.minimum(third / first * dt, 1.0)
        memory[0] += third * error * dt + unwinding * missing
        memory[1] = first * error + second * rate_of(law, memory[2:], error, dt) + memory[0]
    else:
        slow = first * error - rate_of(law, memory[2:], counts, dt)
        unwinding = np.minimum(third / second * dt, 1.0)
        memory[0] += third * slow * dt + unwinding * missing
        memory[1] = second * slow + memory[0]
    return memory[1].copy()


@njit(cache=True)
def run(bodies, machine, law, start, speed, reference, between, period, sub):
    """Counts and joint torque (N, n), reference counts (N, n), or between samples (N sub, n)."""
    samples, n = reference.shape
    q, v = start.copy(), speed.copy()
    before = np.zeros(n)
    memory = np.zeros((law.difference + 4, n))
    counted, torques = np.zeros((samples, n)), np.zeros((samples, n))
    torque, impulse = np.zeros(n), np.zeros(n)
    h = period / sub
    for k in range(samples):
        counts = np.floor(q * machine.counts + machine.shift)
        counted[k] = counts
        if not law.fast:
            asked = command(law, memory, reference[k], counts, torque, period)
            torque = np.minimum(np.maximum(asked, -machine.limit), machine.limit)
        for j in range(sub):
            middle = q + h / 2 * v
            if law.fast:
                counts = np.floor(middle * machine.counts + machine.shift)
                asked = command(law, memory, between[k * sub + j], counts, torque, h)
                torque = np.minimum(np.maximum(asked, -machine.limit), machine.limit)
            if j == 0:
                torques[k] = torque
            matrix = inertia(bodies, machine.rotor, middle)
            guess = v + h / 2 * before
            held = inverse(bodies, middle, guess, np.zeros(n), bodies.gravity)
            held += machine.spring * (middle - machine.rest)
            # Viscous friction by the trapezoidal rule.
            left = matrix + h / 2 * np.diag(machine.viscous)
            compliance = np.linalg.inv(left)
            free = compliance @ (matrix @ v - h / 2 * machine.viscous * v + h * (torque - held))
            # Dry friction: impulses inside their bounds that hold the joint still, if they can.
            after = free + compliance @ impulse
            for _ in range(30):
                moved = 0.0
                for i in range(n):
                    most = h * machine.coulomb[i]
                    wanted = impulse[i] - after[i] / compliance[i, i]
                    wanted = min(max(wanted, -most), most)
                    change = wanted - impulse[i]
                    if change != 0.0:
                        after += compliance[:, i] * change
                        impulse[i] = wanted
                        moved = max(moved, abs(change) / (most + 1e-30))
                if moved < 1e-12:
                    break
            before = (after - v) / h
            q = q + h / 2 * (v + after)
            v = after
    return counted, torques
