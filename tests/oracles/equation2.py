"""Equations (2) and (3) of the paper typed out in numpy: corrected as in ERRATA, and with
`printed=True` as printed.

An oracle for tests only; the model's one home is `plant/`. Joints are 2 and 3 of the PUMA 560: axis
2 horizontal, y2 pointing down at q = 0, hence f5 and f9 pull the arm down with negative torque.
"""

import numpy as np

GRAVITY = 9.81  # [m/s^2]


def D(q, f, printed=False):
    """Inertia matrix of (2), (2, 2) [kg m^2].

    Parameters
    ----------
    q : (2,) array_like
        q2, q3 [rad].
    f : (9,) array_like
        f1..f9; f1, f2, f3, f4, f7 [kg m^2], f5, f6, f8, f9 [kg m].
    printed : bool
        The printed D11 starts with f1; f7 is the correct one.
    """
    f1, f2, f3, f4, _, _, f7, _, _ = f
    c3, s3 = np.cos(q[1]), np.sin(q[1])
    coupling = f2 + f3 * c3 - f4 * s3
    return np.array(
        [[(f1 if printed else f7) + 2 * f3 * c3 - 2 * f4 * s3, coupling], [coupling, f1]]
    )


def C(q, qd, f, printed=False):
    """Coriolis and centrifugal torques of (2), (2,) [N m]; the printed second row has f4 s3, the
    correct one f4 c3.
    """
    _, _, f3, f4, *_ = f
    c3, s3 = np.cos(q[1]), np.sin(q[1])
    v2, v3 = qd
    first = -f3 * s3 * v3**2 - 2 * f3 * v2 * v3 * s3 - f4 * v3**2 * c3 - 2 * f4 * v3 * v2 * c3
    return np.array([first, f3 * v2**2 * s3 + f4 * v2**2 * (s3 if printed else c3)])


def G(q, f, g=GRAVITY):
    """Gravity torques of (2), (2,) [N m]; printed correctly."""
    f5, f6, f8, f9 = f[4], f[5], f[7], f[8]
    second = -f5 * g * np.cos(q[0] + q[1]) + f6 * g * np.sin(q[0] + q[1])
    return np.array([second + f8 * g * np.sin(q[0]) - f9 * g * np.cos(q[0]), second])


def equation3(m, x, y, izz, jm, k, a, printed=False):
    """f1..f9 of (3) from physical parameters, each a pair for links 2 and 3.

    Parameters
    ----------
    m : (2,) array_like
        Masses [kg].
    x, y : (2,) array_like
        Centres of mass in the links' frames [m].
    izz : (2,) array_like
        Inertia about the axis through the centre of mass, parallel to z [kg m^2].
    jm : (2,) array_like
        Motor inertias, motor side [kg m^2].
    k : (2,) array_like
        Gear ratios; the sign does not matter here.
    a : float
        Distance between the axes of joints 2 and 3 [m].
    printed : bool
        As printed, f1 and f7 have each other's motor.
    """
    motor2, motor3 = jm if not printed else jm[::-1]
    about3 = izz[1] + m[1] * x[1] ** 2 + m[1] * y[1] ** 2
    about2 = izz[0] + m[0] * x[0] ** 2 + m[0] * y[0] ** 2
    return np.array(
        [
            motor3 * k[1] ** 2 + about3,
            about3,
            m[1] * x[1] * a,
            m[1] * y[1] * a,
            m[1] * x[1],
            m[1] * y[1],
            motor2 * k[0] ** 2 + about2 + m[1] * a**2 + about3,
            m[0] * y[0],
            m[0] * x[0] + m[1] * a,
        ]
    )
