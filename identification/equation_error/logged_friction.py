"""Friction of logged torques: which numbers have evidence, and which other kinds would help."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from identification.equation_error.band_choice import tried
from identification.equation_error.friction_trial import (
    ASYMMETRIC,
    LOAD_DEPENDENT,
    RISING,
    SATURATING,
    STRIBECK,
    FrictionTrial,
    friction_trials,
    gain,
)
from identification.equation_error.friction_trial import SETTINGS as FRICTION
from identification.equation_error.least_squares import least_squares
from identification.equation_error.offsets import evident
from identification.equation_error.regressor import Places, regressor_along
from identification.equation_error.torque_equations import (
    OFFSET,
    VISCOUS_OFFSET,
    Selection,
    TorqueEquations,
)
from identification.equation_error.torque_fit import TorqueFit
from plant import FrictionCurve
from plant.motion import Motion
from plant.parts import Bools, Floats


def stated_offsets(task: TorqueEquations) -> bool:
    """Whether the user has decided on offsets: states some, or names them unknown or known."""
    curve = task.logs[0].rig.drive.curve
    named = any(name.startswith(OFFSET) for name in task.names)
    return named or (curve is not None and bool(curve.offset.any()))


def by_direction(
    task: TorqueEquations, selection: Selection, weights: Floats | None
) -> TorqueEquations:
    """The same with friction by direction, levels and slopes, where joints have evidence of it.

    Slopes must predict blocks kept aside clearly better, too: viscous friction that saturates looks
    like one by direction where a joint moves faster one way.
    """
    if stated_offsets(task):
        return task
    drive = task.logs[0].rig.drive
    unknown = set(task.names) - set(task.known)
    dry = [j for j in range(drive.n) if f"drive.coulomb[{j}]" in unknown]
    offsets = [f"{OFFSET}[{j}]" for j in dry]
    slopes = [f"{VISCOUS_OFFSET}[{j}]" for j in dry if f"drive.viscous[{j}]" in unknown]
    levels = _evident(task, offsets, selection, weights)
    if drive.curve is not None:
        return levels
    both = _evident(task, [*offsets, *slopes], selection, weights)
    if not any(name.startswith(VISCOUS_OFFSET) for name in both.names):
        return levels
    better, errors = _Pair(levels, both, selection, weights).gained()
    return both if errors > FRICTION.clear and better > FRICTION.enough else levels


class _Pair:
    """Fits of two kinds of friction without each block of the logs."""

    def __init__(
        self,
        task: TorqueEquations,
        other: TorqueEquations,
        selection: Selection,
        weights: Floats | None,
    ) -> None:
        sigma = task.fit(selection, weights, thin=True).sigma
        # One set of weights, so that both are judged alike.
        common = np.tile(1 / sigma, (len(task.logs), 1))
        self._n = task.dynamics.n
        self._fits = []
        for equations in (task, other):
            systems = equations.systems(selection, thin=True)[1]
            fit = tried(systems, task.seconds, 1 / selection.band, common)
            self._fits.append((fit, Places.of(systems).joint))

    def gained(self, judged: Bools | bool = True) -> tuple[float, float]:
        """Gain of the other friction on the blocks: relative, and in standard errors.

        `judged` (n,): joints whose errors count. NaN of equations too few to leave blocks out.
        """
        losses = []
        for fit, joint in self._fits:
            if fit is None:
                return np.nan, np.nan
            counts = np.broadcast_to(judged, self._n)[joint]
            fit = replace(fit, weight=fit.weight * counts)
            losses.append(fit.losses(fit.without))
        before, after = losses
        return gain(before, before - after)


def rising(
    task: TorqueEquations, selection: Selection, weights: Floats | None
) -> tuple[TorqueEquations, FrictionTrial | None, Floats]:
    """The same with Coulomb friction that rises with speed, where blocks kept aside ask for it.

    Near a reversal many joints show less friction than a level that jumps from one sign to the
    other. The blocks decide on all joints together. The last result is what the deviations (k,) of
    a fit are to be multiplied by, since the speeds of the rise are estimates as well.
    """
    drive = task.logs[0].rig.drive
    n = drive.n
    unknown = set(task.names) - set(task.known)
    dry = [j for j in range(n) if f"drive.coulomb[{j}]" in unknown]
    # A Stribeck curve at low speeds, or a rise, is the user's.
    curve = drive.curve
    stated = curve is not None and (curve.rise is not None or curve.breakaway is not None)
    if stated or not dry:
        return task, None, np.ones(1)

    # 1. Equations with slow rows, which show a rise.
    usual = np.maximum(task.usual_speed(), 1e-9)
    slow = selection._replace(
        slowest=task.least(usual, FRICTION.slowest, selection.band), every=None
    )
    # Not separately identifiable, or too few equations: no evidence.
    with contextlib.suppress(ValueError):
        # 2. Of each joint the speed that explains the residual of its own equations best, then
        # Gauss-Newton steps with all other values.
        speeds = _rises(task, selection, slow, weights, dry, usual)
        if not speeds.any():
            return task, None, np.ones(1)
        for _ in range(FRICTION.rounds):
            speeds, _ = _stepped(task, slow, weights, speeds, usual)

        # 3. Joints that gain on blocks kept aside, and then all of these together.
        pair = _Pair(task, task.with_rise(speeds * np.abs(drive.gear)), slow, weights)
        gains = [pair.gained(np.arange(n) == j)[0] for j in range(n)]
        speeds = np.where(np.array(gains) > FRICTION.enough, speeds, 0.0)
        if not speeds.any():
            return task, None, np.ones(1)
        speeds, wider = _stepped(task, slow, weights, speeds, usual)
        risen = task.with_rise(speeds * np.abs(drive.gear))
        pair = _Pair(task, risen, slow, weights)
        better, errors = pair.gained(speeds > 0)
        fit = risen.fit(slow, weights, thin=True)
        levels = np.full(n, np.nan)
        levels[dry] = [fit[f"drive.coulomb[{j}]"] * abs(drive.gear[j]) for j in dry]
        trial = FrictionTrial(
            kind=RISING,
            share=tuple((speeds / usual).tolist()),
            better=better,
            errors=errors,
            levels=levels,
            units=tuple(task.dynamics.chain.effort_units),
            usual=usual,
        )
        if not trial.clear:
            return task, None, np.ones(1)
        # Viscous friction that saturates, or Stribeck's, looks like a rise: the best remains.
        # On the equations of all joints, as theirs is.
        everywhere, _ = pair.gained()
        others = friction_of(task, task.fit(slow, weights, thin=True), slow, False)
        if everywhere > max((other.better for other in others), default=-np.inf):
            return risen, trial, wider
    return task, None, np.ones(1)


def _level(task: TorqueEquations, rise: Floats) -> Callable[[Motion], Floats]:
    """Signed level of the shafts, of 1 at high speed, with a rise at these speeds (n,) [rad/s]."""

    def torque(motion: Motion) -> Floats:
        qd = task.logs[0].rig.drive.coupling.shaft(motion.qd)
        curve = FrictionCurve(offset=0 * rise, rise=rise)
        return curve.risen(np.ones(len(rise)), qd) * np.sign(qd)

    return torque


def _rises(
    task: TorqueEquations,
    selection: Selection,
    slow: Selection,
    weights: Floats | None,
    dry: Sequence[int],
    usual: Floats,
) -> Floats:
    """Speeds (n,) [rad/s] of the shafts, of a grid, at which levels rise to half; 0 for none."""
    drive = task.logs[0].rig.drive
    shares = np.array([0.0, *FRICTION.rises])
    shapes = list(task.shapes(slow, [_level(task, share * usual) for share in shares]))
    # The fit has the rows that its friction was chosen for.
    fit = task.fit(selection, weights, thin=True)
    systems = task.systems(slow, thin=True)[1]
    speeds = np.zeros(drive.n)
    for j in dry:
        level = fit[f"drive.coulomb[{j}]"] * abs(drive.gear[j])
        rows, targets = [], []
        for system, shape in zip(systems, shapes, strict=True):
            used = system.used[:, j]
            torques = shape[used, j]
            residual = system.torque[used, j] - system.regressor[used, j] @ fit.values
            targets.append(residual + level * torques[:, 0])
            viscous = system.speed[used, j] * np.sign(torques[:, 0])
            rows.append(np.column_stack([viscous, torques]))
        columns, target = np.concatenate(rows), np.concatenate(targets)
        squares = []
        for i in range(len(shares)):
            pair = columns[:, [0, i + 1]]
            values = np.linalg.lstsq(pair, target, rcond=None)[0]
            squares.append(np.sum((target - pair @ values) ** 2))
        speeds[j] = shares[int(np.argmin(squares))] * usual[j]
    return speeds


def _stepped(
    task: TorqueEquations, slow: Selection, weights: Floats | None, speeds: Floats, usual: Floats
) -> tuple[Floats, Floats]:
    """Speeds (n,) of the rise after a Gauss-Newton step in their logarithms, beside all values.

    And the ratio (k,) of the deviations of the values with these speeds unknown and known.
    """
    drive = task.logs[0].rig.drive
    joints = np.flatnonzero(speeds)
    risen = task.with_rise(speeds * np.abs(drive.gear))
    fit = risen.fit(slow, weights, thin=True)
    systems = risen.systems(slow, thin=True)[1]
    step = FRICTION.step
    shapes = task.shapes(slow, [_level(task, speeds * np.exp(sign * step)) for sign in (-1, 1)])
    rows, targets = [], []
    for system, shape in zip(systems, shapes, strict=True):
        slope = (shape[:, :, 1] - shape[:, :, 0]) / (2 * step)
        further = [
            drive.coupling.joint_torque(
                fit[f"drive.coulomb[{j}]"] * abs(drive.gear[j]) * slope * (np.arange(drive.n) == j)
            )
            for j in joints
        ]
        columns = np.concatenate([system.regressor, np.stack(further, axis=2)], axis=2)
        weight = np.broadcast_to(1 / fit.sigma, system.used.shape)[system.used]
        rows.append(columns[system.used] * weight[:, None])
        residual = system.torque - system.regressor @ fit.values
        targets.append(residual[system.used] * weight)
    columns = np.concatenate(rows)
    names = (*fit.names, *(f"rise of {j}" for j in joints))
    k = len(fit.names)
    values, covariance, _ = least_squares(names, columns, np.concatenate(targets))
    alone = least_squares(fit.names, columns[:, :k], np.concatenate(targets))[1]
    # Both covariances have the scale of their own residual, about the same.
    wider = np.sqrt(np.maximum(np.diag(covariance)[:k] / np.diag(alone), 1.0))
    moved = speeds.copy()
    moved[joints] *= np.exp(np.clip(values[k:], -FRICTION.most, FRICTION.most))
    low, high = min(FRICTION.rises), max(FRICTION.rises)
    moved[joints] = np.clip(moved[joints], low * usual[joints], high * usual[joints])
    return moved, wider


def _evident(
    task: TorqueEquations, names: Sequence[str], selection: Selection, weights: Floats | None
) -> TorqueEquations:
    """The same with those of these numbers by direction that have evidence."""
    if not names:
        return task
    try:
        fit = task.with_directions(names).fit(selection, weights, thin=True)
    except ValueError:
        # Some of them are not separately identifiable, or equations are too few: no evidence.
        return task
    gear = np.abs(task.logs[0].rig.drive.gear)
    # Of the size of what brakes both ways, or of a joint's errors, where a sensor has an offset.
    sizes = []
    usual = np.maximum(task.usual_speed() * gear, 1e-9)
    for name in names:
        kind, joint = name.rstrip("]").split("[")
        j = int(joint)
        error = fit.sigma[j] / gear[j]
        if kind == VISCOUS_OFFSET:
            sizes.append(max(fit[f"drive.viscous[{j}]"], error / usual[j]))
        else:
            sizes.append(max(fit[f"drive.coulomb[{j}]"], error))
    places = [fit.names.index(name) for name in names]
    chosen = evident(fit.values, fit.covariance, places, np.array(sizes))
    return task.with_directions([fit.names[place] for place in chosen])


def friction_of(
    task: TorqueEquations, fit: TorqueFit, selection: Selection, asymmetric: bool
) -> tuple[FrictionTrial, ...]:
    """Trials of friction beyond Coulomb and viscous, on joints with unknown Coulomb friction.

    `asymmetric`: whether offsets are tried, too; else the evidence has decided on them already.
    """
    dynamics = task.dynamics
    rig = task.logs[0].rig
    usual = np.maximum(task.usual_speed(), 1e-9)
    coupling = rig.drive.coupling
    # Beside a Coulomb level that is fitted; a joint without a residual has nothing to explain.
    joints = [
        j for j in range(dynamics.n) if f"drive.coulomb[{j}]" in fit.names and fit.sigma[j] > 0
    ]
    if not joints:
        return ()
    curve = rig.drive.curve or FrictionCurve(offset=0 * usual)
    columns = [*task.systems(selection, thin=True)[1]]
    # The weights of the fit itself, so that a gain is measured in its residual.
    weights = np.tile(1 / fit.sigma, (len(task.logs), 1))

    def shape(kind: str, share: tuple[float, ...] | None) -> Callable[[Motion], Floats]:
        """Torque on the shafts for a level of 1, at the speeds of the shafts."""
        speed = usual if share is None else np.array(share) * usual

        def torque(motion: Motion) -> Floats:
            qd = coupling.shaft(motion.qd)
            if kind == ASYMMETRIC:
                # A sum with zero gives an offset the shape of the speeds.
                return 1 + 0 * qd
            if kind == LOAD_DEPENDENT:
                # The load is the torque of the links by the fit itself.
                regressor, _ = regressor_along(dynamics, rig, dynamics.names, motion)
                load = (regressor * fit.f).sum(axis=2) - rig.drive.rotor_torque(motion.qdd)
                return np.abs(coupling.shaft_torque(load)) * np.sign(qd)
            if kind == STRIBECK:
                stribeck = FrictionCurve(offset=0 * usual, breakaway=1 + 0 * usual, speed=speed)
                return stribeck.level(qd) * np.sign(qd)
            # Viscous friction that saturates: its level is slope times saturation.
            saturating = FrictionCurve(offset=0 * usual, saturation=speed)
            return saturating.coefficient(1 / speed, qd) * qd

        return torque

    def trials(*candidates: tuple[str, tuple[float, ...] | None]) -> tuple[FrictionTrial, ...]:
        made = task.shapes(selection, [shape(*candidate) for candidate in candidates])
        systems = []
        for system, torques in zip(columns, made, strict=True):
            # Column by column, joint by joint: the torque of one shaft may act on several joints.
            further = [
                coupling.joint_torque(torques[:, :, i] * (np.arange(dynamics.n) == j))
                for i in range(len(candidates))
                for j in joints
            ]
            regressor = np.concatenate([system.regressor, np.stack(further, axis=2)], axis=2)
            systems.append(replace(system, regressor=regressor))
        # Viscous friction that saturates stands in place of the one in proportion.
        places = [i for i, name in enumerate(fit.names) if name.startswith("drive.viscous")]
        return friction_trials(
            systems,
            candidates,
            joints,
            task.seconds,
            1 / selection.band,
            weights,
            usual,
            tuple(dynamics.chain.effort_units),
            places,
        )

    # 1. All kinds that the drive does not state already, at coarse speeds.
    viscous = all(f"drive.viscous[{j}]" in fit.names for j in joints)
    kinds = list[tuple[str, tuple[float, ...] | None]]()
    if asymmetric:
        kinds.append((ASYMMETRIC, None))
    if rig.drive.load_friction is None:
        kinds.append((LOAD_DEPENDENT, None))
    for kind, shares, possible in (
        (STRIBECK, FRICTION.speeds, curve.breakaway is None),
        (SATURATING, FRICTION.saturations, viscous and curve.saturation is None),
    ):
        if possible:
            kinds += [(kind, (share,) * dynamics.n) for share in shares]
    ranked = trials(*kinds)

    # 2. A speed that leads is refined: for all joints together, then for one after another, each
    # from the best so far.
    groups = [joints]
    if len(joints) > 1:
        groups += [[joint] for joint in joints]
    for group in groups:
        best = ranked[0] if ranked else None
        if best is None or not best.clear or not best.share:
            continue
        # Only the speeds of this group vary; others stay at the best so far.
        in_group = np.isin(np.arange(dynamics.n), group)
        finer = FRICTION.finer if best.kind == STRIBECK else FRICTION.wider
        speeds = np.where(in_group, np.array(finer)[:, None], 1.0) * best.share
        refined = trials(*((best.kind, tuple(row)) for row in speeds.tolist()))
        ranked = tuple(sorted((*ranked, *refined), key=lambda trial: -trial.better))
    return ranked
