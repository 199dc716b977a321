"""Friction of logged torques: which numbers have evidence, and which other kinds would help."""

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
from identification.equation_error.offsets import evident
from identification.equation_error.regressor import regressor_along
from identification.equation_error.torque_equations import (
    OFFSET,
    VISCOUS_OFFSET,
    Selection,
    TorqueEquations,
)
from identification.equation_error.torque_fit import TorqueFit
from plant import FrictionCurve
from plant.motion.reference import Motion
from plant.parts.fields import Floats


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
    better, errors = _gained(levels, both, selection, weights)
    return both if errors > FRICTION.clear and better > FRICTION.enough else levels


def _gained(
    task: TorqueEquations, other: TorqueEquations, selection: Selection, weights: Floats | None
) -> tuple[float, float]:
    """Gain of other friction on blocks kept aside: relative, and in standard errors.

    NaN of equations that are too few to leave blocks out.
    """
    sigma = task.fit(selection, weights, thin=True).sigma
    # One set of weights, so that both are judged alike.
    common = np.tile(1 / sigma, (len(task.logs), 1))
    losses = []
    for equations in (task, other):
        systems = equations.systems(selection, thin=True)[1]
        fit = tried(systems, task.seconds, 1 / selection.band, common)
        if fit is None:
            return np.nan, np.nan
        losses.append(fit.losses(fit.without))
    before, after = losses
    return gain(before, before - after)


def rising(
    task: TorqueEquations, selection: Selection, weights: Floats | None
) -> tuple[TorqueEquations, FrictionTrial | None]:
    """The same with Coulomb friction that rises with speed, where blocks kept aside ask for it.

    Near a reversal many joints show less friction than a level that jumps from one sign to the
    other. The speed of each joint is that which leaves least of the fit's residual; the blocks then
    decide on all joints together.
    """
    drive = task.logs[0].rig.drive
    n = drive.n
    # A Stribeck curve at low speeds, or a rise, is the user's.
    stated = drive.curve is not None and not (drive.curve.rise is None is drive.curve.breakaway)
    dry = [
        j
        for j in range(n)
        if f"drive.coulomb[{j}]" in task.names and f"drive.coulomb[{j}]" not in task.known
    ]
    if stated or not dry:
        return task, None

    # 1. The residual with slow rows, which show a rise.
    usual = np.maximum(task.usual_speed(), 1e-9)
    slow = selection._replace(
        slowest=task.least(usual, FRICTION.slowest, selection.band), every=None
    )
    fit = task.fit(selection, weights, thin=True)
    systems = task.systems(slow, thin=True)[1]
    shares = np.array(FRICTION.rises)

    def level(share: float) -> Callable[[Motion], Floats]:
        def torque(motion: Motion) -> Floats:
            qd = drive.coupling.shaft(motion.qd)
            curve = FrictionCurve(offset=0 * usual, rise=share * usual)
            return curve.risen(np.ones(n), qd) * np.sign(qd)

        return torque

    shapes = list(task.shapes(slow, [level(share) for share in (0.0, *shares)]))

    # 2. Of each joint the speed that explains its own residual best, beside a viscous part.
    speeds = np.zeros(n)
    for j in dry:
        squares = np.zeros(len(shares) + 1)
        for i in range(len(squares)):
            rows, targets = [], []
            for system, shape in zip(systems, shapes, strict=True):
                used = system.used[:, j]
                jump, rise, speed = shape[used, j, 0], shape[used, j, i], system.speed[used, j]
                residual = system.torque[used, j] - system.regressor[used, j] @ fit.values
                targets.append(residual + fit[f"drive.coulomb[{j}]"] * abs(drive.gear[j]) * jump)
                rows.append(np.column_stack([rise, speed * np.sign(jump)]))
            columns, target = np.concatenate(rows), np.concatenate(targets)
            values = np.linalg.lstsq(columns, target, rcond=None)[0]
            squares[i] = np.sum((target - columns @ values) ** 2)
        speeds[j] = (0.0, *shares)[int(squares.argmin())]
    if not speeds.any():
        return task, None

    # 3. All joints together, on blocks kept aside.
    risen = task.with_rise(speeds * usual * np.abs(drive.gear))
    try:
        better, errors = _gained(task, risen, slow, weights)
        levels = risen.fit(slow, weights, thin=True)
    except ValueError:
        # Not separately identifiable, or too few equations: no evidence.
        return task, None
    coulomb = np.full(n, np.nan)
    coulomb[dry] = [levels[f"drive.coulomb[{j}]"] * abs(drive.gear[j]) for j in dry]
    trial = FrictionTrial(
        kind=RISING,
        share=tuple(speeds.tolist()),
        better=better,
        errors=errors,
        levels=coulomb,
        usual=usual,
    )
    return (risen, trial) if trial.clear else (task, None)


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
    drive = rig.drive
    curve = drive.curve or FrictionCurve(offset=0 * usual)
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
                load = (regressor * fit.f).sum(axis=2) - drive.rotor_torque(motion.qdd)
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
            systems, candidates, joints, task.seconds, 1 / selection.band, weights, usual, places
        )

    # 1. All kinds that the drive does not state already, at coarse speeds.
    viscous = all(f"drive.viscous[{j}]" in fit.names for j in joints)
    kinds = list[tuple[str, tuple[float, ...] | None]]()
    if asymmetric:
        kinds.append((ASYMMETRIC, None))
    if drive.load_friction is None:
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
