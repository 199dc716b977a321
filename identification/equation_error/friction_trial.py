"""Friction beyond Coulomb and viscous, tried by what it predicts of blocks of the logs that its fit
has not seen.

What a friction that is not modelled leaves looks like an offset, a gear that swings or a wrong
gain, so it is tried before these are blamed.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from identification.equation_error.band_choice import tried
from identification.equation_error.regressor import System
from plant import Drive, FrictionCurve
from plant.parts.fields import Floats
from plant.parts.shown import Piece, Shown

KINDS = ("asymmetric", "load-dependent", "Stribeck", "saturating viscous")

_ADVICE = dict(
    zip(
        KINDS,
        (
            (
                "state it, the drive of fit.friction[0].drive(rig.drive), and add"
                " drive.curve.offset[i] to unknown"
            ),
            "state it, the drive of fit.friction[0].drive(rig.drive)",
            "state it, the drive of fit.friction[0].drive(rig.drive)",
            "trust the fit at the speeds of its logs only",
        ),
        strict=True,
    )
)

# standard errors, and share of the squared error, by which a candidate predicts better
_CLEAR = 3.0
_ENOUGH = 0.1


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FrictionTrial(Shown):
    """One kind of friction on trial, beside what is fitted.

    Attributes
    ----------
    kind : str
    share : tuple of float or None
        Stribeck speed, or speed at which viscous friction saturates, of each joint, in its usual
        speed.
    better : float
        Share of the squared error, of torques in blocks kept aside, that it takes away; negative
        where it adds.
    errors : float
        The same, in standard errors over the blocks.
    levels : (n,) numpy.ndarray
        Its torque [N m] on the shaft of each joint (of load-dependent friction, per N m of load);
        NaN where it was not tried.
    usual : (n,) numpy.ndarray
        Usual speed of each joint, that `share` is a part of [rad/s].
    """

    kind: str
    share: tuple[float, ...] | None
    better: float
    errors: float
    levels: Floats
    usual: Floats

    @property
    def clear(self) -> bool:
        """Whether it predicts better by more than chance, and by more than does not matter."""
        return self.errors > _CLEAR and self.better > _ENOUGH

    @property
    def advice(self) -> str:
        """What to do where it is clear, with what was found, in a line."""
        levels = ", ".join("-" if np.isnan(level) else f"{level:.2g}" for level in self.levels)
        unit = "" if self.kind == KINDS[1] else " N m"
        return (
            f"friction is {self._short()}; its levels on the joints' shafts are {levels}{unit}:"
            f" {_ADVICE[self.kind]}"
        )

    def drive(self, drive: Drive) -> Drive:
        """A drive that has this friction too: fit again with it, and controllers compensate it (but
        of load).

        Raises
        ------
        ValueError
            Of viscous friction that saturates, which no part of a drive describes; of a second
            Stribeck speed.
        """
        found = np.nan_to_num(self.levels)
        if self.kind == KINDS[1]:
            return dataclasses.replace(drive, load_friction=np.maximum(found, 0.0))
        curve = drive.curve or FrictionCurve(offset=0 * found)
        if self.kind == KINDS[0]:
            curve = dataclasses.replace(curve, offset=curve.offset + found / drive.gear)
        elif self.kind == KINDS[2] and self.share is not None:
            if curve.breakaway is not None:
                raise ValueError(
                    "a drive has one Stribeck speed; this one states another. Fit without its"
                    " breakaway."
                )
            gear = np.abs(drive.gear)
            levels = np.maximum(found, 0.0) / gear
            speed = np.array(self.share) * self.usual * gear
            curve = dataclasses.replace(curve, breakaway=levels, speed=speed)
        else:
            raise ValueError(
                f"friction must be one that a drive has; got {self.kind} friction."
                f" {_ADVICE[self.kind]}."
            )
        return dataclasses.replace(drive, curve=curve)

    def _short(self) -> str:
        each = ", ".join(f"{share:.0%}" for share in dict.fromkeys(self.share or ()))
        at = f" at {each} of the usual speed{'s' * (',' in each)}" if each else ""
        return (
            f"{self.kind}{at}: blocks kept aside {self.better:+.0%} better ({self.errors:.1f}"
            " standard errors)"
        )

    def _shown(self) -> Iterator[Piece]:
        yield self._short()


def friction_trials(
    systems: Sequence[System],
    candidates: Sequence[tuple[str, tuple[float, ...] | None]],
    joints: Sequence[int],
    seconds: Floats,
    gap: float,
    weights: Floats,
    usual: Floats,
) -> tuple[FrictionTrial, ...]:
    """Trials, best first, of systems whose last columns are those of each candidate, one for each
    of these joints.

    `seconds` (R,): length of each log. `gap` [s]: around a block, which is left out with it.
    `weights` (R, n). `usual` (n,): speeds that a share is of [rad/s].
    """
    n = weights.shape[1]
    more = len(joints)
    first = systems[0].regressor.shape[2] - len(candidates) * more

    def beside(columns: Iterable[int]) -> tuple[Floats, Floats]:
        places = [*range(first), *columns]
        some = [
            dataclasses.replace(each, regressor=each.regressor[:, :, places]) for each in systems
        ]
        found = tried(some, seconds, gap, weights)
        return (
            (np.full(1, np.nan), np.empty(0))
            if found is None
            else (found.losses(found.without), found.without)
        )

    base = beside(())[0]
    trials = list[FrictionTrial]()
    for i, (kind, share) in enumerate(candidates):
        missed, fits = beside(range(first + i * more, first + (i + 1) * more))
        kept = (base - missed)[np.isfinite(base - missed)]
        if len(kept) < 2:  # too few equations, or blocks
            continue
        levels = np.full(n, np.nan)
        levels[list(joints)] = np.nanmedian(fits[:, first:], axis=0)
        # less of it than none: another kind, seen in a mirror
        if kind != KINDS[0] and np.nansum(levels) < 0:
            continue
        error = max(float(kept.std(ddof=1)) / np.sqrt(len(kept)), 1e-300)
        better = float(kept.mean() / np.nanmean(base))
        said = {"kind": kind, "share": share, "better": better, "errors": kept.mean() / error}
        trials.append(FrictionTrial(**said, levels=levels, usual=usual))
    return tuple(sorted(trials, key=lambda trial: -trial.better))
