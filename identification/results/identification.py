"""Result of an identification: arm, rig and law with the identified values, and their accuracy."""

import dataclasses
import functools
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from identification.equation_error import (
    PredictsTorque,
    along_log,
    checkup_of,
    restated,
    short_names,
)
from identification.planning import pulse_budget
from identification.results.assumed import Assumed, moved_by_lengths
from identification.results.corrected import corrected
from identification.results.diagnostics import Diagnostics
from identification.results.plots import plot_identification
from identification.results.summary import doubts, summary_of
from identification.results.trust import late_by_law, warnings_of
from identification.search import Fit, Search, as_repeated
from plant import Arm, Law, Record, Reference, Resumed, Rig
from plant.checkup import Cause, hardly_moving
from plant.parts import Floats, Frozen, Piece, Saved, Shown, as_text, fingerprint, frozen, kept


@kept
@frozen
class Identification(PredictsTorque, Shown, Saved, Frozen):
    """Result of `identify`.

    Attributes
    ----------
    arm : Arm
        The arm with the best f; D-hat and h-hat of a computed-torque controller.
    rig, law : Rig, Law
        Those of the (first) record, with the values of their unknown numbers.
    records, held_out : tuple of Record
        Records that were searched, and records that were held out.
    versions : dict
        Of the library, numpy, casadi and Python.
    fit : Fit
        Values of the unknowns, and their accuracy.
    search : Search
        Method, settings and course of the search.
    diagnostics : Diagnostics
        How well the values repeat the records.
    own_causes : tuple of Cause
        Hypotheses of the user's that explain the first record better, the likeliest first.
    failed : tuple of str
        Hypotheses of the user's that could not be tried, with the reason, a line each.
    beside : tuple of Cause
        Causes that the first log shows once its mistakes are corrected, where they can be.
    left : tuple of str
        Doubts about this corrected log, a line each.

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
    # Two results are equal if their numbers are, whatever the software.
    versions: Mapping[str, str] = dataclasses.field(compare=False)
    fit: Fit
    search: Search
    diagnostics: Diagnostics
    own_causes: tuple[Cause, ...] = ()
    failed: tuple[str, ...] = ()
    beside: tuple[Cause, ...] = ()
    left: tuple[str, ...] = ()

    def provenance(self) -> dict[str, Any]:
        """Logs by their fingerprints, method, seed and warnings, and versions of the software."""
        # Fingerprints stand for the content of the logs, which may be large.
        logs = {
            name: [fingerprint(log) for log in getattr(self, name)]
            for name in ("records", "held_out")
        }
        search = {"method": self.search.method, "seed": self.search.seed}
        lines = {"warnings": self.warnings, "doubts": self.doubts}
        # The lines belong to these values: no other results may stand under them.
        digest = fingerprint([self.fit, self.diagnostics, lines])
        return {"versions": dict(self.versions)} | logs | search | lines | {"digest": digest}

    def _restored(self, provenance: dict[str, Any]) -> None:
        # A file of an earlier version has no digest: its warnings are computed again.
        if "digest" not in provenance:
            computed = self.provenance()
            provenance |= {name: computed[name] for name in ("doubts", "digest")}
            return
        doubts = set(provenance["doubts"])
        self.__dict__["_warnings"] = {line: line in doubts for line in provenance["warnings"]}

    # -- everyday attributes of the groups `fit`, `search` and `diagnostics` ----------------------
    @property
    def f(self) -> Floats:
        """Parameters (p,) of the arm."""
        return self.arm.f

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names (k) of the unknowns."""
        return self.fit.unknown

    @property
    def path(self) -> Reference | None:
        """Reference of the first record, if it has one."""
        return self.records[0].reference

    def covariance_of(self, names: Sequence[str]) -> Floats:
        """Covariance (m, m) of numbers by their names; zero of numbers that were not unknown.

        An identification without a covariance is refused, with the reason.
        """
        _ = self.fit.std  # raises, with the reason
        return self.fit.covariance_of(names)

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
        """Duration of the identification [s]."""
        return self.search.seconds

    @property
    def message(self) -> str:
        """Why the search ended."""
        return self.search.message

    # -- derived results --------------------------------------------------------------------------
    @property
    def short_names(self) -> tuple[str, ...]:
        """Names (k) of the unknowns for tables; ``arm.dynamics.legend`` has their meaning."""
        return short_names(self.arm.dynamics, self.fit.unknown)

    def bound(self) -> Floats:
        """Cramer-Rao bound (k,): lowest standard deviation of any method, from rounding alone.

        Of the first record, from simulated sensitivities (`pulse_budget`); zero of values that were
        not varied.

        Raises
        ------
        ValueError
            A record without reference.
        """
        record = self.records[0]
        # The bound follows from a simulation along the reference.
        if record.reference is None:
            raise ValueError(
                "the record must have a reference for a bound; it has none. Pass reference= with"
                " the log."
            )
        # As long as the record, as more samples lower the bound.
        seconds = len(record) * record.rig.period
        # With the identified friction and gains, as sensitivities depend on them.
        with warnings.catch_warnings():
            # Gears that are too stiff for the sub-steps give a warning: they are nearly rigid.
            warnings.simplefilter("ignore")
            budget = pulse_budget(
                self.arm,
                self.rig,
                self.law,
                record.reference,
                unknown=self.fit.unknown,
                duration=seconds,
            )
        # A value that was not varied has no error by noise.
        return np.where(self.fit.std > 0, budget.bound, 0.0)

    @functools.cached_property
    def explained(self) -> Floats:
        """Share (n,) of the torque of each joint that the values explain, in the records [%].

        100 % less the length of the error over that of the torque, as `error_on` has them. The
        torque is the logged one, or else the law's along the log. NaN of a joint that hardly moves,
        whose friction holds any torque, and where the torque is not known.
        """
        records = as_repeated(self.records, self.fit.resumptions)
        moving = ~np.all([hardly_moving(record) for record in records], axis=0)
        try:
            error = self.error_on([along_log(self._with_law(record)) for record in records])
        except ValueError:  # the torque is not known, or the log is too short to filter it
            return np.full(self.arm.n, np.nan)
        return np.where(moving, 100 * (1 - error.relative), np.nan)

    def _with_law(self, record: Record) -> Record:
        """A record under the identified law and rig, whose state in it stays."""
        law: Any = record.law
        if isinstance(law, Resumed):
            law = dataclasses.replace(law, law=self.law)
        elif not law.replays:
            law = self.law
        return dataclasses.replace(record, rig=self.rig, law=law)

    def assumed(self, *, lengths: bool = True) -> Assumed:
        """Change of each value by 1 % of each assumed number, which one log cannot reveal.

        Gears, motor gains and gains of the law act through the innovations; lengths of the links
        through the torque along the motion, for which each length needs a model of its own.

        Parameters
        ----------
        lengths : bool
            Whether to include the lengths.

        Raises
        ------
        ValueError
            An identification without covariance, with the reason.
        """
        # They were taken at the optimum of the fit, so they need one.
        # Moves by gears and gains are part of the result; those by lengths are computed here.
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
        if lengths:
            moves |= self._moved_by_lengths
        return Assumed(
            names=tuple(moves),
            unknown=self.short_names,
            moves=np.array(list(moves.values())),
            std=self.fit.std,
        )

    @functools.cached_property
    def _moved_by_lengths(self) -> dict[str, Floats]:
        return moved_by_lengths(self.arm, self.records[0], self.fit.unknown)

    @property
    def causes(self) -> tuple[Cause, ...]:
        """What contradicts the first record, its rig or its law, the likeliest first.

        Mistakes in columns, then in signs and gravity, whatever f is, or in their place those of
        the user's own hypotheses; then effects that the rig does not model. Behind mistakes those
        of the corrected log follow. Where it has none, or cannot be corrected, the effects were
        tested in the log as it is: each may be an effect of the mistake, and says so (`behind`).
        """
        mistakes = self.mistakes
        effects = self.beside or self.diagnostics.detection.causes
        if mistakes and not self.beside:
            behind = mistakes[0].name
            effects = tuple(dataclasses.replace(effect, behind=behind) for effect in effects)
        return (*mistakes, *effects)

    @property
    def mistakes(self) -> tuple[Cause, ...]:
        """What is wrong with the first record, its rig or its law, whatever f is."""
        if self.own_causes:
            return self.own_causes
        record = self.records[0]
        of_log: tuple[Cause, ...] = ()
        # A checkup takes time, and accuses no log that nothing else doubts.
        if self.doubts:
            checkup = checkup_of(record, self.arm.dynamics)
            late = late_by_law(self)
            of_log = tuple(
                cause
                for cause in checkup.causes
                if cause.line in self.warnings or (late and cause.name == "late counts")
            )
            record = checkup.corrected if of_log else record
        return (*of_log, *restated(self.arm.dynamics, record))

    @property
    def corrected(self) -> tuple[Record, ...]:
        """The records without the causes that are numbers of their rigs, or a delay.

        A cause that the log hardly distinguishes from an unknown stays, as do elastic gears,
        cogging and lengths, which a user states.
        """
        records = []
        for record in self.records:
            for sign in self.diagnostics.detection.named:
                record = corrected(record, sign)
            records.append(record)
        return tuple(records)

    @property
    def warnings(self) -> list[str]:
        """Reasons to doubt the values, one line each, causes before their effects."""
        return list(self._warnings)

    @property
    def doubts(self) -> list[str]:
        """The same without those that hold for any log with these unknowns."""
        return [line for line, doubts in self._warnings.items() if doubts]

    # They check the logs once more, which takes seconds: a file keeps them.
    @functools.cached_property
    def _warnings(self) -> dict[str, bool]:
        return warnings_of(self)

    def summary(self, *, full: bool = False) -> str:
        """The text that `print` shows; of many unknowns, one screen.

        Full: each value with its standard deviation, the bound, its 95 % interval and its largest
        correlation; its change by each assumed number; the meaning of the names of parameters.
        """
        return as_text(summary_of(self, full))

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Draw errors, innovations, spectrum and intervals; as `ctc.plot_record`."""
        return plot_identification(self, ax)

    def _shown(self) -> Iterable[Piece]:
        # Short if many unknowns would not fit on a screen.
        return summary_of(self, False)

    def _short(self) -> str:
        count = len(doubts(self))
        # One line, for lists of results; doubts come last, as they qualify the rest.
        text = (
            f"{len(self.fit.values)} values, {self.search.method}, {self.objective:.0f} pulses^2,"
            f" {self.evaluations} evaluations"
        )
        if self.fit.fallback_reason:
            text += ", a fallback"
        if count:
            text += f", {count} warning{'s' * (count > 1)}"
        return text


def covariance_of_f(identification: Identification | None, arm: Arm) -> Floats:
    """Covariance (p, p) of f, in the order of the arm's; zero of an exact arm."""
    if identification is None:  # exact
        return np.zeros((len(arm.f),) * 2)
    if identification.covariance is None:
        raise ValueError(
            "an identification needs a covariance here; this has none:"
            f" {identification.fit.fallback_reason}. Pass found.arm to take the arm as exact."
        )
    return identification.fit.covariance_of(arm.dynamics.names)
