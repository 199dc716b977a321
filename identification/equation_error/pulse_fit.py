"""Equation error of records: torques from the law, motion from the counts, in a pass band.

Under a law without memory the torque of the motors follows from the logged counts, as exactly as
they are known. Low frequencies hardly excite inertias; above the slow mode of the position loop the
rounding of the counts dominates. So the pass band is twice the frequency of that mode: found first
in the spectrum of the tracking error, then, once a first f is there, from the linearised loop.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.equation_error.band_choice import choose_band
from identification.equation_error.filters import BAND_MOST, CUTOFF
from identification.equation_error.naming import of_each
from identification.equation_error.prior import Known
from identification.equation_error.regressor import (
    Filtering,
    System,
    balance,
    linear,
    regressor_and_torque,
)
from identification.equation_error.torque_fit import TorqueFit, weighted
from identification.equation_error.torque_logs import torque_of
from plant import Arm, Dynamics, Law, Record, Rig, modes
from plant.checkup import on_lines, spectrum
from plant.parts import Floats, frozen_settings
from plant.simulation import Clock, jacobians


@frozen_settings
class PassBandSettings:
    """How the pass band of a record is chosen; chosen by hand.

    Parameters
    ----------
    modes : float
        Pass band, in frequencies of the slow mode of the position loop.
    paths : float
        Pass band where nothing oscillates, in the highest frequency of the path.
    path_power : float
        Least ratio of the power of the path to that of rounding.
    lowest : float
        Lowest frequency at which a mode is searched [Hz].
    highest : float
        Highest frequency at which a mode is searched, in sample rates.
    poses : int
        Poses of a record at which its loop is linearised.
    """

    modes: float = 2.0
    paths: float = 8.0
    path_power: float = 1000.0
    lowest: float = 3.0
    highest: float = 0.1
    poses: int = 8


SETTINGS = PassBandSettings()

NO_BAND = (
    "the unknowns must be identifiable in some band; they are in none. Log a motion that excites"
    " more."
)
# Equations per unknown below which a fit in a band is no evidence.
ENOUGH = 5

# Bands that are tested where a torque was logged [Hz]: half octaves.
BANDS = 2.0 ** np.arange(-1, 6, 0.5)


def mode_in(record: Record) -> float:
    """Frequency [Hz] of the strongest oscillation in the tracking errors of a record.

    The strongest acceleration counts, not the largest error.

    Raises
    ------
    ValueError
        Nothing oscillates, or too fast for the samples.
    """
    # Rows without weight may hold anything, and their jumps are fast.
    errors = on_lines(record, record.valid == 0).error_pulses
    frequency, power = spectrum(errors, record.rig.period)
    # Weighted with frequency squared: the slow errors of the motion are larger than a mode's.
    power = np.convolve((power * frequency[:, None] ** 2).sum(axis=1), np.ones(5) / 5, mode="same")
    highest = SETTINGS.highest / record.rig.period
    power[(frequency < SETTINGS.lowest) | (frequency > highest)] = 0
    mode = float(frequency[power.argmax()])
    if not mode > 0:
        reason = f"sampled every {record.rig.period:g} s it does not"
        advice = "State rig.period in seconds, or log faster."
        if not np.ptp(errors, axis=0).any():
            reason = "its tracking errors are constant"
            advice = "Give counts and reference columns of their own."
        raise ValueError(f"a log must show the oscillation of its loop; {reason}. {advice}")
    return mode


def path_in(record: Record) -> float:
    """Highest frequency [Hz] at which the counts of a record hold far more than their rounding."""
    counts = on_lines(record, record.valid == 0).counts
    frequency, power = spectrum(counts, record.rig.period)
    # The upper half of the spectrum holds rounding alone.
    rounding = np.median(power[len(power) // 2 :], axis=0)
    rows = np.flatnonzero((power > SETTINGS.path_power * rounding).any(axis=1))
    return float(frequency[rows.max(initial=1)])


def pass_band(record: Record, arm: Arm | None = None) -> float:
    """Pass band [Hz] of a record's equation error: twice the slow mode.

    The mode is that of the data, or of a linearised arm.

    Under a law with a memory (computed torque), and in a log that is repeated in open loop, nothing
    oscillates, and the band is a multiple of the path's.
    """
    law = record.law
    # A log that is repeated in open loop says nothing of the loop that it was made in.
    if law is not None and (law.replays or law.has_memory(record.n)):
        return round(SETTINGS.paths * path_in(record), 1)
    band = round(SETTINGS.modes * mode_in(record), 1)
    if arm is None or record.law is None:
        return band
    # At each pose the slowest mode; of all poses the fastest of these, so that all are inside.
    at_poses = modes_along(arm, record, record.law, SETTINGS.poses)
    slow = [of_pose[0, 0] for of_pose in at_poses if len(of_pose)]
    return round(SETTINGS.modes * float(np.max(slow)), 1) if slow else band


def modes_along(arm: Arm, record: Record, law: Law, poses: int) -> list[Floats]:
    """Modes of the linearised loop at about so many poses of a record."""
    angles = record.rig.cell_centre(record.counts)
    # Evenly over the log, since the modes change with the pose.
    chosen = angles[:: max(1, len(angles) // poses)]
    return [modes(jacobians(arm, record.rig, law, pose)[0]) for pose in chosen]


def equation_error(
    dynamics: Dynamics,
    records: Sequence[Record],
    unknown: Iterable[str],
    known_values: Mapping[str, float] | None = None,
) -> TorqueFit:
    """Fit of the torque equation to records, in their pass bands.

    `unknown`: all of f, and linear numbers of the drive; others keep their values in the record.
    `known_values`: of some of them, and the prior of f.
    """
    known_values = Known(known_values)
    unknown = linear(dynamics, records[0].rig, unknown)
    records = [without_gaps(record) for record in records]

    def fitted(bands: list[float]) -> TorqueFit:
        systems = of_each(
            lambda record, band: system_of(dynamics, record, band, unknown), records, bands
        )
        return fit_systems(dynamics, unknown, known_values, systems)

    # 1. In bands by the spectrum of the tracking errors.
    initial = fitted(of_each(pass_band, records))
    values = {**known_values, **dict(zip(initial.names, initial.values, strict=True))}

    # 2. In bands by the modes of that arm.
    arm = dynamics.arm([values[name] for name in dynamics.names])
    try:
        bands = [pass_band(record, arm) for record in records]
    except (ValueError, np.linalg.LinAlgError):
        # The fit is no arm yet whose loop has a mode.
        return initial
    return fitted(bands)


def without_gaps(record: Record) -> Record:
    """A record at even times, with counts on straight lines where none were logged."""
    # Filters would ring at a jump.
    if Clock.of(record).even is None:
        record = record.resampled(record.rig.period)
    return on_lines(record, record.valid == 0)


def over_bands(
    dynamics: Dynamics,
    records: Sequence[Record],
    unknown: Iterable[str],
    known_values: Mapping[str, float] | None = None,
) -> dict[float, TorqueFit]:
    """Fits of the torque equation to logged torques in many bands: band [Hz] -> TorqueFit.

    The chosen band comes first.

    Too low a band holds too little of the motion; too high a one holds accelerations that come from
    the rounding of the counts, not from the torque: every value comes out too small. In between the
    equation holds best: the widest band that predicts segments of the logs which it has not seen as
    well as narrower ones do (`band_choice`). Then come the nearest.
    """
    unknown = linear(dynamics, records[0].rig, unknown)
    known_values = Known(known_values)
    # Filters would ring at a jump of counts that nobody logged.
    even = of_each(
        lambda record: on_lines(record, record.valid == 0).resampled(record.rig.period), records
    )
    # Wrong names are wrong in every band: they are refused here, by name.
    of_each(lambda record: balance(dynamics, record.rig, unknown, False), even)
    # Torques do not depend on the band: they are computed once for all bands.
    torques = of_each(torque_of, even)
    highest = min(BAND_MOST / record.rig.period for record in even)
    fits = {}
    systems = {}
    failure = None
    for band in BANDS[highest > BANDS].tolist():
        try:
            equations = [
                system_of(dynamics, record, band, unknown, torque=torque)
                for record, torque in zip(even, torques, strict=True)
            ]
            fit = fit_systems(dynamics, unknown, known_values, equations)
        except ValueError as error:
            # No equations in this band, or unknowns that are not separately identifiable in it.
            failure = error
            continue
        if fit.rows >= ENOUGH * len(fit.names):
            fits[band] = fit
            systems[band] = without_known(unknown, known_values, equations)[1]
    if not fits:
        raise ValueError(NO_BAND) from failure
    seconds = np.array([len(record) * record.rig.period for record in even])
    try:
        best, _ = choose_band(list(fits), systems.__getitem__, seconds, None)
    except ValueError:
        # Too few equations to leave segments out: the residual of the fit must do.
        best = min(fits, key=lambda band: fits[band].relative_error)
    return {band: fits[band] for band in sorted(fits, key=lambda band: abs(np.log(band / best)))}


def fit_systems(
    dynamics: Dynamics,
    unknown: Sequence[str],
    known_values: Known,
    systems: Iterable[System],
    seconds: Floats | None = None,
) -> TorqueFit:
    """Weighted fit, with the prior, of those unknowns that have no known value.

    `systems` have a column for every unknown, known ones too.

    `seconds`: as for `weighted`.
    """
    names, reduced = without_known(unknown, known_values, systems)
    prior = None if known_values.prior is None else known_values.prior.rows(names, known_values)
    return weighted(dynamics, names, reduced, seconds=seconds, prior=prior)


def without_known(
    unknown: Sequence[str], known_values: Mapping[str, float], systems: Iterable[System]
) -> tuple[tuple[str, ...], list[System]]:
    """Names of the unknowns without a known value, and the equations in these alone."""
    stated = [i for i, name in enumerate(unknown) if name in known_values]
    remaining = [i for i, name in enumerate(unknown) if name not in known_values]
    values = np.array([known_values[unknown[i]] for i in stated])
    reduced = [
        replace(
            system,
            regressor=system.regressor[:, :, remaining],
            torque=system.torque - (system.regressor[:, :, stated] * values).sum(axis=2),
            # The relative error of a fit is in this torque, whatever of it is known.
            measured=system.torque,
        )
        for system in systems
    ]
    return tuple(unknown[i] for i in remaining), reduced


def system_of(
    dynamics: Dynamics,
    record: Record,
    band: float,
    unknown: Sequence[str],
    torque: Floats | None = None,
) -> System:
    """The torque equation of a record in a band [Hz].

    `torque` (N, n): of `torque_of`.
    """
    rig = record.rig
    torque = torque_of(record) if torque is None else torque
    q = rig.cell_centre(record.counts)
    filtering = filtering_of(rig, min(band, BAND_MOST / rig.period))
    return regressor_and_torque(dynamics, q, torque, rig, filtering, unknown, {}, record.valid)


def filtering_of(rig: Rig, band: float) -> Filtering:
    """Filtering of counts in a band [Hz], at speeds that stand out of their rounding."""
    # Two samples per period of the band are independent; further ones would pass for more evidence.
    every = max(1, int(1 / (2 * band * rig.period)))
    return Filtering(CUTOFF * band, band, every, speed_noise(rig, band))


def speed_noise(rig: Rig, band: float) -> Floats:
    """Three standard deviations (n,) of the joint speed that rounding makes in a band [rad/s]."""
    # White rounding of variance 1 / 12 has the share 2 band period of its power in the band; the
    # mean square of the angular frequency there is (2 pi band)^2 / 3.
    # Coupled motors turn a joint together: their independent roundings add in squares.
    pulse = np.sqrt((rig.to_angle(np.eye(rig.n)) ** 2).sum(axis=0))
    return 3 * pulse / np.sqrt(12) * np.sqrt(2 * band * rig.period) * 2 * np.pi * band / np.sqrt(3)
