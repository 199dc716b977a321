"""Secondary effects of drives: current lag, torque ripple, load-dependent and drifting friction."""

from typing import Any

import casadi as ca
import numpy as np
from casadi import SX

from plant.parts import ArrayOrSymbols, Part, Vector, array, number, part, real, signs


@part
class TorqueRipple(Part):
    """Torque of the motor's magnets and slots, amplitude sin(cycles q_m + phase). Motor side.

    Parameters
    ----------
    amplitude : (n,) array_like
        Amplitude of the torque [N m], motor side. For comparison: the largest torque of the motor
        is ``motor_gain * current_limit``.
    cycles : (n,) array_like
        Periods of the torque per turn of the motor, such as the number of its slots.
    phase : (n,) array_like, optional
        Phase at motor angle 0 [rad]; 0 by default.

    Raises
    ------
    ValueError
        Negative amplitude, cycles that are not positive.

    See Also
    --------
    plant.Drive

    Examples
    --------
    >>> from plant import TorqueRipple
    >>> ripple = TorqueRipple(amplitude=(0.01, 0.01), cycles=(6, 6))
    >>> ripple.torque((0.1, 0.0)).round(5)
    array([0.00565, 0.     ])
    """

    amplitude: Vector = number(("n",))
    cycles: Vector = number(("n",))
    phase: Any = number(("n",), default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(
            self,
            positive=("cycles",),
            not_negative=("amplitude",),
            advice="For -amplitude give phase + pi, for -cycles pi - phase.",
        )

    def torque(self, q_m: ArrayOrSymbols) -> ArrayOrSymbols:
        """Motor torque [N m] at motor angles [rad]."""
        # Without a phase the equations have a term less than with a phase of 0.
        angle = self.cycles * q_m if self.phase is None else self.cycles * q_m + self.phase
        return self.amplitude * (np.sin(angle) if isinstance(angle, np.ndarray) else ca.sin(angle))


# Largest time constant [s]: a current loop of 8 Hz. Real ones are faster; milliseconds that were
# given as seconds exceed it.
_LONGEST = 0.02


@part
class CurrentLag(Part):
    """How the motor currents follow the commanded ones: a first-order lag.

    Parameters
    ----------
    time : float
        Time constant, at most 0.02 [s].
    """

    time: float = number(())

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.time > 0:
            raise ValueError(
                f"current_lag must be positive; got {self.time:g} s. Leave it out for none."
            )
        if self.time > _LONGEST:
            raise ValueError(
                f"current_lag must be at most {_LONGEST:g} s; got {self.time:g}. Give it in"
                " seconds."
            )


def lagging(commanded: SX, driven: SX, lag: CurrentLag, h: SX) -> tuple[SX, SX]:
    """Mean torque in a step of length h [s] and torque at its end, under a first-order lag."""
    # i' = (commanded - i) / time, solved exactly over the step, and its mean by integration: stable
    # for any step and any time constant.
    decay = ca.exp(-h / lag.time)
    end = commanded + (driven - commanded) * decay
    return commanded + (driven - commanded) * (lag.time / h) * (1 - decay), end


def torque_steps(step: Any, n: int) -> tuple[float, ...]:
    """Steps of the commanded motor torques [N m], one per joint, from one number or from n."""
    if np.ndim(step) == 0:
        step = np.full(n, real("torque_step", step, "Give N m."))
    step = array("torque_step", step, (n,), advice="Give N m.")
    if not (step > 0).all():
        raise ValueError(f"torque_step must be positive; got {step}. Leave it out for none.")
    return tuple(step.tolist())


def rounded(torque: ArrayOrSymbols, step: ArrayOrSymbols) -> ArrayOrSymbols:
    """The nearest multiple of a step [N m]."""
    # floor(x + 1/2): halves go up, in numpy and casadi alike.
    return step * (np.floor if isinstance(torque, np.ndarray) else ca.floor)(torque / step + 0.5)


@part
class LoadFriction(Part):
    """Coulomb friction in proportion to the torque that the gear transmits to its link.

    Parameters
    ----------
    share : (n,) array_like
        Rise of the Coulomb level, divided by the magnitude of the transmitted torque; both joint
        side. From 0 to below 1.
    """

    share: Vector = number(("n",))

    def __post_init__(self) -> None:
        super().__post_init__()
        # A share of 1 would be a gear that locks itself.
        if not ((self.share >= 0) & (self.share < 1)).all():
            raise ValueError(
                f"load_friction must be from 0 to below 1; got {self.share}. Give a share, such as"
                " 0.1."
            )

    def level(self, load: ArrayOrSymbols) -> ArrayOrSymbols:
        """Rise of the Coulomb level [N m] under a transmitted torque [N m], both on the shaft."""
        return self.share * (np.abs(load) if isinstance(load, np.ndarray) else ca.fabs(load))


@part
class FrictionDrift(Part):
    """Slow relative drift of viscous and dry friction from the start of a run, as a gear warms up.

    Friction is 1 + amount (1 - exp(-t / time)) times its value at the start. The offset of a
    `FrictionCurve` and the micro-damping of `Presliding` do not drift.

    Parameters
    ----------
    amount : (n,) array_like
        Relative change after a long time, above -1: -0.2 is a fall by 20 %.
    time : (n,) array_like
        Time constant [s].

    Raises
    ------
    ValueError
        Amount of -1 or less, time that is not positive.

    See Also
    --------
    plant.Drive, plant.FrictionCurve

    Examples
    --------
    >>> from plant import FrictionDrift
    >>> FrictionDrift(amount=(-0.2, -0.2), time=(60, 60))  # a fifth less after some minutes
    FrictionDrift(amount=array([-0.2, -0.2]), time=array([60., 60.]))
    """

    amount: Vector = number(("n",))
    time: Vector = number(("n",))

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("time",), advice="Give the time constant in seconds.")
        if (self.amount <= -1).any():
            raise ValueError(
                f"amount must be above -1; got {self.amount}. Give a relative change, such as -0.2."
            )

    def factor(self, drifted: ArrayOrSymbols) -> ArrayOrSymbols:
        """Friction relative to the start, for a drift of 0 (start) to 1 (end)."""
        return 1 + self.amount * drifted

    def following(self, drifted: ArrayOrSymbols, h: ArrayOrSymbols) -> ArrayOrSymbols:
        """The drift (0 to 1) a time h [s] later."""
        # 1 - drifted decays by exp(-h / time): exact for any step.
        passed = -h / self.time
        return 1 - (1 - drifted) * (
            np.exp(passed) if isinstance(passed, np.ndarray) else ca.exp(passed)
        )
