"""Which inner loop is the best: the register of a servo, or the gains that a drive's frames carry.

Computed torque with its default tuning is simulated above each inner loop. A stiff inner loop has
smaller errors, but it makes more torque of every encoder count, and it cycles where a gear has
backlash. A soft one leaves more of the error to the law above it.
"""

import dataclasses
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ctc.certification import Task, percent
from ctc.laws import ComputedTorque
from ctc.tuning.effort_scale import effort_scale
from identification import IdentificationWarning
from plant import MitDrive, Rig
from plant.machine import InnerLoop
from plant.parts import (
    Floats,
    Frozen,
    Piece,
    Shown,
    Table,
    Verdict,
    frozen,
    heading,
    instance,
    largest_cell,
)


@frozen
class InnerTrial(Shown, Frozen):
    """An inner loop under the default computed torque, on samples of the uncertainty.

    `register`: the key under which the loop was given, such as the value of P. `inner`: the loop.
    `left`, `of`: samples that exceed the limit, and samples simulated. `peak`: largest tracking
    error of any sample [pulses]. `chatter` (n,): mean change of the motors' torque from one
    sampling instant to the next, mean of samples and motions [N m, or N where a joint slides].
    `noise`: the same in shares of each joint's torque along the motions, mean of the joints.
    `peak`, `chatter` and `noise` are infinite where a loop diverged.
    """

    register: Any
    inner: InnerLoop
    left: int
    of: int
    peak: float
    chatter: Floats
    noise: float

    @property
    def rank(self) -> tuple[int, float]:
        """Rank of a trial; a smaller one is better: first the failing samples, then the noise."""
        # A loop with more failing samples is always worse, however quiet it is. Shares of each
        # torque, as in the search above: a wrist counts like a shoulder.
        return self.left, self.noise

    @property
    def fields(self) -> str:
        """What is written to the drives: the register, or its name and the integers kp and kd."""
        # The frames of a `MitDrive` carry no register, but kp and kd as integers, for each joint.
        if not isinstance(self.inner, MitDrive):
            return str(self.register)
        kp, kd = self.inner.whole_gains
        return f"{self.register}: kp {' '.join(map(str, kp))}, kd {' '.join(map(str, kd))}"

    def _short(self) -> str:
        return (
            f"inner loop {self.register}: {self.left} of {self.of} samples exceed the limit, peak"
            f" {self.peak:.0f} pulses"
        )

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(self._short(), not self.left)


def inner_trials(
    inner: Mapping[Any, InnerLoop] | None,
    rig: Rig,
    task_above: Callable[..., Task],
    settings: Any,
    options: dict[str, Any],
) -> tuple[InnerTrial, ...]:
    """Trials of all loops, the best first; none if `inner` is None.

    `inner`: loops by their register. `task_above`: makes the certification task for a rig that has
    an inner loop. `settings`: a `ctc.tuning.search.SearchSettings`. `options`: keyword arguments
    for `under` of the sampled `Population`.
    """
    options = {**options, "steps_per_sample": settings.check_steps}
    if inner is None:
        return ()
    advice = "Give {P: PositionServo(gain=P * unit) for P in (8, 16, 32)}, or MitDrives by a name."
    if not isinstance(inner, Mapping) or not inner:
        raise ValueError(f"inner must be loops by their register; got {inner!r:.60}. {advice}")
    trials = []
    for register, loop in inner.items():
        instance(f"inner[{register!r}]", loop, InnerLoop, advice)
        with warnings.catch_warnings():
            # `tune` itself gives the warnings of the identification.
            warnings.simplefilter("ignore", IdentificationWarning)
            above = dataclasses.replace(rig, inner=loop)
            task = task_above(above, progress=False, checkpoint=None)
            law = ComputedTorque(task.found, task.rig)
        # Every loop is simulated with the same samples, so that trials differ by the loop alone.
        plants = task.sampled(settings.inner_samples)
        runs = [
            plants.under(law, path, duration=duration, **options).run(task.threads)
            for path, duration in task.motions.values()
        ]
        # A sample fails if any motion leaves the limit, as in the certificate.
        failed = np.any([run.outside > 0 for run in runs], axis=0)
        chatter = np.mean([run.chatter.mean(axis=0) for run in runs], axis=0)
        scale = effort_scale(plants.arm, plants.rig, task.motions)
        trials.append(
            InnerTrial(
                register=register,
                # A loop may have one number for all joints; the trial states one for each joint.
                inner=loop.for_joints(rig.n),
                left=int(failed.sum()),
                of=len(failed),
                peak=float(max(run.peak.max() for run in runs)),
                chatter=chatter,
                noise=float((chatter / scale).mean()),
            )
        )
    return tuple(sorted(trials, key=lambda trial: trial.rank))


def inner_table(trials: tuple[InnerTrial, ...], efforts: Sequence[str]) -> Table:
    """A row for each inner loop, the best first; `efforts`: units of the joints' torques."""
    rows = [
        (
            trial.fields,
            percent(trial.left / trial.of),
            f"{trial.peak:.0f}",
            largest_cell(trial.chatter, efforts),
        )
        for trial in trials
    ]
    head = ("inner loop", "exceed", "peak [pulses]", heading("chatter", efforts))
    return Table(head, rows, words=(0,))
