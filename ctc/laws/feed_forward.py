"""A simple feedback with torque from the model added: gravity alone, or all that the reference needs."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np

from ctc.laws.model_law import ModelLaw
from plant import Law
from plant.parts.part import part, structure

__all__ = ["Aided", "FeedForward", "PDGravity"]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Aided(ModelLaw):
    """Base: tau = feedback + what `aid` gives, as often as the feedback runs.

    Parameters
    ----------
    arm : Arm
    rig : Rig
    feedback : Law
        A simple law, such as `plant.PD`; of what the amplifier cuts off it is told its own part.
    """

    feedback: Law = structure(Law)  # noqa: RUF009 - declares a field

    def __post_init__(self):
        super().__post_init__()
        if isinstance(self.feedback, ModelLaw) or self.feedback.replays:
            given = type(self.feedback).__name__
            raise ValueError(f"feedback must be a simple law, such as PD; got {given}. Its model would count twice.")
        self.feedback.block(self.rig)  # refuses gains for other joints

    @property
    def period(self):
        """That of the feedback [s], or None."""
        return self.feedback.period

    def block(self, rig):
        self.feedback.block(rig)  # refuses gains for other joints
        return super().block(rig)

    def initial_state(self, n):
        """The feedback's, and no aid given yet."""
        return np.concatenate([self.feedback.initial_state(n), np.zeros(n)])

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        """Tau = feedback + aid."""
        n = rig.n
        asked, memory = self.feedback.equations(rig, state[:-n], setpoint, pulses, torque - state[-n:], dt)
        aid = self.aid(rig, setpoint, pulses)
        return asked + aid, ca.vertcat(memory, aid)


@part
class PDGravity(Aided):
    """tau = feedback + g-hat(q), with q the middle of the encoder's cell: the arm weighs nothing to the feedback.

    Parameters
    ----------
    arm : Arm
        The identified arm, ``found.arm``.
    rig : Rig
        The identified rig, ``found.rig``.
    feedback : Law
        A simple law, such as `plant.PD`; its period is that of the whole.

    Raises
    ------
    ValueError
        As `ModelLaw`; a feedback for other joints.

    Source: Takegaki and Arimoto (1981).
    """

    def aid(self, rig, setpoint, pulses):
        """Torque of gravity (n,) [N m]."""
        return self.arm.dynamics.gravity(rig.cell_centre(pulses), self.arm.f)


@part
class FeedForward(Aided):
    """tau = feedback + D-hat(q_r) qdd_r + h-hat(q_r, qd_r) + friction(qd_r): the whole model, of the reference alone.

    Parameters
    ----------
    arm : Arm
        The identified arm, ``found.arm``.
    rig : Rig
        The identified rig, ``found.rig``: its friction is fed forward.
    feedback : Law
        A simple law, such as `plant.PD`; its period is that of the whole.

    Raises
    ------
    ValueError
        As `ModelLaw`; a feedback for other joints.
    """

    def aid(self, rig, setpoint, pulses):
        """Torque that the reference needs (n,) [N m]."""
        model, f = self.arm.dynamics, self.arm.f
        moving = model.D(setpoint.q, f) @ setpoint.qdd + model.h(setpoint.q, setpoint.qd, f)
        return moving + self.rig.drive.friction(setpoint.qd)
