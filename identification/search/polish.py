"""What methods share: where the torque equation lets a search begin, and the fit of the prediction error it ends in."""

from __future__ import annotations

import numpy as np

from identification.equation_error.pulse_fit import equation_error as fit_pulses
from identification.equation_error.pulse_fit import over_bands
from identification.equation_error.torque_fit import TorqueFit
from identification.replay.gauss_newton import gauss_newton
from identification.replay.prediction import Prediction
from identification.search.problem import Outcome
from plant.machine.motor_inertia import least_inertia_margin

__all__ = ["polished", "require_fast", "start_of_fit", "torque_fit"]

_SMALL = 0.01
"""Step of the derivatives, in standard deviations of the equation error."""

_WEIGHINGS = 2
"""How often records and joints are weighted anew."""


def torque_fit(search):
    """The torque equation's fit; of logged torques, in the band where it holds best and gives an arm."""
    if not any(record.law.replays for record in search.records):
        return fit_pulses(search.dynamics, search.records, search.unknown, search.known)
    prediction = Prediction(search.dynamics, search.records, search.unknown, **search.options)
    fits = over_bands(search.dynamics, search.records, search.unknown, search.known).values()
    for fit in sorted(fits, key=lambda fit: fit.relative_error):
        values, _ = start_of_fit(search, fit)
        if np.isfinite(prediction.surprises(np.append(values, prediction.nuisances))).all():
            return fit
    raise ValueError(
        "the torque equation must give an arm that can follow the log; it does in no band. Ask record.check() for "
        "order, signs and units of torques and positions, or give ranges."
    )


def start_of_fit(search, fit: TorqueFit):
    """Values (k,) of all unknowns, those that the fit lacks as range or record have them; and a step for each."""
    values, step = search.nominal.copy(), np.abs(search.nominal) * 0.02
    for name, value in search.known.items():
        values[search.unknown.index(name)] = value
    for i, name in enumerate(search.unknown):
        if name in fit.names:
            place = fit.names.index(name)
            values[i], step[i] = fit.values[place], fit.std[place]
    if search.ranges is not None:
        step = np.where(step > 0, step, 0.01 * (search.ranges[:, 1] - search.ranges[:, 0]))
        step = np.where(search.ranges[:, 0] == search.ranges[:, 1], 0.0, step)
    return np.clip(values, *search.bounds.T), step


def require_fast(search):
    """Refuse a law whose memory cannot be followed: its own state is not in the log."""
    for record in search.records:
        if record.law.has_memory(record.n):
            raise ValueError(
                f"the law of the log must be fast and without memory, like P; got {type(record.law).__name__}. Use "
                "method='equation_error', or give the record law=LoggedTorque(): both read its logged torques."
            )


def polished(search, start, step, stages, *, free=False):
    """The prediction error's fit from a start; the start itself where no arm comes of it."""
    prediction = Prediction(
        search.dynamics, search.records, search.unknown, free=free, zeros=search.zeros, **search.options
    )
    k, bounds = len(start), np.vstack([search.bounds, prediction.nuisance_bounds])
    steps = np.append(_SMALL * step, prediction.nuisance_steps)
    fit = gauss_newton(prediction, np.append(start, prediction.nuisances), steps, bounds)
    for _ in range(_WEIGHINGS):
        if not prediction.reweigh(fit.values):
            break
        fit = gauss_newton(prediction, fit.values, steps, bounds)
    arm, rig, _ = _parts(search, fit.values[:k])
    sound = least_inertia_margin(search.dynamics, rig, arm.f[None])[0] >= 0
    trouble = (
        None
        if sound
        else (
            "D(q) of the fit falls short of the motors' own inertia, Jm k^2; check motor_inertia, gears and motor_gain"
        )
    )
    return Outcome(
        values=fit.values[:k] if sound else start,
        covariance=fit.covariance[:k, :k],
        scatter=fit.scatter,
        evaluations=prediction.evaluations,
        message=f"Surprises of {fit.scatter:.3f} pulses (rounding alone gives 0.289).",
        trouble=trouble,
        stages=stages,
        zeros=prediction.zeros_in(fit.values) if search.zeros else None,
    )


def _parts(search, values):
    """Arm, rig and law of the first record with these values in place."""
    named = dict(zip(search.unknown, values, strict=True))
    record = search.records[0]
    arm = search.dynamics.arm([named[name] for name in search.dynamics.names])
    return arm, record.rig.filled(named), record.law.filled(named, "law.")
