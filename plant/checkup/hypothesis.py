"""What can be wrong with a log, its rig or its law: hypotheses, their score and their ranking.

A hypothesis states one mistake in words and undoes it. Its evidence is how much likelier the log is
without the mistake. Forward selection accepts the likeliest hypothesis, undoes it, and begins anew.

`Experiment` stands for what is examined: a record without an arm (`record.check()`), or a
fitted model with its records (`identify`). The selection is the same for both.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from plant.parts import Piece, Shown, Verdict, instance, kept, real

Experiment = TypeVar("Experiment")
Joints = tuple[int, ...]


def whole(n: int) -> Iterator[Joints]:
    """The scope of a mistake that concerns the log or the rig as a whole."""
    # One empty scope, not none: such a mistake is tried once, of no joint in particular.
    yield ()


def each_joint(n: int) -> Iterator[Joints]:
    """The scope of a mistake of one joint: every joint of n."""
    yield from ((joint,) for joint in range(n))


def pairs(n: int) -> Iterator[Joints]:
    """The scope of an exchange: every pair of n joints."""
    yield from combinations(range(n), 2)


def columns_of(joints: Joints) -> list[int] | slice:
    """The columns of these joints: of all where a mistake concerns none in particular."""
    return list(joints) or slice(None)


SENTENCE_FIELDS = {
    "joint": "name of the joint, or of the first of a pair",
    "other": "name of the second joint of a pair",
    "value": "the size, a number: {value:.2g}",
    "inverse": "one over the size",
    "shift": "the size as a delay in words: 2 samples late",
    "option": "the option of the robot file that undoes a delay",
    "torque": "name of the joint's column of torques in the log",
    "counts": "name of the joint's column of counts",
    "reference": "name of the joint's column of references",
    "error": "name of the joint's column of tracking errors",
    "cell": "the cell of the counter at zero by the rounding that is not stated",
    "rounding": "the rounding of the encoder that is not stated",
    "gain": "name of the main gain of the law",
    "gravity": "gravity of the chain on a tilted base [m/s^2]",
    "variant": "what a variant of the law has in place of what is stated",
}
"""Fields of the sentence and the remedy of a hypothesis, with their meanings."""


@dataclass(frozen=True, kw_only=True)
class Hypothesis(Generic[Experiment]):
    """One thing that can be wrong: its words, how to undo it, and how likely it is.

    Parameters
    ----------
    name : str
        Name of the mistake, "delay".
    sentence : str
        What is wrong, with fields in braces: `{joint}` and `{other}` are the joints of the scope,
        `{value}` the size. `SENTENCE_FIELDS` lists all of them.
    remedy : str
        What the user does about it, with the same fields.
    undo : callable
        ``undo(experiment, joints, size)`` gives the experiment without the mistake. It raises
        ValueError where the experiment does not allow that.
    scope : callable
        The joints that the mistake may concern, of a number of joints: `whole`, `each_joint` or
        `pairs`.
    sizes : tuple of float
        Sizes that are tried. A switch has one size.
    against : float
        Natural logarithm of the odds against the mistake before the log is read.
    tolerance : float, optional
        Standard deviation of the size before the log is read, in its unit. A size that the log
        determines much better than that costs evidence (Occam's factor).
    whole : bool
        Whether the size is a whole number, unless the log says otherwise.
    unit : str
        Unit of the size in messages.
    check : str
        Name of the check whose finding shows the mistake; by default the name of the mistake.
    suggested : callable, optional
        ``suggested(experiment, joints)`` gives sizes that the log itself suggests, in place of
        `sizes`.
    evidence : callable, optional
        Evidence of its own, where the score has none: ``evidence(experiment, joints)`` gives pairs
        of a size and its log odds, from which `against` is not yet subtracted.
    scored : bool
        Whether the score counts, too, where a hypothesis has evidence of its own: then the larger
        of the two counts.
    of_record : callable, optional
        ``of_record(record, joints, size)`` gives the record without the mistake, where `undo`
        changes something else than a record.
    parameter : bool
        Whether the mistake is a number of the model that an identification estimates. A correction
        that the log cannot distinguish from it is not advised.
    measurement : str
        What distinguishes the mistake from others, as a sentence.

    Raises
    ------
    ValueError
        If the sentence or the remedy has a field that is not in `SENTENCE_FIELDS`, or that cannot
        be written so; if `undo` or `scope` is not a function; numbers that are none, or negative
        odds.

    See Also
    --------
    plant.Record

    Examples
    --------
    >>> from plant import Hypothesis
    >>> from plant.checkup.hypothesis import pairs
    >>> swapped = Hypothesis(
    ...     name="swapped torques",
    ...     sentence="The torques of {joint} and {other} are exchanged",
    ...     remedy="Exchange the two columns.",
    ...     undo=lambda record, joints, size: record,
    ...     scope=pairs,
    ... )
    >>> list(swapped.scope(3))
    [(0, 1), (0, 2), (1, 2)]
    """

    name: str
    sentence: str
    remedy: str
    undo: Callable[[Experiment, Joints, float], Experiment]
    scope: Callable[[int], Iterator[Joints]] = whole
    sizes: tuple[float, ...] = (1.0,)
    against: float = 5.0
    tolerance: float | None = None
    whole: bool = False
    unit: str = ""
    check: str = ""
    suggested: Callable[[Any, Joints], tuple[float, ...]] | None = None
    evidence: Callable[[Any, Joints], Iterable[tuple[float, float]]] | None = None
    scored: bool = False
    of_record: Callable[[Any, Joints, float], Any] | None = None
    parameter: bool = False
    measurement: str = ""

    def __post_init__(self) -> None:
        # Check the fields here, so that the author of the hypothesis sees the error.
        if not instance("name", self.name, str, "Name the mistake.").strip():
            raise ValueError("name must be a word; got ''. Name the mistake.")
        of_this = f"hypothesis {self.name!r}: "
        sizes = tuple(self.sizes) if isinstance(self.sizes, Iterable) else ()
        if not sizes:
            raise ValueError(
                f"{of_this}sizes must be numbers, at least one; got"
                f" {self.sizes!r:.60}. Write a single one as (2.0,)."
            )
        for size in sizes:
            real(f"{of_this}a size", size, "Write sizes as (1.0, 2.0).")
        object.__setattr__(self, "sizes", sizes)
        if self.tolerance is not None:
            advice = "Leave it out for a size that needs no spread."
            real(f"{of_this}tolerance", self.tolerance, advice, positive=True)
        # A mistake that were likelier than none without a log would be found in every log.
        if real(f"{of_this}against", self.against, "Give the log of odds, such as 5.0.") < 0:
            raise ValueError(
                f"{of_this}against must not be negative; got {self.against:g}. Give 0 for even"
                " odds."
            )
        for field in ("undo", "scope", "suggested", "evidence", "of_record"):
            function = getattr(self, field)
            # Only what a row can do without may be None.
            if not callable(function) and (function is not None or field in ("undo", "scope")):
                raise ValueError(
                    f"{of_this}{field} must be a function; got {function!r:.60}."
                    " `Hypothesis` lists what it takes and gives."
                )
        sample = dict.fromkeys(SENTENCE_FIELDS, "") | {"value": 1.5, "inverse": 1.5}
        for text in (self.sentence, self.remedy):
            try:
                text.format(**sample)
            except (ValueError, LookupError, AttributeError, TypeError) as error:
                raise ValueError(
                    f"{of_this}expected text with fields among"
                    f" {', '.join(SENTENCE_FIELDS)}; got {text!r} ({error}). Use one of these"
                    " fields, or write {{ and }} for braces."
                ) from None


def require_rows(hypotheses: Any) -> tuple[Hypothesis[Any], ...]:
    """The hypotheses as a tuple, or a refusal of what is no sequence of them."""
    rows = hypotheses
    if isinstance(hypotheses, Iterable):
        rows = tuple(hypotheses)
        if all(isinstance(row, Hypothesis) for row in rows):
            return rows
    raise ValueError(
        f"hypotheses must be a sequence of Hypothesis; got {rows!r:.80}. Write a single one as"
        " hypotheses=[mine]."
    )


class Candidate(NamedTuple):
    """A hypothesis with its joints and size, and its evidence: log odds for it [natural log].

    `corrected` gives the experiment without the mistake when it is asked for; `words`: further
    fields of its sentence and remedy.
    """

    hypothesis: Hypothesis[Any]
    joints: Joints
    size: float
    log_odds: float
    # A function: undoing a mistake takes time, and only the likeliest candidate is undone.
    corrected: Callable[[], Any]
    # Words that a sentence needs beside the size, such as the unit that was used by mistake.
    words: Mapping[str, str] = {}


@kept
class Rival(NamedTuple):
    """Another cause that may explain the log: its name, joints, size, odds and measurement."""

    name: str
    joints: Joints
    size: float
    log_odds: float
    measurement: str = ""


def _power(log_odds: float) -> str:
    power = log_odds / np.log(10)
    # No model of a log is right to more digits.
    return f"1e{power:.0f}" if power < 100 else "over 1e99"


@kept
@dataclass(frozen=True, kw_only=True, repr=False)
class Cause(Shown):
    """A mistake that a log shows, in its place in the ranked list.

    Parameters
    ----------
    name : str
    joints : tuple of int
        Indices in q; empty where the mistake concerns the whole log.
    size : float
        Estimated size in `unit`.
    unit : str
    log_odds : float
        Natural logarithm of the odds for this cause against none.
    sentence, remedy : str
        What is wrong, and what to do.
    rivals : tuple of Rival
        Causes whose log odds are near: the log cannot tell them apart.
    runner_up : Rival, optional
        The likeliest other cause.
    check : str
        Name of the check whose finding shows the cause.
    certain : bool
        Whether its correction may be applied: the cause is a parameter of the model, or no rival
        is one.
    behind : str
        Name of a mistake that the log still had when this cause was found. This cause may be an
        effect of that mistake. Empty without one.
    """

    name: str
    joints: Joints
    size: float
    unit: str
    log_odds: float
    sentence: str
    remedy: str
    rivals: tuple[Rival, ...] = ()
    runner_up: Rival | None = None
    check: str = ""
    certain: bool = True
    behind: str = ""

    @property
    def odds(self) -> str:
        """The odds as a power of ten, "1e6", and those of the runner-up."""
        # Odds alone do not show how clearly the cause leads: the next one gives the distance.
        runner_up = self.runner_up
        own = _power(self.log_odds)
        if runner_up is None:
            return own
        following = _power(runner_up.log_odds)
        # Two equal texts do not: then it is said how much less likely the next one is.
        if following == own:
            lead = self.log_odds - runner_up.log_odds
            near = lead < SELECTION.undecided
            following = "nearly as likely" if near else f"less likely by {_power(lead)}"
        return f"{own}; next: {runner_up.name}, {following}"

    def _short(self) -> str:
        # As in labels of joints: "joint 1" could be the first or the second.
        joints = ", ".join(f"q[{joint}]" for joint in dict.fromkeys(self.joints))
        joints = f" of {joints}" if joints else ""
        # A switch, such as an exchange of columns, has a size without a unit: it says nothing.
        size = f" {self.size:.3g} {self.unit}".rstrip() if self.unit else ""
        effect = f"; may be an effect of: {self.behind}" if self.behind else ""
        return f"{self.name}{joints}{size}, odds {self.odds}{effect}"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(self._short(), good=False)
        yield self.line

    @property
    def line(self) -> str:
        """What is wrong with which odds, what else it may be, and what to do, as one line."""
        sentence = f"{self.sentence.rstrip('.')} (odds {self.odds})"
        # One full stop after each part, whether its author wrote one or not.
        parts = (sentence, self.doubt.rstrip("."), self.remedy.rstrip("."))
        return "".join(f"{part}. " for part in parts if part).rstrip()

    @property
    def doubt(self) -> str:
        """A sentence about the causes that explain nearly as much; empty without one."""
        if not self.rivals:
            return ""
        # One mistake at several joints is one name in the sentence.
        names = ", ".join(dict.fromkeys(rival.name for rival in self.rivals))
        measurements = dict.fromkeys(rival.measurement for rival in self.rivals)
        advice = "".join(f" {text.rstrip('.')}." for text in measurements if text)
        return f"The log cannot distinguish this from: {names}.{advice}"


@dataclass(frozen=True, kw_only=True)
class SelectionSettings:
    """Limits of the forward selection.

    Parameters
    ----------
    causes : int
        Causes that are accepted of one log, at most.
    accepted : float
        Log odds above which a cause is accepted.
    traces : float
        The same for a further cause, as a share of the log odds of the one before: a mistake that
        is undone imperfectly leaves traces.
    undecided : float
        Difference of log odds below which two causes are not told apart: odds of 20 to 1.
    """

    causes: int = 3
    accepted: float = 0.0
    traces: float = 0.0
    undecided: float = 3.0


SELECTION = SelectionSettings()


@dataclass(frozen=True)
class Ranking(Generic[Experiment]):
    """The accepted causes, in the order of acceptance, and the experiments without them.

    Attributes
    ----------
    causes : tuple of Cause
    experiments : tuple
        The experiment as it is, without the first cause, without the first two, ...
    failed : tuple of str
        Hypotheses that could not be tried, with the reason, a line each.
    accepted : tuple of Hypothesis
        The rows of the table that the causes belong to.
    """

    causes: tuple[Cause, ...]
    experiments: tuple[Experiment, ...]
    failed: tuple[str, ...] = ()
    accepted: tuple[Hypothesis[Experiment], ...] = ()

    @property
    def corrected(self) -> Experiment:
        """The experiment without the accepted causes that are certain."""
        return self.experiments[-1]


def ranking(
    experiment: Experiment,
    candidates: Callable[[Experiment], Iterable[Candidate]],
    labels: tuple[str, ...],
    settings: SelectionSettings = SELECTION,
) -> Ranking[Experiment]:
    """Accept the likeliest candidate, undo it, and begin anew, while one is likelier than none.

    Parameters
    ----------
    experiment : Experiment
    candidates : callable
        Gives the candidates of an experiment with their evidence.
    labels : tuple of str
        Names of the joints in messages.
    settings : SelectionSettings
    """
    causes: list[Cause] = []
    experiments = [experiment]
    accepted: list[Hypothesis[Experiment]] = []
    undone: set[tuple[str, Joints, float | None]] = set()

    def mistake(candidate: Candidate) -> tuple[str, Joints, float | None]:
        # A size that was refined is the likeliest one already: no other size is tried.
        refined = candidate.hypothesis.tolerance is not None
        return candidate.hypothesis.name, candidate.joints, None if refined else candidate.size

    def others(experiment: Experiment) -> Iterator[Candidate]:
        # The same mistake is not made twice.
        for candidate in candidates(experiment):
            if mistake(candidate) not in undone:
                yield candidate

    def accept(ranked: list[Candidate]) -> Experiment | None:
        causes.append(_cause(ranked, labels, settings))
        accepted.append(ranked[0].hypothesis)
        undone.add(mistake(ranked[0]))
        # A rival is a parameter of the model: an identification must decide, so nothing is undone.
        if not causes[-1].certain:
            return None
        experiments.append(ranked[0].corrected())
        return experiments[-1]

    select(experiment, others, accept, settings)
    return Ranking(tuple(causes), tuple(experiments), accepted=tuple(accepted))


def select(
    experiment: Experiment,
    candidates: Callable[[Experiment], Iterable[Candidate]],
    accept: Callable[[list[Candidate]], Experiment | None],
    settings: SelectionSettings = SELECTION,
) -> None:
    """Forward selection: rank the candidates, undo the likeliest mistake, and repeat.

    ``accept(ranked)`` takes the candidates, the likeliest first, and gives the experiment without
    that one, or None to end.
    """
    limit = settings.accepted
    # A log with more mistakes than that is judged anew after the first ones are corrected.
    for _ in range(settings.causes):
        # Evidence of a user's own may be no number; it would hide all others in the order.
        numbers = [
            candidate for candidate in candidates(experiment) if not np.isnan(candidate.log_odds)
        ]
        ranked = sorted(numbers, key=lambda candidate: -candidate.log_odds)
        if not ranked or not ranked[0].log_odds > limit:
            return
        # Traces of a mistake grow with its own evidence, so the limit of the next one does, too.
        limit = max(settings.accepted, settings.traces * ranked[0].log_odds)
        following = accept(ranked)
        if following is None:
            return
        # Every further candidate is judged beside the correction: a second mistake may show only
        # then.
        experiment = following


def beside(
    ranked: list[Candidate], settings: SelectionSettings = SELECTION
) -> tuple[list[Candidate], list[Candidate]]:
    """Other causes that are likelier than none; and those that the log does not exclude."""
    best = ranked[0]
    others = [
        candidate
        for candidate in ranked[1:]
        # Another size, or another joint, of the same mistake is no other cause.
        if candidate.log_odds > settings.accepted
        and candidate.hypothesis.name != best.hypothesis.name
    ]
    return others, [
        other for other in others if other.log_odds > best.log_odds - settings.undecided
    ]


def _cause(ranked: list[Candidate], labels: tuple[str, ...], settings: SelectionSettings) -> Cause:
    """The likeliest candidate, and the others that the log does not exclude."""
    best = ranked[0]
    hypothesis = best.hypothesis
    others, near = beside(ranked, settings)
    certain = hypothesis.parameter or not any(rival.hypothesis.parameter for rival in near)
    # A sentence has two joints at most; a mistake of the whole log has none.
    joint, other = ([labels[j] for j in best.joints] + ["", ""])[:2]
    # What is known with an arm alone is empty without one.
    words: dict[str, Any] = dict.fromkeys(SENTENCE_FIELDS, "")
    words |= {"joint": joint, "other": other, "value": best.size, **best.words}
    remedy = hypothesis.remedy.format(**words) if certain else "Do not correct the log for it."
    return Cause(
        name=hypothesis.name,
        joints=best.joints,
        size=best.size,
        unit=hypothesis.unit,
        log_odds=best.log_odds,
        sentence=hypothesis.sentence.format(**words),
        remedy=remedy,
        rivals=tuple(_rival(candidate, hypothesis) for candidate in near),
        runner_up=_rival(others[0], hypothesis) if others else None,
        check=hypothesis.check or hypothesis.name,
        certain=certain,
    )


def _rival(candidate: Candidate, best: Hypothesis[Any]) -> Rival:
    """A candidate beside the best hypothesis."""
    rival = candidate.hypothesis
    # Either of the two may know what tells them apart; the likelier one is asked first.
    measurement = best.measurement or rival.measurement
    return Rival(rival.name, candidate.joints, candidate.size, candidate.log_odds, measurement)
