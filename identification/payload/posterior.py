"""What is possible of a load, a range of masses on a line of places; and its distribution given
a window.
"""

import dataclasses
import functools
from collections.abc import Iterator
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error.least_squares import NORMAL
from plant import Arm, Body
from plant.mechanics.lumping import LOAD, STANDARD
from plant.parts.arguments import array, real
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table

_PLACES = 61  # along the line where the centre may be


@dataclasses.dataclass(frozen=True)
class LoadShape:
    """Loads of any mass in a range whose centre is at a known place, or along a line.

    `mass` (2,): lowest and highest [kg]. `places` (K, 3): where the centre may be, in the frame of
    the last link's body [m]; one where it is known. `inertia` (6,): own inertia about the centre,
    per kg [m^2]; zero for a point mass.
    """

    mass: Floats
    places: Floats
    inertia: Floats

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
        """From what a user states."""
        limits = array(
            "mass",
            mass,
            (2,),
            advice="Give the lightest and the heaviest load, such as (0, 5) [kg].",
        )
        if not 0 <= limits[0] < limits[1]:
            raise ValueError(
                f"mass must be a range from 0 or more upwards; got {mass!r}. Give kg, such as"
                " (0, 5)."
            )
        own = array(
            "inertia",
            inertia,
            (6,),
            advice="Give Ixx, Ixy, Ixz, Iyy, Iyz, Izz about the centre, per kg.",
        )
        if own.any():
            Body(mass=1.0, com=np.zeros(3), inertia=own).require_physical("of the load")
        if position is not None:
            if along is not None:
                raise ValueError(
                    "a load has a known position, or one along a line; got both. Leave one out."
                )
            place = array(
                "position",
                position,
                (3,),
                advice="Give x, y, z in the frame of the last link's body [m].",
            )
            return cls(limits, place[None], own)
        ends = array(
            "reach",
            reach,
            (2,),
            advice="Give the shortest and the longest distance, such as (0.2, 0.5) [m].",
        )
        if not ends[0] < ends[1]:
            raise ValueError(
                f"reach must be a shorter and a longer distance; got {reach!r}. Give metres."
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
        return cls(
            limits, np.linspace(ends[0], ends[1], _PLACES)[:, None] * direction / length, own
        )

    @functools.cached_property
    def per_kg(self) -> Floats:
        """Standard parameters (K, 10) of 1 kg at each place."""
        bodies = (Body(mass=1.0, com=place, inertia=self.inertia) for place in self.places)
        return np.array([body.standard_parameters for body in bodies])

    @functools.cached_property
    def basis(self) -> Floats:
        """Standard parameters (b, 10) of which those of all places are combinations: one, or of
        a parabola three.
        """
        chosen = [0] if len(self.places) == 1 else [0, len(self.places) // 2, len(self.places) - 1]
        return self.per_kg[chosen]

    @functools.cached_property
    def shares(self) -> Floats:
        """Shares (K, b) of the basis at each place."""
        return np.asarray(np.linalg.lstsq(self.basis.T, self.per_kg.T, rcond=None)[0].T)

    @property
    def prior(self) -> Floats:
        """Standard parameters (10,) of half the heaviest load, in the middle of the places."""
        return self.mass[1] / 2 * self.per_kg[len(self.places) // 2]


def _outwards(arm: Arm) -> Floats:
    """Axis of the last link's frame along which its own centre of mass lies, as far as f says it
    by itself.
    """
    matrix = np.array(arm.dynamics.lumping.matrix)
    alone = ~matrix[:, : -len(STANDARD)].any(axis=1)
    increments = arm.dynamics.load_matrix()[alone]
    phi = (
        np.linalg.lstsq(increments, np.array(arm.f)[alone], rcond=None)[0]
        if alone.any()
        else np.zeros(len(LOAD))
    )
    moments = np.where(np.abs(increments).sum(axis=0) > 0, phi, 0.0)[1:4]
    if not np.linalg.norm(moments) > 1e-3 * np.abs(arm.f).max():
        raise ValueError(
            "along must be given for this arm: its f does not say by itself where the last link"
            " points. Give the direction in which the load's centre lies, in the frame of the last"
            " link's body, such as (0, 0, 1)."
        )
    longest = int(np.argmax(np.abs(moments)))
    return np.asarray(np.sign(moments[longest]) * np.eye(3)[longest])


# standard deviation of the mass, in its range, above which a window says too little (evenly: 0.29)
_TOO_LITTLE = 0.15

_OUTSIDE = 3.0  # standard deviations by which a mass is outside its range

# standard deviations to which a distribution is looked at, and at how many masses
_FAR = 6.0
_GRID = 401


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PayloadEstimate(Shown, Frozen):
    """What a window says of a load.

    Attributes
    ----------
    mass, std : float
        Mean and standard deviation [kg] within the stated range; of a load that is outside, the
        nearest mass, and how far it is away.
    interval : (2,) numpy.ndarray
        That holds the mass with 95 % [kg]; of a load outside the range, it goes there.
    parameters : (10,) numpy.ndarray
        Standard parameters of the load (`Body.standard_parameters`), the mean.
    position : (3,) numpy.ndarray
        Centre of mass [m], in the frame of the last link's body; the mean.
    sufficient : bool
        Whether it may be used; otherwise `message` says why not, and `mass` is not to be believed.
    explained : bool
        Whether one load, constant over the window, can be what was seen.
    misfit : float
        Root mean square of what remains of the torque equation, in standard deviations of the
        rounded counts.
    message : str
    """

    mass: float
    std: float
    interval: Floats
    parameters: Floats
    position: Floats
    sufficient: bool
    explained: bool
    misfit: float
    message: str

    def _short(self) -> str:
        return (
            f"{self.mass:.3g} +- {self.std:.2g} kg{'' if self.sufficient else ', not to be used'}"
        )

    def _shown(self) -> Iterator[Piece]:
        low, high = self.interval
        said = f"mass {self.mass:.3g} +- {self.std:.2g} kg, 95 % from {low:.3g} to {high:.3g}"
        yield Verdict(
            said if self.sufficient else f"not to be used: {self.message}", self.sufficient
        )
        place = ", ".join(f"{x:.3g}" for x in self.position)
        rows = [
            ("centre of mass [m]", place),
            ("misfit [standard deviations of the counts]", f"{self.misfit:.2g}"),
        ]
        yield Table((), [*([] if self.sufficient else [("mass [kg]", f"{self.mass:.3g}")]), *rows])


def information(load: Floats, uncertain: Floats, torque: Floats) -> tuple[Floats, Floats, float]:
    """Information matrix (b, b) and vector (b,) of the load's columns, and the sum of squares
    without a load.

    Each uncertain column is scaled such that its number has a standard deviation of 1; their
    numbers are estimated along, and what they could explain is not counted for the load.
    """
    columns = np.column_stack([load, torque])
    normal = columns.T @ columns
    told = uncertain.T @ columns
    if len(told):
        normal -= told.T @ np.linalg.solve(np.eye(len(told)) + uncertain.T @ uncertain, told)
    return normal[:-1, :-1], normal[:-1, -1], float(normal[-1, -1])


def posterior(
    shape: LoadShape,
    matrix: Floats,
    vector: Floats,
    square: float,
    rows: int,
    misfit_limit: float = 2.0,
) -> PayloadEstimate:
    """Estimate from `information`; mass and place are evenly likely beforehand.

    `matrix`, `vector`, `square`: from `information`. `rows`: of the window. `misfit_limit`: root
    mean square of what remains, in that of rounding, from which on no load explains a window; from
    1 on it widens the distribution.
    """
    low, high = shape.mass
    weight = np.einsum("kb,bc,kc->k", shape.shares, matrix, shape.shares)
    pull = shape.shares @ vector
    if not rows or not weight.max() > 0:
        interval = np.array([low + 0.025 * (high - low), high - 0.025 * (high - low)])
        message = "the arm rests, or no joint moves that feels a load; the prior stays"
        return nothing(shape, shape.prior, interval, message)
    weight = np.maximum(weight, 1e-12 * weight.max())
    misfit = float(np.sqrt(max(0.0, square - (pull**2 / weight).max()) / rows))
    weight = weight / max(1.0, misfit) ** 2
    pull = pull / max(1.0, misfit) ** 2
    centre = pull / weight
    sigma = 1 / np.sqrt(weight)
    a = (low - centre) / sigma
    b = (high - centre) / sigma
    inside = _log_between(a, b)
    log_odds = pull**2 / weight / 2 + np.log(sigma) + inside
    odds = np.exp(log_odds - log_odds.max())
    odds /= odds.sum()
    with np.errstate(over="ignore", under="ignore"):
        peak_a, peak_b = (np.exp(-(x**2) / 2 - inside) / np.sqrt(2 * np.pi) for x in (a, b))
    mean = np.clip(centre + sigma * (peak_a - peak_b), low, high)
    spread = 1 + a * peak_a - b * peak_b - (peak_a - peak_b) ** 2
    variance = sigma**2 * np.clip(np.where(np.isfinite(spread), spread, 0.0), 0.0, 1.0)
    mass = float(odds @ mean)
    std = float(np.sqrt(odds @ (variance + (mean - mass) ** 2)))
    likely = int(np.argmax(log_odds))
    parameters = (odds * mean) @ shape.per_kg
    position = parameters[1:4] / mass if mass > 1e-6 else shape.places[likely]
    ends = max(low, mass - _FAR * std), min(high, mass + _FAR * std)
    message, sufficient = judged(shape, misfit <= misfit_limit, misfit, std)
    over = (centre[likely] - high) / sigma[likely], (low - centre[likely]) / sigma[likely]
    if sufficient and max(over) > _OUTSIDE:
        message = (
            f"the load is outside its range: {centre[likely]:.2f} kg of {low:g} to {high:g}; the"
            " nearest is taken"
        )
    interval = _interval(odds, centre, sigma, inside, ends)
    if max(over) > _OUTSIDE:  # the range is not believed any more
        std = float(np.hypot(sigma[likely], centre[likely] - mass))
        sides = np.append(interval, centre[likely] + NORMAL * sigma[likely] * np.array([-1, 1]))
        interval = np.array([sides.min(), sides.max()])
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
    """What an estimate of the mass is worth, and whether it is to be used."""
    if not explained:
        return f"no load explains this window (misfit {misfit:.1f}); the prior stays", False
    if std > _TOO_LITTLE * (shape.mass[1] - shape.mass[0]):
        return f"the window says too little (std {std:.2g} kg); the prior stays", False
    return "sufficient", True


def nothing(
    shape: LoadShape, parameters: Floats, interval: Floats, message: str
) -> PayloadEstimate:
    """Where nothing was found: the load that is taken, by its ten parameters."""
    return PayloadEstimate(
        mass=float(parameters[0]),
        std=float(np.ptp(shape.mass) / np.sqrt(12)),
        parameters=parameters,
        misfit=float("nan"),
        interval=interval,
        sufficient=False,
        explained=True,
        position=shape.places[len(shape.places) // 2],
        message=message,
    )


def _log_between(a: Floats, b: Floats) -> Floats:
    """Logarithm of the normal probability between a and b, also far out."""
    from scipy.special import log_ndtr

    flip = a > 0
    low = np.where(flip, -b, a)
    high = np.where(flip, -a, b)
    top = log_ndtr(high)
    return np.asarray(top + np.log1p(-np.exp(np.minimum(log_ndtr(low) - top, -1e-300))))


def _interval(
    odds: Floats, centre: Floats, sigma: Floats, inside: Floats, ends: tuple[float, float]
) -> Floats:
    """The likeliest 95 % of the mixture, which is negligible outside these ends; a bound of the
    range can be in it.
    """
    grid = np.linspace(*ends, _GRID)[:, None]
    log_density = -(((grid - centre) / sigma) ** 2) / 2 - np.log(sigma) - inside
    density = np.exp(log_density - log_density.max()) @ odds
    likeliest = np.argsort(-density)
    needed = np.searchsorted(np.cumsum(density[likeliest]), 0.95 * density.sum()) + 1
    kept = grid[likeliest[:needed], 0]
    return np.array([kept.min(), kept.max()])
