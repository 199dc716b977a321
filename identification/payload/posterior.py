"""Prior of a load, masses and centres, and its posterior distribution given a window.

Read `LoadShape` (the prior), `information` (least squares of a window), `posterior`.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error import NORMAL
from plant import Arm, Body
from plant.mechanics import STANDARD
from plant.parts import (
    Floats,
    Frozen,
    Piece,
    Shown,
    Table,
    Verdict,
    array,
    frozen,
    frozen_settings,
    least,
    real,
)


@frozen_settings
class PosteriorSettings:
    """Grids of the posterior distribution of a load, and the limits of its use.

    Chosen by hand; ``tests/benchmarks/payload.py`` measures errors and intervals of the mass.

    Parameters
    ----------
    centres : int
        Number of centres of mass along a line.
    resolved : float
        Standard deviation of the centre, in distances between neighbouring centres, below which
        closer ones are taken: their sums no longer stand for integrals.
    masses : int
        Number of masses at which the interval is computed.
    tails : float
        Standard deviations from the mean beyond which the distribution is negligible.
    too_little : float
        Ratio of the standard deviation of the mass to the width of its range, above which a window
        is not used. Without any information this ratio is 0.29.
    outside : float
        Distance of a mass from the range, in standard deviations, above which the mass counts as
        outside the range.
    """

    # Grids.
    centres: int = 61
    resolved: float = 0.6
    masses: int = 401
    tails: float = 6.0
    # Limits of use.
    too_little: float = 0.15
    outside: float = 3.0


POSTERIOR = PosteriorSettings()


@dataclass(frozen=True)
class LoadShape:
    """Prior of a load: a range of masses, and a centre that is known or lies on a line.

    `mass` (2,): lowest and highest [kg]. `places` (K, 3): possible centres of mass in the frame of
    the last link's body [m], equally likely; one if known. `inertia` (6,): about the centre, per kg
    [m^2]; zero for a point mass. `spanned`: the `basis`, where it is that of a longer line.
    """

    mass: Floats
    places: Floats
    inertia: Floats
    spanned: Floats | None = None

    @classmethod
    def of(
        cls,
        arm: Arm,
        mass: ArrayLike,
        position: ArrayLike | None,
        along: ArrayLike | None,
        reach: ArrayLike,
        inertia: ArrayLike,
    ) -> Self:
        """`LoadShape` from a user's range of mass, and either a position or a line.

        Raises
        ------
        ValueError
            An argument out of range, or a position and a line.
        """
        # 1. Mass and inertia.
        limits = array(
            "mass",
            mass,
            (2,),
            advice="Give the lightest and the heaviest load, such as (0, 5) [kg].",
        )
        # A negative mass is no load.
        if not 0 <= limits[0] < limits[1]:
            raise ValueError(
                f"mass must be a range from 0 or more upwards; got {mass!r}. Give kg, such as"
                " (0, 5)."
            )
        moments = array(
            "inertia",
            inertia,
            (6,),
            advice="Give Ixx, Ixy, Ixz, Iyy, Iyz, Izz about the centre, per kg.",
        )
        # A point mass needs no check; an inertia must be one that a body of 1 kg can have.
        if moments.any():
            Body(mass=1.0, com=np.zeros(3), inertia=moments).require_physical("of the load")

        # 2. A known centre.
        if position is not None:
            if along is not None:
                raise ValueError(
                    "a load has a known position, or one along a line; got both. Leave one out."
                )
            centre = array(
                "position",
                position,
                (3,),
                advice="Give x, y, z in the frame of the last link's body [m].",
            )
            return cls(limits, centre[None], moments)

        # 3. A line from the origin of the frame: distances times a unit vector.
        ends = array(
            "reach",
            reach,
            (2,),
            advice="Give the shortest and the longest distance, such as (0.2, 0.5) [m].",
        )
        # Equal ends are a known position, with arguments of its own.
        if not 0 <= ends[0] < ends[1]:
            raise ValueError(
                f"reach must be a shorter and a longer distance, 0 or more; got {reach!r}. Give"
                " metres, and the direction as along."
            )
        direction = (
            _outwards(arm)
            if along is None
            else array("along", along, (3,), advice="Give a direction.")
        )
        length = real(
            "length of along",
            np.linalg.norm(direction),
            "Give a direction that is not zero.",
            positive=True,
        )
        distances = np.linspace(ends[0], ends[1], POSTERIOR.centres)[:, None]
        return cls(limits, distances * direction / length, moments)

    @functools.cached_property
    def per_kg(self) -> Floats:
        """Standard parameters (K, 10) of 1 kg at each centre."""
        bodies = (Body(mass=1.0, com=centre, inertia=self.inertia) for centre in self.places)
        return np.array([body.standard_parameters for body in bodies])

    @functools.cached_property
    def basis(self) -> Floats:
        """Standard parameters (b, 10) that span those of all centres: of one, or of three.

        Along a line they are quadratic in the distance, so three points determine all.
        """
        if self.spanned is not None:
            return self.spanned
        # The two ends and the middle of the line.
        chosen = [0] if len(self.places) == 1 else [0, len(self.places) // 2, len(self.places) - 1]
        return self.per_kg[chosen]

    @functools.cached_property
    def shares(self) -> Floats:
        """Coefficients (K, b) of the basis for each centre."""
        return least(self.basis.T, self.per_kg.T).T

    def resolving(self, odds: Floats) -> Self:
        """The same with closer centres, if these (K,) are too far apart for their odds."""
        number = np.arange(len(odds))
        middle = odds @ number
        std = np.sqrt(odds @ (number - middle) ** 2)
        if len(odds) == 1 or std >= POSTERIOR.resolved:
            return self
        # One more at each end: the likeliest centre may lie between two of these.
        reach = POSTERIOR.tails * std + 1
        first, last = np.clip([middle - reach, middle + reach], 0, len(odds) - 1)
        steps = np.linspace(first, last, POSTERIOR.centres)[:, None]
        places = self.places[0] + steps * (self.places[1] - self.places[0])
        return replace(self, places=places, spanned=self.basis)

    @property
    def prior(self) -> Floats:
        """Standard parameters (10,) of the mean mass, at the middle centre."""
        return self.mass.mean() * self.per_kg[len(self.places) // 2]


def _outwards(arm: Arm) -> Floats:
    """Signed axis (3,) of the last link's frame along which the link's first moment is largest.

    The arm's parameters f give the first moment.

    Raises
    ------
    ValueError
        The parameters f that belong to the last link alone give no first moment, or a negligible
        one.
    """
    matrix = np.array(arm.dynamics.lumping.matrix)
    # Rows of f to which no other link contributes.
    alone = ~matrix[:, : -len(STANDARD)].any(axis=1)
    increments = arm.dynamics.load_matrix()[alone]
    # Least squares of the link's own parameters; f of planar arms omits some.
    phi = least(increments, arm.f[alone])
    # First moments m x, m y, m z follow the mass; one that f does not contain counts as zero.
    moments = np.where(np.abs(increments).sum(axis=0) > 0, phi, 0.0)[1:4]
    if not np.linalg.norm(moments) > 1e-3 * np.abs(arm.f).max():
        raise ValueError(
            "along must be given for this arm: its f does not say by itself where the last link"
            " points. Give the direction in which the load's centre lies, in the frame of the last"
            " link's body, such as (0, 0, 1)."
        )
    # A whole axis: f determines the direction of the moment only roughly.
    longest = int(np.argmax(np.abs(moments)))
    return np.sign(moments[longest]) * np.eye(3)[longest]


@frozen
class PayloadEstimate(Shown, Frozen):
    """Estimate of a load from a window of counts and torques.

    Attributes
    ----------
    mass, std : float
        Mean and standard deviation [kg] within the stated range. If the load lies more than
        `POSTERIOR.outside` standard deviations outside the range, `std` also includes the distance
        of the load from `mass`.
    interval : (2,) numpy.ndarray
        95 % interval of the mass [kg]. If the load lies that far outside the range, the interval
        extends from the range to the load.
    parameters : (10,) numpy.ndarray
        Mean of the standard parameters of the load (`Body.standard_parameters`).
    position : (3,) numpy.ndarray
        Mean of the centre of mass [m], in the frame of the last link's body.
    sufficient : bool
        Whether the estimate may be used; if not, `message` gives the reason, and `mass` is
        unreliable.
    explained : bool
        Whether one constant load explains the window.
    misfit : float
        RMS residual of the torque equation, in standard deviations that rounding causes.
    message : str
    """

    # The estimate.
    mass: float
    std: float
    interval: Floats
    parameters: Floats
    position: Floats
    # Its use, and the reason.
    sufficient: bool
    explained: bool
    misfit: float
    message: str

    def _short(self) -> str:
        reservation = "" if self.sufficient else ", not to be used"
        return f"{self.mass:.3g} +- {self.std:.2g} kg{reservation}"

    def _shown(self) -> Iterator[Piece]:
        low, high = self.interval
        verdict = f"mass {self.mass:.3g} +- {self.std:.2g} kg, 95 % from {low:.3g} to {high:.3g}"
        rows = []
        if not self.sufficient:
            verdict = f"not to be used: {self.message}"
            rows.append(("mass [kg]", f"{self.mass:.3g}"))
        yield Verdict(verdict, self.sufficient)
        rows.append(("centre of mass [m]", ", ".join(f"{x:.3g}" for x in self.position)))
        rows.append(("misfit [standard deviations of the counts]", f"{self.misfit:.2g}"))
        yield Table((), rows)


def information(load: Floats, uncertain: Floats, torque: Floats) -> tuple[Floats, Floats, float]:
    """Information matrix (b, b) and vector (b,) of a load, and the sum of squares without a load.

    `load` (R, b), `uncertain` (R, u), `torque` (R,): weighted columns of the torque equation. Each
    uncertain column is scaled such that its number has a prior standard deviation of 1. These
    numbers are estimated as well: the part of the torque that they can explain is no information
    about the load.
    """
    # The torque as the last column: one product gives matrix, vector and sum of squares.
    columns = np.column_stack([load, torque])
    normal = columns.T @ columns
    cross = uncertain.T @ columns
    if len(cross):
        # Schur complement of the uncertain numbers; the unit matrix is their prior.
        normal -= cross.T @ np.linalg.solve(np.eye(len(cross)) + uncertain.T @ uncertain, cross)
    return normal[:-1, :-1], normal[:-1, -1], float(normal[-1, -1])


def posterior(
    shape: LoadShape,
    matrix: Floats,
    vector: Floats,
    square: float,
    rows: int,
    misfit_limit: float = 2.0,
) -> PayloadEstimate:
    """Posterior distribution of mass and centre; the prior is uniform in both.

    `matrix`, `vector`, `square`: from `information`. `rows`: number of rows of the window.
    `misfit_limit`: ratio of the RMS residual to that of rounding, above which no load explains a
    window. A ratio above 1 widens the distribution.
    """
    # 1. Each centre k has a quadratic log-likelihood of the mass m: m pull - m^2 weight / 2.
    low, high = shape.mass
    weight = np.einsum("kb,bc,kc->k", shape.shares, matrix, shape.shares)
    pull = shape.shares @ vector
    finite = np.isfinite(weight).all() and np.isfinite(pull).all() and np.isfinite(square)
    if not finite or not rows or not weight.max() > 0:
        return unheard(shape, finite=bool(finite))
    # A centre without an effect on the torques has no weight: avoid the division by zero.
    weight = np.maximum(weight, 1e-12 * weight.max())
    # The misfit is that of the best centre: a worse centre would count its own error as noise.
    misfit = float(np.sqrt(max(0.0, square - (pull**2 / weight).max()) / rows))
    # A residual above rounding shows further noise: less information for all centres.
    weight = weight / max(1.0, misfit) ** 2
    pull = pull / max(1.0, misfit) ** 2
    # A distribution a thousand times as wide as the range is flat within it, to a millionth; what
    # a wider one says of the range is lost by rounding.
    weight = np.maximum(weight, (1e-3 / (high - low)) ** 2)
    centre = pull / weight
    sigma = 1 / np.sqrt(weight)

    # 2. Mixture of the normal distributions of all centres, truncated to the range. exp(inside) is
    # the probability that the distribution of each centre gives to the range.
    mean, variance, inside = _truncated(centre, sigma, low, high)
    # The odds of a centre are proportional to its likelihood, integrated over the masses of the
    # range.
    log_odds = pull**2 / weight / 2 + np.log(sigma) + inside
    odds = np.exp(log_odds - log_odds.max())
    odds /= odds.sum()
    closer = shape.resolving(odds)
    if closer is not shape:
        return posterior(closer, matrix, vector, square, rows, misfit_limit)
    mass = float(odds @ mean)
    std = float(np.sqrt(odds @ (variance + (mean - mass) ** 2)))
    # If the mass is zero, the mean moments do not determine the centre: take the likeliest one.
    likely = int(np.argmax(log_odds))
    parameters = (odds * mean) @ shape.per_kg
    position = parameters[1:4] / mass if mass > 1e-6 else shape.places[likely]
    reach = POSTERIOR.tails * std
    ends = max(low, mass - reach), min(high, mass + reach)
    interval = _interval(odds, centre, sigma, inside, ends)

    # 3. Verdict. A load far outside the range shows that the range is wrong. The interval then
    # also contains the interval of the likeliest centre without the range.
    message, sufficient = judged(shape, misfit <= misfit_limit, misfit, std)
    outside = max((centre[likely] - high) / sigma[likely], (low - centre[likely]) / sigma[likely])
    if sufficient and outside > POSTERIOR.outside:
        message = (
            f"the load is outside its range: {centre[likely]:#.3g} kg of {low:g} to {high:g}; the"
            " nearest is taken"
        )
    if outside > POSTERIOR.outside:
        std = float(np.hypot(sigma[likely], centre[likely] - mass))
        limits = np.append(interval, centre[likely] + NORMAL * sigma[likely] * np.array([-1, 1]))
        interval = np.array([limits.min(), limits.max()])
    return PayloadEstimate(
        mass=mass,
        std=std,
        interval=interval,
        parameters=parameters,
        position=position,
        sufficient=sufficient,
        explained=misfit <= misfit_limit,
        misfit=misfit,
        message=message,
    )


def judged(shape: LoadShape, explained: bool, misfit: float, std: float) -> tuple[str, bool]:
    """Message about an estimate of the mass, and whether it may be used."""
    # A misfit comes first: with it the standard deviation means nothing. NaN is never sufficient.
    if not explained:
        return f"no load explains this window (misfit {misfit:.1f}); the prior stays", False
    if not std <= POSTERIOR.too_little * (shape.mass[1] - shape.mass[0]):
        return f"the window says too little (std {std:.2g} kg); the prior stays", False
    return "sufficient", True


def unheard(shape: LoadShape, finite: bool) -> PayloadEstimate:
    """Estimate of a window that holds NaN, or (`finite`) none in which a load is felt."""
    low, high = shape.mass
    interval = np.array([low + 0.025 * (high - low), high - 0.025 * (high - low)])
    message = "the arm rests, or no joint moves that feels a load; the prior stays"
    if not finite:
        message = "the window holds NaN or infinite numbers; the prior stays"
    return uninformed(shape, shape.prior, interval, message)


def uninformed(
    shape: LoadShape, parameters: Floats, interval: Floats, message: str
) -> PayloadEstimate:
    """Estimate of a window without information: a load of these ten standard parameters."""
    return PayloadEstimate(
        mass=float(parameters[0]),
        # A uniform distribution over the range.
        std=float(np.ptp(shape.mass) / np.sqrt(12)),
        parameters=parameters,
        misfit=float("nan"),
        interval=interval,
        sufficient=False,
        explained=True,
        position=shape.places[len(shape.places) // 2],
        message=message,
    )


def _truncated(
    centre: Floats, sigma: Floats, low: float, high: float
) -> tuple[Floats, Floats, Floats]:
    """Mean, variance and log probability (K,) of normal distributions truncated to a range."""
    a = (low - centre) / sigma
    b = (high - centre) / sigma
    inside = _log_between(a, b)
    with np.errstate(over="ignore", under="ignore"):
        peak_a = np.exp(-(a**2) / 2 - inside) / np.sqrt(2 * np.pi)
        peak_b = np.exp(-(b**2) / 2 - inside) / np.sqrt(2 * np.pi)
    # Rounding must not put the mean outside.
    mean = np.clip(centre + sigma * (peak_a - peak_b), low, high)
    # Far in a tail the formula is inf minus inf: no variance is left there.
    spread = 1 + a * peak_a - b * peak_b - (peak_a - peak_b) ** 2
    variance = sigma**2 * np.clip(np.where(np.isfinite(spread), spread, 0.0), 0.0, 1.0)
    return mean, variance, inside


def _log_between(a: Floats, b: Floats) -> Floats:
    """Logarithm of the normal probability between a and b, accurate in both tails."""
    from scipy.special import log_ndtr

    # Above the mean both probabilities are close to 1; mirrored, their difference is exact.
    flip = a > 0
    low = np.where(flip, -b, a)
    high = np.where(flip, -a, b)
    # log(P(high) - P(low)) without subtracting nearly equal numbers.
    top = log_ndtr(high)
    return np.asarray(top + np.log1p(-np.exp(log_ndtr(low) - top)))


def _interval(
    odds: Floats, centre: Floats, sigma: Floats, inside: Floats, ends: tuple[float, float]
) -> Floats:
    """Least interval that contains the likeliest masses, which hold 95 % of the mixture.

    The mixture is negligible outside `ends`. The interval may end at a bound of the range.
    """
    grid = np.linspace(*ends, POSTERIOR.masses)[:, None]
    # The grid would miss a distribution that is narrower than its steps.
    sigma = np.maximum(sigma, grid[1] - grid[0])
    log_density = -(((grid - centre) / sigma) ** 2) / 2 - np.log(sigma) - inside
    # Logarithms first: narrow distributions would overflow as densities.
    density = np.exp(log_density - log_density.max()) @ odds
    likeliest = np.argsort(-density)
    # Take grid points by falling density until they hold 95 %.
    needed = np.searchsorted(np.cumsum(density[likeliest]), 0.95 * density.sum()) + 1
    masses = grid[likeliest[:needed], 0]
    return np.array([masses.min(), masses.max()])
