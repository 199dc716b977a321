"""The result of an identification: arm, rig and law with what was found, and how well it is
known.
"""

import dataclasses
import warnings
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.naming import short_names
from identification.planning.budget import pulse_budget
from identification.results.assumed import Assumed, moved_by_lengths
from identification.results.diagnostics import Diagnostics
from identification.results.plots import plot_identification
from identification.results.summary import doubts, said_of
from identification.results.trust import warnings_of
from identification.search.outcome import Fit, Search
from plant import Arm, Law, Record, Rig
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.saved import Saved, fingerprint
from plant.parts.shown import Piece, Shown, as_text


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Identification(Shown, Saved, Frozen):
    """What was found, and how.

    Attributes
    ----------
    arm : Arm
        The arm with the best f; D-hat and h-hat of a computed-torque controller.
    rig, law : Rig, Law
        Those of the (first) record, with whatever else was unknown filled in.
    records, held_out : tuple of Record
        Those that were searched, and those that were held out.
    versions : dict
        Of the library, numpy, casadi and Python that found it.
    fit : Fit
        The values of the unknowns, and how well they are known.
    search : Search
        How they were searched.
    diagnostics : Diagnostics
        How well they repeat the records.

    See Also
    --------
    identification.identify, ctc.write_report

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import Identification, identify
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference())
    >>> found = identify(puma560.dynamics(), record, progress=False)
    >>> found.arm.f.shape, found.warnings
    ((9,), [])
    >>> found.save("found.json")
    >>> Identification.load("found.json") == found
    True
    """

    arm: Arm
    rig: Rig
    law: Law
    records: tuple[Record, ...]
    held_out: tuple[Record, ...]
    versions: Mapping[str, str] = dataclasses.field(compare=False)
    fit: Fit
    search: Search
    diagnostics: Diagnostics

    def provenance(self) -> dict[str, Any]:
        """Logs by their fingerprints, method, seed and warnings, and the versions that found it."""
        logs = {
            name: [fingerprint(log) for log in getattr(self, name)]
            for name in ("records", "held_out")
        }
        search = {"method": self.search.method, "seed": self.search.seed, "warnings": self.warnings}
        return {"versions": dict(self.versions)} | logs | search

    # -- the everyday attributes of the groups ----------------------------------------------------
    @property
    def f(self) -> Floats:
        """Parameters (p,) of the arm."""
        return self.arm.f

    @property
    def candidates(self) -> Floats:
        """Vectors (C, k) that repeat the records as well; see `Fit`."""
        return self.fit.candidates

    @property
    def covariance(self) -> Floats | None:
        """Covariance (k, k) of the values; None where the method provides none."""
        return self.fit.covariance

    @property
    def objective(self) -> float:
        """Objective (4) of the result [pulses^2]."""
        return self.diagnostics.objective

    @property
    def initial_objective(self) -> float:
        """Objective (4) of the best candidate of the first generation [pulses^2]."""
        return self.search.initial_objective

    @property
    def initial_population(self) -> Floats:
        """The first generation (P, k)."""
        return self.search.initial_population

    @property
    def history(self) -> Floats:
        """Best, mean and worst finite objective of each generation (generations + 1, 3)."""
        return self.search.history

    @property
    def evaluations(self) -> int:
        """Simulated experiments."""
        return self.search.evaluations

    @property
    def seconds(self) -> float:
        """Of the whole identification."""
        return self.search.seconds

    @property
    def message(self) -> str:
        """Why the search ended."""
        return self.search.message

    # -- what can be made of it -------------------------------------------------------------------
    @property
    def short_names(self) -> tuple[str, ...]:
        """Names (k) of the unknowns for tables and figures; ``arm.dynamics.legend`` says what
        they mean.
        """
        return short_names(self.arm.dynamics, self.fit.unknown)

    def bound(self) -> Floats:
        """Cramer-Rao bound (k,): the least standard deviation of any method on the first record,
        from rounding alone.

        From simulated sensitivities (`pulse_budget`); of what was kept fixed, zero.

        Raises
        ------
        ValueError
            A record without reference.
        """
        record = self.records[0]
        if record.reference is None:
            raise ValueError(
                "the record must have a reference for a bound; it has none. Pass reference= with"
                " the log."
            )
        seconds = len(record) * record.rig.period
        with warnings.catch_warnings():
            # gears that are stiffer than sub-steps follow are found as good as rigid
            warnings.simplefilter("ignore")
            budget = pulse_budget(
                self.arm,
                self.rig,
                self.law,
                record.reference,
                unknown=self.fit.unknown,
                duration=seconds,
            )
        return np.where(self.fit.std > 0, budget.bound, 0.0)

    def assumed(self) -> Assumed:
        """What one log cannot reveal: by how much 1 % of each assumed number moves each value.

        Gears, motor gains and gains of the law by the innovations; lengths of the links by the
        torque along the motion.

        Raises
        ------
        ValueError
            Nothing is known of it, with the reason.
        """
        moves = dict(self.diagnostics.detection.assumed)
        if not moves or self.covariance is None:
            reason = (
                self.fit.fallback_reason
                or self.diagnostics.detection.reason
                or "the fit did not follow the log"
            )
            raise ValueError(
                f"found must have a covariance; it has none: {reason}. State one, or log another"
                " motion."
            )
        moves |= moved_by_lengths(self.arm, self.records[0], self.fit.unknown)
        return Assumed(
            names=tuple(moves),
            unknown=self.short_names,
            moves=np.array(list(moves.values())),
            std=self.fit.std,
        )

    @property
    def warnings(self) -> list[str]:
        """What a user should know before trusting the values, one line each."""
        return warnings_of(self)

    def summary(self, *, full: bool = False) -> str:
        """What `print` shows: of many unknowns one screen.

        Full: each value with its standard deviation, the bound, its 95 % interval and its largest
        correlation; by how much each assumed number moves it; what the names of parameters mean.
        """
        return as_text(said_of(self, full))

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Draw errors, innovations, spectrum and intervals; as `ctc.plot_record`."""
        return plot_identification(self, ax)

    def _shown(self) -> Iterable[Piece]:
        return said_of(self, False)

    def _short(self) -> str:
        count = len(doubts(self))
        fallback = self.fit.fallback_reason
        doubtful = f", {count} warning{'s' * (count > 1)}" if count else ""
        went = (
            f"{self.search.method}, {self.objective:.0f} pulses^2, {self.evaluations} evaluations"
        )
        return f"{len(self.fit.values)} values, {went}{', a fallback' * bool(fallback)}{doubtful}"


def covariance_of_f(found: Identification | None, arm: Arm) -> Floats:
    """Of f, in the order of the arm's; zero of an exact arm, which is not found."""
    if found is None:
        return np.zeros((len(arm.f),) * 2)
    if found.covariance is None:
        raise ValueError(
            "an identification needs a covariance here; this has none:"
            f" {found.fit.fallback_reason}. Pass found.arm to take the arm as exact."
        )
    return found.fit.covariance_of(arm.dynamics.names)
