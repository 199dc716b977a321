"""Coulomb friction as a set-valued law with true stiction, by impulses.

In a step of length h, the friction impulse of joint i lies within +-C_i h, where C_i is the Coulomb
level of the joint. It is the impulse that stops the joint or, if that one is too large, the largest
impulse against the motion. There is no branch, no regularisation and no creep: sweeps over the
joints (projected Gauss-Seidel) start from the impulse of the last step, so that an arm at rest
stays held by the friction that held it. Source: paper Fig. 4 (static friction). Coulomb's law has
equal static and sliding levels; a `FrictionCurve` may add a breakaway level.

Presliding friction is that of bristles that bend before they slide. The deflection r of the
bristles, in units of the presliding distance d, follows dr/dt = (v - abs(v) r) / d with the speed
v. The friction is level r + damping d dr/dt. Without damping it rises from zero with the path as
1 - exp(-path / d), at first with the stiffness level / d; in the limit of zero distance it is
Coulomb friction. Sources: Dahl (1968); Canudas de Wit et al. (1995), LuGre. (The bristles of LuGre
have one stiffness at every level; the bristles of this module have one distance. Where the level is
constant, the two models are the same.) In the first half of a sub-step the bristles bend with the
speed at the start of the sub-step, and in the second half with the speed at its end. The speed at
the end is the speed that the friction of the bristles leaves; it is found in closed form for each
joint, in sweeps over the joints as above. This method is stable for any distance. The step itself
damps the bristles as a damping of (stiffness times h / 2) would, so only the part of a stated
damping that exceeds this value is added.

Viscous friction that saturates follows H. Eyring, Viscosity, plasticity, and diffusion as examples
of absolute reaction rates, Journal of Chemical Physics 4, 1936. Seven curves with one parameter
more than proportional friction were compared on blocks of a real six-axis log that the fit had not
used. Eyring's curve and a logarithm alone predicted these blocks best. (The squared error is less
than with proportional friction by 31 % for arsinh, 29 % for arctan, 27 % for tanh, and 26 % for
v / (1 + v).)

Coulomb friction may rise with speed: near a reversal, the torques of real geared joints show less
friction than a constant level times sign(speed). They do so while the joints brake as well as while
they accelerate, so presliding is not the cause. Seven curves with one parameter more were compared
on blocks of a UR10 and of a TX40 that the fit had not used. v / (v + rise) was best or within one
percentage point of the best (42 and 14 % less squared error; tanh 41 and 11, 1 - exp 43 and 12).
"""

from typing import Any, NamedTuple, Self

import casadi as ca
import numpy as np
from casadi import SX

from plant.mechanics import Inverse
from plant.parts import ArrayOrSymbols, Part, Vector, number, part, signs

# Joint speed [rad/s] at which the smooth law, used for derivatives only, reaches tanh(1) of the
# Coulomb level.
REGULARISATION = 1e-3


# Functions of numbers and of symbols that a friction curve needs.
_NUMERIC = (np.abs, np.maximum, np.log, np.sqrt)
_SYMBOLIC = (ca.fabs, ca.fmax, ca.log, ca.sqrt)

# Share of the saturation speed below which viscous friction is in proportion to the speed.
_PROPORTIONAL = 1e-6

# Motor speed [rad/s] that is rest for Coulomb friction which rises: far below one count a day.
_AT_REST = 1e-12


@part
class FrictionCurve(Part):
    """Friction beyond a constant Coulomb level and one viscous coefficient. Motor side.

    It may differ by direction, have the Stribeck effect, saturate with speed, and rise with it.

    Parameters
    ----------
    offset : (n,) array_like
        Friction torque that keeps its sign when the motion reverses [N m]. Coulomb friction that is
        c+ forwards and c- backwards is ``coulomb = (c+ + c-) / 2`` with ``offset = (c+ - c-) / 2``.
    breakaway : (n,) array_like, optional
        Excess of the breakaway level over ``coulomb`` [N m]; left out, with `speed`, there is none.
    speed : (n,) array_like, optional
        Stribeck speed, of the motor [rad/s]: level = coulomb + breakaway exp(-(motor speed /
        speed)^2).
    viscous_offset : (n,) array_like, optional
        Viscous friction that is b+ forwards and b- backwards is ``viscous = (b+ + b-) / 2`` with
        ``viscous_offset = (b+ - b-) / 2`` [N m s/rad].
    saturation : (n,) array_like, optional
        Speed, of the motor [rad/s], from which on viscous friction grows with the logarithm of the
        speed: viscous saturation arsinh(speed / saturation), Eyring's law of a lubricant in shear.
        ``viscous`` is then the slope at low speed; infinity is no saturation.
    rise : (n,) array_like, optional
        Speed, of the motor [rad/s], at which the Coulomb level has risen to half of ``coulomb``:
        coulomb speed / (speed + rise). Such friction holds nothing at rest; zero is Coulomb's.

    Raises
    ------
    ValueError
        Negative magnitudes; a breakaway without a speed, or a speed without one.

    See Also
    --------
    plant.Drive, plant.Presliding, identification.motor_test

    Examples
    --------
    >>> from plant import FrictionCurve
    >>> curve = FrictionCurve(offset=(0, 0), breakaway=(0.02, 0.01), speed=(1.0, 1.0))
    >>> curve.level(0.0 * curve.speed)                     # at rest, over the Coulomb level [N m]
    array([0.02, 0.01])
    """

    offset: Vector = number(("n",))
    breakaway: Any = number(("n",), default=None)
    speed: Any = number(("n",), default=None)
    viscous_offset: Any = number(("n",), default=None)
    saturation: Any = number(("n",), default=None, finite=False)
    rise: Any = number(("n",), default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(
            self,
            positive=("speed", "saturation"),
            not_negative=("breakaway", "rise"),
            advice="All are magnitudes.",
        )
        # One without the other defines no Stribeck curve.
        if (self.breakaway is None) != (self.speed is None):
            raise ValueError(
                "breakaway and speed must be given together; one is missing. Give both, or neither."
            )

    def level(self, qd_m: ArrayOrSymbols) -> ArrayOrSymbols:
        """Excess over the Coulomb level [N m] at motor speeds [rad/s]."""
        if self.breakaway is None:
            return 0.0
        # The square makes the level even: the same in both directions.
        ratio = qd_m / self.speed
        return self.breakaway * (
            np.exp(-(ratio**2)) if isinstance(ratio, np.ndarray) else ca.exp(-(ratio**2))
        )

    def risen(self, coulomb: ArrayOrSymbols, qd_m: ArrayOrSymbols) -> ArrayOrSymbols:
        """Coulomb level [N m] at motor speeds [rad/s]; `coulomb` is the level at high speed."""
        if self.rise is None:
            return coulomb
        absolute = np.abs if isinstance(qd_m, (np.ndarray, float)) else ca.fabs
        # The added speed makes the quotient 1 instead of 0 / 0 at rest where `rise` is zero, so
        # that the level is exactly `coulomb` there.
        speed = absolute(qd_m) + _AT_REST
        return coulomb * (speed / (speed + self.rise))

    def coefficient(self, viscous: ArrayOrSymbols, qd_m: ArrayOrSymbols) -> ArrayOrSymbols:
        """Viscous torque per speed [N m s/rad] at motor speeds [rad/s].

        `viscous` is the coefficient at low speed. The result is a secant, not a slope: the product
        of it and the speed is the torque, at any speed.
        """
        numeric = isinstance(qd_m, (np.ndarray, float))
        if self.viscous_offset is not None:
            sign = np.sign(qd_m) if numeric else ca.sign(qd_m)
            viscous = viscous + self.viscous_offset * sign
        if self.saturation is not None:
            absolute, most, log, root = _NUMERIC if numeric else _SYMBOLIC
            # At rest 0 / 0 is 1: below this share of the saturation arsinh(x) is x to 12 digits.
            x = most(absolute(qd_m) / self.saturation, _PROPORTIONAL)
            viscous = viscous * log(x + root(1 + x * x)) / x
        return viscous


def friction_impulse(inverse: Inverse, stopping: SX, impulse: SX, bound: SX, sweeps: int) -> SX:
    """Friction impulse (n, 1) of one step [N m s], from that of the previous step by sweeps.

    `inverse` is the inverse of the inertia matrix [kg m^2], joint side. Entry i of `stopping` is
    the impulse that would stop joint i if friction acted on no other joint: -inverse.alone qd,
    where qd is the velocity at the end of the step without Coulomb friction. `bound` is the Coulomb
    level times the length of the step.
    """
    impulses = ca.vertsplit(impulse)
    # A level below zero would turn the interval around.
    bound = ca.fabs(bound)
    # Projected Gauss-Seidel: each joint takes the impulse that stops it, given the impulses of all
    # others now, and is cut to the interval +-bound.
    for _ in range(sweeps):
        for i in range(len(impulses)):
            wanted = _stopping_impulse(inverse, stopping, impulses, i)
            impulses[i] = ca.fmin(ca.fmax(wanted, -bound[i]), bound[i])
    return ca.vertcat(*impulses)


def _stopping_impulse(inverse: Inverse, stopping: SX, impulses: list[SX], i: int) -> SX:
    """Impulse that stops joint i [N m s], given the impulses on all other joints."""
    coupled = (inverse.share[i, j] * impulses[j] for j in range(len(impulses)) if j != i)
    return sum(coupled, stopping[i])


def smooth_impulse(inverse: Inverse, stopping: SX, bound: SX) -> SX:
    """Friction impulse of a differentiable law: -bound tanh(qd / REGULARISATION)."""
    # stopping = -qd / diagonal: the speed without Coulomb friction comes back from it.
    qd = -inverse.diagonal * stopping
    return -bound * ca.tanh(qd / REGULARISATION)


# Least denominator of a quotient: it makes 0 / 0 zero, and leaves larger denominators unchanged.
_TINY = 1e-300


@part
class Presliding(Part):
    """Presliding of the friction of all motors (Dahl, LuGre). Motor side.

    Parameters
    ----------
    distance : (n,) array_like
        Presliding distance of the motor [rad]: the Coulomb level divided by the stiffness of the
        bristles. After a motion over this distance, from unbent bristles, the friction is at 63 %
        of its level. Zero means Coulomb friction. ``encoder.to_angle(pulses)`` gives the distance
        for a number of pulses.
    damping : (n,) array_like, optional
        Micro-damping, torque per speed of the bristles [N m s/rad]; none by default.

    Raises
    ------
    ValueError
        Negative numbers.

    See Also
    --------
    plant.FrictionCurve, plant.Drive

    Examples
    --------
    >>> from plant import Presliding
    >>> Presliding(distance=(0.002, 0.002))
    Presliding(distance=array([0.002, 0.002]), damping=None)
    """

    distance: Vector = number(("n",))
    damping: Any = number(("n",), default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        advice = "Give the motor's way in rad, and its damping in N m s/rad."
        signs(self, not_negative=("distance", "damping"), advice=advice)


class Bristles(NamedTuple):
    """Bristles of all shafts: deflection (-1 to 1), distance [rad], damping [N m s/rad]."""

    deflection: SX
    distance: SX
    damping: SX | None

    def damped(self, bound: SX) -> SX:
        """Impulse per change of deflection in a step with this bound of the friction impulse."""
        # The step damps the bristles like a damping of stiffness h / 2 already: the larger one
        # counts.
        return bound if self.damping is None else ca.fmax(bound, 2 * self.distance * self.damping)

    def bent(self, speed: SX, time: SX) -> Self:
        """The bristles a time [s] later, at this speed [rad/s]."""
        # An implicit Euler step of dr/dt = (v - abs(v) r) / d: it stays within -1 to 1 for any
        # step.
        path = time * ca.fabs(speed)
        change = (time * speed - path * self.deflection) / ca.fmax(self.distance + path, _TINY)
        return self._replace(deflection=self.deflection + change)


def bristle_impulse(
    inverse: Inverse,
    stopping: SX,
    impulse: SX,
    bristles: Bristles,
    bound: SX,
    h: SX,
    sweeps: int,
) -> tuple[SX, SX]:
    """Presliding friction impulse (n, 1) of one step [N m s], and the deflection (n, 1) at its end.

    `bristles` is their state in the middle of the step, whose length is h [s]. For a joint alone
    that moves forwards, let r be this deflection, x the momentum at the end of the step, m the
    momentum there if the friction of the middle stayed, and D the momentum with which the joint
    travels the presliding distance in half a step. Then, with ``damped = bristles.damped(bound)``,
    x^2 + (D - m + damped (1 - r)) x - D m = 0.
    """
    # In units of momentum: `distance` is D of the docstring, the momentum with which the joint goes
    # the presliding distance in half a step.
    impulses = ca.vertsplit(impulse)
    bound = ca.vertsplit(ca.fabs(bound))
    deflection = ca.vertsplit(bristles.deflection)
    distance = ca.vertsplit(2 / h * inverse.alone * bristles.distance)
    damped = ca.vertsplit(bristles.damped(ca.vertcat(*bound)))
    following = list(deflection)
    for _ in range(sweeps):
        for i in range(len(impulses)):
            wanted = _stopping_impulse(inverse, stopping, impulses, i)
            # `free` is m with its sign: the momentum that remains if the bristles bend no further.
            # The joint moves in the direction of `free`, so the equation is solved for the
            # momentum in this direction, which is not negative.
            free = -(wanted + bound[i] * deflection[i])
            forwards = ca.sign(free)
            m = ca.fabs(free)
            room = 1 - forwards * deflection[i]
            # The positive root of x^2 + 2 half x - D m = 0. For half > 0 it is the product of the
            # roots over the other root: the direct formula would cancel there.
            half = (distance[i] - m + damped[i] * room) / 2
            larger = ca.fabs(half) + ca.sqrt(half * half + distance[i] * m)
            momentum = ca.if_else(half > 0, distance[i] * m / ca.fmax(larger, _TINY), larger)
            # The impulse is what would stop the joint, plus the momentum that it keeps.
            impulses[i] = wanted + forwards * momentum
            bending = forwards * momentum * room / ca.fmax(distance[i] + momentum, _TINY)
            following[i] = deflection[i] + bending
    return ca.vertcat(*impulses), ca.vertcat(*following)


def smooth_bristle_impulse(
    inverse: Inverse, stopping: SX, bristles: Bristles, bound: SX, h: SX
) -> tuple[SX, SX]:
    """Friction impulse and deflection (n, 1) of a differentiable step, from bristles at its start.

    Each joint is treated alone. Its bristles bend with the speed at the end of the step for the
    whole step, in an equation that is linear in the change of this speed. The step is of first
    order, and has a limit as h goes to 0. It holds a joint at rest where Coulomb friction holds it,
    even if the bristles are stiff for the length of the step.
    """
    holding = bound * bristles.deflection
    # Speed at the end, if the friction at the start stayed: joints alone, no sweeps, so that the
    # derivative is cheap.
    speed = -inverse.diagonal * (stopping + holding)
    path = h * ca.fabs(speed)
    added = bound if bristles.damping is None else bound + bristles.distance * bristles.damping
    room = bristles.distance + path + h * inverse.diagonal * added
    bending = (h * speed - path * bristles.deflection) / ca.fmax(room, _TINY)
    return -(holding + added * bending), bristles.deflection + bending
