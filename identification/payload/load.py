"""What `find_load` found."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from plant import Arm, Rig
from plant.parts.frozen import Frozen
from plant.parts.shown import Piece, Shown, Verdict, Warned
from plant.parts.tables import Table

_QUANTILE = 1.96
"""Of the normal distribution, for 95 %."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Load(Shown, Frozen):
    """A load on the last link, or another one. Print it.

    Attributes
    ----------
    mass, std : float
        [kg]
    arm : Arm
        The known arm with this load.
    rms_innovation : float
        Root mean square of the innovations [pulses]; rounding alone gives 0.289.
    com, com_std : (3,) numpy.ndarray
        Centre of mass in the frame of the link's body [m]; NaN along an axis that does not show in the torques. Of a
        given position it is that, with a deviation of 0.
    names : tuple of str
        Of all that was unknown: ``mass``, ``com[i]``, numbers of friction.
    values : (k,) numpy.ndarray
    covariance : (k, k) numpy.ndarray
    rig : Rig
        Of the first record, with the friction that was found.
    runs : tuple of (float, float)
        Mass and standard deviation of each record alone [kg]; empty of a single one.
    chi_square, freedom : float, int
        By how much an arm with any f follows the logs better, and its degrees of freedom: about as many, by chance. NaN
        and 0 where the logs do not tell all of f, so that nothing was tested.
    warnings : tuple of str
        What should be known before the mass is trusted, one line each.
    """

    mass: float
    std: float
    arm: Arm
    rms_innovation: float
    com: NDArray[np.float64]
    com_std: NDArray[np.float64]
    names: tuple[str, ...]
    values: NDArray[np.float64]
    covariance: NDArray[np.float64]
    rig: Rig
    runs: tuple[tuple[float, float], ...] = ()
    chi_square: float = np.nan
    freedom: int = 0
    warnings: tuple[str, ...] = ()

    @property
    def interval(self) -> NDArray[np.float64]:
        """That holds the mass with 95 % (2,) [kg]."""
        return self.mass + _QUANTILE * self.std * np.array([-1.0, 1.0])

    def _short(self) -> str:
        count = len(self.warnings)
        return f"{self.mass:.4g} +- {self.std:.2g} kg{f', {count} warning' * bool(count)}{'s' * (count > 1)}"

    def _shown(self) -> Iterator[Piece]:
        low, high = self.interval
        said = f"mass {self.mass:.4g} +- {self.std:.2g} kg, 95 % from {low:.4g} to {high:.4g}"
        yield Verdict(said, not self.warnings)
        where = [f"{axis} {at:.4g} +- {std:.2g}" if np.isfinite(at) else f"{axis} does not show"
                 for axis, at, std in zip("xyz", self.com, self.com_std, strict=True)]  # fmt: skip
        yield f"centre of mass [m]: {', '.join(where)}"
        std = np.sqrt(np.diag(self.covariance))
        yield Table((), [
            (name, f"{self.values[i]:.4g}", f"+- {std[i]:.2g}" if std[i] > 0 else "known")
            for i, name in enumerate(self.names) if name.startswith("drive.")
        ], words=(2,))  # fmt: skip
        yield from (f"record {k} alone: {mass:.4g} +- {own:.2g} kg" for k, (mass, own) in enumerate(self.runs))
        tested = f"chi-square {self.chi_square:.1f} of {self.freedom}" if self.freedom else "not tested"
        yield f"another arm, not a load: {tested}"
        yield f"RMS innovation {self.rms_innovation:.3f} pulses (rounding alone gives 0.289)"
        yield Warned(self.warnings)
