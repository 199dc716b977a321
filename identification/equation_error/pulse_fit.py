"""The equation error of records: torques from the law that commanded them, motion from counts, in a
pass band.

Under a law without memory the torque of the motors follows from the logged counts, as exactly as
they are known. Low frequencies hardly excite inertias; above the slow mode of the position loop the
rounding of the counts dominates. So the pass band is twice the frequency of that mode: found first
in the spectrum of the tracking error, then, once a first f is there, from the linearised loop.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from identification.equation_error.band_choice import choose_band
from identification.equation_error.naming import of_each
from identification.equation_error.prior import Known
from identification.equation_error.regressor import Filtering, System, linear, regressor_and_torque
from identification.equation_error.torque_fit import TorqueFit, weighted
from identification.equation_error.torque_logs import torque_of
from plant import Arm, Dynamics, Law, Record, Rig
from plant.analysis.linearise import modes
from plant.checkup.lost_rows import on_lines
from plant.checkup.oscillation import spectrum
from plant.parts.fields import Floats
from plant.simulation.clock import Clock
from plant.simulation.jacobians import jacobians

_BAND = 2.0  # pass band, in frequencies of the slow mode

# Pass band where nothing oscillates, in frequencies of the path; and the power of the path over
# that of rounding.
_BEYOND = 8.0
_FAR_MORE = 1000.0

CUTOFF = 2.5  # low-pass before differentiation, in pass bands

BAND_MOST = 0.4 / CUTOFF  # highest pass band, in sample rates

# where a mode is searched: from so many Hz to this share of the sample rate
_LOWEST = 3.0
_HIGHEST = 0.1

_POSES = 8

NO_BAND = (
    "the unknowns must be identifiable in some band; they are in none. Log a motion that excites"
    " more."
)
ENOUGH = 5  # equations per unknown below which a band says too little

BANDS = 2.0 ** np.arange(-1, 6, 0.5)  # bands that are tested where a torque was logged [Hz]


def mode_in(record: Record) -> float:
    """Frequency [Hz] of the strongest oscillation in the tracking errors of a record, by their
    accelerations.
    """
    frequency, power = spectrum(record.error_pulses, record.rig.period)
    power = np.convolve((power * frequency[:, None] ** 2).sum(axis=1), np.ones(5) / 5, mode="same")
    power[(frequency < _LOWEST) | (frequency > _HIGHEST / record.rig.period)] = 0
    return float(frequency[power.argmax()])


def path_in(record: Record) -> float:
    """Highest frequency [Hz] at which the counts of a record hold far more than their rounding."""
    frequency, power = spectrum(record.counts, record.rig.period)
    rows = np.flatnonzero(
        (power > _FAR_MORE * np.median(power[len(power) // 2 :], axis=0)).any(axis=1)
    )
    return float(frequency[rows.max(initial=1)])


def pass_band(record: Record, arm: Arm | None = None) -> float:
    """Pass band [Hz] of a record's equation error: twice the slow mode, of the data or of a
    linearised arm.

    Under a law with a memory (computed torque) nothing oscillates, and the band is a multiple of
    the path's.
    """
    if record.law is not None and record.law.has_memory(record.n):
        return round(_BEYOND * path_in(record), 1)
    band = round(_BAND * mode_in(record), 1)
    if arm is None or record.law is None:
        return band
    slow = [each[0, 0] for each in modes_along(arm, record, record.law, _POSES) if len(each)]
    return round(_BAND * float(np.max(slow)), 1) if slow else band


def modes_along(arm: Arm, record: Record, law: Law, poses: int) -> list[Floats]:
    """Modes of the linearised loop at about so many poses of a record."""
    angles = record.rig.cell_centre(record.counts)
    some = angles[:: max(1, len(angles) // poses)]
    return [modes(jacobians(arm, record.rig, law, pose)[0]) for pose in some]


def equation_error(
    dynamics: Dynamics,
    records: Sequence[Record],
    unknown: Iterable[str],
    known: Mapping[str, float] | None = None,
) -> TorqueFit:
    """Fit of the torque equation to records, in their pass bands.

    `unknown`: all of f, and linear numbers of the drive; others keep their values in the record.
    `known`: what some of them are, and the prior of f.
    """
    known, unknown = Known(known), linear(dynamics, records[0].rig, unknown)
    records = [_without_gaps(record) for record in records]

    def fitted(bands: list[float]) -> TorqueFit:
        systems = of_each(
            lambda record, band: system_of(dynamics, record, band, unknown), records, bands
        )
        return fit_systems(dynamics, unknown, known, systems)

    first = fitted([pass_band(record) for record in records])
    values = {**known, **dict(zip(first.names, first.values, strict=True))}
    arm = dynamics.arm([values[name] for name in dynamics.names])
    try:
        bands = [pass_band(record, arm) for record in records]
    except (ValueError, np.linalg.LinAlgError):  # no arm yet that has a mode
        return first
    return fitted(bands)


def _without_gaps(record: Record) -> Record:
    """A record at even times, with counts on straight lines where none were logged: filters
    would ring at a jump.
    """
    if Clock.of(record).even is None:
        record = record.resampled(record.rig.period)
    missing = record.valid == 0
    return record if missing.all() else on_lines(record, missing)


def over_bands(
    dynamics: Dynamics,
    records: Sequence[Record],
    unknown: Iterable[str],
    known: Mapping[str, float] | None = None,
) -> dict[float, TorqueFit]:
    """Fits of the torque equation to logged torques, band [Hz] -> TorqueFit; first the band that is
    chosen.

    Too low a band holds too little of the motion; too high a one holds accelerations of the counts'
    rounding, and of what the torque does not drive: every value comes out too small. In between the
    equation holds best: the widest band that predicts segments of the logs which it has not seen as
    well as narrower ones do (`band_choice`). Then come the nearest.
    """
    unknown, known = linear(dynamics, records[0].rig, unknown), Known(known)
    even = of_each(lambda record: record.resampled(record.rig.period), records)
    torques = of_each(torque_of, even)
    highest = min(BAND_MOST / record.rig.period for record in even)
    fits, systems = dict[float, TorqueFit](), dict[float, list[System]]()
    for band in BANDS[highest > BANDS].tolist():
        try:
            whole = [
                system_of(dynamics, record, band, unknown, torque=torque)
                for record, torque in zip(even, torques, strict=True)
            ]
            fit = fit_systems(dynamics, unknown, known, whole)
        # a band without equations, or in which unknowns are not separately identifiable
        except ValueError:
            continue
        if fit.rows >= ENOUGH * len(fit.names):
            fits[band], systems[band] = fit, without_known(unknown, known, whole)[1]
    if not fits:
        raise ValueError(NO_BAND)
    seconds = np.array([len(record) * record.rig.period for record in even])
    try:
        best, _ = choose_band(list(fits), systems.__getitem__, seconds, None)
    except ValueError:  # too few equations to leave some out
        best = min(fits, key=lambda band: fits[band].relative_error)
    return {band: fits[band] for band in sorted(fits, key=lambda band: abs(np.log(band / best)))}


def fit_systems(
    dynamics: Dynamics,
    unknown: Sequence[str],
    known: Known,
    systems: Iterable[System],
    seconds: Floats | None = None,
) -> TorqueFit:
    """Weighted fit of what is not known to systems of equations in all the unknowns, and to the
    prior.

    `seconds`: as for `weighted`.
    """
    names, less = without_known(unknown, known, systems)
    prior = None if known.prior is None else known.prior.rows(names, known)
    return weighted(dynamics, names, less, seconds=seconds, prior=prior)


def without_known(
    unknown: Sequence[str], known: Mapping[str, float], systems: Iterable[System]
) -> tuple[tuple[str, ...], list[System]]:
    """Names of what is not known, and the systems of equations in these alone."""
    given = [i for i, name in enumerate(unknown) if name in known]
    rest = [i for i, name in enumerate(unknown) if name not in known]
    values = np.array([known[unknown[i]] for i in given])
    less = []
    for system in systems:
        left = system.torque - (system.regressor[:, :, given] * values).sum(axis=2)
        own = {"regressor": system.regressor[:, :, rest], "torque": left, "measured": system.torque}
        less.append(dataclasses.replace(system, **own))
    return tuple(unknown[i] for i in rest), less


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
    """Of counts, in a band [Hz]: no more equations than are independent in it, at speeds that
    stand out of rounding.
    """
    return Filtering(
        CUTOFF * band, band, max(1, int(1 / (2 * band * rig.period))), speed_noise(rig, band)
    )


def speed_noise(rig: Rig, band: float) -> Floats:
    """Three standard deviations (n,) of the joint speed that rounding makes in a band [rad/s]."""
    pulse = np.abs(rig.to_angle(np.eye(rig.n))).max(axis=0)
    return 3 * pulse / np.sqrt(12) * np.sqrt(2 * band * rig.period) * 2 * np.pi * band / np.sqrt(3)
