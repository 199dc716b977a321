"""Base of the laws that hold an identified arm: checks of arm and rig, period, model torque."""

import dataclasses
from typing import Any, TypeVar, dataclass_transform

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error import Estimate
from identification.results import warn_of_doubts
from plant import Arm, Law, Rig, number, structure
from plant.analysis import SampledLoops
from plant.laws import Block
from plant.machine import require_inertia, sliding_rig
from plant.parts import array, instance
from plant.realtime import Running

T = TypeVar("T")

# Bandwidth times period above which `start` checks stability; computed torque is unstable at 1.
_FAST = 0.5


@dataclass_transform(
    frozen_default=True,
    kw_only_default=True,
    eq_default=False,
    field_specifiers=(number, structure),
)
def base(cls: type[T]) -> type[T]:
    """Make a class a frozen dataclass; the parts derived from it have its fields in common."""
    return dataclasses.dataclass(frozen=True, kw_only=True, eq=False)(cls)


@base
class ModelLaw(Law):
    """Base of the laws that work out torques from an arm; runs once per sample of its rig.

    `arm`: the identified arm, or an identification, which brings its rig as well:
    ``ComputedTorque(found)``. An identification with doubts causes an `IdentificationWarning`.
    `rig`: the identified rig, ``found.rig``; a rig that is passed replaces the identification's.

    Raises
    ------
    ValueError
        The inertia matrix D(q) of the arm does not exceed the motors' own inertia everywhere (no
        feedback would be stable), or arm and rig have different numbers of joints. Later, `block`
        refuses a rig that differs from the law's own in joints, period, direction of a gear, or
        type of the inner loop.
    """

    arm: Arm | Any = structure(kw_only=False)  # an Identification goes in, too; its arm is kept
    rig: Rig = structure(kw_only=False, default=None)

    def __post_init__(self) -> None:
        found = self.arm
        name = type(self).__name__
        # An identification brings arm and rig; a rig that the caller passes takes precedence.
        if isinstance(found, Estimate):
            object.__setattr__(self, "arm", found.arm)
            object.__setattr__(self, "rig", found.rig if self.rig is None else self.rig)
            warn_of_doubts(found, name)
        instance(f"arm of {name}", self.arm, Arm, "Pass an identification, or an arm and its rig.")
        instance(
            f"rig of {name}",
            self.rig,
            Rig,
            "Pass the arm's rig, or an identification in place of the arm.",
        )
        # The fields are checked after arm and rig: checks of numbers need the joints.
        super().__post_init__()
        if self.arm.n != self.rig.n:
            both = f"{self.arm.n} and {self.rig.n}. Pass found.arm and found.rig."
            raise ValueError(f"arm and rig must have equal joints; got {both}")
        # Friction that the rig leaves open must be identified before a law can feed it forward.
        self.rig.drive.require_friction()
        require_inertia(self.arm, self.rig)

    @property
    def period(self) -> float | None:  # type: ignore[override]  # declared, and here the rig's
        """Period of the law [s], which is the sampling period of its rig."""
        return self.rig.period

    def rig_of_frames(self, rig: Rig) -> Rig:
        """Return the law's own rig, not `rig`: goals need the servo gain that the law assumes."""
        return self.rig

    def sliding(self) -> Law:
        """Return a copy of this law that assumes its rig to be without dry friction."""
        return dataclasses.replace(self, rig=sliding_rig(self.rig))

    def start(self, rig: Rig, pulses: ArrayLike, **options: Any) -> Running:
        """Return this law as a running controller, as `Law.start` does; refuse an unstable loop.

        The linearised loop is checked if the given rig or the law's own rig states elastic gears,
        or if the bandwidth is high for the period.

        Raises
        ------
        ValueError
            As `Law.start`; an unstable loop, with the frequency at which it would swing.
        """
        self.require_stable(rig, pulses)
        return super().start(rig, pulses, **options)

    def require_stable(self, rig: Rig, pulses: ArrayLike) -> None:
        """Raise a ValueError if the linearised loop that `start` checks is unstable."""
        # Take the machine's rig if it states elastic gears, and the law's own rig otherwise.
        stated = rig if getattr(rig.drive, "elasticity", None) is not None else self.rig
        # Rigid loops with a moderate bandwidth are stable by design, and cost no linearisation.
        fast = getattr(self, "bandwidth", 0.0) * self.rig.period > _FAST
        if self.period is None or not (fast or stated.drive.elasticity is not None):
            return
        counts = array(
            "pulses", pulses, (stated.n,), advice="Give the encoder count of each joint."
        )
        try:
            pole = SampledLoops(self.arm, stated, self, stated.cell_centre(counts)).unstable_pole()
        except ValueError:
            # The motors cannot hold this pose at rest: there is no equilibrium to linearise at.
            return
        if pole is not None:
            # Hertz and a time constant are what is seen on the arm; a real pole does not swing.
            hz = abs(pole.imag) / (2 * np.pi)
            grows = f"swings up at {hz:.3g} Hz" if hz > 0 else "runs away"
            advice = "Take what tune finds."
            speed = ""
            bandwidth = getattr(self, "bandwidth", None)
            if bandwidth is not None:
                per_sample = bandwidth * stated.period
                speed = f"; its bandwidth is {bandwidth:g} rad/s, {per_sample:.2g} rad per sample"
                advice = "Lower it, or take what tune finds."
            raise ValueError(
                f"{type(self).__name__} must be stable on this rig; linearised it {grows} with the"
                f" time constant {1 / pole.real:.2g} s{speed}. {advice}"
            )

    def h(self, q: ca.SX, qd: ca.SX) -> ca.SX:
        """Torque (n, 1) [N m] without inertia and friction: h of the arm less the rig's springs."""
        return self.arm.dynamics.h(q, qd, self.arm.f) - self.rig.spring_torque(q)

    def model_parts(self, q: ca.SX, qd: ca.SX, qdd: ca.SX) -> dict[str, ca.SX]:
        """Model torques (n, 1) [N m] by name: gravity, inertia, and friction if the law uses it."""
        model = self.arm.dynamics
        f = self.arm.f
        parts = {"gravity": model.gravity(q, f)}
        inertia = model.D(q, f) @ qdd
        if getattr(self, "friction", True):
            drive = self.rig.drive
            load = parts["gravity"] + inertia - drive.rotor_torque(qdd)
            parts["friction"] = drive.friction(qd, load)
        return parts | {"inertia": inertia}

    def block(self, rig: Rig) -> Block:
        # The law may run on another rig than its own, if the law's equations hold for it.
        rig.require_fit(self.arm.dynamics.chain)
        if abs(rig.period - self.rig.period) > 1e-9 * self.rig.period:
            periods = f"every {self.rig.period:.6g} s; got {rig.period:.6g} s"
            raise ValueError(
                f"the rig must be sampled as the law's own, {periods}. Make the law for this rig."
            )
        # A gear that turns the other way would make the feedback positive.
        turned = np.flatnonzero(np.sign(rig.drive.gear) != np.sign(self.rig.drive.gear))
        if len(turned):
            i = int(turned[0])
            raise ValueError(
                "gears of rig and law must turn the same way; that of"
                f" {rig.joint_labels[i]} is {rig.drive.gear[i]:g}, the law's"
                f" {self.rig.drive.gear[i]:g}. Correct the sign, or make the law for this rig."
            )
        # A goal that is taken for a torque moves an arm at full power.
        if type(rig.inner) is not type(self.rig.inner):
            got, own = (type(r.inner).__name__ if r.inner else "none" for r in (rig, self.rig))
            raise ValueError(
                f"rig and law must have the same inner loop, {own}; got {got}. Make the law for"
                " this rig: ComputedTorque(found, rig)."
            )
        return super().block(rig)
