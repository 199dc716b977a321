"""Priors of what a log shows of its motors: log likelihoods beside what the drive states.

An inertia is at least the rotor's, a friction near the stated one, a coupling smaller than the
inertias that it couples, and a torque within the amplifier's limit.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant.checkup.motor_equation import Motion
from plant.parts import Floats


@dataclass(frozen=True, kw_only=True)
class PriorSettings:
    """Numbers of the priors.

    They are chosen by hand; ``tests/benchmarks/second_reading.py causes`` counts the mistakes that
    are named with them.

    Parameters
    ----------
    inertia, inertia_spread : float
        Median of the inertia at a motor [rotor inertias], and standard deviation of its logarithm.
    rotor : float
        Share of the stated rotor inertia that no arm undercuts.
    rotor_spread : float
        Relative standard deviation of that limit.
    coupling_spread : float
        Relative standard deviation of the largest coupling of two motors, since inertias are means
        over poses.
    surest : float
        Largest square of the number of standard deviations by which an inertia or a coupling passes
        its limit: errors of a model have heavier tails than a normal distribution.
    friction_spread : float
        Standard deviation of the logarithm of friction over the stated one.
    guessed, guess_spread : float
        Share of rigs whose friction is a guess, and the standard deviation of its logarithm.
    beyond, beyond_spread : float
        Share of the amplifier's limit that a torque may reach, and its relative standard deviation.
    """

    inertia: float = 5.0
    inertia_spread: float = 1.5
    rotor: float = 0.8
    rotor_spread: float = 0.1
    coupling_spread: float = 0.2
    surest: float = 50.0
    friction_spread: float = 0.4
    guessed: float = 0.2
    guess_spread: float = 1.5
    beyond: float = 1.02
    beyond_spread: float = 0.02


SETTINGS = PriorSettings()


def motion_priors(motions: Sequence[Motion], drive: Any) -> dict[str, Floats]:
    """Log likelihoods (n,) of the coefficients of all motors, by name."""
    rotors = zip(motions, drive.motor_inertia, strict=True)
    terms = {
        "inertia": np.array([_inertia_prior(motion, rotor) for motion, rotor in rotors]),
        "coupling": _coupling_prior(motions),
    }
    for name in ("coulomb", "viscous"):
        terms[name] = np.array(
            [
                _friction_prior(getattr(motion, name), getattr(motion, f"{name}_std"), stated)
                for motion, stated in zip(motions, getattr(drive, name), strict=True)
            ]
        )
    return terms


def limit_prior(torque: Floats, drive: Any) -> Floats:
    """Log likelihood (n,) of the largest motor torques (M, n) under the amplifier's limit."""
    share = np.abs(torque).max(axis=0) / (drive.motor_gain * drive.current_limit)
    beyond = np.log(np.maximum(share / SETTINGS.beyond, 1.0)) / SETTINGS.beyond_spread
    return np.asarray(-(np.minimum(beyond, 10.0) ** 2) / 2)


def _inertia_prior(motion: Motion, rotor: float) -> float:
    """Log likelihood of an inertia at the motor: not less than its rotor, nor a thousand times."""
    # A motion that is held tells neither an inertia nor its deviation.
    if not rotor or not 0 < motion.inertia_std < np.inf:
        return 0.0

    def log_prior(inertia):
        usual = np.log(inertia / rotor / SETTINGS.inertia) / SETTINGS.inertia_spread
        below = np.log(np.minimum(inertia / rotor / SETTINGS.rotor, 1.0)) / SETTINGS.rotor_spread
        return -(usual**2) / 2 - np.minimum(below**2, SETTINGS.surest) / 2

    return _likeliest(motion.inertia, motion.inertia_std, SETTINGS.inertia * rotor, log_prior)


def _friction_prior(friction: float, std: float, stated: float) -> float:
    """Log likelihood of a friction beside the stated one, which is measured, or a guess."""
    if not stated or not 0 < std < np.inf:
        return 0.0

    def log_prior(friction):
        distance = np.log(friction / stated)
        measured, guess = (
            np.log(share) - (distance / spread) ** 2 / 2 - np.log(spread)
            for share, spread in (
                (1 - SETTINGS.guessed, SETTINGS.friction_spread),
                (SETTINGS.guessed, SETTINGS.guess_spread),
            )
        )
        return np.logaddexp(measured, guess)

    return _likeliest(friction, std, stated, log_prior)


def _likeliest(
    value: float, std: float, usual: float, log_prior: Callable[[Floats], Floats]
) -> float:
    """Largest log likelihood, over positive true values, of an estimate and of the prior.

    The prior's `usual` value is tried, too, so that an uncertain estimate costs nothing.
    """
    quantity = np.append(value + std * _DEVIATIONS, usual)
    quantity = quantity[quantity > 0]
    return float((-(((quantity - value) / std) ** 2) / 2 + log_prior(quantity)).max())


# Standard deviations beside an estimate at which a quantity is tried: their step changes a log
# likelihood by less than a tenth.
_DEVIATIONS = np.linspace(-6, 6, 49)


def _coupling_prior(motions: Sequence[Motion]) -> Floats:
    """Log likelihood (n,) of the couplings: an inertia matrix has no negative eigenvalue."""
    n = len(motions)
    away = ~np.eye(n, dtype=bool)
    coupling, std = np.zeros((2, n, n))
    coupling[away] = np.concatenate([motion.coupling for motion in motions])
    std[away] = np.concatenate([motion.coupling_std for motion in motions])
    # |M_ij| <= sqrt(M_ii M_jj), by inertias as large as they may be.
    largest = np.sqrt([motion.inertia + motion.inertia_std for motion in motions])
    bound = np.outer(largest, largest)
    known = away & np.isfinite(bound) & np.isfinite(std + std.T)
    symmetric = np.where(known, coupling + coupling.T, 0.0)[known] / 2
    # The true matrix is symmetric: half of the difference of two entries is an error, too.
    spread = np.sqrt(
        (std**2 + std.T**2)[known]
        + (coupling[known] - symmetric) ** 2
        + (SETTINGS.coupling_spread * bound[known]) ** 2
    )
    beyond = np.maximum((np.abs(symmetric) - bound[known]) / spread, 0.0)
    prior = np.zeros((n, n))
    prior[known] = -np.minimum(beyond**2, SETTINGS.surest) / 2
    return prior.sum(axis=1)
