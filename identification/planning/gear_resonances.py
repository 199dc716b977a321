"""Resonances of the gears, from the measured response of an arm.

Without the inertia and the friction of the motors, the response from torque to angle is that of
links and gears in series. It is the sum of the links' inverse inertia over (i omega)^2, a term of
gravity of higher order, and, on the diagonal, the gear's compliance 1 / (k + i omega c). For light
damping, the real part of the response is linear in inverse inertia and compliance, and its
imaginary part is linear in the damping c. The fits of both parts give the gears' resonances.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant import Drive
from plant.parts import Floats

# Upper limit of the band, as a share of the sampling rate. Below it, the hold of the torque is a
# gain and a delay of half a sample, to about 1 %.
_HELD = 0.2

# A compliance counts if it exceeds this many of its standard deviations. Rounding repeats from
# period to period, so that the standard deviations do not contain it: by rounding, the compliance
# of a rigid gear reaches up to 5 standard deviations.
_FIRM = 8


class Resonances(NamedTuple):
    """Lowest resonance [Hz] (n,) and damping ratio (n,) of each joint, all else locked.

    The joint's motor and all other joints are held, as for `Elasticity.from_resonance`. Fields that
    end in ``_std`` are standard deviations. A gear whose compliance does not exceed 8 of its
    standard deviations counts as rigid: its `hz` is inf, and its other fields are nan. All fields
    are nan if the lines show the compliance, but no positive inertia behind it.
    """

    hz: Floats
    hz_std: Floats
    damping_ratio: Floats
    damping_ratio_std: Floats


def resonances(
    frequency: Floats, plant: NDArray[np.complex128], std: Floats, held: float, drive: Drive
) -> Resonances:
    """Resonances from the response `plant` (n, n, F), torque to angle, and its deviation `std`.

    `frequency` (F,) [Hz]. `held`: time for which a torque is held [s].

    Raises
    ------
    ValueError
        The drive has a coupling, so that a motor does not belong to one joint; fewer lines in the
        band than unknowns of a joint; a standard deviation of 0.
    """
    if drive.coupling.matrix:
        raise ValueError(
            "drive must have one motor per joint; got a coupling. Fit gears by identify(...) there."
        )
    # 1. The continuous plant G (F, n, n), in the band where the hold is a gain, sinc(x), and a
    # delay of half a sample: the measured response is divided by both.
    band = _band(frequency, std, held)
    omega = 2 * np.pi * frequency[band]
    n = drive.n
    hold = np.exp(0.5j * omega * held) / np.sinc(omega * held / 2 / np.pi)
    G = np.moveaxis(plant[:, :, band] * hold, -1, 0)

    # 2. Remove inertia and viscous friction of the motors: the torque that they take does not reach
    # the gears. The variance of `series` follows from its derivative by G.
    motor = (
        -drive.reflected_inertia() * omega[:, None] ** 2
        + 1j * drive.joint_viscous() * omega[:, None]
    )
    from_angle = np.linalg.inv(np.eye(n) - G * motor[:, None])
    from_torque = np.linalg.inv(np.eye(n) - motor[:, :, None] * G)
    series = from_angle @ G
    errors = np.moveaxis(std[:, :, band] ** 2, -1, 0)
    variance = np.abs(from_angle) ** 2 @ errors @ np.abs(from_torque) ** 2

    # 3. Real parts: inverse inertia and gravity, and on the diagonal the compliance.
    powers = np.column_stack([-(omega**-2), omega**-4, omega**0])
    inverse_inertia = np.empty((n, n))
    inertia_variance = np.empty((n, n))
    gears = []
    for i in range(n):
        for j in range(n):
            columns = powers if i == j else powers[:, :2]
            fit = _fitted(columns, series[:, i, j].real, variance[:, i, j])
            inverse_inertia[i, j] = fit.values[0]
            inertia_variance[i, j] = fit.covariance[0, 0]
            if i == j:
                gears.append(fit)
    inertia = np.linalg.inv(inverse_inertia)

    # 4. Resonance and damping of each gear that is not rigid.
    result = Resonances(*np.full((4, n), np.nan))
    for i, gear in enumerate(gears):
        if not gear.values[2] > _FIRM * np.sqrt(gear.covariance[2, 2]):
            result.hz[i] = np.inf
        # Noise can hide the inertia behind a soft gear.
        elif inertia[i, i] > 0:
            damping = _fitted(-omega[:, None], series[:, i, i].imag, variance[:, i, i])
            numbers = _resonance(i, gear, damping, inertia, inertia_variance)
            for field, number in zip(result, numbers, strict=True):
                field[i] = number
    return result


def _band(frequency: Floats, std: Floats, held: float) -> NDArray[np.bool_]:
    """Lines (F,) that count, or the refusal of a response that does not determine the gears."""
    highest = _HELD / held if held else np.inf
    # The mean, a line at 0 Hz, shows no inertia.
    band = (frequency > 0) & (frequency < highest)
    # A joint has three unknowns: inverse inertia, gravity and compliance.
    if band.sum() < 3:
        where = f" from 0 to {highest:.4g} Hz" if held else ""
        raise ValueError(
            f"the response must have 3 lines at least{where}; got {band.sum()}. Excite more there."
        )
    # A torque of 0 leaves a response, and a standard deviation, of 0.
    for line in np.flatnonzero(band):
        least = std[:, :, line].min()
        if not least > 0:
            raise ValueError(
                f"plant_std must be positive; got {least:g} at {frequency[line]:.3g} Hz. Log the"
                " torque of each motor."
            )
    return band


class _Coefficients(NamedTuple):
    """Coefficients (k,) of a fit, and their covariance (k, k)."""

    values: Floats
    covariance: Floats


def _resonance(
    i: int,
    gear: _Coefficients,
    damping: _Coefficients,
    inertia: NDArray[np.floating[Any]],
    inertia_variance: Floats,
) -> tuple[float, float, float, float]:
    """Numbers of a joint, in the order of `Resonances`, from the fits of both parts.

    `inertia_variance` (n, n): that of each inverse inertia.
    """
    compliance = gear.values[2]
    lag = damping.values[0]
    hz = 1 / np.sqrt(compliance * inertia[i, i]) / 2 / np.pi
    ratio = np.pi * hz / compliance * lag
    # Derivatives of log(hz^2) by each inverse inertia. The sum leaves out that of the joint
    # itself, whose fit correlates with the compliance: `slope` treats these two together.
    slopes = np.outer(inertia[i], inertia[:, i]) / inertia[i, i]
    others = slopes**2 * inertia_variance
    others[i, i] = 0.0
    spread = others.sum()
    slope = np.array([slopes[i, i], 0, -1 / compliance])
    hz_std = hz / 2 * np.sqrt(spread + slope @ gear.covariance @ slope)
    # The damping ratio has the errors of hz and of the compliance, which share a fit, and that of
    # the lag, which has its own.
    ratio_slope = np.array([slopes[i, i] / 2, 0, -1.5 / compliance])
    shared = spread / 4 + ratio_slope @ gear.covariance @ ratio_slope
    of_lag = damping.covariance[0, 0] * (np.pi * hz / compliance) ** 2
    return hz, hz_std, ratio, np.sqrt(ratio**2 * shared + of_lag)


def _fitted(columns: Floats, values: Floats, variance: Floats) -> _Coefficients:
    """Weighted least squares of the real or the imaginary part of complex values.

    `variance` (F,) is that of the complex values. If the residuals are larger than it predicts, the
    covariance grows with them.
    """
    # Each part has half of the variance of a complex number.
    weight = np.sqrt(2 / variance)
    rows = columns * weight[:, None]
    # Columns of unit length: powers of omega differ by many decades.
    size = np.linalg.norm(rows, axis=0)
    inverse = np.linalg.pinv(rows / size) / size[:, None]
    solved = inverse @ (values * weight)
    residual = values * weight - rows @ solved
    # As many lines as unknowns leave no residual.
    freedom = max(len(values) - columns.shape[1], 1)
    return _Coefficients(solved, inverse @ inverse.T * max(1.0, residual @ residual / freedom))
