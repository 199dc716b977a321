"""Effects that contradict the rig of a log: compliance, backlash, lag, friction, late counts.

Every identification tests whether one of these effects explains the innovations of all its records,
those held out as well, at the optimum of the model. `stepwise` selects them one after another.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from identification.equation_error.between_runs import BetweenRuns
from identification.equation_error.least_squares import at_least
from identification.replay.extended import joint_of
from identification.results.alternatives import ArmHypothesis, Sign
from identification.results.with_arm import BY_NAME, STIFF
from identification.search.outcome import Fit
from plant.checkup.hypothesis import Cause, Rival
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen, frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown, Verdict, Warned


@dataclass(frozen=True, kw_only=True)
class DetectionSettings:
    """Limits of what a text mentions. All values were chosen by hand; no verdict depends on them.

    Parameters
    ----------
    blind_percent : float
        Detectable size [%] above which a joint counts as one that shows nothing.
    blind_factor : float
        The same in other units, as a multiple of the smallest detectable size of any joint.
    smallest : float
        Detectable size below which no number is printed, in the unit of the text.
    """

    blind_percent: float = 100.0
    blind_factor: float = 1e4
    smallest: float = 1e-3


SETTINGS = DetectionSettings()


_MEAN = (
    "Values are the mean of each record's own{0.left_out}: found.fit.between tells how these differ"
)


@kept
@frozen
class Detection(Shown, Frozen):
    """Effects that the rig does not model, as a log shows them; its text is one line.

    Attributes
    ----------
    signs : tuple of Sign
        Tests of all alternatives, at the optimum of the model as stated.
    named : tuple of Sign
        Causes that contradict the model, with fitted values, in the order of their selection; each
        was tested beside the previous ones.
    stated : dict
        Friction that the rig states, motor side [N m s/rad, N m], by the names of a sign's values.
    joints : tuple of str
        Name of each joint.
    slides : tuple of int
        Joints that slide.
    reason : str or None
        Why nothing could be tested.
    doubt : (k, k) numpy.ndarray or None
        Covariance of the unknowns due to effects that the model may lack. It is added to the
        covariance of noise; see `model_error`.
    grouped : (k,) numpy.ndarray or None
        Lower limits of the standard deviations of the unknowns, from the scatter between segments
        and between records; see `least_squares`.
    between : BetweenRuns or None
        Scatter of the unknowns between two records or more.
    mean : Fit or None
        Mean of the fits of each record alone, where the records contradict each other; its
        covariance is that of noise.
    assumed : dict
        Change (k,) of the unknowns if a gear, a motor's gain, or a gain of the law is 1 % larger,
        by the name of that number.
    friction : dict
        Standard deviations that friction would have had as an unknown, where it was not one, by the
        names of a sign's values.
    """

    signs: tuple[Sign, ...] = ()
    named: tuple[Sign, ...] = ()
    stated: dict[str, float] = field(default_factory=dict)
    joints: tuple[str, ...] = ()
    # It only sets the units of sizes. It is not compared, so that files of earlier versions keep
    # their digest.
    slides: tuple[int, ...] = field(default=(), compare=False)
    reason: str | None = None
    # This and all fields below are absent or empty if the fit has no covariance, or if nothing
    # could be tested.
    doubt: Floats | None = None
    grouped: Floats | None = None
    between: BetweenRuns | None = None
    mean: Fit | None = None
    assumed: dict[str, Floats] = field(default_factory=dict)
    friction: dict[str, float] = field(default_factory=dict)

    def widened(self, fit: Fit) -> Fit:
        """The fit, or the mean if there is one, with `doubt` and `grouped` in its covariance."""
        # A mean exists if the records contradict each other: then the common fit describes no
        # machine.
        fit = fit if self.mean is None else self.mean
        # Without a covariance, or with unknown gears, `detect` gives no scatter.
        if (
            fit.covariance is None
            or fit.resonance is not None
            or self.doubt is None
            or self.grouped is None
        ):
            return fit
        return replace(
            fit,
            covariance=at_least(fit.covariance + self.doubt, self.grouped),
            noise_covariance=fit.covariance,
            between=self.between,
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the causes that contradict the model, each once."""
        return tuple(dict.fromkeys(sign.name for sign in self.named))

    @property
    def resonances(self) -> dict[str, float]:
        """Locked-rotor resonance [Hz] of each gear that is elastic, by joint."""
        # Compliance is in 1 / Hz^2, and zero of a rigid gear.
        return {
            self._joint(name): value**-0.5
            for name, value in self._values("compliance")
            if value > STIFF**-2
        }

    @property
    def played(self) -> tuple[str, ...]:
        """Joints whose gears have backlash."""
        joints = [
            self._joint(name)
            for name, value in self._values("backlash")
            if name.startswith("backlash") and value  # the same sign has the compliance of the gear
        ]
        return tuple(dict.fromkeys(joints))

    def _values(self, kind: str) -> list[tuple[str, float]]:
        """Fitted values of one cause, by name."""
        return [item for sign in self.named if sign.name == kind for item in sign.values.items()]

    def _short(self) -> str:
        if self.reason is not None:
            return "not tested"
        if self.named:
            return f"significant: {', '.join(self.names)}"
        return f"{len(self.signs)} tests, none significant"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(str(self), None if self.reason is not None else not self.named)
        yield Warned(list(self.warnings()))

    def __str__(self) -> str:
        if self.reason is not None:
            return f"compliance, backlash, lag, friction: not tested: {self.reason}"
        # In the order of a reader: causes, clean tests, doubts, records, effects without a test.
        # `signs` has the tests before any cause was selected; `named` has the selected causes.
        by_name = {sign.name: sign for sign in self.signs}
        fittable = {name for name in by_name if BY_NAME[name].refit}
        rest = [by_name[name] for name in by_name if name in fittable - {*self.names}]
        # A fitted cause explains what was significant beside it, so nothing else is unclear then.
        fitted = [name for name in self.names if BY_NAME[name].refit]
        unclear = [sign.name for sign in rest if sign.significant and not fitted]
        clean = [self._visible(sign) for sign in rest if sign.name not in unclear]
        parts = []
        if self.named:
            parts.append(f"significant: {', '.join(self.names)}")
        if clean:
            parts.append(f"no sign of {'; '.join(clean)}")
        if unclear:
            parts.append(
                f"significant, but explaining next to nothing: {', '.join(unclear)} (are lengths"
                " and rig right?)"
            )
        # Only several records can disagree.
        if "disagreement" in by_name:
            sign = by_name["disagreement"]
            verb = "contradict each other" if sign.significant else "agree"
            parts.append(f"the records {verb} (chi-square {sign.chi_square:.0f} of {sign.freedom})")
        if "compliance" not in by_name and "compliance" not in self.names:
            # Backlash is tested where the model has springs: then the unknowns absorb compliance.
            parts.append(
                "compliance cannot be told from the unknowns"
                if "backlash" in by_name
                else "compliance and backlash not tested (no inertia beside the motors')"
            )
        return ". ".join(parts)

    def warnings(self) -> Iterator[str]:
        """A line for each cause; of backlash for each joint."""
        yield from (cause.line for cause in self.causes)

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The causes that contradict the model, in the order of selection; backlash by gear."""
        return tuple(cause for sign in self.named for cause in self._causes(sign))

    def _causes(self, sign: Sign) -> Iterator[Cause]:
        """The cause of a sign; of backlash, that of each gear."""
        hypothesis = BY_NAME[sign.name]
        sizes = list(self._sizes(sign))
        each = hypothesis.between.join(hypothesis.each.format(**size) for size in sizes)
        # Fields of all rows together: each sentence takes those that it names.
        fields = {
            "each": each or "some resonance",
            "value": next(iter(sign.values.values()), 0.0),
            "mean": (
                "Identify each alone, and compare"
                if self.mean is None
                else _MEAN.format(self.between)
            ),
            "chi_square": sign.chi_square,
            "freedom": sign.freedom,
            "threshold": sign.threshold,
        }
        # The row has the words of the cause; what follows from this log is added here.
        sentence = hypothesis.sentence
        remedy = hypothesis.remedy
        if sign.absorbing:
            # If the log cannot tell the correction from an unknown, the correction would move that
            # unknown instead.
            remedy = (
                f"This log hardly distinguishes that from another {', '.join(sign.absorbing)}:"
                f" {hypothesis.telling}"
            )
        elif hypothesis.biased:
            sentence += ", which biases f"
        if sign.rivals:
            remedy += f". To tell causes apart, {hypothesis.telling or 'log another motion'}"
        others = {name: Rival(name, (), 0.0, odds) for name, odds in sign.others}
        joints = tuple(joint_of(name) for name in hypothesis.shown(sign) if "[" in name)
        # Backlash is repaired gear by gear; all other causes are one statement.
        for i, size in enumerate(sizes if hypothesis.gears else [sizes[0] if sizes else {}]):
            yield Cause(
                name=sign.name,
                joints=joints[i : i + 1] if hypothesis.gears else joints,
                size=float(size.get("size", 0.0)),
                unit=size.get("unit", hypothesis.unit),
                log_odds=sign.log_odds,
                sentence=sentence.format(**fields | size),
                remedy=remedy.format(**fields | size),
                rivals=tuple(others.get(name, Rival(name, (), 0.0, 0.0)) for name in sign.rivals),
                runner_up=next(iter(others.values()), None),
            )

    def _sizes(self, sign: Sign) -> Iterator[dict[str, Any]]:
        """Fields of the text of each size of a cause."""
        hypothesis = BY_NAME[sign.name]
        numbers = {number.name: number for number in hypothesis.numbers}
        for name, value in hypothesis.shown(sign).items():
            kind = name.partition("[")[0]
            stated = self.stated.get(name, 0.0)
            unit, convert = self._scale(hypothesis, name)
            per = numbers[kind].unit if kind in numbers else ""
            size = convert(value)
            if hypothesis.shares:
                # Of what the rig states as zero there is no share.
                size, unit = (convert(value / stated), unit) if stated else (value, per)
            yield {
                "size": size,
                "distance": abs(value),
                "late": "late" if value > 0 else "early",
                "unit": unit,
                "joint": self._joint(name) if "[" in name else "",
                "kind": kind,
                "variant": kind.partition(".")[2],
                "cycles": "".join(filter(str.isdigit, kind)),
                "stated": stated,
                "total": stated + value,  # fitted values are deviations from the stated ones
                "per": per,
            }

    def _visible(self, sign: Sign) -> str:
        """An alternative, and the smallest size of it that the log would show."""
        hypothesis = BY_NAME[sign.name]
        # Sizes are in the unit of the text. Friction is a share of what the rig states, so a number
        # that the rig states as zero is left out.
        stated = self.stated if hypothesis.shares else dict.fromkeys(sign.visible, 1.0)
        scales = {name: self._scale(hypothesis, name) for name in sign.visible if stated.get(name)}
        sizes = {
            name: convert(sign.visible[name] / stated[name])
            for name, (_, convert) in scales.items()
        }
        if hypothesis.falling:
            span = _span([*sizes.values()])
            return f"{hypothesis.title} (detectable below {span} {hypothesis.unit})"
        # A joint that would show an effect only when it is huge is listed apart.
        largest = SETTINGS.blind_factor * min(sizes.values(), default=0.0)
        if hypothesis.unit == "%":
            largest = SETTINGS.blind_percent
        shown = {name: size for name, size in sizes.items() if size <= largest}
        if not shown:
            return f"{hypothesis.title} (none is detectable)"
        # Sizes of joints that turn and of slides have a span each.
        of_unit: dict[str, list[float]] = {}
        for name, size in shown.items():
            unit = scales[name][0]
            unit += " of the motor" * (unit == "N m")
            of_unit.setdefault(unit, []).append(size)
        spans = [
            f"{_span(values)} {unit}"
            if max(values) > SETTINGS.smallest
            else f"less than {SETTINGS.smallest:g} {unit}"
            for unit, values in of_unit.items()
        ]
        # The order of the joints, each once.
        blind = dict.fromkeys(self._joint(name) for name in sizes if name not in shown)
        exception = f", not at {', '.join(blind)}" if blind else ""
        return f"{hypothesis.title} (detectable from {' and '.join(spans)}{exception})"

    def _scale(self, hypothesis: ArmHypothesis, name: str) -> tuple[str, Callable[[float], float]]:
        """Unit in which the size of a number is printed, and the way to it from the model's."""
        slides = "[" in name and joint_of(name) in self.slides
        if hypothesis.of_slides is not None and slides:
            return hypothesis.of_slides
        return hypothesis.unit, hypothesis.convert

    def _joint(self, name: str) -> str:
        """Joint of a number such as ``gear[1]``."""
        return self.joints[joint_of(name)]


def _span(values: list[float]) -> str:
    """Smallest and largest value, as a text."""
    # Two digits, but no exponent for hundreds.
    low, high = (
        f"{value:.2g}" if value < 100 else f"{value:.0f}" for value in (min(values), max(values))
    )
    # Values that print alike are one.
    return low if low == high else f"{low} to {high}"
