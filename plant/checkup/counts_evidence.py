"""Evidence that counts and stamps give, beside the score."""

from collections.abc import Iterator

import numpy as np

from plant.checkup.hypothesis import Joints, columns_of
from plant.checkup.quantisation import noted_steps
from plant.checkup.rounding import rounding_log_odds
from plant.checkup.score import SETTINGS as SCORE
from plant.checkup.score import Experiment
from plant.checkup.sizes import common_step
from plant.checkup.stamps import another_period, unit_of_time
from plant.checkup.undo import counted_edges, counted_in_steps, other_resolution
from plant.parts import frozen_settings


@frozen_settings
class CountsSettings:
    """When another resolution, unit of time or period explains a log; chosen by hand.

    Parameters
    ----------
    printed : float
        Distance from a whole number that the rounding of a stated resolution leaves [pulses per
        turn].
    strange : float
        The angles are in doubt if the motion leaves more than this multiple of the share of torque
        that it may leave unexplained in right logs. Drawn machines with springs reach 10.
    below_rotor : float
        The resolution is in doubt if another one raises the log odds of the inertias by more than
        this: as much as two joints whose inertia is surely below that of the rotor.
    per_e_fold : float
        Log odds per factor e of a unit of time, and per thousandth of a period. Stamps and period
        come from one clock: a thousandth is 3 standard deviations of what is usual.
    """

    printed: float = 0.01
    strange: float = 12.0
    below_rotor: float = 40.0
    per_e_fold: float = 10.0


SETTINGS = CountsSettings()


def rounding_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of the convention that is not stated, by the width of the cell at zero."""
    encoder = experiment.record.rig.encoder
    # Positions that were no whole pulses were rounded by the reader, not by a counter.
    if encoder.smooth or noted_steps(experiment.record):
        return
    odds = rounding_log_odds(experiment.signals)
    if odds is not None:
        yield 1.0, -odds if encoder.rounding == "fix" else odds


def grid_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of counts that are multiples of one step: free counts would use the cells between.

    A broken step is a factor of units; a whole one is a coarser encoder, of which no log knows
    whether the rig or the counts are to change.
    """
    for step in common_step(experiment, joints):
        if step % 1:
            levels = len(np.unique(experiment.signals.counts[:, 0]))
            yield step, levels * float(np.log(step))


def radian_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of a resolution per radian."""
    changed = experiment.changed(other_resolution(experiment.record, joints, 2 * np.pi))
    yield from _stranger(experiment, changed, 2 * np.pi)


def edges_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of lines that are stated in place of counts, or the reverse."""
    follows = experiment.signals.tracks[columns_of(joints)].all()
    # Of some joints alone the motion is no evidence: the others' torques are coupled to them.
    if follows and len(joints) not in (0, experiment.n):
        return
    for size in EDGES:
        changed = experiment.changed(counted_edges(experiment.record, joints, size))
        # Counts that do not follow their reference show the factor by themselves.
        if not follows:
            yield size, changed.score - experiment.score
        else:
            yield from _stranger(experiment, changed, size)


EDGES = (4.0, 2.0, 0.5, 0.25)
"""Counts per pulse that is stated: a line of an encoder has four edges, of which some count two."""


def _stranger(experiment, changed, size):
    """Log odds of another resolution, if an arm can have its gravity and inertia, not the stated.

    What springs and other arms need of more columns is a small share of their torque.
    """
    if experiment.motions is None or changed.motions is None:
        return
    before, after = (
        max(motion.unexplained for motion in motions)
        for motions in (experiment.motions, changed.motions)
    )
    inertia = float((changed.beside_law["inertia"] - experiment.beside_law["inertia"]).sum())
    strange = before > SETTINGS.strange * SCORE.motion or inertia > SETTINGS.below_rotor
    if strange and after < SCORE.motion:
        stated, restated = (
            _whole_pulses(each.record.rig.encoder) for each in (experiment, changed)
        )
        yield size, changed.score - experiment.score + restated - stated


def _whole_pulses(encoder):
    """Log odds that the resolution is whole pulses per turn, as it is made, not any number."""
    broken = np.abs(encoder.resolution - np.round(encoder.resolution))
    return float(np.maximum(np.log(0.5 / SETTINGS.printed) - broken / SETTINGS.printed, 0.0).sum())


def steps_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """How much likelier the log is where law and rig count in whole steps."""
    for step in common_step(experiment, joints):
        changed = experiment.changed(counted_in_steps(experiment.record, joints, step))
        yield step, changed.score - experiment.score


def _interval_ratio(experiment):
    return experiment.signals.interval / experiment.record.rig.period


def time_unit_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of times in milliseconds or microseconds, by the rig's period."""
    factor = unit_of_time(_interval_ratio(experiment))
    if factor != 1:
        yield factor, abs(float(np.log(factor))) * SETTINGS.per_e_fold


def period_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of another period of the rig, by the median interval of the stamps."""
    ratio = _interval_ratio(experiment)
    if another_period(experiment.signals, ratio) and abs(np.log(ratio)) < 3:
        yield float(ratio), abs(float(np.log(ratio))) * 1e3 * SETTINGS.per_e_fold
