"""Effects that contradict the rig of a log: compliance, backlash, lag, friction, late counts.

Every identification tests whether one of these effects explains the innovations of all its records,
those held out as well, at the optimum of the model. `stepwise` selects them one after another.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from identification.equation_error.between_runs import BetweenRuns
from identification.equation_error.least_squares import at_least
from identification.results.alternatives import Sign
from identification.search.outcome import Fit
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen, frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown, Verdict, Warned


@dataclass(frozen=True, kw_only=True)
class DetectionSettings:
    """Limits of what a text mentions. All values were chosen by hand; no verdict depends on them.

    Parameters
    ----------
    stiff : float
        Resonance [Hz] above which a gear is not mentioned.
    blind_percent : float
        Detectable size [%] above which a joint counts as one that shows nothing.
    blind_factor : float
        The same in other units, as a multiple of the smallest detectable size of any joint.
    smallest : float
        Detectable size below which no number is printed, in the unit of the text.
    scaled : float
        Relative deviation of the friction of all joints from which on a common factor is mentioned,
        and within which the ratios of the joints have to agree.
    """

    stiff: float = 300.0
    blind_percent: float = 100.0
    blind_factor: float = 1e4
    smallest: float = 1e-3
    scaled: float = 0.08


SETTINGS = DetectionSettings()


class _Quantity(NamedTuple):
    """Factor from the unit of `Extended` to that of a text, that unit, and the effect's name."""

    factor: float
    unit: str
    name: str


_QUANTITIES = {
    "backlash": _Quantity(180 / np.pi, "degrees", "backlash"),
    "lag": _Quantity(1e3, "ms", "lag"),
    "delay": _Quantity(1.0, "samples", "delay"),
    "gear": _Quantity(100.0, "%", "another gear"),
    "offset": _Quantity(1.0, "N m of the motor", "an offset of the torque"),
    "cogging": _Quantity(1.0, "N m of the motor", "cogging"),
    "length": _Quantity(100.0, "%", "another length"),
    "lead": _Quantity(1e3, "ms", "a derivative in the law"),
    "friction": _Quantity(100.0, "%", "other friction"),
}

# Texts of one number (in the unit above) and its joint, where a cause has one of each joint.
_BY_JOINT = {
    "gear": "{:+.2g} % at {}",
    "offset": "{:.3g} N m at {}",
    "lead": "{:.2g} ms at {}",
    "length": "{:+.2g} % before {}",
}

# Each cause, its evidence and what to do; `Detection.warnings` fills the fields by name. A cause
# "biases f" where the unknowns take a part of its effect over.
_MESSAGES = {
    # A rigid model takes the deflection of a gear for inertia.
    "compliance": (
        "the joints are elastic: locked-rotor resonance near {each} ({chance}), which biases f."
        " Give the drive an Elasticity, and identify its stiffness too."
    ),
    "backlash": (
        "the gear of {joint} has backlash, about {degrees:.1g} degrees ({chance}): where its load"
        " changes sign, that is the model's accuracy floor."
    ),
    "lag": (
        "torques lag behind commands by {lag:.2g} ms ({chance}). Give the drive current_lag, and"
        " compare."
    ),
    "delay": (
        "the counts are {late} ({chance}), which biases f. Identify without_delay(record,"
        " {value:.2g}) and compare."
    ),
    # All friction is one cause; the text lists its numbers.
    "friction": (
        "friction is not the rig's{scaled} ({chance}): {each}. Add these numbers to unknown"
        " (drive.viscous[0] and so on)."
    ),
    "offset": (
        "torques have an offset that the rig lacks, {each}, motor side ({chance}), which biases f."
        " Give the drive a FrictionCurve(offset=0 of each joint), and add drive.curve.offset[0] and"
        " so on to unknown."
    ),
    # Wrong lengths and counts per turn scale a motion as a wrong gear does.
    "gear": (
        "gears (or lengths, or counts per turn) are not the rig's: {each} ({chance}), which biases"
        " f. Check them, or add drive.gear[0] and so on to unknown."
    ),
    # Its torque is known along the log but for the size, so it is stated, not identified.
    "cogging": "motors cog: {each}, motor side ({chance}). Give the drive a TorqueRipple of that.",
    "length": (
        "the arm's lengths are not the chain's: {each} ({chance}), which biases f. Measure them,"
        " and correct the chain."
    ),
    # A derivative in the law advances its torque by the ratio of the gains.
    "lead": (
        "the stated law lacks the rate of its error: torques lead by {each} ({chance}), which"
        " biases f. Check the law; a PD has such a lead, its derivative per gain."
    ),
    # Not fitted: of wide backlash only the instants are known at which it acts.
    "reversals": (
        "the model fails where the load of {each} changes sign: squared innovations are {ratio:.2g}"
        " times those elsewhere. Its gear has backlash, wider than the model of it tells."
    ),
    # Not fitted: no single model has the difference of the records.
    "disagreement": (
        "the records contradict each other: each alone has other values (chi-square"
        " {chi_square:.0f} of {freedom} degrees of freedom, by chance below {threshold:.0f}). The"
        " model lacks something, or the robot has changed (friction; a load, which find_load"
        " weighs). {do}."
    ),
}

_MEAN = (
    "Values are the mean of each record's own{0.left_out}: found.fit.between tells how these differ"
)
UNFITTED = ("reversals", "disagreement")  # causes that are no number of a model


@kept
@frozen
class Detection(Shown, Frozen):
    """Effects that the rig does not model, as a log shows them; printed, a line.

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
    reason : str or None
        Why nothing could be tested.
    doubt : (k, k) numpy.ndarray or None
        Covariance of the unknowns by what the model may lack, to be added to that of noise; see
        `model_error`.
    grouped : (k,) numpy.ndarray or None
        Lower limits of their standard deviations, from their scatter between segments, and
        records; see `least_squares`.
    between : BetweenRuns or None
        Scatter of the unknowns between two records or more.
    mean : Fit or None
        Mean of the fits of each record alone, where the records contradict each other; its
        covariance is that of noise.
    assumed : dict
        Their change (k,) if a gear, a motor's gain, or a gain of the law is 1 % larger, by its
        name.
    friction : dict
        Standard deviations of friction that was not unknown, if it had been, by the names of a
        sign's values.
    """

    signs: tuple[Sign, ...] = ()
    named: tuple[Sign, ...] = ()
    stated: dict[str, float] = field(default_factory=dict)
    joints: tuple[str, ...] = ()
    reason: str | None = None
    doubt: Floats | None = None
    grouped: Floats | None = None
    between: BetweenRuns | None = None
    mean: Fit | None = None
    assumed: dict[str, Floats] = field(default_factory=dict)
    friction: dict[str, float] = field(default_factory=dict)

    def widened(self, fit: Fit) -> Fit:
        """A fit, or the mean, whose covariance includes effects that the rig may lack."""
        # The mean replaces the common fit, which is that of no machine.
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
            if value > SETTINGS.stiff**-2
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
        by_name = {sign.name: sign for sign in self.signs}
        rest = [sign for sign in self.signs if sign.name not in (*self.names, *UNFITTED)]
        # A fitted cause explains what was significant beside it, so nothing else is unclear then.
        fitted = set(self.names) - {*UNFITTED}
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
        for sign in self.named:
            # Lag and delay have one number, which has their name; the rest has one per joint.
            value = sign.values.get(sign.name, 0.0)
            # The fields of all messages; each takes its own.
            fields = {
                "each": self._by_joint(sign),
                "chance": f"chi-square {sign.chi_square:.0f}, by chance below {sign.threshold:.0f}",
                "late": f"{abs(value):.2g} samples {'late' if value > 0 else 'early'}",
                "value": value,
                "lag": 1e3 * value,
                "scaled": self._scaled(sign),
                "do": (
                    "Identify each alone, and compare"
                    if self.mean is None
                    else _MEAN.format(self.between)
                ),
                "ratio": next(iter(sign.values.values()), 0.0),
                "chi_square": sign.chi_square,
                "freedom": sign.freedom,
                "threshold": sign.threshold,
            }
            rivals = ""
            if sign.rivals:
                rivals = f" Another cause explains nearly as much: {', '.join(sign.rivals)}."
            message = _MESSAGES[sign.name]
            # Each gear with backlash has a line of its own.
            gears = [name for name in sign.values if name.startswith("backlash")]
            for name in gears:
                joint = {"joint": self._joint(name), "degrees": np.rad2deg(sign.values[name])}
                yield message.format(**fields, **joint) + rivals
            if not gears:
                yield message.format(**fields) + rivals

    def _scaled(self, sign: Sign) -> str:
        """A remark where one factor fits all friction, as if a wrong gain scaled all torques."""
        # Ratio of fitted to stated friction, where some is stated.
        ratios = [
            1 + value / self.stated[name]
            for name, value in sign.values.items()
            if self.stated.get(name)
        ]
        # Two ratios may agree by chance.
        factor = float(np.median(ratios)) if len(ratios) > 2 else 1.0
        if (
            not factor > 0
            or abs(factor - 1) < SETTINGS.scaled
            or np.abs(np.array(ratios) / factor - 1).max() > SETTINGS.scaled
        ):
            return ""
        return (
            f", or gains of law or motor are not: all of it is {factor:.2g} times as stated, so"
            " check them first"
        )

    def _visible(self, sign: Sign) -> str:
        """An alternative, and the smallest size of it that the log would show."""
        limits = dict(sign.visible)
        if sign.name == "compliance":
            span = _span([value**-0.5 for value in limits.values()])
            return f"compliance (detectable below {span} Hz)"
        if sign.name == "friction":  # as a share of the friction that the rig states
            limits = {
                name: value / self.stated[name]
                for name, value in limits.items()
                if self.stated.get(name)
            }
        # In units of the text.
        factor, unit, title = _QUANTITIES[sign.name]
        # A joint that would show an effect only when it is huge is listed apart.
        if unit == "%":
            largest = SETTINGS.blind_percent
        else:
            largest = SETTINGS.blind_factor * factor * min(limits.values(), default=0.0)
        sizes = {
            name: factor * value for name, value in limits.items() if factor * value <= largest
        }
        if not sizes:
            return f"{title} (none is detectable)"
        if max(sizes.values()) > SETTINGS.smallest:
            span = _span([*sizes.values()])
        else:
            span = f"less than {SETTINGS.smallest:g}"
        # The order of the joints, each once.
        blind = dict.fromkeys(self._joint(name) for name in limits if name not in sizes)
        exception = f", not at {', '.join(blind)}" if blind else ""
        return f"{title} (detectable from {span} {unit}{exception})"

    def _joint(self, name: str) -> str:
        """Joint of a number such as ``gear[1]``."""
        return self.joints[int(name.partition("[")[2].partition("]")[0])]

    def _by_joint(self, sign: Sign) -> str:
        """Fitted values of a sign, joint by joint."""
        if sign.name == "friction":
            return "; ".join(self._friction(name, value) for name, value in sign.values.items())
        if sign.name == "compliance":
            # Stiff gears are part of the fit, but not of the text.
            gears = [f"{hz:.0f} Hz at {joint}" for joint, hz in self.resonances.items()]
            return ", ".join(gears) or "some resonance"
        if sign.name == "reversals":
            return self._joint(next(iter(sign.values)))
        if sign.name in _BY_JOINT:
            factor = _QUANTITIES[sign.name].factor
            return ", ".join(
                _BY_JOINT[sign.name].format(factor * value, self._joint(name))
                for name, value in sign.values.items()
            )
        if sign.name == "cogging":
            return self._cogging(sign)
        return ""

    def _cogging(self, sign: Sign) -> str:
        """Amplitudes of cogging, from the pairs ``cogging.6cos[i]`` and ``cogging.6sin[i]``."""
        # One cosine and one sine per motor: their root sum of squares is the amplitude.
        cosines = [name for name in sign.values if "cos" in name]
        sizes = {
            name: np.hypot(sign.values[name], sign.values[name.replace("cos", "sin")])
            for name in cosines
        }
        # A motor below the detectable amplitude is noise, unless all are.
        shown = [name for name in cosines if sizes[name] > sign.visible[name]] or cosines
        texts = []
        for name in shown:
            cycles = name.removeprefix("cogging.").partition("cos")[0]
            texts.append(f"{sizes[name]:.2g} N m, {cycles} times per turn, at {self._joint(name)}")
        return ", ".join(texts)

    def _friction(self, name: str, value: float) -> str:
        """Friction of a joint, fitted and stated."""
        # Fitted values are deviations from the stated ones.
        kind = name.partition("[")[0]
        stated = self.stated.get(name, 0.0)
        unit = {"viscous": "N m s/rad", "coulomb": "N m"}[kind]
        return f"{kind} of {self._joint(name)} {stated + value:.3g} {unit}, stated {stated:.3g}"


def _span(values: list[float]) -> str:
    """Smallest and largest value, as a text."""
    # Two digits, but no exponent for hundreds.
    low, high = (
        f"{value:.2g}" if value < 100 else f"{value:.0f}" for value in (min(values), max(values))
    )
    # Values that print alike are one.
    return low if low == high else f"{low} to {high}"
