"""The rig between controller and arm: drives, encoders, sampling period, delay, springs."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Self

import casadi as ca
import numpy as np
from casadi import SX

from plant.machine.drive import Drive
from plant.machine.encoder import Encoder
from plant.machine.inner_loop import InnerLoop
from plant.machine.known_torque import KnownTorque, require_torques, total_torque
from plant.mechanics import Chain
from plant.parts import (
    ArrayOrSymbols,
    Floats,
    Part,
    joint_labels,
    joint_numbers,
    number,
    part,
    real,
    signs,
    structure,
)

# `sliding_rig` sets the numbers of dry friction to zero. Their names begin with one of these.
DRY_FRICTION = (
    "drive.coulomb",
    "drive.curve.breakaway",
    "drive.load_friction",
    "drive.presliding.damping",
)

# Factor of the draws of jitter in stream 0. At stream 2^20 the factor would be twice that, and the
# instants would follow those of stream 0; far above, the draws have no digits left.
_FACTOR = 2**20


@part
class Jitter(Part):
    """Uniform random displacement of the instants at which a law reads the encoders.

    Jitter moves neither the instants of the log nor the start of the torque. Linear analysis
    ignores jitter.

    Parameters
    ----------
    share : float
        Largest displacement to either side, as a share of the law's period.
    seed : int
        Seed of the draws.
    stream : float
        A whole number from 0 to 2^20 - 1: loops with different streams have different instants.

    See Also
    --------
    plant.Rig, plant.Transport

    Examples
    --------
    >>> from plant import Jitter
    >>> Jitter(share=0.1, seed=3)
    Jitter(share=0.1, seed=3, stream=0.0)
    """

    share: float = number(())
    seed: int = structure(default=0)
    stream: float = number((), default=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        # Half a period to either side at most: two readings cannot change their order.
        if not 0 <= self.share <= 0.5:
            raise ValueError(
                f"share must be from 0 to 0.5 of the period; got {self.share:g}. Instants stay"
                " apart so."
            )
        if (
            isinstance(self.seed, bool)
            or not isinstance(self.seed, (int, np.integer))
            or self.seed < 0
        ):
            raise ValueError(
                f"seed must be a whole number, 0 or more; got {self.seed!r:.60}. Give one, such"
                " as 0."
            )
        if not 0 <= self.stream < _FACTOR or self.stream % 1:
            raise ValueError(
                f"stream must be a whole number, 0 or more and below {_FACTOR}; got"
                f" {self.stream:g}. One loop needs none."
            )
        object.__setattr__(self, "seed", int(self.seed))

    def draws(self, steps: int) -> Floats:
        """One draw (steps,) from 0 to 1 for each step of the law."""
        return np.random.default_rng(self.seed).random(steps)

    def late(self, draw: SX, period: SX | float) -> SX:
        """Time [s] by which a step reads the encoders late; negative if it reads them early."""
        # All loops of a batch share one draw per step. The fractional part of a large multiple of
        # it is uniform again; with a factor far above all streams, two streams are as good as
        # independent.
        scaled = (_FACTOR + self.stream) * draw
        # From 0..1 to -1..1, times the largest displacement.
        return self.share * period * (2 * (scaled - ca.floor(scaled)) - 1)


@part
class Transport(Part):
    """Delayed torque and lost samples under a law with a period; linear analysis ignores them.

    Parameters
    ----------
    delay : float
        Time from a sample to its torque [s], at most one period of the law.
    lost : sequence of int
        Steps of the law, counted from 0, whose counts do not arrive; those of step 0 always do.
    bit : float
        1 / 2^j for the loop whose losses are in bit j of a shared word; 1 for a loop on its own.

    See Also
    --------
    plant.Rig, plant.Jitter

    Examples
    --------
    >>> from plant import Transport
    >>> Transport(delay=0.0005, lost=(100, 101))
    Transport(delay=0.0005, lost=(100, 101), bit=1.0)
    """

    delay: float = number((), default=0.0)
    lost: tuple[int, ...] = structure(default=())
    bit: float = number((), default=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, not_negative=("delay",), advice="Give seconds after the sample.")
        lost = self.lost
        if isinstance(lost, str) or not np.iterable(lost):
            raise ValueError(
                f"lost must be a sequence of steps; got {lost!r:.60}. Write ({lost!r:.60},)."
            )
        # An iterator gives its steps once.
        lost = tuple(lost)
        # True is an int in Python, but no step. Step 0 has no earlier counts that could be read in
        # the place of its own.
        whole = all(isinstance(k, (int, np.integer)) and not isinstance(k, bool) for k in lost)
        if not whole or min(lost, default=1) < 1:
            raise ValueError(
                f"lost must be whole numbers of at least 1; got {lost!r:.60}. The first counts"
                " arrive."
            )
        object.__setattr__(self, "lost", tuple(int(k) for k in lost))
        # A power of two has the mantissa 1/2.
        if not 0 < self.bit <= 1 or math.frexp(self.bit)[0] != 0.5:
            raise ValueError(
                f"bit must be 1, or 1 / 2^j for bit j of a word; got {self.bit:g}. One loop needs"
                " none."
            )

    def words(self, steps: int) -> Floats:
        """Words (steps,) of one loop: 1 at steps of the law whose counts are lost, otherwise 0."""
        words = np.zeros(steps)
        # Losses behind the end of the log are allowed.
        words[[k for k in self.lost if k < steps]] = 1.0
        return words

    def arrived(self, pulses: SX, seen: SX, word: SX) -> SX:
        """Counts that the law reads: these, or those that it read last."""
        # One word carries the losses of several loops. Bit j is 1 if the whole part of the word
        # divided by 2^j is odd.
        shifted = ca.floor(word * self.bit)
        lost = shifted - 2 * ca.floor(shifted / 2)
        return lost * seen + (1 - lost) * pulses

    def acting(self, torque: SX, previous: SX, place: SX, h: SX) -> SX:
        """Mean torque in sub-step `place` (from 0), of length h [s], after a step of the law."""
        # This sub-step ends (place + 1) h after the sample. The new torque acts in the share of it
        # that comes after `delay`.
        share = ca.fmin(ca.fmax(place + 1 - self.delay / h, 0), 1)
        return share * torque + (1 - share) * previous


@part
class Rig(Part):
    """Drives, encoders and the sampling period.

    Parameters
    ----------
    drive : Drive
    encoder : Encoder
    period : float
        Sampling period of the log [s].
    transport : Transport, optional
        Delay of the torque [s], lost counts.
    jitter : Jitter, optional
        Displacement of the instants at which a law reads the encoders, a share of its period.
    springs : KnownTorque or tuple of KnownTorque, optional
        `JointSpring`, `Counterbalance`, `CosineTorque` or another `KnownTorque`, on the links; none
        by default.
    inner : InnerLoop, optional
        `PositionServo` or `MitDrive`: the position loop inside the motors, which takes goals or
        frames in place of torques. None by default: the torque is the law's.

    See Also
    --------
    plant.Drive, plant.Encoder, plant.Record

    Examples
    --------
    >>> from plant import puma560
    >>> rig = puma560.rig()
    >>> rig.n, rig.period
    (2, 0.0007)
    >>> rig.position_in_pulses((0.01, 0.01)).round(1)
    array([137.3, -85.5])
    >>> rig.cell_centre(rig.counts((0.01, 0.01))).round(3)
    array([0.01, 0.01])
    """

    drive: Drive = structure(Drive)
    encoder: Encoder = structure(Encoder)
    period: float = structure(float)
    transport: Transport | None = structure(Transport, default=None)
    jitter: Jitter | None = structure(Jitter, default=None)
    springs: KnownTorque | tuple[KnownTorque, ...] | None = structure(default=None, several=True)
    inner: InnerLoop | None = structure(InnerLoop, default=None)

    def __post_init__(self) -> None:
        real("period", self.period, "Give seconds; the paper logs every 0.7e-3.", positive=True)
        # One resolution for all joints: the drive knows how many there are.
        if np.ndim(self.encoder.resolution) == 0:
            alike = np.full(self.drive.n, self.encoder.resolution)
            object.__setattr__(self, "encoder", dataclasses.replace(self.encoder, resolution=alike))
        if len(self.encoder.resolution) != self.drive.n:
            raise ValueError(
                f"encoder must have {self.drive.n} joints like the drive; got"
                f" {len(self.encoder.resolution)}. Give one resolution per joint."
            )
        # With rigid gears both encoders would show the same position.
        if self.encoder.side != "motor" and self.drive.elasticity is None:
            raise ValueError(
                "an encoder on the link's side needs elastic gears; got rigid ones. Add elasticity."
            )
        if isinstance(self.springs, (tuple, list)):
            object.__setattr__(self, "springs", tuple(self.springs) or None)
        require_torques(self._springs, self.n)
        if self.inner is not None:
            self._require_inner(self.inner)

    def _require_inner(self, inner: InnerLoop) -> None:
        """Refuse an inner loop for other joints, or one that is slower than the rig's samples."""
        # Before one number for all joints takes the blame for another one's length.
        inner.require_joints(self.n, "inner.")
        inner = inner.for_joints(self.n)
        object.__setattr__(self, "inner", inner)
        # A slower loop would still hold one goal when the next arrives. The factor tolerates the
        # rounding of a period that was computed by division.
        if inner.period > self.period * (1 + 1e-9):
            raise ValueError(
                f"the rig's period must be at least that of its inner loop, {inner.period:g} s; got"
                f" {self.period:g} s. Send goals less often."
            )

    def filled(self, values: Mapping[str, float], prefix: str = "") -> Self:
        """Copy with the numbers in `values`, by name; friction that they name is no longer open."""
        rig = super().filled(values, prefix)
        if not rig.drive.left_open:
            return rig
        # A value is known even if it is 0, which by itself leaves an open field open.
        named = {name.partition("[")[0] for name in values}
        still_open = tuple(
            kind for kind in rig.drive.left_open if f"{prefix}drive.{kind}" not in named
        )
        drive = dataclasses.replace(rig.drive, left_open=still_open)
        return dataclasses.replace(rig, drive=drive)

    @property
    def _springs(self) -> tuple[KnownTorque, ...]:
        """All of the springs, none or several."""
        if self.springs is None:
            return ()
        return self.springs if isinstance(self.springs, tuple) else (self.springs,)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.drive.n

    @property
    def joint_labels(self) -> list[str]:
        """Labels of the joints, by the drive's names (`joint_label`)."""
        return joint_labels(self.drive.joints, self.n)

    def require_fit(self, chain: Chain) -> None:
        """Refuse a chain of another number of joints, or with another coupling."""
        if self.n != chain.n:
            raise ValueError(
                f"rig must have {chain.n} joints like the arm; got {self.n}. Use a matching rig."
            )
        # One coupling, stated twice: rotors (chain) and encoders (drive) must agree on it.
        if self.drive.coupling != chain.coupling:
            raise ValueError(
                "chain and drive must have the same coupling; got"
                f" {chain.coupling.matrix or 'none'} in the chain and"
                f" {self.drive.coupling.matrix or 'none'} in the drive. Give both the same Coupling"
                " (chain.coupled)."
            )

    def spring_torque(self, q: ArrayOrSymbols) -> ArrayOrSymbols:
        """Torque of the springs [N m] on the links at q [rad], in the direction of q.

        q is casadi's (n, 1), or an array (..., n) of rows. Without springs the result is the number
        0.0.
        """
        q = joint_numbers("q", q, self.n)
        return total_torque(self._springs, q) if self._springs else 0.0

    def limited(self, torque: ArrayOrSymbols) -> ArrayOrSymbols:
        """A law's torque [N m], joint side, within the amplifiers' limit (`Drive.limited`).

        With an inner loop the torque stays as it is, because the frame has limited it already.
        """
        return torque if self.inner is not None else self.drive.limited(torque)

    @property
    def torque_rounding(self) -> ArrayOrSymbols | float:
        """Largest change of a motor torque (n,) [N m] by the rounding of amplifier or frames."""
        return (
            self.drive.torque_rounding if self.inner is None else self.inner.torque_rounding(self)
        )

    def counts(self, q: ArrayOrSymbols) -> ArrayOrSymbols:
        """Counts at a joint position [rad], with the motor's sign, without the phase."""
        # Without the phase, which a controller cannot know.
        q = joint_numbers("q", q, self.n, finite=True)
        return self.encoder.quantised(self.position_in_pulses(q))

    def true_counts(self, q: ArrayOrSymbols) -> ArrayOrSymbols:
        """Encoder counts at a joint position [rad], with the phase of the encoder."""
        return self.encoder.true_counts(self.position_in_pulses(q))

    def position_in_pulses(self, q: ArrayOrSymbols) -> ArrayOrSymbols:
        """Joint position [rad] in pulses of the motor shaft, before rounding."""
        # Signed: pulses count in the direction of the motor.
        per_radian = self.encoder.position_in_pulses(self.drive.gear)
        return per_radian * self.drive.coupling.shaft(q)

    def to_angle(self, position: ArrayOrSymbols) -> ArrayOrSymbols:
        """Joint position [rad] of a position in pulses; the way back from `position_in_pulses`."""
        return self.drive.joint_angle(self.encoder.to_angle(position))

    def cell_centre(self, counts: ArrayOrSymbols) -> ArrayOrSymbols:
        """Joint position [rad] in the middle of the quantisation cell of these counts."""
        counts = joint_numbers("counts", counts, self.n)
        return self.drive.joint_angle(self.encoder.cell_centre(counts))

    def outside_cell(self, distance: SX, counts: SX, share: SX) -> SX:
        """Part of a distance (n, 1) [rad] that exceeds a share of the half cell.

        The distance is measured from the middle of the cell of these counts. For a smooth encoder
        the result is the whole distance.
        """
        if self.encoder.smooth:
            return distance  # without a kink where it is zero, where loops are linearised
        # A dead zone, in pulses, where the cells are of equal width.
        position = self.position_in_pulses(distance)
        half = self.encoder.half_cell(counts)
        beyond = position - ca.fmin(ca.fmax(position, -share * half), share * half)
        return self.drive.joint_angle(self.encoder.to_angle(beyond))


def punctual_rig(rig: Rig) -> Rig:
    """The same rig without transport and jitter, for users that have no instants."""
    return dataclasses.replace(rig, transport=None, jitter=None)


def smooth_rig(rig: Rig) -> Rig:
    """The same rig without quantisation of counts and torques."""
    drive = dataclasses.replace(rig.drive, torque_step=None)
    encoder = dataclasses.replace(rig.encoder, smooth=True)
    return dataclasses.replace(rig, drive=drive, encoder=encoder)


def sliding_rig(rig: Rig) -> Rig:
    """The same rig without dry friction: linear analysis of joints that slide in one direction."""
    names = rig.number_names()
    values = rig.number_values()
    # Their names say which numbers are dry friction; all other numbers stay.
    return rig.with_numbers(
        np.where([name.startswith(DRY_FRICTION) for name in names], 0.0, values)
    )
