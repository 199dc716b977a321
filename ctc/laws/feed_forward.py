"""A simple feedback plus torque from the model: gravity alone, or the reference's whole torque."""

import abc
import functools

import casadi as ca

from ctc.laws.model_law import ModelLaw, base
from plant import Fields, Law, Rig, part, per_joint, state_of, structure
from plant.laws import Block, Setpoint, Step


@base
class Aided(ModelLaw):
    """Base: tau = feedback + aid. In each step of the feedback, `aid` is computed from the setpoint
    and the counts.

    `feedback`: a simple law, such as `plant.PD`, whose period is that of the whole. Its
    anti-windup gets the applied torque less the aid.

    Raises
    ------
    ValueError
        As for `ModelLaw`; if the feedback has a model, replays a log or has gains for other joints.
    """

    feedback: Law = structure(Law)

    def __post_init__(self) -> None:
        super().__post_init__()
        # A model in the feedback, or a replayed torque, would feed gravity forward a second time.
        if isinstance(self.feedback, ModelLaw) or self.feedback.replays:
            kind = type(self.feedback).__name__
            raise ValueError(
                f"feedback must be a simple law, such as PD; got {kind}. Its model would count"
                " twice."
            )
        self.feedback.block(self.rig)  # refuses gains for other joints

    @property
    def period(self) -> float | None:  # type: ignore[override]  # a plain attribute in the base
        """Period of the feedback [s]; None where the feedback has none."""
        return self.feedback.period

    def block(self, rig: Rig) -> Block:
        self.feedback.block(rig)  # refuses gains for other joints
        return super().block(rig)

    @functools.cached_property
    def fields(self) -> Fields:
        """State of the feedback, and the aid given last [N m]."""
        return Fields(feedback=state_of(self.feedback), aid=per_joint())

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = feedback + aid."""
        before = self.fields.read(state, rig.n)
        # The anti-windup of the feedback needs the part of the torque that the feedback gave.
        feedback_torque = torque - before.aid
        commanded, memory = self.feedback.equations(
            rig, before.feedback, setpoint, pulses, feedback_torque, dt
        )
        aid = self.aid(rig, setpoint, pulses)
        return commanded + aid, self.fields.write(rig.n, feedback=memory, aid=aid)

    @abc.abstractmethod
    def aid(self, rig: Rig, setpoint: Setpoint, pulses: ca.SX) -> ca.SX:
        """Torque from the model (n,) [N m]."""


@part
class PDGravity(Aided):
    """tau = feedback + g-hat(q) - springs(q): PD control with gravity compensation.

    q (n,) is, for each joint, the middle of the interval of positions that give its count.

    Parameters
    ----------
    arm, rig
        As of `ComputedTorque`.
    feedback : Law
        A simple law, such as `plant.PD`; its period is that of the whole.

    See Also
    --------
    ctc.FeedForward, plant.PD

    Examples
    --------
    >>> from plant import PD, puma560
    >>> from ctc import PDGravity
    >>> feedback = PD(gain=(0.2, 0.1), derivative=(0.004, 0.002), filter=600)
    >>> PDGravity(puma560.arm(), puma560.rig(), feedback=feedback).feedback.gain
    array([0.2, 0.1])

    Source: Takegaki and Arimoto (1981).
    """

    def model_parts(self, q: ca.SX, qd: ca.SX, qdd: ca.SX) -> dict[str, ca.SX]:
        """Gravity alone, which depends on neither `qd` nor `qdd`."""
        return {"gravity": self.arm.dynamics.gravity(q, self.arm.f)}

    def aid(self, rig: Rig, setpoint: Setpoint, pulses: ca.SX) -> ca.SX:
        """Torque of gravity, less that of springs (n,) [N m]."""
        # Gravity depends on the true position; the middle of the cell is its best estimate.
        q = rig.cell_centre(pulses)
        return self.model_parts(q, q, q)["gravity"] - self.rig.spring_torque(q)


@part
class FeedForward(Aided):
    """tau = feedback + D-hat(q_r) qdd_r + h-hat(q_r, qd_r) + friction(qd_r).

    The whole torque of the model is computed from the reference, without any measurement.

    Parameters
    ----------
    arm, rig, feedback
        As of `PDGravity`.

    See Also
    --------
    ctc.PDGravity, ctc.ComputedTorque

    Examples
    --------
    >>> from plant import PD, puma560
    >>> from ctc import FeedForward
    >>> feedback = PD(gain=(0.2, 0.1), derivative=(0.004, 0.002), filter=600)
    >>> FeedForward(puma560.arm(), puma560.rig(), feedback=feedback).feedback.gain
    array([0.2, 0.1])
    """

    def aid(self, rig: Rig, setpoint: Setpoint, pulses: ca.SX) -> ca.SX:
        """Torque that the reference needs (n,) [N m]."""
        # No measured speed is used: it would feed the rounding of counts into the torque.
        parts = self.model_parts(*setpoint[:3])
        return parts["inertia"] + self.h(setpoint.q, setpoint.qd) + parts["friction"]
