"""Friction beyond Coulomb and viscous, tested on blocks of the logs that its fit has not seen.

The residual of a friction that is not modelled looks like an offset, an elastic gear or a wrong
gain, so friction is tried before these are blamed.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.equation_error.band_choice import tried
from identification.equation_error.regressor import System
from plant import Drive, FrictionCurve
from plant.parts import Floats, Shown, frozen, frozen_settings, listed

KINDS = ("asymmetric", "load-dependent", "Stribeck", "saturating viscous", "rising")

ASYMMETRIC, LOAD_DEPENDENT, STRIBECK, SATURATING, RISING = KINDS

_STATE = "state it by drive(rig.drive) of this trial"

_ADVICE = {
    ASYMMETRIC: f"{_STATE}, and add drive.curve.offset[i] to unknown",
    LOAD_DEPENDENT: _STATE,
    STRIBECK: _STATE,
    SATURATING: _STATE,
    RISING: _STATE,
}


@frozen_settings
class FrictionTrialSettings:
    """Kinds of friction that are tried, and when one is reported; chosen by hand.

    Parameters
    ----------
    clear : float
        Standard errors by which a candidate must predict better.
    enough : float
        Share of the squared error by which it must predict better.
    speeds : tuple of float
        Stribeck speeds that are tried, relative to the usual speed of each joint.
    finer : tuple of float
        Ratios to a Stribeck speed that predicts better. They are tried next, first for all joints
        together, then for one joint after another.
    saturations : tuple of float
        Tried speeds at which viscous friction saturates, relative to the usual speed of each joint.
    wider : tuple of float
        Ratios to a saturation speed that predicts better, tried like `finer`. They spread wider,
        since a logarithm depends less sharply on its speed than the Stribeck peak.
    rises : tuple of float
        Tried speeds at which Coulomb friction reaches half its level, relative to the usual speed
        of each joint.
    rounds : int
        Number of Gauss-Newton steps that then refine these speeds together with all other values.
    step, most : float
        Step in the logarithm of these speeds for central differences, and the largest change of
        that logarithm in one Gauss-Newton step.
    slowest : float
        Lowest speed, relative to the usual speed of a joint, that shows such a rise. Slower motion
        does not, since the friction that holds a joint at rest may have any value.
    """

    clear: float = 3.0
    enough: float = 0.1
    speeds: tuple[float, ...] = (0.02, 0.1, 0.5)
    finer: tuple[float, ...] = (0.5, 0.63, 0.8, 1.25, 1.6, 2.0)
    saturations: tuple[float, ...] = (0.1, 0.4, 1.6)
    wider: tuple[float, ...] = (0.125, 0.25, 0.5, 2.0, 4.0, 8.0)
    rises: tuple[float, ...] = (0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2, 0.3, 0.5)
    rounds: int = 3
    step: float = 0.05
    most: float = 0.7
    slowest: float = 0.02


SETTINGS = FrictionTrialSettings()


@frozen
class FrictionTrial(Shown):
    """One kind of friction on trial, beside what is fitted.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    share : tuple of float or None
        Speed of each joint that shapes the friction (Stribeck, saturation or rise), relative to its
        usual speed.
    better : float
        Share of the squared error, of torques in blocks kept aside, that it takes away; negative
        where it adds.
    errors : float
        The same, in standard errors over the blocks.
    levels : (n,) numpy.ndarray
        Its torque on the shaft of each joint (of load-dependent friction, per torque of the load);
        NaN where it was not tried.
    units : tuple of str
        Of each joint's torque: N m, or N of a slide.
    usual : (n,) numpy.ndarray
        Usual speed of each joint, that `share` is a part of [rad/s].
    """

    kind: str
    share: tuple[float, ...] | None
    better: float
    errors: float
    levels: Floats
    units: tuple[str, ...]
    usual: Floats

    @property
    def clear(self) -> bool:
        """Whether `errors` and `better` both exceed their thresholds in the settings."""
        return self.errors > SETTINGS.clear and self.better > SETTINGS.enough

    @property
    def advice(self) -> str:
        """The friction with its levels, and what to do about it, in a line."""
        levels = ["-" if np.isnan(level) else f"{level:.2g}" for level in self.levels]
        # Of load-dependent friction they are shares, without a unit.
        shown = ", ".join(levels) if self.kind == LOAD_DEPENDENT else listed(levels, self.units)
        return (
            f"friction is {self._short()}; its levels on the joints' shafts are {shown}:"
            f" {_ADVICE[self.kind]}"
        )

    def drive(self, drive: Drive) -> Drive:
        """A drive with this friction, to fit again and to compensate in controllers.

        Raises
        ------
        ValueError
            If the trial is of Stribeck or saturating friction, and the drive states one already.
        """
        # A joint that was not tried gets level 0. Levels are of the shafts, a curve of the motors.
        tried = np.isfinite(self.levels)
        levels = np.nan_to_num(self.levels)
        # A drive refuses negative friction, so a slightly negative level becomes 0. An offset may
        # have either sign.
        if self.kind != ASYMMETRIC:
            levels = np.maximum(levels, 0.0)
        if self.kind == LOAD_DEPENDENT:
            stated = 0.0 if drive.load_friction is None else drive.load_friction.share
            return replace(drive, load_friction=stated + levels)
        curve = drive.curve or FrictionCurve(offset=0 * levels)
        if self.kind == ASYMMETRIC:
            curve = replace(curve, offset=curve.offset + levels / drive.gear)
        elif self.kind == STRIBECK and self.share is not None:
            # Two curves of different speeds do not add up to one.
            if curve.breakaway is not None:
                raise ValueError(
                    "a drive has one Stribeck speed; this one states another. Fit without its"
                    " breakaway."
                )
            gear = np.abs(drive.gear)
            # A curve is stated on the motor side: speeds times the gear, torques divided by it.
            speed = np.array(self.share) * self.usual * gear
            curve = replace(curve, breakaway=levels / gear, speed=speed)
        elif self.kind == SATURATING and self.share is not None:
            if curve.saturation is not None:
                raise ValueError(
                    "a drive has one saturation of its viscous friction; this one states another."
                    " Fit without it."
                )
            # A joint that was not tried stays in proportion to its speed.
            speed = np.array(self.share) * self.usual
            saturation = np.where(tried, speed * np.abs(drive.gear), np.inf)
            # The level is slope times saturation, both of the joint.
            slope = levels / speed / drive.gear**2
            curve = replace(curve, saturation=saturation)
            drive = replace(drive, viscous=np.where(tried, slope, drive.viscous))
        elif self.kind == RISING and self.share is not None:
            gear = np.abs(drive.gear)
            # A joint that was not tried keeps its level, which does not rise.
            rise = np.where(tried, np.array(self.share) * self.usual * gear, 0.0)
            curve = replace(curve, rise=rise)
            drive = replace(drive, coulomb=np.where(tried, levels / gear, drive.coulomb))
        return replace(drive, curve=curve)

    def _short(self):
        # Shares that print alike are one.
        speeds = ", ".join(dict.fromkeys(f"{share:.0%}" for share in self.share or ()))
        at = f" at {speeds} of the usual speed{'s' * (',' in speeds)}" if speeds else ""
        return (
            f"{self.kind}{at}: blocks kept aside {self.better:+.0%} better ({self.errors:.1f}"
            " standard errors)"
        )

    def _shown(self):
        yield self._short()


def gain(base: Floats, gains: Floats) -> tuple[float, float]:
    """Mean of `gains` (S,), relative to the mean of the losses `base` (S,), and in standard errors.

    Blocks without a finite gain count in neither. Both are NaN with fewer than two others, which
    have no standard error.
    """
    finite = np.isfinite(gains)
    # One base may stand for all blocks.
    base = np.broadcast_to(base, gains.shape)[finite]
    gains = gains[finite]
    if len(gains) < 2:
        return np.nan, np.nan
    # Blocks that all gain alike have no scatter.
    error = max(float(gains.std(ddof=1)) / np.sqrt(len(gains)), 1e-300)
    return float(gains.mean() / base.mean()), float(gains.mean() / error)


def friction_trials(
    systems: Sequence[System],
    candidates: Sequence[tuple[str, tuple[float, ...] | None]],
    joints: Sequence[int],
    seconds: Floats,
    gap: float,
    weights: Floats,
    usual: Floats,
    units: tuple[str, ...],
    viscous: Sequence[int] = (),
) -> tuple[FrictionTrial, ...]:
    """Trials of kinds of friction, best first.

    The last columns of each system belong to the candidates, in order: one for each of `joints`.

    `seconds` (R,): length of each log. `gap` [s]: margin around a block that is left out with the
    block. `weights` (R, n). `usual` (n,): speeds [rad/s] to which shares are relative. `units`: of
    the joints' torques. `viscous`: indices of the columns that saturating friction replaces.
    """
    size = len(joints)
    count = systems[0].regressor.shape[2] - len(candidates) * size

    def beside(columns: Sequence[int], left_out: Sequence[int] = ()) -> tuple[Floats, Floats]:
        """Losses of a fit with these columns beside the common ones, and their values.

        NaN where there are too few equations.
        """
        # The common columns come first in each system; the columns of the candidates follow, joint
        # by joint.
        places = [*(i for i in range(count) if i not in left_out), *columns]
        chosen = [replace(system, regressor=system.regressor[:, :, places]) for system in systems]
        fit = tried(chosen, seconds, gap, weights)
        # NaN compares as no gain, so a candidate without enough equations drops out below.
        if fit is None:
            return np.full(1, np.nan), np.empty(0)
        return fit.losses(fit.without), fit.without[:, len(places) - len(columns) :]

    # All candidates against the fit without any, on the same blocks.
    base = beside(())[0]
    trials = []
    for i, (kind, share) in enumerate(candidates):
        further = range(count + i * size, count + (i + 1) * size)
        losses, fits = beside(further, viscous if kind == SATURATING else ())
        better, errors = gain(base, base - losses)
        if not np.isfinite(errors):
            continue
        # The median over the fits: a fit to data without slow motion may give any level.
        levels = np.full(weights.shape[1], np.nan)
        levels[list(joints)] = np.nanmedian(fits, axis=0)
        # A negative sum of levels is not this kind of friction; an offset may have either sign.
        if kind != ASYMMETRIC and np.nansum(levels) < 0:
            continue
        trials.append(
            FrictionTrial(
                kind=kind,
                share=share,
                better=better,
                errors=errors,
                levels=levels,
                units=units,
                usual=usual,
            )
        )
    return tuple(sorted(trials, key=lambda trial: -trial.better))
