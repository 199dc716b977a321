"""The oscillation in the tracking errors: its frequency, whether it is the loop's own mode, and its
band-stop filter.

The paper takes the 27-32 Hz of its errors for a disturbance and filters it out (Figs. 10-11). Under
P control it is the position loop's own mode: it shows the inertias, and belongs into the
identification. Only a frequency that the linearised loop does not have (a flexible base, a loose
sensor) is a disturbance.

Source: paper Figs. 10-11, 4.2.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.equation_error.pulse_fit import mode_in, modes_along
from identification.results.plots import plot_oscillation
from plant import Arm, Law, Record
from plant.parts.arguments import array, instance, known_options
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table

_WIDTH = 1.5  # the band-stop reaches from the frequency divided by this to the frequency times this

_NEAR = 0.15  # relative distance up to which a mode of the linearised loop is the oscillation

# of the oscillation, by which the errors are continued at their ends, so that it is filtered there
# too
_PERIODS = 8

_POSES = 12


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Oscillation(Shown, Frozen):
    """The oscillation in the tracking errors of a record.

    Attributes
    ----------
    frequency : float
        [Hz]
    amplitude : (n,) numpy.ndarray
        Root mean square of what the filter takes out of each error [pulses].
    modes : tuple of (float, float)
        Lowest and highest frequency of each mode of the linearised loop along the motion [Hz]; none
        without an arm.
    own : bool or None
        Whether the oscillation is the position loop's own mode; None without an arm.
    record : Record
    joints : tuple of str
        What to call each joint.
    """

    frequency: float
    amplitude: Floats
    modes: tuple[tuple[float, float], ...]
    own: bool | None
    record: Record
    joints: tuple[str, ...]

    def removed(self, errors: ArrayLike) -> Floats:
        """Errors (N, n) without the oscillation, by a band-stop run forwards and backwards: no
        phase.
        """
        from scipy.signal import butter, sosfiltfilt

        shape = self.record.error_pulses.shape
        errors = array(
            "errors",
            errors,
            shape,
            advice="Give one row per sample of this record, one column per joint.",
        )
        band = (
            np.array([self.frequency / _WIDTH, self.frequency * _WIDTH])
            * 2
            * self.record.rig.period
        )
        ends = min(len(errors) - 1, int(_PERIODS / (self.frequency * self.record.rig.period)))
        return sosfiltfilt(butter(3, band, "bandstop", output="sos"), errors, axis=0, padlen=ends)

    def _short(self) -> str:
        whose = {None: "", True: ", the loop's own", False: ", a disturbance"}[self.own]
        return f"{self.frequency:.1f} Hz, up to {self.amplitude.max():.2f} pulses (rms){whose}"

    def _shown(self) -> Iterator[Piece]:
        found = ", ".join(f"{low:.1f}-{high:.1f}" for low, high in self.modes)
        said = f"oscillation at {self.frequency:.1f} Hz"
        if self.own is None:
            yield Verdict(f"{said}; pass an arm to determine whether it is the loop's own")
        elif self.own:
            yield Verdict(
                f"{said}; the position loop's own mode ({found} Hz): it excites the inertias,"
                " keep it",
                True,
            )
        else:
            none = f"no mode of this arm's position loop ({found} Hz)"
            yield Verdict(f"{said}; {none}: a disturbance, unless the arm is known badly", False)
        rows = [
            (label, f"{value:.2f}")
            for label, value in zip(self.joints, self.amplitude, strict=True)
        ]
        yield Table(("", "amplitude [pulses, rms]"), rows)

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Draw the errors as measured and without the oscillation (Figs. 10-11), and their
        spectrum: n + 1 Axes.
        """
        return plot_oscillation(self, ax)


@known_options
def oscillation(record: Record, arm: Arm | None = None) -> Oscillation:
    """Find the oscillation in the tracking errors of a record.

    Parameters
    ----------
    record : Record
    arm : Arm, optional
        Known roughly: its linearised loop says whether the oscillation is its own mode.

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
    frequency = mode_in(record)
    spans: tuple[tuple[float, float], ...] = ()
    own = None
    joints = record.rig.joint_labels
    if arm is not None:
        instance("arm", arm, Arm, "Pass found.arm.")
        if record.law is None:
            raise ValueError(
                "the record must name the law that made it; got None. Pass law= when loading it."
            )
        record.rig.require_fit(arm.dynamics.chain)
        joints = arm.dynamics.chain.joint_labels
        law = instance("law of the record", record.law, Law, "Pass law= with the log.")
        found = [each[:, 0] for each in modes_along(arm, record, law, _POSES)]
        count = min(map(len, found))
        lowest, highest = (
            extreme([each[:count] for each in found], axis=0) for extreme in (np.min, np.max)
        )
        spans = tuple(zip(lowest.tolist(), highest.tolist(), strict=True))
        own = any(low * (1 - _NEAR) < frequency < high * (1 + _NEAR) for low, high in spans)
    made = Oscillation(
        frequency=frequency,
        amplitude=np.zeros(record.n),
        modes=spans,
        own=own,
        record=record,
        joints=tuple(joints),
    )
    taken = record.error_pulses - made.removed(record.error_pulses)
    return dataclasses.replace(made, amplitude=np.sqrt((taken**2).mean(axis=0)))
