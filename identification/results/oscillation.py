"""Oscillation in the tracking errors: its frequency, its origin, and a filter that removes it.

The paper takes the 27-32 Hz of its errors for a disturbance and filters it out (Figs. 10-11). Under
P control this oscillation is a mode of the position loop: it depends on the inertias, so the
identification needs it. An oscillation is a disturbance (from a flexible base or a loose sensor)
only if the linearised loop has no mode at its frequency.

Source: paper Figs. 10-11, 4.2.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.equation_error import mode_in, modes_along
from identification.results.plots import plot_oscillation
from plant import Arm, Law, Record
from plant.parts import (
    Floats,
    Frozen,
    Piece,
    Shown,
    Table,
    Verdict,
    array,
    frozen,
    frozen_settings,
    instance,
    known_options,
)


@frozen_settings
class OscillationSettings:
    """Shape of the band-stop filter, and tolerance of the comparison with the modes of the loop.

    All values were chosen by hand.

    Parameters
    ----------
    band : float
        Factor by which the edges of the stop band lie below and above the frequency.
    order : int
        Order of the Butterworth filter.
    periods : float
        Periods of the oscillation by which the errors are continued at both ends, so that the
        filter acts there too.
    tolerance : float
        Relative distance from the frequencies of a mode of the linearised loop within which the
        oscillation counts as that mode.
    poses : int
        Poses along the motion at which the loop is linearised.
    """

    band: float = 1.5
    order: int = 3
    periods: float = 8
    tolerance: float = 0.15
    poses: int = 12


SETTINGS = OscillationSettings()


@frozen
class Oscillation(Shown, Frozen):
    """The oscillation in the tracking errors of a record.

    Attributes
    ----------
    frequency : float
        [Hz]
    amplitude : (n,) numpy.ndarray
        Root mean square of the part of each error that the filter removes [pulses].
    modes : tuple of (float, float)
        Lowest and highest frequency of each mode of the linearised loop along the motion [Hz];
        empty without an arm.
    own : bool or None
        Whether the oscillation is the position loop's own mode; None without an arm.
    record : Record
    joints : tuple of str
        Name of each joint.
    """

    frequency: float
    amplitude: Floats
    modes: tuple[tuple[float, float], ...]
    own: bool | None
    record: Record
    joints: tuple[str, ...]

    def removed(self, errors: ArrayLike) -> Floats:
        """Errors (N, n) without the oscillation, by a band-stop filter without phase shift."""
        from scipy.signal import butter, sosfiltfilt

        shape = self.record.error_pulses.shape
        # Any signal of the same shape, such as errors of a simulation.
        errors = array(
            "errors",
            errors,
            shape,
            advice="Give one row per sample of this record, one column per joint.",
        )
        per_sample = self.frequency * self.record.rig.period  # periods of the oscillation
        # The filter counts in units of the Nyquist frequency.
        band = (
            np.array([self.frequency / SETTINGS.band, self.frequency * SETTINGS.band])
            * 2
            * self.record.rig.period
        )
        # Near the Nyquist frequency all above the lower edge belongs to the oscillation.
        kind, edges = ("bandstop", band) if band[1] < 1 else ("lowpass", band[0])
        sections = butter(SETTINGS.order, edges, kind, output="sos")
        # Forwards and backwards, so that the phases cancel.
        ends = min(len(errors) - 1, int(SETTINGS.periods / per_sample))
        return sosfiltfilt(sections, errors, axis=0, padlen=ends)

    def _short(self) -> str:
        origin = {None: "", True: ", the loop's own", False: ", a disturbance"}[self.own]
        return f"{self.frequency:.1f} Hz, up to {self.amplitude.max():.2f} pulses (rms){origin}"

    def _shown(self) -> Iterator[Piece]:
        modes = ", ".join(f"{low:.1f}-{high:.1f}" for low, high in self.modes)
        title = f"oscillation at {self.frequency:.1f} Hz"
        if self.own is None:  # without an arm the verdict is open
            yield Verdict(f"{title}; pass an arm to determine whether it is the loop's own")
        # A mode of the loop depends on the inertias.
        elif self.own:
            yield Verdict(
                f"{title}; the position loop's own mode ({modes} Hz): it excites the inertias,"
                " keep it",
                True,
            )
        else:
            yield Verdict(
                f"{title}; no mode of this arm's position loop ({modes} Hz): a disturbance, unless"
                " the arm is known badly",
                False,
            )
        # How much of the errors it is, joint by joint.
        amplitudes = [f"{value:.2f}" for value in self.amplitude]
        rows = list(zip(self.joints, amplitudes, strict=True))
        yield Table(("", "amplitude [pulses, rms]"), rows)

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Draw errors with and without the oscillation (Figs. 10-11), and spectra: n + 1 Axes."""
        return plot_oscillation(self, ax)


@known_options
def oscillation(record: Record, arm: Arm | None = None) -> Oscillation:
    """Find the oscillation in the tracking errors of a record.

    Parameters
    ----------
    record : Record
    arm : Arm, optional
        The linearised loop of this arm shows whether the oscillation is a mode of the loop. A rough
        arm suffices.

    Returns
    -------
    Oscillation
        Print it.

    Raises
    ------
    ValueError
        Bad input, or a law that cannot be linearised.

    See Also
    --------
    identification.Objective

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import oscillation
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference())
    >>> oscillation(record).amplitude.shape
    (2,)
    """
    instance("record", record, Record, "The order is record, arm.")
    # The strongest line of the errors of all joints, by their accelerations.
    frequency = mode_in(record)
    spans: tuple[tuple[float, float], ...] = ()
    is_mode = None
    # Joints have the labels of the rig, unless an arm is given: its chain names them.
    joints = record.rig.joint_labels
    if arm is not None:
        # With an arm, compare the frequency with the modes of the loop.
        instance("arm", arm, Arm, "Pass found.arm.")
        if record.law is None:
            raise ValueError(
                "the record must name the law that made it; got None. Pass law= when loading it."
            )
        # The loop consists of the arm and of the record's rig and law: the arm must fit the rig.
        record.rig.require_fit(arm.dynamics.chain)
        joints = arm.dynamics.chain.joint_labels
        law = instance("law of the record", record.law, Law, "Pass law= with the log.")
        # The modes move with the pose: compare the frequency with the span of each of them.
        poses = [modes[:, 0] for modes in modes_along(arm, record, law, SETTINGS.poses)]
        spans = mode_spans(poses)
        tolerance = SETTINGS.tolerance
        is_mode = any(
            low * (1 - tolerance) < frequency < high * (1 + tolerance) for low, high in spans
        )
    result = Oscillation(
        frequency=frequency,
        amplitude=np.zeros(record.n),
        modes=spans,
        own=is_mode,
        record=record,
        joints=tuple(joints),
    )
    # The amplitude needs the filter, which needs the frequency.
    removed = record.error_pulses - result.removed(record.error_pulses)
    return replace(result, amplitude=np.sqrt((removed**2).mean(axis=0)))


def mode_spans(poses: Sequence[Floats]) -> tuple[tuple[float, float], ...]:
    """Lowest and highest frequency of each mode, from those of each pose in rising order."""
    most = max(map(len, poses))
    complete = np.array([modes for modes in poses if len(modes) == most])
    lowest = complete.min(axis=0, initial=np.inf)
    highest = complete.max(axis=0, initial=0.0)
    # A mode can be overdamped in some poses: those that are left belong to the nearest ones.
    middle = np.sqrt(lowest * highest)
    for modes in poses:
        if len(modes) < most:
            for frequency in modes:
                nearest = np.argmin(np.abs(np.log(frequency / middle)))
                lowest[nearest] = min(lowest[nearest], frequency)
                highest[nearest] = max(highest[nearest], frequency)
    return tuple(zip(lowest.tolist(), highest.tolist(), strict=True))
