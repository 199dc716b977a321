"""Gears in a measured frequency response: what yields between motor and link, joint by joint.

Without the motor's own share, the response from torque to angle is that of link and gear in a row:
the links' inverse inertia over (i omega)^2, gravity of higher order, and on the diagonal the gear's
compliance 1 / (k + i omega c). Its real part is linear in both, and its imaginary part in the
damping.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant import Drive
from plant.parts.fields import Floats

# share of the sampling rate up to which a held torque is its mean, half a sample late, to 1 %
_HELD = 0.2

# Standard deviations of a compliance above which it counts: rounding, which repeats, gives rigid
# gears up to 5.
_FIRM = 8


class Resonances(NamedTuple):
    """Lowest resonance [Hz] (n,) and damping ratio of each joint, its motor and every other joint
    held.

    As `Elasticity.from_resonance` takes them; ``_std`` are standard deviations. A gear whose
    compliance does not stand out of the noise is rigid, as far as it is seen: inf, and nan for the
    rest.
    """

    hz: Floats
    hz_std: Floats
    damping_ratio: Floats
    damping_ratio_std: Floats


def resonances(
    frequency: Floats, plant: NDArray[np.complex128], std: Floats, held: float, drive: Drive
) -> Resonances:
    """Resonances from the plant (n, n, F), its standard deviation, and for how long torques are
    held [s].
    """
    if drive.coupling.matrix:
        raise ValueError(
            "drive must have one motor per joint; got a coupling. Fit gears by identify(...) there."
        )
    known = frequency * (held or 1e-9) < _HELD
    omega = 2 * np.pi * frequency[known]
    n = drive.n
    smooth = np.exp(0.5j * omega * held) / np.sinc(omega * held / 2 / np.pi)
    G = np.moveaxis(plant[:, :, known] * smooth, -1, 0)
    motor = (
        -drive.reflected_inertia() * omega[:, None] ** 2
        + 1j * drive.joint_viscous() * omega[:, None]
    )
    left = np.linalg.inv(np.eye(n) - G * motor[:, None])
    right = np.linalg.inv(np.eye(n) - motor[:, :, None] * G)
    series = left @ G
    variance = np.abs(left) ** 2 @ np.moveaxis(std[:, :, known] ** 2, -1, 0) @ np.abs(right) ** 2
    powers = np.column_stack([-(omega**-2), omega**-4, omega**0])
    fits = [
        [
            _fitted(powers[:, : 2 + (i == j)], series[:, i, j].real, variance[:, i, j])
            for j in range(n)
        ]
        for i in range(n)
    ]
    link = np.linalg.inv([[fit[0][0] for fit in row] for row in fits])
    found = np.full((4, n), np.nan)
    for i in range(n):
        (_, _, yields), covariance = fits[i][i]
        if not yields > _FIRM * np.sqrt(covariance[2, 2]):
            found[0, i] = np.inf
            continue
        # change of log(hz^2) by each inverse inertia
        weight = np.outer(link[i], link[:, i]) / link[i, i]
        spread = sum(
            weight[p, q] ** 2 * fits[p][q][1][0, 0]
            for p in range(n)
            for q in range(n)
            if (p, q) != (i, i)
        )
        own = np.array([weight[i, i], 0, -1 / yields])
        hz = 1 / np.sqrt(yields * link[i, i]) / 2 / np.pi
        (lag,), lags = _fitted(-omega[:, None], series[:, i, i].imag, variance[:, i, i])
        ratio = np.pi * hz / yields * np.array([lag, np.sqrt(lags[0, 0])])
        found[:, i] = hz, hz / 2 * np.sqrt(spread + own @ covariance @ own), *ratio
    return Resonances(*found)


def _fitted(columns: Floats, values: Floats, variance: Floats) -> tuple[Floats, Any]:
    """Coefficients of one part of complex values, and their covariance, raised where they do not
    fit within it.
    """
    weight = np.sqrt(2 / variance)
    rows = columns * weight[:, None]
    size = np.linalg.norm(rows, axis=0)
    inverse = np.linalg.pinv(rows / size) / size[:, None]
    found = inverse @ (values * weight)
    left = values * weight - rows @ found
    spare = len(values) - columns.shape[1]
    return found, inverse @ inverse.T * max(1.0, left @ left / max(spare, 1))
