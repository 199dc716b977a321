"""Limits of a first experiment's motion; multisines for frequency responses, of low crest factor.

In record m joint j is later by j m / n of the period. At lines that share no factor with n the
records are orthogonal so, and all joints move in all of them, each with the crest factor of one
signal.

Source: E. van der Ouderaa, J. Schoukens, J. Renneboog, Peak factor minimization using a
time-frequency domain swapping algorithm, IEEE Transactions on Instrumentation and Measurement 37
(1988); T. Dobrowiecki, J. Schoukens, Measuring a linear approximation to weakly nonlinear MIMO
systems, Automatica 43 (2007), for orthogonal multisines.
"""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant import Arm, Chain, Dynamics, Harmonics, Rig
from plant.parts.arguments import array
from plant.parts.fields import Floats

# Share of the way to a limit, and of a limit of speed; [rad] to either side of joints without
# limits; near a pose.
_SHARE = 0.9
_AROUND = np.pi / 2
_NARROW = 0.1


def experiment_of(given: Any, rig: Rig) -> tuple[Any, Rig]:
    """The arm of a chain with bodies, with the drive's rotors where it has none, and the rig within
    its efforts.

    Anything else as it is.
    """
    if not isinstance(given, Chain):
        return given, rig
    rig.require_fit(given)
    rotors = any(body.rotor for body in given.bodies)
    dynamics = Dynamics.from_chain(given if rotors else given.with_rotors(rig.drive))
    if given.limits is not None:
        rig = dataclasses.replace(rig, drive=rig.drive.limited_to(given.limits.effort))
    return dynamics.arm(dynamics.f()), rig


def motion_limits(
    arm: Arm,
    period: float,
    harmonics: int,
    position: ArrayLike | None,
    velocity: ArrayLike | None,
    acceleration: ArrayLike | None,
    narrow: bool = False,
) -> tuple[Floats, Floats, Floats]:
    """Limits as given; else those of the chain, and as fast as the harmonics can go within them."""
    chain = arm.dynamics.chain
    fastest = 2 * np.pi * harmonics / period
    advice = "Give one per joint."
    lower = np.full(arm.n, -np.inf)
    upper = np.full(arm.n, np.inf)
    speed = np.full(arm.n, np.inf)
    if chain.limits is not None:
        lower = chain.limits.lower
        upper = chain.limits.upper
        speed = chain.limits.velocity
    position = (
        _within(chain, lower, upper, _NARROW if narrow else 1.0) if position is None else position
    )
    position = array(
        "position", position, (arm.n, 2), advice="Give the lowest and highest angle of each joint."
    )
    own = np.minimum(_SHARE * speed, fastest * np.diff(position, axis=1).ravel() / 2)
    velocity = array("velocity", own if velocity is None else velocity, (arm.n,), advice=advice)
    acceleration = fastest * velocity if acceleration is None else acceleration
    acceleration = array("acceleration", acceleration, (arm.n,), advice=advice)
    if (
        not (position[:, 0] < position[:, 1]).all()
        or not (velocity > 0).all()
        or not (acceleration > 0).all()
    ):
        raise ValueError(
            "position must be (low, high) with low < high, speeds and accelerations positive."
            " Correct them."
        )
    return position, velocity, acceleration


def _within(chain: Chain, lower: Floats, upper: Floats, part: float) -> Floats:
    """Positions (n, 2) that leave a share of the way to the limits free; of a joint without, a
    right angle around 0.
    """
    endless = upper - lower >= 2 * np.pi
    for i in np.flatnonzero(~np.isfinite(upper - lower)):
        if chain.links[i].prismatic:
            raise ValueError(
                f"position must be given: {chain.joint_labels[i]} slides without limits. Give"
                " (n, 2)."
            )
    lower = np.where(endless, -_AROUND, lower)
    upper = np.where(endless, _AROUND, upper)
    middle = (lower + upper) / 2
    half = part * _SHARE * (upper - lower) / 2
    return np.column_stack([middle - half, middle + half])


# by default: lines, and the highest of them, as a share of the sampling rate
_LINES = 25
_HIGHEST = 0.1

# Of the search for phases: shares of the peak at which it clips in turn, samples per period of the
# highest line.
_CLIPPED = np.linspace(0.5, 0.98, 200)
_TIMES = 8

# Rounds in which amplitudes shrink to the torque that is allowed, and share by which the last may
# exceed it.
_FITS = 20
_SLACK = 1e-3


def _lines(rig: Rig, period: float, frequencies: ArrayLike | None) -> NDArray[np.intp]:
    """Multiples of 1 / period that are excited: those nearest the frequencies that share no
    factor with n.
    """
    top = _HIGHEST / rig.period
    wanted = np.geomspace(min(2 / period, top), top, _LINES) if frequencies is None else frequencies
    wanted = array("frequencies", wanted, ("F",), advice="Give the lines [Hz].")
    nyquist = 0.5 / rig.period
    if not len(wanted) or not ((wanted > 0) & (wanted < nyquist)).all():
        rule = f"be positive, and below half the sampling rate, {nyquist:.4g} Hz"
        raise ValueError(f"frequencies must {rule}; got {wanted}. Give the lines [Hz].")
    free = np.arange(1, round(nyquist * period) + 1)
    free = free[np.gcd(free, rig.n) == 1]
    return np.unique(free[np.abs(free - period * wanted[:, None]).argmin(axis=1)])


def multisines(
    arm: Arm,
    rig: Rig,
    period: float,
    frequencies: ArrayLike | None,
    share: float,
    limits: tuple[Any, Any, Any],
) -> tuple[Harmonics, ...]:
    """Motions of n records within limits of position, velocity and acceleration, and this share
    of the torques.
    """
    period = max(round(period / rig.period), 1) * rig.period
    lines = _lines(rig, period, frequencies)
    position, velocity, acceleration = motion_limits(
        arm, period, int(lines[-1]), *limits, narrow=True
    )
    unit = np.zeros(lines[-1], complex)
    unit[lines - 1] = -1j * np.exp(1j * _phases(lines)) / lines
    later = np.exp(-2j * np.pi / arm.n * np.outer(np.arange(arm.n), np.arange(1, len(unit) + 1)))
    room = np.diff(position, axis=1).ravel() / 2
    middle = position.mean(axis=1)

    def motion(size: Floats, record: int) -> Harmonics:
        each = size[:, None] * unit * later**record
        return Harmonics(period=period, offset=middle, cosine=each.real, sine=-each.imag)

    of_one = motion(np.ones(arm.n), 0)(np.linspace(0, period, 4 * _TIMES * len(unit)))
    peaks = np.abs(of_one - np.array([middle, 0 * middle, 0 * middle])[:, None]).max(axis=1)
    size = (np.array([room, velocity, acceleration]) / peaks).min(axis=0)
    holding = motion(0 * size, 0).torque_share(arm, rig) / share
    for _ in range(_FITS if (holding < 1).all() else 0):
        motions = tuple(motion(size, record) for record in range(arm.n))
        needed = np.max([each.torque_share(arm, rig) for each in motions], axis=0) / share
        if (needed < 1 + _SLACK).all():
            return motions
        size = size * np.minimum((1 - holding) / np.maximum(needed - holding, 1e-9), 1)
    joint = int(holding.argmax())
    taken = (
        f"{arm.dynamics.chain.joint_labels[joint]} takes {100 * holding[joint]:.0f} % of what"
        " it may"
    )
    raise ValueError(
        f"position must be where drives hold the arm with torque to spare; {taken}. Choose another"
        " pose."
    )


def _phases(lines: NDArray[np.intp]) -> Floats:
    """Phases of cosines of one amplitude at these lines for a low crest factor: from
    Schroeder's, clipped in turns.
    """
    count = _TIMES * int(lines[-1])
    phases: Floats = -np.pi * np.arange(len(lines)) ** 2 / len(lines)
    best = phases
    least = np.inf
    for share in _CLIPPED:
        spectrum = np.zeros(count // 2 + 1, complex)
        spectrum[lines] = np.exp(1j * phases)
        signal = np.fft.irfft(spectrum, count)
        peak = np.abs(signal).max()
        if peak < least:
            best = phases
            least = peak
        phases = np.angle(np.fft.rfft(np.clip(signal, -share * peak, share * peak))[lines])
    return best
