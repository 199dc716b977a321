"""Effects that contradict the rig of a log: compliance, backlash, lag, friction, late counts.

Every identification tests whether one of these effects explains the innovations of all its records,
those held out as well, at the optimum of the model. `stepwise` selects them one after another.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from identification.equation_error import BetweenRuns, at_least
from identification.replay import joint_of
from identification.results.alternatives import ArmHypothesis, Sign
from identification.results.with_arm import BY_NAME, STIFF
from identification.search import Fit
from plant.checkup import Cause, Rival
from plant.parts import Floats, Frozen, Piece, Shown, Verdict, Warned, frozen, kept


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
    # This and all fields below are absent or empty if nothing could be tested. `grouped` and
    # `between` are absent also if the fit has no covariance, or if its gears are unknown.
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
        if fit.covariance is None or fit.finds_gears or self.doubt is None or self.grouped is None:
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
        # Tests whose causes explain next to nothing, or what the tolerances allow.
        unclear = [sign.name for sign in self.signs if sign.significant]
        if unclear:
            return f"{len(self.signs)} tests, significant without a cause: {', '.join(unclear)}"
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
        telling = hypothesis.telling or "log another motion"
        if sign.absorbing:
            # If the log cannot tell the correction from an unknown, the correction would move that
            # unknown instead.
            remedy = (
                f"This log hardly distinguishes that from another {', '.join(sign.absorbing)}:"
                f" {telling}"
            )
        elif hypothesis.biased:
            sentence += ", which biases f"
        # The same measurement tells unknowns and causes apart: it is advised once.
        if sign.rivals and not sign.absorbing:
            remedy += f". To tell causes apart, {telling}"
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
        for name, value in hypothesis.shown(sign).items():
            kind = name.partition("[")[0]
            stated = self.stated.get(name, 0.0)
            size, unit = self._size(hypothesis, name, value)
            yield {
                "size": size,
                "distance": abs(value),
                "late": "late" if value > 0 else "early",
                "unit": unit,
                "joint": self._joint(name) if "[" in name else "",
                "where": f" at {self._joint(name)}" if "[" in name else "",
                "kind": kind,
                "variant": kind.partition(".")[2],
                "cycles": "".join(filter(str.isdigit, kind)),
                "stated": stated,
                "total": stated + value,  # fitted values are deviations from the stated ones
                "per": _unit(hypothesis, name),
            }

    def _visible(self, sign: Sign) -> str:
        """An alternative, and the smallest size of it that the log would show."""
        hypothesis = BY_NAME[sign.name]
        # Sizes of each unit have a span: of joints that turn, of slides, and of friction that the
        # rig states, or states as zero.
        of_unit: dict[str, dict[str, float]] = {}
        for name, value in sign.visible.items():
            size, unit = self._size(hypothesis, name, value)
            of_unit.setdefault(unit, {})[name] = size
        if not of_unit:
            return f"{hypothesis.title} (none is detectable)"
        if hypothesis.falling:
            spans = [f"{_span([*sizes.values()])} {unit}" for unit, sizes in of_unit.items()]
            return f"{hypothesis.title} (detectable below {' and '.join(spans)})"
        # A joint that would show an effect only when it is huge is listed apart.
        spans = []
        shown: set[str] = set()
        for unit, sizes in of_unit.items():
            largest = SETTINGS.blind_factor * min(sizes.values())
            if unit == "%":
                largest = SETTINGS.blind_percent
            visible = {name: size for name, size in sizes.items() if size <= largest}
            # Torques, and friction per speed, are those of the motor.
            of_motor = " of the motor" if unit.startswith("N m") else ""
            if visible:
                spans.append(f"{_span([*visible.values()])} {unit}{of_motor}")
            shown |= {*visible}
        if not spans:
            return f"{hypothesis.title} (none is detectable)"
        # The order of the joints, each once.
        blind = dict.fromkeys(self._joint(name) for name in sign.visible if name not in shown)
        exception = f", not at {', '.join(blind)}" if blind else ""
        return f"{hypothesis.title} (detectable from {' and '.join(spans)}{exception})"

    def _size(self, hypothesis: ArmHypothesis, name: str, value: float) -> tuple[float, str]:
        """Size of a number in the unit in which it is printed, and that unit."""
        slides = "[" in name and joint_of(name) in self.slides
        if hypothesis.of_slides is not None and slides:
            unit, convert = hypothesis.of_slides
            return convert(value), unit
        if not hypothesis.shares:
            return hypothesis.convert(value), hypothesis.unit
        stated = self.stated.get(name, 0.0)
        # Of what the rig states as zero there is no share.
        if not stated:
            return value, _unit(hypothesis, name)
        return hypothesis.convert(value / stated), hypothesis.unit

    def _joint(self, name: str) -> str:
        """Joint of a number such as ``gear[1]``."""
        return self.joints[joint_of(name)]


def _unit(hypothesis: ArmHypothesis, name: str) -> str:
    """Unit of a number in the model, such as ``coulomb[0]``; empty where it has none."""
    kind = name.partition("[")[0]
    return next((number.unit for number in hypothesis.numbers if number.name == kind), "")


def _span(values: list[float]) -> str:
    """Smallest and largest value, as a text."""
    low, high = _digits(min(values)), _digits(max(values))
    # Values that print alike are one.
    return low if low == high else f"{low} to {high}"


def _digits(value: float) -> str:
    """A size, as a text."""
    if not value > SETTINGS.smallest:
        return f"less than {SETTINGS.smallest:g}"
    # Two digits, but no exponent for hundreds: from ten on, these are the digits of a whole number.
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"
