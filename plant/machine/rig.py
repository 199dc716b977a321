"""The rig: drives, encoders, sampling period and delay, springs: all that stands between a controller and the arm."""

import dataclasses

from plant.machine.drive import Drive
from plant.machine.encoder import Encoder
from plant.machine.jitter import Jitter
from plant.machine.known_torque import KnownTorque, require_torques, total_torque
from plant.machine.transport import Transport
from plant.mechanics.chain import Chain
from plant.parts.arguments import instance, real
from plant.parts.fields import ArrayOrSymbols
from plant.parts.labels import joint_labels
from plant.parts.part import Part, part, structure


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
        Of the instants at which a law reads the encoders, a share of its period.
    springs : KnownTorque or tuple of KnownTorque, optional
        `JointSpring`, `Counterbalance`, `CosineTorque` or a part of one's own, on the links; none by default.

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
    transport: Transport | None = structure(default=None)
    jitter: Jitter | None = structure(default=None)
    springs: KnownTorque | tuple[KnownTorque, ...] | None = structure(default=None, several=True)

    def __post_init__(self) -> None:
        real("period", self.period, "Give seconds; the paper logs every 0.7e-3.", positive=True)
        if self.transport is not None:
            instance("transport", self.transport, Transport, "Give Transport(delay=..., lost=...).")
        if self.jitter is not None:
            instance("jitter", self.jitter, Jitter, "Give Jitter(share=..., seed=...).")
        if len(self.encoder.resolution) != self.drive.n:
            raise ValueError(
                f"encoder must have {self.drive.n} joints like the drive; got {len(self.encoder.resolution)}. "
                "Give one resolution per joint."
            )

        if self.encoder.side != "motor" and self.drive.elasticity is None:
            raise ValueError("an encoder on the link's side needs a drive that gives; got a rigid one. Add elasticity.")
        if isinstance(self.springs, (tuple, list)):
            object.__setattr__(self, "springs", tuple(self.springs) or None)
        require_torques(self._springs, self.n)

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
        """Refuse a chain of another number of joints, or with another coupling.

        Raises
        ------
        ValueError
        """
        if self.n != chain.n:
            raise ValueError(f"rig must have {chain.n} joints like the arm; got {self.n}. Use a matching rig.")
        if self.drive.coupling != chain.coupling:
            raise ValueError(
                f"chain and drive must have the same coupling; got {chain.coupling.matrix or 'none'} in the chain and "
                f"{self.drive.coupling.matrix or 'none'} in the drive. Give both the same Coupling (chain.coupled)."
            )

    def spring_torque(self, q: ArrayOrSymbols) -> ArrayOrSymbols:
        """Torque of the springs on the links at q [rad], in the direction of q [N m]; 0 without springs.

        Of casadi's (n, 1), or for each row of an array (..., n).
        """
        return total_torque(self._springs, q) if self._springs else 0.0

    def counts(self, q: ArrayOrSymbols) -> ArrayOrSymbols:
        """Encoder counts at a joint position [rad], whole numbers with the motor's sign, without the unknown phase."""
        return self.encoder.quantised(self.position_in_pulses(q))

    def true_counts(self, q: ArrayOrSymbols) -> ArrayOrSymbols:
        """Encoder counts at a joint position [rad], with the phase of the encoder."""
        return self.encoder.true_counts(self.position_in_pulses(q))

    def position_in_pulses(self, q: ArrayOrSymbols) -> ArrayOrSymbols:
        """Joint position [rad] in pulses of the motor shaft, before rounding."""
        per_radian = self.encoder.position_in_pulses(self.drive.gear)
        return per_radian * self.drive.coupling.shaft(q)

    def to_angle(self, position: ArrayOrSymbols) -> ArrayOrSymbols:
        """Joint position [rad] of a position in pulses; the way back from `position_in_pulses`."""
        return self.drive.joint_angle(self.encoder.to_angle(position))

    def cell_centre(self, counts: ArrayOrSymbols) -> ArrayOrSymbols:
        """Joint position [rad] in the middle of the quantisation cell of these counts."""
        return self.drive.joint_angle(self.encoder.cell_centre(counts))


def punctual_rig(rig: Rig) -> Rig:
    """The same rig without transport and without jitter, for what knows no instants."""
    return dataclasses.replace(rig, transport=None, jitter=None)


def smooth_rig(rig: Rig) -> Rig:
    """The same rig without quantisation."""
    return dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, smooth=True))
