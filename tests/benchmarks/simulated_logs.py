"""Identified arms of public logs, simulated: EMPS under its own law, KR300 from its torques alone.

    python tests/benchmarks/scoreboard.py DATA --only emps kr300

The closed loop of the EMPS is that of the benchmark's authors: a reference, a sampled cascade
(position gain kp, speed gain kv on the difference of the mean of two positions, limit 10 V), pulses
on its output in the second file; the error is that of the force from the fiftieth sample on. Along
the logged positions this law repeats the logged voltage to 0.24 %, without delay. The KR300 is
simulated from each eighth second on, from its angles and speeds there and its torques between the
rows by a spline; the linear model beside it predicts the next angles from the last ones and the
torques, and is fitted to all blocks of training but the last tenth, which choose its order.
"""

import dataclasses
from pathlib import Path

import casadi as ca
import numpy as np
import public_logs
from scipy.interpolate import CubicSpline

from identification import fit_torque
from identification.equation_error import with_possible_bodies
from plant import FrictionCurve, KnownTorque, LoggedTorque, Record, SteppedArm, number, part, replay

# -- EMPS ----------------------------------------------------------------------------------------
VOLTS = 10.0  # limit of the controller [V]
BORDER = 49  # samples that the authors leave out
PUBLISHED = {"M": 95.1089, "viscous": 203.5034, "coulomb": 20.3935, "offset": -3.1648}


def closed_loop(folder, found):
    """Relative errors [%] of the force of both files under the logged law; None: published values."""
    from scipy.io import loadmat

    log = public_logs.emps(folder)
    arm, rig = (found.arm, found.rig) if found is not None else published(log)
    errors = []
    for name, record in zip(
        ("DATA_EMPS", "DATA_EMPS_PULSES"), (*log.fitted, *log.kept), strict=True
    ):
        table = loadmat(Path(folder) / "emps" / f"{name}.mat")
        reference, measured, voltage = (table[key].ravel() for key in ("qg", "qm", "vir"))
        pulses = table["pulses_N"].ravel() if "pulses_N" in table else 0 * voltage
        kp, kv, gain = (table[key].item() for key in ("kp", "kv", "gtau"))
        slide = SteppedArm(arm, rig, measured[:1])
        last = mean = measured[0]
        volts = np.empty(len(reference))
        for k in range(len(reference)):
            position = slide.q[0]
            before, mean, last = mean, (position + last) / 2, position
            speed = (mean - before) / record.rig.period
            volts[k] = np.clip(kv * (kp * (reference[k] - position) - speed), -VOLTS, VOLTS)
            volts[k] += pulses[k]
            slide.step([gain * volts[k]])
        difference = (volts - voltage)[BORDER:]
        errors.append(100 * np.linalg.norm(difference) / np.linalg.norm(voltage[BORDER:]))
    return errors


def published(log):
    """The slide with the values that the authors published."""
    rig = log.fitted[0].rig
    gear = rig.drive.gear
    drive = dataclasses.replace(
        rig.drive,
        viscous=[PUBLISHED["viscous"]] / gear**2,
        coulomb=[PUBLISHED["coulomb"]] / gear,
        curve=FrictionCurve(offset=[PUBLISHED["offset"]] / gear),
    )
    return log.dynamics.arm([PUBLISHED["M"]]), dataclasses.replace(rig, drive=drive)


# -- KR300 ---------------------------------------------------------------------------------------
HORIZONS = (1, 2, 4, 8)  # [s]
FINER = 10  # samples of a simulation per row of the log
ORDERS = (2, 4, 6, 8)  # rows before, of which the linear model predicts the next


@part
class Balance(KnownTorque):
    """The counterbalance of joint 2: what the further columns of the fit leave the motors."""

    values: object = number(("waves",))

    def torque(self, q):
        waves = [wave(k * q[1]) for k in (2, 3) for wave in (ca.cos, ca.sin)]
        values = [self.values[i] for i in range(len(waves))]
        force = sum(value * wave for value, wave in zip(values, waves, strict=True))
        return ca.vertcat(0, -force, 0, 0, 0, 0)


def windows(records):
    """Rows at which simulations of the longest horizon begin, of each record."""
    step = round(HORIZONS[-1] / records[0].rig.period)
    # The linear model needs some rows before, and so has the speed a place in the spline.
    return range(max(ORDERS), len(records[0]) - step, step)


def by_horizon(errors, period):
    """RMS [degrees] of the angles within each horizon, of errors (W, N, n) [rad]."""
    rows = [round(seconds / period) for seconds in HORIZONS]
    values = [np.degrees(np.sqrt(np.mean(errors[:, :row] ** 2))) for row in rows]
    return ", ".join(f"{value:.3g}" for value in values) + " degrees"


def forward(log, training):
    """Errors of the arm of a fit, and of a linear model, by horizon: texts."""
    ours = by_horizon(physical(log), log.kept[0].rig.period)
    return ours, by_horizon(linear(training, log.kept), log.kept[0].rig.period)


def machine(log, records):
    """Arm, rig with the counterbalance, and fit of the torque equation of these records."""
    rig = records[0].rig
    # Friction that holds a joint at rest: it does not rise with speed.
    zero = np.zeros(rig.n)
    drive = dataclasses.replace(rig.drive, curve=FrictionCurve(offset=zero, rise=zero))
    held = [
        dataclasses.replace(record, rig=dataclasses.replace(rig, drive=drive)) for record in records
    ]
    fit = fit_torque(log.dynamics, held, extra=log.extra)
    possible = with_possible_bodies(log.dynamics, fit.rig, fit) or fit
    filled = fit.rig.filled(dict(zip(possible.names, possible.values, strict=True)))
    balance = Balance(values=[fit[name] for name in log.extra])
    return possible.arm, dataclasses.replace(filled, springs=(balance,)), fit


def physical(log):
    """Errors (W, N, n) [rad] of the fitted arm, simulated from the torques of the logs kept aside."""
    arm, rig, _ = machine(log, log.fitted)
    fine = dataclasses.replace(rig, period=rig.period / FINER)
    errors = []
    for record in log.kept:
        angle = record.rig.cell_centre(record.counts)
        path, torque = (CubicSpline(record.t, values) for values in (angle, record.torque))
        for begin in windows(log.kept):
            rows = round(HORIZONS[-1] / rig.period)
            t = record.t[begin] + fine.period * np.arange(FINER * rows + 1)
            start = np.array([path(t[0]), path(t[0], 1)])
            cut = Record(
                t=t - t[0], error_pulses=-np.round(fine.true_counts(path(t))), torque=torque(t), rig=fine,
                law=LoggedTorque(), initial=start,
            )  # fmt: skip
            again = replay(arm, cut)
            errors.append(fine.to_angle(again.counts - cut.counts)[FINER::FINER])
    return np.array(errors)


def rows_before(angle, torque, order):
    """Regressor (N - order, m) of the next angles: the last ones, the torques until then, 1."""
    n = len(angle)
    past = [angle[i : n - order + i] for i in range(order)]
    drive = [torque[i : n - order + i] for i in range(order + 1) if n - order + i <= n]
    return np.hstack([*past, *drive, np.ones((n - order, 1))])


def linear(training, kept):
    """Errors (W, N, n) [rad] of the linear model of the order that predicts best for 8 s."""
    logs = [(record.rig.cell_centre(record.counts), record.torque) for record in training]
    judges = len(logs) - len(logs) // 10
    best = min(
        (linear_model(logs[:judges], order) for order in ORDERS),
        key=lambda model: np.mean(linear_errors(model, training[judges:]) ** 2),
    )
    return linear_errors(best, kept)


def linear_model(logs, order):
    columns = np.concatenate([rows_before(*log, order) for log in logs])
    target = np.concatenate([angle[order:] for angle, _ in logs])
    scale = np.sqrt(np.mean(columns**2, axis=0))
    return order, np.linalg.lstsq(columns / scale, target, rcond=None)[0] / scale[:, None]


def linear_errors(model, records):
    order, matrix = model
    errors = []
    for record in records:
        angle, torque = record.rig.cell_centre(record.counts), record.torque
        for begin in windows(records):
            rows = round(HORIZONS[-1] / record.rig.period)
            past = list(angle[begin - order + 1 : begin + 1])
            for k in range(begin, begin + rows):
                drive = torque[k - order + 1 : k + 2]
                past.append(np.concatenate([*past[-order:], *drive, [1.0]]) @ matrix)
            errors.append(np.array(past[order:]) - angle[begin + 1 : begin + rows + 1])
    return np.array(errors)
