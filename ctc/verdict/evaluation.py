"""`Evaluation`: tracking error in encoder pulses, torque and chatter of a simulated run."""

import functools
import math
from collections.abc import Callable, Iterator
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.figures import plot_evaluation, plot_phase
from ctc.laws import ModelLaw
from ctc.verdict.on_gears import SETTLED, FromRest, LowestResonance, from_rest, lowest_resonance
from ctc.verdict.servos import in_play, slow_profiles
from plant import Arm, Record
from plant.compiler import cores
from plant.machine import DAMPING_RATIO
from plant.parts import (
    Floats,
    Piece,
    Shown,
    Verdict,
    by_joint,
    frozen,
    heading,
    significant,
    with_units,
)


@frozen
class Evaluation(Shown):
    """Tracking error and torque of a simulated arm under a controller. Print it for a table.

    Attributes
    ----------
    arm : Arm
    record : Record
    true_error_pulses : (N steps_per_sample, n) numpy.ndarray
        Reference minus joint, unrounded, at every sub-step [pulses]; with elastic gears, of the
        motor.
    max_error_pulses, rms_error_pulses : (n,) numpy.ndarray
        Of the quantised tracking error, magnitude.
    max_true_error_pulses : (n,) numpy.ndarray
        Largest of the true error, at every sub-step, magnitude [pulses].
    link_error : (N, n) numpy.ndarray
        Commanded motion of the links (`Reference.links`) minus theirs, behind the gears, at the
        samples [rad].
    peak_torque, rms_torque : (n,) numpy.ndarray
        Joint side [N m].
    chatter : (n,) numpy.ndarray
        Mean change of the torque from one sample to the next, magnitude [N m].
    saturation : (n,) numpy.ndarray
        Share of the samples at the amplifier's limit.

    See Also
    --------
    ctc.evaluate

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, evaluate
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> report = evaluate(arm, rig, ComputedTorque(arm, rig), puma560.reference(), duration=0.5)
    >>> report.within(1), report.share_within(1)
    (True, '100.00%')
    """

    arm: Arm
    record: Record
    true_error_pulses: Floats

    @property
    def joint_labels(self) -> list[str]:
        """Names of the joints in tables and figures."""
        return self.arm.dynamics.chain.joint_labels

    @property
    def max_error_pulses(self) -> Floats:
        # Whole pulses, as the counter of a machine shows them.
        return np.abs(self.record.error_pulses).max(axis=0)

    @property
    def max_true_error_pulses(self) -> Floats:
        return np.abs(self.true_error_pulses).max(axis=0)

    @property
    def link_error(self) -> Floats:
        # On elastic gears the reference of the motors differs from the motion of the links.
        record: Any = self.record
        return record.reference.links(record.t).q - record.true_q

    @property
    def rms_error_pulses(self) -> Floats:
        return np.sqrt(np.mean(self.record.error_pulses**2, axis=0))

    @functools.cached_property
    def on_gears(self) -> LowestResonance | None:
        """Elastic gears on which this run would stay within ±1 pulse.

        None for a rig whose gears are elastic, and for a run with an injected torque.
        """
        record: Any = self.record
        # A torque that was injected at samples of this run has no meaning on another one.
        if record.rig.drive.elasticity is not None or record.injected is not None:
            return None
        # A run that exceeds the limit on rigid gears needs no simulation on softer ones.
        if (np.abs(record.error_pulses[record.t >= SETTLED]) > 1).any():
            return LowestResonance.none(DAMPING_RATIO, 1)
        # Tuples, since the results are stored by their arguments.
        start = None if record.initial is None else tuple(map(tuple, record.initial.tolist()))
        return lowest_resonance(*self._loop, DAMPING_RATIO, SETTLED, cores(), start)

    @functools.cached_property
    def from_rest(self) -> FromRest | None:
        """Run of an arm at rest, where the path begins in motion and that arm exceeds the limit."""
        record: Any = self.record
        # A run that itself began at rest has nothing to add.
        began_at_rest = record.initial is not None and not record.initial[1].any()
        if record.injected is not None or began_at_rest:
            return None
        return from_rest(*self._loop)

    @property
    def _loop(self) -> Any:
        """Arguments of the loop: arm, rig, law, reference, limit, duration, steps per sample."""
        record = self.record
        # The true error has a row for each sub-step.
        steps = len(self.true_error_pulses) // len(record)
        duration = len(record) * record.rig.period
        return self.arm, record.rig, record.law, record.reference, 1, duration, steps

    @property
    def refused(self) -> str | None:
        """Why `start` would refuse this controller at the first sample; None where it would not."""
        record: Any = self.record
        # Only laws with a model have a test of their own stability.
        if isinstance(record.law, ModelLaw):
            try:
                record.law.require_stable(record.rig, record.counts[0])
            except ValueError as error:
                return f"`start` refuses this controller: {error}"
        return None

    @property
    def holds(self) -> bool:
        """Whether the run stays within ±1 pulse, and a machine would begin as it did."""
        # A verdict on a run that no machine would begin is not positive.
        return self.within(1) and not self.reasons

    @property
    def reasons(self) -> list[str]:
        """Why a machine would not begin as this run did, one line each."""
        from_rest = None if self.from_rest is None else str(self.from_rest)
        return [line for line in (from_rest, self.refused) if line is not None]

    @property
    def conditions(self) -> list[str]:
        """Assumptions of the verdict, and a machine's behaviour without them, one line each."""
        gears = [] if self.on_gears is None else [f"rigid gears assumed; {self.on_gears}"]
        return [*gears, *self.in_play, *self.slow_profiles, *self.reasons]

    @property
    def in_play(self) -> list[str]:
        """Joints that move within the play before their encoder, one line each."""
        return in_play(self.record.rig, self.joint_labels, self.max_error_pulses)

    @property
    def slow_profiles(self) -> list[str]:
        """Joints whose servo moves its own goal slower than the path does, one line each."""
        record: Any = self.record
        return slow_profiles(record.rig, self.joint_labels, record.reference(record.t).qd)

    @property
    def lowest_resonance(self) -> float | None:
        """Locked-rotor resonance [Hz] above which this run stays within ±1 pulse.

        See `on_gears`.
        """
        return None if self.on_gears is None else self.on_gears.hz

    @property
    def _torque(self) -> Floats:
        return np.asarray(self.record.torque)

    @property
    def peak_torque(self) -> Floats:
        return np.abs(self._torque).max(axis=0)

    @property
    def rms_torque(self) -> Floats:
        return np.sqrt(np.mean(self._torque**2, axis=0))

    @property
    def chatter(self) -> Floats:
        # From one sample to the next: what wears gears and heats motors.
        return np.abs(np.diff(self._torque, axis=0)).mean(axis=0)

    @property
    def saturation(self) -> Floats:
        limit = self.record.rig.drive.current_limit
        # Rounding may leave a limited current just below the limit.
        return (np.abs(np.asarray(self.record.current)) >= limit * (1 - 1e-12)).mean(axis=0)

    def fraction_within(self, k: float) -> float:
        """Share of the samples at which every joint's encoder error is within +-k pulses."""
        if not isinstance(k, Real) or not k >= 0:
            raise ValueError(
                f"k must be a number of pulses, 0 or more; got {k!r}. The promise is 1."
            )
        # All joints at once: a sample counts only where every joint is inside.
        return float((np.abs(self.record.error_pulses) <= k).all(axis=1).mean())

    def share_within(self, k: float) -> str:
        """`fraction_within` as text, rounded down, so that 100.00% means all samples."""
        # 1e-9 keeps a share of 1 less a rounding error at 100 %.
        return f"{math.floor(self.fraction_within(k) * 1e4 + 1e-9) / 100:.2f}%"

    def within(self, k: float) -> bool:
        """Whether every joint's encoder error is within +-k pulses at every sample."""
        return self.fraction_within(k) == 1.0

    def plot(self, ax: Any = None, *, phase: bool = False) -> NDArray[Any]:
        """Draw error and torque of every joint on (n, 2) Axes.

        With `phase`, draw the phase plot of the true error on (n,) Axes.
        """
        return plot_phase(self, ax) if phase else plot_evaluation(self, ax)

    def _short(self) -> str:
        share = f"{self.share_within(1)} of {len(self.record)} samples within ±1 pulse"
        return f"{type(self.record.law).__name__}: {share}"

    def _shown(self) -> Iterator[Piece]:
        elastic = self.record.rig.drive.elasticity is not None
        # On elastic gears encoder and controller know the motor alone.
        part = "motor" if elastic else "joint"
        decimals = "{:.2f}".format
        units = self.arm.dynamics.chain.joint_units
        pulses = ["pulses"] * len(units)
        efforts = [unit.effort for unit in units]
        quantities: list[tuple[str, Floats, Callable[[float], str], list[str]]] = [
            ("encoder error, peak", self.max_error_pulses, "{:.0f}".format, pulses),
            ("encoder error, RMS", self.rms_error_pulses, decimals, pulses),
            (f"true {part} error, peak", self.max_true_error_pulses, decimals, pulses),
        ]
        # Encoders sit on the motors: elastic gears hide an error of the links.
        if elastic:
            link = 1e3 * np.abs(self.link_error)
            rms = np.sqrt(np.mean(link**2, axis=0))
            thousandths = [f"m{unit.position}" for unit in units]
            of_link = ("peak", link.max(axis=0)), ("RMS", rms)
            quantities += [
                (f"link error, {kind}", value, "{:.3f}".format, thousandths)
                for kind, value in of_link
            ]
        # The torques of a wrist are thousandths of those of a shoulder.
        quantities += [
            ("torque, peak", self.peak_torque, significant, efforts),
            ("torque chatter per sample", self.chatter, significant, efforts),
        ]
        rows = [
            (heading(title, of_joints), *with_units(map(form, values), of_joints))
            for title, values, form, of_joints in quantities
        ]
        rows.append(("share at the amplifier's limit", *map("{:.2%}".format, self.saturation)))
        # The verdict first, then the numbers, then the assumptions.
        yield Verdict(self._short(), self.holds)
        yield by_joint(self.joint_labels, rows)
        yield from self.conditions
