"""Elastic gears: stiffness, damping and backlash between motor shaft and joint; their sub-step."""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from casadi import SX
from numpy.typing import ArrayLike

from plant.mechanics import Arm, Inverse, inverse, row_by_row
from plant.parts import Part, Vector, array, instance, joint_label, number, part, signs, warn

# Damping ratio of a gear against its locked motor where none is stated; measured ones: 0.01 to 0.03
DAMPING_RATIO = 0.01


@part
class Elasticity(Part):
    """Stiffness, damping and backlash of the gears, joint side (of coupled motors: on the shafts).

    Parameters
    ----------
    stiffness : (n,) array_like
        Torque per deflection [N m/rad].
    damping : (n,) array_like
        Torque per rate of deflection [N m s/rad].
    backlash : (n,) array_like, optional
        Angle that the joint can turn while the motor stands [rad], at most one turn of the motor;
        none by default.

    Raises
    ------
    ValueError
        Stiffness that is not positive, negative damping, backlash beyond a turn.

    See Also
    --------
    plant.Drive

    Examples
    --------
    >>> from plant import Elasticity, puma560
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> gears = Elasticity.from_resonance(arm, hz=60, damping_ratio=0.02, drive=rig.drive)
    >>> print(gears.stiffness.round(-2))                   # [N m/rad]
    [535200. 156800.]
    """

    stiffness: Vector = number(("n",))
    damping: Vector = number(("n",))
    backlash: Any = number(("n",), default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        # Stiffness 0 would be a broken gear, not a rigid one.
        advice = "Give it joint side, in N m, rad and s; leave elasticity out of a rigid drive."
        signs(self, positive=("stiffness",), not_negative=("damping", "backlash"), advice=advice)
        if self.backlash is not None and (self.backlash > 2 * np.pi).any():
            raise ValueError(
                f"backlash must be within one turn; got {self.backlash.max():g}. {advice}"
            )

    @classmethod
    def from_resonance(
        cls,
        arm: Arm,
        hz: ArrayLike,
        damping_ratio: ArrayLike,
        *,
        drive: Any = None,
        q: ArrayLike | None = None,
        backlash: ArrayLike | None = None,
    ) -> "Elasticity | Resonance":
        """Gears with these locked-rotor resonances [Hz].

        The resonance of joint i, with every other joint held, is sqrt(stiffness_i / L_i) / 2 pi.
        The inertia of its links is L_i = D_ii - Jm_i k_i^2, with the gear k_i of the drive.

        Parameters
        ----------
        arm : Arm
        hz, damping_ratio : float or (n,) array_like
            Locked-rotor resonance [Hz], and its damping ratio; a ratio above 1 warns.
        drive : Drive, optional
            The drive whose motor inertias the arm's D contains; by default the `Drive` that takes
            the result as its elasticity.
        q : (n,) array_like, optional
            Pose [rad]; zeros by default.
        backlash : (n,) array_like, optional
            Backlash [rad], as of `Elasticity`.

        Returns
        -------
        Elasticity, or Resonance
            Without a drive a Resonance; ``Drive(..., elasticity=...)`` makes an Elasticity of it.
        """
        instance("arm", arm, Arm, "The order is arm, hz, damping_ratio.")
        # `Drive` imports this module, so that its class is not known here.
        if drive is not None and not hasattr(drive, "reflected_inertia"):
            raise ValueError(f"drive must be a Drive; got {type(drive).__name__}. Give rig.drive.")
        n = arm.n
        hz, ratio = (
            array(
                name,
                np.full(n, value) if np.size(value) == 1 else value,
                (n,),
                advice="Give one number, or one per joint.",
                finite=False,
            )
            for name, value in (("hz", hz), ("damping_ratio", damping_ratio))
        )
        # A rigid gear has no resonance; the model has elastic gears on all joints or on none.
        rigid = np.flatnonzero(np.isposinf(hz))
        if rigid.size:
            advice = "Give it one above all that matters, or leave elasticity out if all are rigid."
            raise ValueError(
                f"hz must be finite; {arm.dynamics.chain.joint_labels[rigid[0]]} has inf. {advice}"
            )
        pose = array(
            "q", np.zeros(n) if q is None else q, (n,), advice="Give one angle per joint [rad]."
        )
        # Motors and gears are on the shafts, so the inertia is taken there too.
        shaft = arm.dynamics.chain.coupling.shaft_inertia(ca.DM(arm.D(pose))).full()
        resonance = Resonance(hz=hz, damping_ratio=ratio, inertia=np.diag(shaft), backlash=backlash)
        return resonance if drive is None else resonance.of(drive)


@part
class Resonance(Part):
    """Gears given by their locked-rotor resonance [Hz], until a drive states the motors' inertia.

    ``inertia``: diagonal (n,) of D at the pose, motors included [kg m^2], on the shafts.
    """

    hz: Vector = number(("n",))
    damping_ratio: Vector = number(("n",))
    inertia: Vector = number(("n",))
    backlash: Any = number(("n",), default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("hz",), advice="Leave elasticity out of a rigid drive.")
        if (self.damping_ratio < 0).any():
            smallest = self.damping_ratio.min()
            raise ValueError(
                f"damping_ratio must not be negative; got {smallest:g}. Gears have"
                f" {DAMPING_RATIO:g} to 0.03."
            )
        if (self.damping_ratio > 1).any():
            largest = self.damping_ratio.max()
            warn(f"damping_ratio {largest:g} is above critical: such a joint does not oscillate.")

    def of(self, drive: Any) -> Elasticity:
        """The elasticity with a drive, whose motors must be lighter than the inertia of the arm."""
        self.require_joints(drive.n, "elasticity.")
        # The motor is locked: only the links swing, and D_ii holds the rotor Jm k^2 as well.
        rotors = drive.reflected_inertia()
        links = self.inertia - rotors
        if (links <= 0).any():
            i = int(np.argmax(links <= 0))
            raise ValueError(
                f"D must exceed the motors' inertia; {joint_label(drive.joints, i)} has"
                f" {self.inertia[i]:.4g} kg m^2, its motor {rotors[i]:.4g}. Use the drive whose"
                " motors are in f."
            )
        stiffness, damping = gears(self.hz, self.damping_ratio, links)
        return Elasticity(stiffness=stiffness, damping=damping, backlash=self.backlash)


def gears(hz: Any, damping_ratio: Any, inertia: Any) -> tuple[Any, Any]:
    """Stiffness [N m/rad] and damping [N m s/rad] of a locked-rotor resonance [Hz].

    The inertia [kg m^2] is that of the link alone.
    """
    # k = I omega^2 and d = 2 zeta I omega, with omega = 2 pi hz.
    omega = 2 * np.pi * hz
    return inertia * omega**2, 2 * damping_ratio * inertia * omega


# Largest (omega h)^2 of a free vibration that a step follows: its frequency is right to 1 % there.
FOLLOWED = 2


class Spring(NamedTuple):
    """Torque of a gear on its link in a step [N m], and the inertia that it adds.

    The torque is that of the middle of the step, with the speeds at its start.

    ``added`` [kg m^2]: inertia with which the spring resists a change of the deflection's speed.
    """

    torque: SX
    added: SX


class Joined(NamedTuple):
    """Motors and links in a step, reduced to one matrix (n, n) of the links.

    Motors act on each other through the links alone, so they can be eliminated.

    ``alone`` (n, 1): inertia of a motor and of the spring that it drags along. ``passed``: share of
    its impulse that its link gets. ``links``: inverse of the links' inertia, with that of the
    motors as far as springs hold them.
    """

    alone: SX
    passed: SX
    links: Inverse

    def motors(self, speed: SX, impulse: SX, gained: SX) -> SX:
        """Speed of the motors after an impulse, where links gained a speed."""
        # (motor + added) change = impulse + added gained: the spring drags the motor along with its
        # link.
        return speed + impulse / self.alone + self.passed * gained

    def mobility(self) -> Inverse:
        """Inverse inertia (n, n) that motors have against impulses."""
        passed = ca.diag(self.passed)
        return row_by_row(ca.diag(1 / self.alone) + passed @ self.links.matrix() @ passed)


def joined(motor: SX, link: SX, added: SX) -> Joined:
    """Inertias (n, 1) of motors and (n, n) of links, joined by what the springs add."""
    # Eliminating the motors from [[motor + added, -added], [-added, link + added]] leaves the
    # links' matrix with added - added^2 / alone = passed motor on its diagonal.
    alone = motor + added
    passed = added / alone
    return Joined(alone, passed, inverse(link + ca.diag(passed * motor)))


def reduced(motor: Any, link: Any) -> Any:
    """Reduced inertia of two bodies that vibrate against each other through a spring [kg m^2]."""
    return motor * link / (motor + link)


def spring(elasticity: Any, deflection: SX, rate: SX, h: SX, motor: SX, link: SX) -> Spring:
    """The spring of each gear in a step of length h [s], between motor and link (n, 1) [kg m^2].

    Deflection: shaft minus link at the middle of the step [rad]; rate: its rate at the start
    [rad/s].

    A drift-kick-drift step whose kick is taken at the middle position plus kappa h times the change
    of speed. kappa = 0 is the explicit leapfrog step, 1/4 the implicit midpoint rule. With 1/12 the
    frequency of a spring is right to fourth order in omega h; where (omega h)^2 exceeds 2, kappa
    grows to 1/3, and the step is stable for any stiffness. All that changes the inertia, not the
    energy. The damper is raised by (omega h)^2 / 12, which makes its damping ratio right to fourth
    order too.
    """
    stiffness = elasticity.stiffness
    swinging = reduced(motor, link)
    # kappa h^2 k, with kappa = 1/12, and above (omega h)^2 = 2 that kappa which keeps the step
    # stable.
    kick = h * h * stiffness
    added = ca.fmax(kick / 12, kick / 3 - swinging / 2)
    # The correction of the damper stays where it is accurate: beyond FOLLOWED it is constant.
    damping = elasticity.damping * (1 + ca.fmin(kick / swinging, FOLLOWED) / 12)
    if elasticity.backlash is not None:
        # Backlash: the spring is wound only by what exceeds half the play to either side, and
        # within the play neither spring nor damper acts.
        half = elasticity.backlash / 2
        wound = deflection - ca.fmin(ca.fmax(deflection, -half), half)
        touching = ca.if_else(ca.fabs(wound) > 0, 1, 0)
        stiffness = touching * stiffness
        damping = touching * damping
        deflection = wound
        added = touching * added
    # h / 2 damping: the damper acts with the mean of the rates at both ends of the step.
    return Spring(stiffness * deflection + damping * rate, added + h / 2 * damping)
