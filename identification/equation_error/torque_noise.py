"""Noise of a logged torque or current: white, and independent of what the law commanded.

A current sensor has noise of some tenths of a per cent of its range, which no model of an arm
explains. Third differences remove the torque of the motion and leave the noise; those of the stated
law's torque tell the chatter of its counts apart, which the arm did feel.
"""

import numpy as np

from plant.parts import Bools, Floats, dot, frozen_settings


@frozen_settings
class TorqueNoiseSettings:
    """When a part of a torque is noise; chosen by hand.

    Parameters
    ----------
    alike : float
        Correlation of the third differences with those of the commanded torque, above which they
        come from the command: the law differs in what it makes of counts.
    normal : float
        Standard deviation over the median of the absolute value, of a normal distribution.
    certain : float
        Standard deviations of a correlation above which a difference is more than noise.
    """

    alike: float = 0.3
    normal: float = 1.4826
    certain: float = 5.0


SETTINGS = TorqueNoiseSettings()


def white_noise(torque: Floats, *, held: bool = False) -> Floats:
    """Standard deviation (n,) of the noise in torques (N, n) of consecutive samples.

    The noise is white, or the mean of two samples of white noise where a torque is `held`.

    The median keeps jumps out, such as those of dry friction. Chatter of a controller counts as
    noise: it is an upper bound where the commanded torque is not known.
    """
    differences = np.diff(torque, n=3, axis=0)
    # Third differences of white noise have (1 + 9 + 9 + 1) times its variance, those of means of
    # two samples (1 + 4 + 4 + 1) / 4 for a variance of a half.
    ratio = 5 if held else 20
    return SETTINGS.normal * np.median(np.abs(differences), axis=0) / np.sqrt(ratio)


def independent_noise(logged: Floats, commanded: Floats, *, held: bool) -> Floats:
    """The same (n,) of a logged torque (N, n) less the commanded one (N, n), if it is noise.

    0 of a joint whose difference goes with the chatter of the command.
    """
    noise = white_noise(logged - commanded, held=held)
    for i, (measured, stated) in enumerate(zip(logged.T, commanded.T, strict=True)):
        difference = np.diff(measured - stated, n=3)
        chatter = np.diff(stated, n=3)
        size = np.sqrt(dot(difference, difference) * dot(chatter, chatter))
        if size > 0 and abs(dot(difference, chatter)) > SETTINGS.alike * size:
            noise[i] = 0.0
    return noise


def is_white(difference: Floats) -> Bools:
    """Whether differences (N, n) of torques that are held for a sample are white, of each joint."""
    # Means of two samples of white noise: half of their square changes, the other half stays.
    squares = np.einsum("ij,ij->j", difference, difference)
    steps = np.diff(difference, axis=0)
    changing = np.einsum("ij,ij->j", steps, steps)
    # The sampling deviation of a correlation falls with the root of the number of rows.
    return changing >= squares * (1 - SETTINGS.certain * np.sqrt(2 / len(difference)))
