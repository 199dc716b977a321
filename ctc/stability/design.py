"""Feedback and observer gains of one joint, from bandwidth and damping, poles, or noise (Kalman).

If the model cancels the arm's dynamics, the error of a joint is a double integrator of minus the
feedback acceleration. Gains are feedback accelerations per error [rad], not torques. `motor_gain`
converts them to motor torque per pulse, the gains of `P` and similar laws, with the inertia of the
joint.
"""

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ctc.laws.observer import predict
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
        zeta. With 1/sqrt(2), as in `ComputedTorque`, and a bandwidth of sqrt(a / e), the feedback
        is the linear-quadratic regulator that weighs an error e [rad] as much as a feedback
        acceleration a [rad/s^2].
    integral : float
        p, pole of the integral part [rad/s]; 0 for none.

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
    """Motor torque per pulse [N m], the unit of `P`, for an acceleration per error.

    It converts gains on the rate and on the integral of the error alike.

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
    pulse = rig.to_angle(np.ones(rig.n))
    # With coupled motors a gain of one joint acts on several motors.
    if rig.drive.coupling.matrix:
        raise ValueError(
            "motor_gain is for motors that turn one joint each; got a coupling. Use arm.D(q) in"
            " full."
        )
    # The acceleration of one pulse of error, times the inertia, through the gear.
    return rig.drive.motor_torque(of_joints * np.asarray(gain) * pulse)


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
        Continuous-time [rad/s], negative real parts; complex ones in pairs.
    disturbance : float or (n,) array_like, optional
        Instead of poles: standard deviation of the change of the disturbance acceleration, a random
        walk, in one second [rad/s^2].

    Returns
    -------
    (n, 3) numpy.ndarray
        Of the innovation in the corrections of error, rate [1/s] and disturbance [1/s^2].

    Raises
    ------
    ValueError
        Poles that are not stable; both of them, or neither.

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
        # Both fix all three gains, so only one of them can be met.
        raise ValueError(f"one of poles and disturbance must be given; got {got}. Leave one out.")
    step, output = _model()
    if poles is not None:
        s = np.asarray(poles, complex)
        # Complex poles that come in pairs have a real polynomial, to rounding.
        sound = s.shape == (3,) and (s.real < 0).all()
        if not sound or abs(np.poly(s).imag).max() > 1e-9 * abs(s).max() ** 3:
            raise ValueError(
                f"poles must be three, stable, complex ones in pairs; got {s}. Give rad/s, below"
                " zero."
            )
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
        # Variances in units of the rounding error's, pulse^2 / 12, and of one sample.
        ratio = (size * rig.period**2) ** 2 / (pulse**2 / 12)
        _, spread, _ = control.dlqe(step, [[0.0], [0.0], [1.0]], output, [[ratio]], [[1.0]])
        # `dlqe` gives the gain of a predictor; that of a filter follows from its covariance.
        rows.append((spread @ output.T / (output @ spread @ output.T + 1)).ravel())
    return np.array(rows) / rig.period ** np.arange(3)


def _model() -> tuple[Floats, Floats]:
    """Matrices of one step of error, rate and disturbance, and of the measurement, the error.

    Time is counted in samples, which keeps all three of one size; gains are converted to seconds
    afterwards.
    """
    # The laws' own prediction, so that the gains belong to the observer that uses them.
    x = ca.SX.sym("x", 3)
    following = ca.vertcat(*predict(x[0], x[1], x[2], 0, 1.0))
    step = ca.Function("step", [x], [ca.jacobian(following, x)])
    return step(np.zeros(3)).full(), np.array([[1.0, 0.0, 0.0]])
