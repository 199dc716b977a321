"""The incremental encoder on the motor shaft: angles to pulses. Source: paper Fig. 4."""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plant.parts import ArrayOrSymbols, Part, Vector, choice, number, part, signs, structure


def fix(x: ArrayOrSymbols) -> ArrayOrSymbols:
    """Round towards zero: the cell around zero is two pulses wide. Source: paper 3.3."""
    # copysign keeps casadi's expression free of a branch at zero.
    return ca.copysign(ca.floor(ca.fabs(x)), x) if isinstance(x, ca.SX) else np.trunc(x)


def nearest(x: ArrayOrSymbols) -> ArrayOrSymbols:
    """Round to the nearest whole number, halves up: the same in numpy and casadi."""
    return ca.floor(x + 0.5) if isinstance(x, ca.SX) else np.floor(x + 0.5)


@part
class Phase(Part):
    """Offset of the counters' zero within a pulse, added before rounding; unknown to a controller.

    Parameters
    ----------
    shift : (n,) array_like
        [pulses]

    See Also
    --------
    plant.Encoder

    Examples
    --------
    >>> from plant import Phase
    >>> Phase(shift=(0.25, 0.5))
    Phase(shift=array([0.25, 0.5 ]))
    """

    shift: Vector = number(("n",))


@part
class QuadratureError(Part):
    """Periodic error of an encoder's tracks (phase and duty cycle), with a period of four counts.

    Counts are taken of the position plus amplitude sin(pi/2 position + phase), in pulses; a
    controller does not know.

    Parameters
    ----------
    amplitude : (n,) array_like
        [pulses], below 2/pi: above, counts would run backwards.
    phase : (n,) array_like, optional
        At position 0 [rad].

    See Also
    --------
    plant.Encoder, identification.oscillation

    Examples
    --------
    >>> from plant import QuadratureError
    >>> QuadratureError(amplitude=(0.1, 0.1))
    QuadratureError(amplitude=array([0.1, 0.1]), phase=None)
    """

    amplitude: Vector = number(("n",))
    phase: Any = number(("n",), default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        # The slope of the shown position, 1 + amplitude pi/2 cos, stays positive below 2/pi.
        if not ((self.amplitude >= 0) & (self.amplitude < 2 / np.pi)).all():
            raise ValueError(
                f"amplitude must be from 0 to below 2/pi pulses; got {self.amplitude}. Give pulses."
            )

    def shifted(self, position: ArrayOrSymbols) -> ArrayOrSymbols:
        """Position that the tracks show, of a true one, both in pulses."""
        # Four counts per line of the tracks: the error repeats every four pulses.
        angle = np.pi / 2 * position if self.phase is None else np.pi / 2 * position + self.phase
        return position + self.amplitude * (
            np.sin(angle) if isinstance(angle, np.ndarray) else ca.sin(angle)
        )


@part
class Encoder(Part):
    """Encoders of all joints.

    Parameters
    ----------
    resolution : (n,) array_like or float
        N_enc, pulses per turn of the *motor*; one number where all are alike.
    smooth : bool
        True leaves out the quantisation, for derivatives (those of a quantiser are zero).
    rounding : {"floor", "fix", "round"}
        Of a position in pulses to counts: down by default, as quadrature counters do, whose cells
        are all one pulse wide; towards zero, as the paper's rig does: the cell around zero is two
        pulses wide; or to the nearest.
    phase : Phase, optional
        By default zero is where a pulse begins; ``Phase(shift=(0.3, 0.6))`` [pulses] places it
        elsewhere.
    quadrature : QuadratureError, optional
        None by default: every pulse is as wide as the next.
    side : {"motor", "link", "both"} or (n,) tuple of "motor" and "both"
        Whether it turns with the motor, or behind an elastic gear with the link; its pulses are
        those of the motor's shaft in any case. With both, the law reads the motor's, and a record
        holds the link's beside them. A tuple where some joints alone have both.

    See Also
    --------
    plant.Rig, plant.QuadratureError, plant.Phase

    Examples
    --------
    >>> from plant import puma560
    >>> encoder = puma560.rig().encoder
    >>> encoder.resolution
    array([ 800., 1000.])
    >>> encoder.to_angle((1, 1)).round(6)                  # of one pulse, at the motor [rad]
    array([0.007854, 0.006283])
    """

    resolution: Vector = number(("n",), alike=True)
    smooth: bool = structure(bool, default=False)
    rounding: str = structure(choices=("floor", "fix", "round"), default="floor")
    phase: Phase | None = structure(Phase, default=None)
    side: str | tuple[str, ...] = structure(default="motor")
    quadrature: QuadratureError | None = structure(QuadratureError, default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("resolution",), advice="Give pulses per motor turn.")
        # Two encoders on some joints alone: the motor's is then always among them.
        if isinstance(self.side, (tuple, list)):
            sides = tuple(choice("side of a joint", x, ("motor", "both")) for x in self.side)
            object.__setattr__(self, "side", sides)
            self.require_joints(len(self.side))
        else:
            choice("side", self.side, ("motor", "link", "both"))
        if np.ndim(self.resolution):
            self.require_joints(len(self.resolution))

    def on_links(self, n: int) -> NDArray[np.bool_]:
        """Which of n motors (n,) have a second encoder, behind their gears."""
        return np.broadcast_to(np.array(self.side) == "both", n)

    def position_in_pulses(self, q_m: ArrayOrSymbols) -> ArrayOrSymbols:
        """Motor angle [rad] in pulses, before rounding."""
        # The constant factor comes first: a kernel then multiplies and does not divide.
        return q_m * (self.resolution * (1 / (2 * np.pi)))

    def counts(self, q_m: ArrayOrSymbols) -> ArrayOrSymbols:
        """Counts of a motor angle [rad], whole numbers, without the phase. Source: paper Fig. 4."""
        return self.quantised(self.position_in_pulses(q_m))

    def quantised(self, position: ArrayOrSymbols) -> ArrayOrSymbols:
        """Counts of a position in pulses, without the phase; the position itself if smooth."""
        # A smooth encoder is for derivatives: those of a quantiser are zero almost everywhere.
        if self.smooth:
            return position
        if self.rounding == "fix":
            return fix(position)
        # floor(x + 1/2) is the same in numpy and casadi, also for halves.
        position = position + 0.5 if self.rounding == "round" else position
        return ca.floor(position) if isinstance(position, ca.SX) else np.floor(position)

    def true_counts(self, position: ArrayOrSymbols) -> ArrayOrSymbols:
        """Counts of a position in pulses, with phase and (unless smooth) quadrature error."""
        # First the error of the tracks, which depends on the true position, then the phase of the
        # counter's zero.
        if self.quadrature is not None and not self.smooth:
            position = self.quadrature.shifted(position)
        return self.quantised(position if self.phase is None else position + self.phase.shift)

    def to_angle(self, position: ArrayOrSymbols) -> ArrayOrSymbols:
        """Motor angle [rad] of a position in pulses; the way back from `position_in_pulses`."""
        return position * (2 * np.pi / self.resolution)

    def cell_centre(self, counts: ArrayOrSymbols) -> ArrayOrSymbols:
        """Motor angle [rad] in the middle of the cell of these counts, without the phase."""
        # The estimate of the position with the smallest error is the middle of the cell: at the
        # count itself when rounding, half a pulse above it with floor, half a pulse further from
        # zero with fix.
        if self.smooth or self.rounding == "round":
            return self.to_angle(counts)
        if self.rounding == "floor":
            return self.to_angle(counts + 0.5)
        return self.to_angle(
            counts + 0.5 * (ca.sign(counts) if isinstance(counts, ca.SX) else np.sign(counts))
        )

    @property
    def centre(self) -> float:
        """Middle of a cell beyond its count [pulses]; of ``"fix"`` that of the widest, around 0."""
        return 0.5 if self.rounding == "floor" and not self.smooth else 0.0

    def half_cell(self, counts: ArrayOrSymbols) -> ArrayOrSymbols:
        """Half the width of the cell of these counts [pulses]: 0.5, or 1 around zero of `fix`."""
        # `0 * counts` gives the result the shape, and the kind, of the counts.
        return 0.5 + (0.5 * (counts == 0) if self.rounding == "fix" else 0 * counts)
