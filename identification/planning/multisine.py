"""Motion limits of an experiment; multisines of low crest factor for frequency responses.

In record m the signal of joint j is delayed by j m / n of the period. At lines that share no factor
with n this makes the records orthogonal, while all joints move in all of them, each with the crest
factor of one signal.

Source: E. van der Ouderaa, J. Schoukens, J. Renneboog, Peak factor minimization using a
time-frequency domain swapping algorithm, IEEE Transactions on Instrumentation and Measurement 37
(1988); T. Dobrowiecki, J. Schoukens, Measuring a linear approximation to weakly nonlinear MIMO
systems, Automatica 43 (2007), for orthogonal multisines.
"""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant import Arm, Chain, Dynamics, Harmonics, Rig
from plant.parts import Floats, array, frozen_settings


@frozen_settings
class MotionSettings:
    """Default limits of an experiment's motion, and numbers of the design of multisines.

    Chosen by hand; ``tests/identification/planning`` checks limits, crest factor and the measured
    responses.

    Parameters
    ----------
    share : float
        Share of the chain's limits of position and speed that a motion may use.
    around : float
        Angle to either side of a joint without limits [rad].
    narrow : float
        Share of the range of positions that a multisine may use: it stays near a pose.
    lines : int
        Number of lines where the user states none.
    highest : float
        Highest of them, as a share of the sampling rate.
    clipped : tuple of (float, float, int)
        Lowest and highest share of the peak at which the search for phases clips the signal, and
        the number of its rounds.
    samples : int
        Samples per period of the highest line in that search.
    rounds : int
        Rounds in which the amplitudes shrink until the drives can give the torque.
    slack : float
        Share by which the torque may then exceed its limit.
    """

    # Default limits of any motion.
    share: float = 0.9
    around: float = np.pi / 2
    narrow: float = 0.1
    # Design of multisines.
    lines: int = 25
    highest: float = 0.1
    clipped: tuple[float, float, int] = (0.5, 0.98, 200)
    samples: int = 8
    rounds: int = 20
    slack: float = 1e-3


SETTINGS = MotionSettings()


def experiment_of(source: Any, rig: Rig) -> tuple[Any, Rig]:
    """The arm of a chain, and the rig within the chain's efforts; anything else stays as it is.

    A chain without rotors gets those of the drive.
    """
    if not isinstance(source, Chain):
        return source, rig
    rig.require_fit(source)
    # Model files seldom state rotors, but geared arms depend on them.
    rotors = any(body.rotor for body in source.bodies)
    dynamics = Dynamics.from_chain(source if rotors else source.with_rotors(rig.drive))
    if source.limits is not None:
        rig = dataclasses.replace(rig, drive=rig.drive.limited_to(source.limits.effort))
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
    """Position (n, 2), velocity (n,) and acceleration (n,) limits: the user's, or the chain's.

    Where neither states one, it is what the harmonics need within the others.
    """
    chain = arm.dynamics.chain
    # Angular frequency of the highest harmonic [rad/s].
    fastest = 2 * np.pi * harmonics / period
    advice = "Give one per joint."
    # Without limits of the chain only a stated position keeps a joint in place.
    lower = np.full(arm.n, -np.inf)
    upper = np.full(arm.n, np.inf)
    speed = np.full(arm.n, np.inf)
    if chain.limits is not None:
        lower = chain.limits.lower
        upper = chain.limits.upper
        speed = chain.limits.velocity
    if position is None:
        position = _within(chain, lower, upper, SETTINGS.narrow if narrow else 1.0)
    position = array(
        "position", position, (arm.n, 2), advice="Give the lowest and highest angle of each joint."
    )
    # A user may state any of the three limits; the others follow in this order.
    if velocity is None:
        # The highest harmonic alone, over the range of positions.
        amplitude = np.diff(position, axis=1).ravel() / 2
        velocity = np.minimum(SETTINGS.share * speed, fastest * amplitude)
    velocity = array("velocity", velocity, (arm.n,), advice=advice)
    if acceleration is None:
        acceleration = fastest * velocity
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


def _within(chain, lower, upper, part):
    """Positions (n, 2) around the middle of each joint's limits, `part` of their usable range.

    A joint that turns without end is limited to a right angle on both sides of 0.
    """
    endless = upper - lower >= 2 * np.pi
    # A right angle means nothing on a sliding joint.
    for i in np.flatnonzero(~np.isfinite(upper - lower)):
        if chain.links[i].prismatic:
            raise ValueError(
                f"position must be given: {chain.joint_labels[i]} slides without limits. Give"
                " (n, 2)."
            )
    lower = np.where(endless, -SETTINGS.around, lower)
    upper = np.where(endless, SETTINGS.around, upper)
    middle = (lower + upper) / 2
    half = part * SETTINGS.share * (upper - lower) / 2
    return np.column_stack([middle - half, middle + half])


def _lines(rig, period, frequencies):
    """Multiples of 1 / period nearest to the frequencies, without a common factor with n."""
    wanted = frequencies
    if wanted is None:
        # From two periods in a record on; evenly spaced in the logarithm.
        top = SETTINGS.highest / rig.period
        wanted = np.geomspace(min(2 / period, top), top, SETTINGS.lines)
    wanted = array("frequencies", wanted, ("F",), advice="Give the lines [Hz].")
    # Above half the sampling rate a line is an alias of a lower one.
    nyquist = 0.5 / rig.period
    if not len(wanted) or not ((wanted > 0) & (wanted < nyquist)).all():
        rule = f"be positive, and below half the sampling rate, {nyquist:.4g} Hz"
        raise ValueError(f"frequencies must {rule}; got {wanted}. Give the lines [Hz].")
    # Lines with a factor in common with n would be delayed alike in two records.
    multiples = np.arange(1, round(nyquist * period) + 1)
    multiples = multiples[np.gcd(multiples, rig.n) == 1]
    # Two frequencies can have the same nearest line.
    return np.unique(multiples[np.abs(multiples - period * wanted[:, None]).argmin(axis=1)])


def multisines(
    arm: Arm,
    rig: Rig,
    period: float,
    frequencies: ArrayLike | None,
    share: float,
    limits: tuple[Any, Any, Any],
) -> tuple[Harmonics, ...]:
    """Multisines of n records within limits of position, velocity, acceleration and torque.

    `share`: share of the amplifiers' limits that the torque may reach.
    """
    # 1. Spectrum of one joint: the amplitudes fall with the frequency, so that all lines have the
    # same speed. The period is a whole number of samples, since only that repeats exactly.
    period = max(round(period / rig.period), 1) * rig.period
    lines = _lines(rig, period, frequencies)
    position, velocity, acceleration = motion_limits(
        arm, period, int(lines[-1]), *limits, narrow=True
    )
    unit = np.zeros(lines[-1], complex)
    unit[lines - 1] = -1j * np.exp(1j * _phases(lines)) / lines
    delay = np.exp(-2j * np.pi / arm.n * np.outer(np.arange(arm.n), np.arange(1, len(unit) + 1)))
    reach = np.diff(position, axis=1).ravel() / 2
    middle = position.mean(axis=1)

    def motion(size, record):
        amplitude = size[:, None] * unit * delay**record
        return Harmonics(period=period, offset=middle, cosine=amplitude.real, sine=-amplitude.imag)

    # 2. The largest amplitude that position, velocity and acceleration allow. Between its own
    # samples a signal goes further, so the peaks are taken at four times as many.
    times = np.linspace(0, period, 4 * SETTINGS.samples * len(unit))
    unit_motion = motion(np.ones(arm.n), 0)(times)
    peaks = np.abs(unit_motion - np.array([middle, 0 * middle, 0 * middle])[:, None]).max(axis=1)
    size = (np.array([reach, velocity, acceleration]) / peaks).min(axis=0)

    # 3. Shrink it to the torque beside the one that holds the pose. A joint's torque depends on the
    # amplitudes of all, hence several rounds.
    # Amplitudes of zero: what the pose alone takes cannot be shrunk away.
    holding = motion(0 * size, 0).torque_share(arm, rig) / share
    for _ in range(SETTINGS.rounds if (holding < 1).all() else 0):
        motions = tuple(motion(size, record) for record in range(arm.n))
        shares = [record.torque_share(arm, rig) for record in motions]
        needed = np.max(shares, axis=0) / share
        if (needed < 1 + SETTINGS.slack).all():
            return motions
        # Only the part of the torque beyond the holding one shrinks with the amplitude.
        size = size * np.minimum((1 - holding) / np.maximum(needed - holding, 1e-9), 1)
    # Either the pose alone takes the torque, or the rounds did not converge.
    joint = int(holding.argmax())
    taken = (
        f"{arm.dynamics.chain.joint_labels[joint]} takes {100 * holding[joint]:.0f} % of what"
        " it may"
    )
    raise ValueError(
        f"position must be where drives hold the arm with torque to spare; {taken}. Choose another"
        " pose."
    )


def _phases(lines):
    """Phases of cosines of equal amplitude at these lines, for a low crest factor.

    From Schroeder's phases: clip the signal, take the phases of the result, and clip less and less.
    """
    count = SETTINGS.samples * int(lines[-1])
    phases = -np.pi * np.arange(len(lines)) ** 2 / len(lines)
    best = phases
    lowest = np.inf
    for share in np.linspace(*SETTINGS.clipped):
        # Clipping changes amplitudes and phases; keep the phases, restore the amplitudes.
        spectrum = np.zeros(count // 2 + 1, complex)
        spectrum[lines] = np.exp(1j * phases)
        signal = np.fft.irfft(spectrum, count)
        peak = np.abs(signal).max()
        # The peak need not fall in every round.
        if peak < lowest:
            best = phases
            lowest = peak
        # Less and less is clipped, as hard clipping at the end would undo what has been gained.
        phases = np.angle(np.fft.rfft(np.clip(signal, -share * peak, share * peak))[lines])
    return best
