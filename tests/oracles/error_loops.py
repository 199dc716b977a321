"""The linear loops of all joints under `ComputedTorque`, written down by hand: numpy, poles, and no
casadi.

Error e = q_r - q of an arm without weight and friction whose model is true: edd = M (delta - u),
with M the inverse of its inertia matrix, u the torque beyond what the model needs, held over a
period T, and delta what the model lacks.
"""

import numpy as np
from scipy.signal import bilinear_zpk, place_poles

from ctc.laws import DRIFT


def tustin(poles):
    """Of s T, by the trapezoid rule, as scipy's."""
    return bilinear_zpk([], poles, 1.0, 1.0)[1]


def observer_gains(omega, T):
    """Of error, rate times T, disturbance times T^2: the stable zeros of s^6 + w^4 s^2 - (DRIFT
    w)^6, sampled.
    """
    zeros = np.roots([1, 0, 0, 0, omega**4, 0, -((DRIFT * omega) ** 6)])
    A, seen = np.array([[1, 1, 1 / 2], [0, 1, 1], [0, 0, 1]]), np.array([[1.0, 0, 0]])
    return place_poles(
        A.T, (seen @ A).T, tustin(zeros[zeros.real < 0] * T), rtol=1e-12, maxiter=100
    ).gain_matrix[0]


def regulator_gains(omega, T):
    """Of error and rate times T: poles at omega, damping 1/sqrt(2), sampled; acceleration times
    T^2.
    """
    A, B = np.array([[1.0, 1], [0, 1]]), np.array([[1 / 2], [1]])
    poles = tustin(omega * T * np.array([-1 + 1j, -1 - 1j]) / np.sqrt(2))
    return place_poles(A, B, poles).gain_matrix[0]


def error_loops(mobility, bandwidth, omega, T, delay=0):
    """A (m, m), B (m, n), C (n, m): from the errors that the law measures to those that are; closed
    by A + B C.

    States, n each, time in samples: error, rate, both as estimated, the disturbance torque as
    estimated, the torque u that acted last, and with a delay the one that acts next.
    """
    M, n = mobility * T**2, len(mobility)
    felt, root = np.diag(1 / np.diag(M)), np.linalg.cholesky(np.linalg.inv(M))
    carried = root / np.diag(root) @ felt
    g, k = observer_gains(omega, T), regulator_gains(bandwidth, T)
    size = (6 + delay) * n
    e, rate, e_hat, rate_hat, lacking, acted, *coming = np.eye(size).reshape(6 + delay, n, size)
    # what depends on the states, and on the measured errors
    measured = np.zeros((n, size)), np.eye(n)

    def of(states):
        return states, np.zeros((n, n))

    def plus(*terms):
        """Sum of factor times signal."""
        return tuple(sum(factor @ signal[i] for factor, signal in terms) for i in (0, 1))

    one = np.eye(n)

    def ahead(error, speed, torque, delta):
        pushed = plus((M, delta), (-M, torque))
        return plus((one, error), (one, speed), (one / 2, pushed)), plus(
            (one, speed), (one, pushed)
        )

    error, speed = ahead(of(e_hat), of(rate_hat), of(acted), of(lacking))
    innovation = plus((one, measured), (-one, error))
    error, speed = (
        plus((one, error), (g[0] * one, innovation)),
        plus((one, speed), (g[1] * one, innovation)),
    )
    delta = plus((one, of(lacking)), (g[2] * felt, innovation))
    then = ahead(error, speed, of(coming[0]), delta) if delay else (error, speed)
    wanted = plus((one, delta), (k[0] * carried, then[0]), (k[1] * carried, then[1]))
    acts = of(coming[0]) if delay else wanted
    truly = ahead(of(e), of(rate), acts, of(np.zeros((n, size))))
    following = (*truly, error, speed, delta, acts, *([wanted] if delay else []))
    return np.vstack([x[0] for x in following]), np.vstack([x[1] for x in following]), e
