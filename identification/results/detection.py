"""What a log says against the rig that it came with: compliance, backlash, lag, other friction,
late counts.

Every identification tests whether one of them explains the innovations of all its records, those
held out too, where the model follows them best. What explains most is fitted, the rest tested again
beside it, until none is significant.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from identification.equation_error.between_runs import BetweenRuns
from identification.equation_error.least_squares import at_least
from identification.results.alternatives import Sign
from identification.search.outcome import Fit
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown, Verdict, Warned

_STIFF = 300.0  # resonance above which a gear is not mentioned [Hz]
# What turns the numbers of `Extended` into those of a text, their units, and their name there.
_LIMITS = {
    "backlash": (180 / np.pi, "degrees", "backlash"),
    "lag": (1e3, "ms", "lag"),
    "delay": (1.0, "samples", "delay"),
    "gear": (100.0, "%", "another gear"),
    "offset": (1.0, "N m of the motor", "an offset of the torque"),
    "cogging": (1.0, "N m of the motor", "cogging"),
    "length": (100.0, "%", "another length"),
    "lead": (1e3, "ms", "a derivative in the law"),
    "friction": (100.0, "%", "other friction"),
}
# limits from which on a joint shows nothing; in other units, of the least one
_BLIND = {"%": 100.0}
_FAR = 1e4

# Factor and text of the numbers of a joint.
_EACH = {
    "gear": (100.0, "{:+.2g} % at {}"),
    "offset": (1.0, "{:.3g} N m at {}"),
    "lead": (1e3, "{:.2g} ms at {}"),
    "length": (100.0, "{:+.2g} % before {}"),
}

# What contradicts the model, and what to do.
_SAID = {
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
    "friction": (
        "friction is not the rig's{scaled} ({chance}): {each}. Add these numbers to unknown"
        " (drive.viscous[0] and so on)."
    ),
    "offset": (
        "torques have an offset that the rig lacks, {each}, motor side ({chance}), which biases f."
        " Give the drive a FrictionCurve(offset=0 of each joint), and add drive.curve.offset[0] and"
        " so on to unknown."
    ),
    "gear": (
        "gears (or lengths, or counts per turn) are not the rig's: {each} ({chance}), which biases"
        " f. Check them, or add drive.gear[0] and so on to unknown."
    ),
    "cogging": "motors cog: {each}, motor side ({chance}). Give the drive a TorqueRipple of that.",
    "length": (
        "the arm's lengths are not the chain's: {each} ({chance}), which biases f. Measure them,"
        " and correct the chain."
    ),
    "lead": (
        "the stated law lacks the rate of its error: torques lead by {each} ({chance}), which"
        " biases f. Check the law; a PD has such a lead, its derivative per gain."
    ),
    "reversals": (
        "the model fails where the load of {each} changes sign: squared innovations are {ratio:.2g}"
        " times those elsewhere. Its gear has backlash, wider than the model of it tells."
    ),
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
UNFITTED = ("reversals", "disagreement")  # what is told, but is no number of a model

# by which friction is off in all its numbers, and by which they may differ: then torques are scaled
_SCALED = 0.08
_LEAST = 1e-3  # of these units, below which nobody asks


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Detection(Shown, Frozen):
    """What a log says against its rig; printed, a line.

    Attributes
    ----------
    signs : tuple of Sign
        Of all alternatives, beside the model as it is.
    named : tuple of Sign
        What contradicts the model, the first first; each beside those before it, with fitted
        values.
    stated : dict
        Friction that the rig states, motor side [N m s/rad, N m], by the names of a sign's values.
    joints : tuple of str
        What to call each joint.
    reason : str or None
        Why nothing could be tested.
    doubt : (k, k) numpy.ndarray or None
        What is added to the covariance of the unknowns for what the model may lack; see
        `model_error`.
    grouped : (k,) numpy.ndarray or None
        Their least standard deviations, from how they differ between segments, and records; see
        `least_squares`.
    between : BetweenRuns or None
        How they differ between two records or more.
    mean : Fit or None
        The mean of what each record alone says, where they contradict each other, known to noise.
    assumed : dict
        Their change (k,) if a gear, a motor's gain, or a gain of the law is 1 % larger, by its
        name.
    friction : dict
        Standard deviations of friction that was not unknown, if it had been, by the names of a
        sign's values.
    """

    signs: tuple[Sign, ...] = ()
    named: tuple[Sign, ...] = ()
    stated: dict[str, float] = dataclasses.field(default_factory=dict)
    joints: tuple[str, ...] = ()
    reason: str | None = None
    doubt: Floats | None = None
    grouped: Floats | None = None
    between: BetweenRuns | None = None
    mean: Fit | None = None
    assumed: dict[str, Floats] = dataclasses.field(default_factory=dict)
    friction: dict[str, float] = dataclasses.field(default_factory=dict)

    def whole(self, fit: Fit) -> Fit:
        """A fit, or the mean, whose covariance counts what the rig may lack; the same one where
        that adds nothing.
        """
        fit = fit if self.mean is None else self.mean
        if (
            fit.covariance is None
            or fit.resonance is not None
            or self.doubt is None
            or self.grouped is None
        ):
            return fit
        covariance = at_least(fit.covariance + self.doubt, self.grouped)
        noise = fit.covariance
        return dataclasses.replace(
            fit, covariance=covariance, noise_covariance=noise, between=self.between
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what contradicts the model, each once."""
        return tuple(dict.fromkeys(sign.name for sign in self.named))

    @property
    def resonances(self) -> dict[str, float]:
        """Locked-rotor resonance [Hz] of each gear that was found to give, by joint."""
        return {
            self._joint(name): value**-0.5
            for name, value in self._values("compliance")
            if value > _STIFF**-2
        }

    @property
    def played(self) -> tuple[str, ...]:
        """Joints in whose gears backlash was found."""
        played = [
            name
            for name, value in self._values("backlash")
            if name.startswith("backlash") and value
        ]
        return tuple(dict.fromkeys(map(self._joint, played)))

    def _values(self, kind: str) -> list[tuple[str, float]]:
        """What was found of one alternative, by name."""
        return [item for sign in self.named if sign.name == kind for item in sign.values.items()]

    def _short(self) -> str:
        if self.reason is not None:
            return "not tested"
        tested = f"{len(self.signs)} tests, none significant"
        return f"significant: {', '.join(self.names)}" if self.named else tested

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(str(self), None if self.reason is not None else not self.named)
        yield Warned(list(self.warnings()))

    def __str__(self) -> str:
        if self.reason is not None:
            return f"compliance, backlash, lag, friction: not tested: {self.reason}"
        found = {sign.name: sign for sign in self.signs}
        others = [sign for sign in self.signs if sign.name not in (*self.names, *UNFITTED)]
        # by what is named: so what was significant beside it is not
        explained = set(self.names) - {*UNFITTED}
        unclear = [sign.name for sign in others if sign.significant and not explained]
        clean = [self._visible(sign) for sign in others if sign.name not in unclear]
        parts = [f"no sign of {'; '.join(clean)}"] if clean else []
        if unclear:
            some = ", ".join(unclear)
            parts.append(
                f"significant, but explaining next to nothing: {some} (are lengths and rig right?)"
            )
        if "disagreement" in found:
            sign = found["disagreement"]
            verb = "contradict each other" if sign.significant else "agree"
            parts.append(f"the records {verb} (chi-square {sign.chi_square:.0f} of {sign.freedom})")
        if "compliance" not in found and "compliance" not in self.names:
            untested = "compliance and backlash not tested (no inertia beside the motors')"
            parts.append(
                "compliance cannot be told from the unknowns" if "backlash" in found else untested
            )
        return ". ".join([f"significant: {', '.join(self.names)}"] * bool(self.names) + parts)

    def warnings(self) -> Iterator[str]:
        """A line for each that contradicts the model; of backlash for each joint."""
        for sign in self.named:
            value = sign.values.get(sign.name, 0.0)
            about = {
                "each": self._each(sign),
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
            } | {name: getattr(sign, name) for name in ("chi_square", "freedom", "threshold")}
            played = [name for name in sign.values if name.startswith("backlash")] or [""]
            for name in played:
                joint = (
                    {"joint": self._joint(name), "degrees": np.rad2deg(sign.values[name])}
                    if name
                    else {}
                )
                rivals = (
                    f" Another cause explains nearly as much: {', '.join(sign.rivals)}."
                    if sign.rivals
                    else ""
                )
                yield _SAID[sign.name].format(**about, **joint) + rivals

    def _scaled(self, sign: Sign) -> str:
        """What else than friction, where all of it is off by one factor: torques are, by a wrong
        gain.
        """
        ratios = [
            1 + value / self.stated[name]
            for name, value in sign.values.items()
            if self.stated.get(name)
        ]
        factor = float(np.median(ratios)) if len(ratios) > 2 else 1.0
        if (
            not factor > 0
            or abs(factor - 1) < _SCALED
            or np.abs(np.array(ratios) / factor - 1).max() > _SCALED
        ):
            return ""
        return (
            f", or gains of law or motor are not: all of it is {factor:.2g} times as stated, so"
            " check them first"
        )

    def _visible(self, sign: Sign) -> str:
        """An alternative, and the least of it that would have been seen."""
        limits = list(sign.visible.items())
        kind = sign.name
        if kind == "compliance":
            return f"compliance (detectable below {_span([value**-0.5 for _, value in limits])} Hz)"
        if kind == "friction":
            limits = [
                (name, value / self.stated[name]) for name, value in limits if self.stated.get(name)
            ]
        scale, unit, said = _LIMITS[kind]
        most = _BLIND.get(unit, _FAR * scale * min((value for _, value in limits), default=0.0))
        told = {name: scale * value for name, value in limits if scale * value <= most}
        if not told:
            return f"{said} (none is detectable)"
        seen = _span([*told.values()]) if max(told.values()) > _LEAST else f"less than {_LEAST:g}"
        blind = dict.fromkeys(self._joint(name) for name, _ in limits if name not in told)
        but = f", not at {', '.join(blind)}" if blind else ""
        return f"{said} (detectable from {seen} {unit}{but})"

    def _joint(self, name: str) -> str:
        return self.joints[int(name.partition("[")[2].partition("]")[0])]

    def _each(self, sign: Sign) -> str:
        """What a sign found, joint by joint."""
        if sign.name == "friction":
            return "; ".join(self._level(name, value) for name, value in sign.values.items())
        if sign.name == "compliance":
            return (
                ", ".join(f"{hz:.0f} Hz at {joint}" for joint, hz in self.resonances.items())
                or "some resonance"
            )
        if sign.name == "reversals":
            return self._joint(next(iter(sign.values)))
        if sign.name in _EACH:
            scale, form = _EACH[sign.name]
            return ", ".join(
                form.format(scale * value, self._joint(name)) for name, value in sign.values.items()
            )
        if sign.name == "cogging":
            pairs = [name for name in sign.values if "cos" in name]
            sizes = {
                name: np.hypot(sign.values[name], sign.values[name.replace("cos", "sin")])
                for name in pairs
            }
            shown = [name for name in pairs if sizes[name] > sign.visible[name]] or pairs
            form = "{:.2g} N m, {} times per turn, at {}"
            return ", ".join(
                form.format(sizes[name], name[8 : name.index("cos")], self._joint(name))
                for name in shown
            )
        return ""

    def _level(self, name: str, value: float) -> str:
        """Friction of a joint, found and stated."""
        kind = name.partition("[")[0]
        stated = self.stated.get(name, 0.0)
        unit = {"viscous": "N m s/rad", "coulomb": "N m"}[kind]
        return f"{kind} of {self._joint(name)} {stated + value:.3g} {unit}, stated {stated:.3g}"


def _span(values: list[float]) -> str:
    """The least and the largest, as a text."""
    low, high = (
        f"{value:.2g}" if value < 100 else f"{value:.0f}" for value in (min(values), max(values))
    )
    return low if low == high else f"{low} to {high}"
