"""Feedback and observer gains of one joint, from bandwidth and damping, poles, or noise (Kalman).

If the model cancels the arm's dynamics, the second derivative of a joint's error is minus the
feedback acceleration. PID gains are feedback accelerations per error [rad], not torques.
`motor_gain` uses the inertia of each joint to convert them to motor torques per pulse, the unit of
the gains of `P` and similar laws.
"""

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.laws import predict
from plant import Rig
from plant.parts import Floats, array, instance, real


def pid_gains(
    bandwidth: float, damping: float = 1.0, integral: float = 0.0
) -> tuple[float, float, float]:
    """PID gains for error poles at the zeros of (s^2 + 2 zeta w s + w^2) (s + p).

    Parameters
    ----------
    bandwidth : float
        w [rad/s]
    damping : float
        zeta. With 1/sqrt(2), as in `ComputedTorque`, a bandwidth of sqrt(a / e) and no integral
        part, the feedback is the linear-quadratic regulator that weighs an error e [rad] as much as
        a feedback acceleration a [rad/s^2].
    integral : float
        p [rad/s]. The integral part adds an error pole at -p; 0 leaves the integral part out.

    Returns
    -------
    proportional, integral, derivative : float
        Feedback acceleration per error [1/s^2], per its integral [1/s^3], and per its rate [1/s].

    Raises
    ------
    ValueError
        A bandwidth or a damping that is not positive, a negative integral.

    See Also
    --------
    ctc.motor_gain, plant.PID

    Examples
    --------
    >>> from ctc import pid_gains
    >>> pid_gains(20.0, integral=5.0)
    (600.0, 2000.0, 45.0)
    """
    w = real("bandwidth", bandwidth, "Give rad/s.", positive=True)
    zeta = real("damping", damping, "1 is a double pole.", positive=True)
    p = real("integral", integral, "Give rad/s, or 0 for no integral part.")
    if p < 0:
        raise ValueError(
            f"integral must not be negative; got {p}. Give rad/s, or 0 for no integral part."
        )
    # The coefficients of s, 1 and s^2 of the product of the two factors.
    return w**2 + 2 * zeta * w * p, w**2 * p, 2 * zeta * w + p


def motor_gain(rig: Rig, inertia: ArrayLike, gain: ArrayLike) -> Floats:
    """Motor torque per pulse [N m], as `P` takes it, from a feedback acceleration per error.

    The function converts gains on the rate and on the integral of the error in the same way.

    Parameters
    ----------
    rig : Rig
    inertia : (n,) array_like
        Of each joint [kg m^2], such as the diagonal of ``arm.D(q)``.
    gain : float or (n,) array_like
        [1/s^2]

    Returns
    -------
    (n,) numpy.ndarray

    Raises
    ------
    ValueError
        A wrong shape, a number that is not finite, or motors that are coupled.

    See Also
    --------
    ctc.pid_gains, plant.PID

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import motor_gain
    >>> motor_gain(puma560.rig(), (3.0, 1.0), 400.0).round(3)
    array([0.001, 0.001])
    """
    instance("rig", rig, Rig, "Pass the rig of the arm.")
    of_joints = array("inertia", inertia, (rig.n,), advice="Give the diagonal of arm.D(q).")
    # One number holds for every joint.
    gains = np.full(rig.n, gain) if np.ndim(gain) == 0 else gain
    advice = "Give one number, or one per joint [1/s^2]."
    accelerations = array("gain", gains, (rig.n,), advice=advice)
    pulse = rig.to_angle(np.ones(rig.n))
    # With coupled motors a gain of one joint acts on several motors.
    if rig.drive.coupling.matrix:
        raise ValueError(
            "motor_gain is for motors that turn one joint each; got a coupling. Use arm.D(q) in"
            " full."
        )
    # The acceleration of one pulse of error, times the inertia, through the gear.
    return rig.drive.motor_torque(of_joints * accelerations * pulse)


def observer_gains(
    rig: Rig, *, poles: ArrayLike | None = None, disturbance: ArrayLike | None = None
) -> Floats:
    """Observer gains of each joint for error, rate and disturbance: by poles, or a Kalman filter.

    The measurement noise of the stationary Kalman filter is that of the counts, uniform over one
    pulse.

    Parameters
    ----------
    rig : Rig
    poles : (3,) array_like, optional
        Continuous-time [rad/s], negative real parts; complex ones in pairs, with imaginary parts
        below pi divided by the rig's period.
    disturbance : float or (n,) array_like, optional
        Selects the Kalman filter, instead of poles. The filter models the disturbance acceleration
        as a random walk; this is the standard deviation of its change in one second [rad/s^2].

    Returns
    -------
    (n, 3) numpy.ndarray
        Corrections of error [1], rate [1/s] and disturbance [1/s^2] per unit of the innovation.

    Raises
    ------
    ValueError
        The poles are not three finite, stable ones, complex poles are not in pairs, or are too fast
        for the rig's period; the disturbance is not positive; both poles and disturbance are given,
        or neither is.

    See Also
    --------
    ctc.pid_gains, ctc.ComputedTorque

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import observer_gains
    >>> observer_gains(puma560.rig(), poles=(-100, -100, -100))[0].round(1).tolist()
    [0.2, 18.9, 630.6]
    """
    import control

    instance("rig", rig, Rig, "Pass the rig of the arm.")
    if (poles is None) == (disturbance is None):
        got = "both" if poles is not None else "none"
        # Poles and disturbance each fix all three gains, so only one of the two can be met.
        raise ValueError(f"one of poles and disturbance must be given; got {got}. Leave one out.")
    step, output = _model()
    if poles is not None:
        s = _poles(poles, rig.period)
        # Ackermann's formula for the dual system. The observer corrects after its prediction, so
        # its output is that of the predicted state.
        gains = control.acker(step.T, (output @ step).T, np.exp(s * rig.period))
        gains = np.tile(np.asarray(gains).ravel(), (rig.n, 1))
        # Time counted in samples becomes seconds: rate per period, disturbance per period squared.
        return gains / rig.period ** np.arange(3)
    # The variance of a random walk grows with time, so its deviation with the root of the period.
    walk = np.broadcast_to(np.asarray(disturbance, float), (rig.n,)) * np.sqrt(rig.period)
    if not (np.isfinite(walk) & (walk > 0)).all():
        raise ValueError(
            f"disturbance must be positive; got {np.asarray(disturbance)}. Give rad/s^2 in one"
            " second."
        )
    rows = []
    for size, pulse in zip(walk, rig.to_angle(np.ones(rig.n)), strict=True):
        # Variance of the walk in one sample, relative to that of the rounding error, pulse^2 / 12.
        ratio = (size * rig.period**2) ** 2 / (pulse**2 / 12)
        _, spread, _ = control.dlqe(step, [[0.0], [0.0], [1.0]], output, [[ratio]], [[1.0]])
        # `dlqe` gives the gain of a predictor; that of a filter follows from its covariance.
        rows.append((spread @ output.T / (output @ spread @ output.T + 1)).ravel())
    return np.array(rows) / rig.period ** np.arange(3)


def _poles(poles: ArrayLike, period: float) -> NDArray[np.complex128]:
    """Three stable poles [rad/s] of a real polynomial, or a refusal."""
    s = np.asarray(poles, complex)
    sound = s.shape == (3,) and np.isfinite(s).all() and (s.real < 0).all()
    if not sound or not _paired(s):
        raise ValueError(
            f"poles must be three, stable, complex ones in pairs; got {s}. Give rad/s, below zero."
        )
    # A faster oscillation looks like a slower one in the samples.
    fastest = np.abs(s.imag).max()
    if fastest >= np.pi / period:
        raise ValueError(
            f"poles must have imaginary parts below {np.pi / period:.5g} rad/s, pi divided by the"
            f" rig's period; got {fastest:.5g}. Give slower ones."
        )
    return s


def _paired(s: NDArray[np.complex128]) -> bool:
    """Whether each of three poles is real or has its conjugate among them, to rounding."""
    # The scale of rounding is that of each pole, since one may be much faster than the others.
    # 1e-9: poles that were computed, such as zeros of a polynomial, are less exact than one number.
    rounding = 1e-9 * np.abs(s)
    paired = np.abs(s[:, None] - s.conj()).min(axis=1) <= rounding
    # Of a pole that stands twice beside one conjugate each has a partner, and the sum shows it.
    return bool(paired.all() and np.abs(s.imag.sum()) <= rounding.max())


def _model() -> tuple[Floats, Floats]:
    """Transition matrix of error, rate and disturbance for one sample, and measurement matrix.

    The measurement is the error. Time is counted in samples, so that all entries are of similar
    size; `observer_gains` converts its gains to seconds.
    """
    # The laws' own prediction, so that the gains belong to the observer that uses them.
    x = ca.SX.sym("x", 3)
    following = ca.vertcat(*predict(x[0], x[1], x[2], 0, 1.0))
    step = ca.Function("step", [x], [ca.jacobian(following, x)])
    return step(np.zeros(3)).full(), np.array([[1.0, 0.0, 0.0]])
