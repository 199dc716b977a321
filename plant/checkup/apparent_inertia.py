"""Inertia with which the motors of an arm answer their torques at one frequency.

Behind rigid gears the motors move their own rotors and the arm, so that together they never show
less than the rotors' inertia: D less the rotors is still a positive matrix. Behind elastic gears,
or within their backlash, the arm can swing against the motors: near that resonance small torques
move them far.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plant.checkup.along_log import at_times, sample_times, torque_along
from plant.checkup.signals import Signals
from plant.parts import Floats


@dataclass(frozen=True, kw_only=True)
class ApparentInertiaSettings:
    """Limits of the inertia that motors show; chosen by hand.

    Parameters
    ----------
    around : float
        Lines within this share of the frequency are compared.
    rigid : float
        Share of the rotors' inertia below which no rigid gears lead: the inertia of a rotor is
        known to some per cent. Oscillating loops of ``tests/benchmarks/causes.py`` have 1.3 and
        more behind rigid gears, and 0.2 to 0.8 behind elastic ones or those with backlash.
    """

    around: float = 0.03
    rigid: float = 0.9


SETTINGS = ApparentInertiaSettings()


def shows_soft_gears(signals: Signals, frequency: float) -> bool:
    """Whether the motors show less than the rotors' inertia at a frequency [Hz]."""
    share = share_of_rotors(signals, frequency)
    return share is not None and share < SETTINGS.rigid


def share_of_rotors(signals: Signals, frequency: float) -> float | None:
    """Inertia that the motors show at a frequency [Hz], as a share of their rotors'.

    None where that cannot be seen: no torque is logged and none follows from the law, or the
    inertia of no rotor is known, or an encoder is not on its motor.
    """
    rig = signals.rig
    torque = _joint_torques(signals)
    if torque is None or rig.encoder.on_links(signals.n).any():
        return None
    t = sample_times(signals, len(torque))
    turns = at_times(t, signals.t, signals.counts) / rig.encoder.resolution

    lines = np.fft.rfftfreq(len(t), signals.interval)
    near = np.abs(lines - frequency) <= SETTINGS.around * frequency
    acceleration = (2 * np.pi * lines[near, None]) ** 2 * _lines(2 * np.pi * turns)[near]
    # A torque that is held for a sample acts with less of its amplitude.
    held = np.sinc(lines[near, None] * signals.interval)
    driving = held * _lines(rig.drive.motor_torque(torque))[near]

    # Energy per squared speed: each motor counts by its motion, and couplings of the arm drop out.
    of_rotors = float((rig.drive.motor_inertia * np.abs(acceleration) ** 2).sum())
    # The magnitude, since a delay of the torques changes the phase alone.
    of_torques = float(np.abs((driving * acceleration.conj()).sum()))
    return of_torques / of_rotors if of_rotors > 0 else None


def _lines(values: Floats) -> NDArray[np.complex128]:
    """Spectral lines (L, n) of values (K, n), in a window against leakage of the slow motion."""
    window = np.hanning(len(values))[:, None]
    return np.fft.rfft((values - values.mean(axis=0)) * window, axis=0)


def _joint_torques(signals: Signals) -> Floats | None:
    """Joint torques (K, n) [N m] at evenly spaced times: as logged, or as the law gave them."""
    if signals.torque is None:
        return torque_along(signals, signals.record.law, signals.rig)
    torque = signals.rig.drive.joint_torque(signals.torque)
    return at_times(sample_times(signals, len(signals.times)), signals.t, torque)
