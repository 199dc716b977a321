"""Summary and warnings of a fit of the torque: the values, the choices behind them, the doubts."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from identification.equation_error.band_choice import FitTrial
from identification.equation_error.between_runs import ONE_LOG
from identification.equation_error.bounds import brakes
from identification.equation_error.least_squares import NORMAL
from identification.equation_error.naming import short_names, units
from plant.parts import Aside, Bools, Piece, Table, Verdict, Warned, frozen_settings, inside, listed


@frozen_settings
class TorqueWarningSettings:
    """When a fit of the torque warns; chosen by hand.

    Parameters
    ----------
    poor : float
        Relative torque error above which something is wrong with the log rather than with the arm.
    apart : float
        Standard deviations of a log by which f, which is the arm's, may differ between logs.
    doubted : float
        Standard deviations by which a known number must differ from its estimate to be doubted.
    different : float
        Relative difference by which it must differ as well.
    brakes : float
        Standard deviations by which a free estimate of friction must be negative to be doubted: by
        fewer, what the model lacks may make it so.
    lines : int
        Warnings that are given, the most basic ones: those after them may be their effects.
    """

    poor: float = 0.3
    apart: float = 4.0
    doubted: float = 5.0
    different: float = 0.2
    brakes: float = 8.0
    lines: int = 3


SETTINGS = TorqueWarningSettings()


def summary_of(fit: Any) -> Iterator[Piece]:
    """Pieces of the summary of a `TorqueFit`: verdict, values, choices, friction, errors."""
    summary = (
        f"{fit.rows} equations, relative torque error {fit.relative_error:.2%}, condition"
        f" {fit.condition:.0f}"
    )
    yield Verdict(summary, not fit.warnings)
    yield Warned(fit.warnings)
    # Friction brakes: an interval that holds zero leaves it open whether there is any.
    remarks = np.where(_zero(fit), ", zero within it", "").tolist()
    notes = [f"+- {std:.2g}{remark}" for std, remark in zip(fit.std, remarks, strict=True)]
    # Known numbers stand in the same table: beside the fitted ones they make up f.
    names = (*fit.names, *fit.known)
    columns = (
        short_names(fit.dynamics, names),
        [f"{value:.5g}" for value in (*fit.values, *fit.known.values())],
        units(fit.dynamics, names),
        [*notes, *["known"] * len(fit.known)],
    )
    rows = list(zip(*columns, strict=True))
    yield Table((), rows, words=(2, 3))
    yield from (f"left out: {joint}, {why}" for joint, why in fit.left_out.items())
    yield from _choices(fit)
    # It has no number of its own among the values: it changes their law.
    if fit.rising is not None:
        yield f"Coulomb friction is {fit.rising}"
    # A prior moves what the logs hardly show, so a reader must know that there is one.
    better, errors = fit.bodies
    if fit.prior is not None:
        # A stated prior was not compared.
        compared = np.isfinite(better)
        gained = f": blocks kept aside {better:+.0%} better ({errors:.1f} standard errors)"
        yield f"f has a prior of spread {fit.prior.spread:g}{gained if compared else ''}"
    # A clear one is a warning already.
    if fit.friction and not fit.friction[0].clear:
        yield f"of other friction, the nearest to help is {fit.friction[0]}"
    yield from [ONE_LOG] if fit.between is None else inside(fit.between)
    if fit.error is not None:
        yield from inside(fit.error)
    yield Aside("What the parameters mean", fit.dynamics.legend.splitlines())


def _zero(fit: Any) -> Bools:
    """Which values (k,) are friction that may be none: zero lies in the 95 % interval."""
    return brakes(fit.names) & (np.abs(fit.values) <= NORMAL * fit.std)


def _short_known(fit: Any) -> list[tuple[str, float]]:
    return list(zip(short_names(fit.dynamics, fit.known), fit.known.values(), strict=True))


def _choices(fit: Any) -> Iterator[Piece]:
    """How band and least speeds were chosen; nothing where they were stated."""
    if fit.bands:
        yield (
            f"band {fit.band:g} Hz, chosen by torques of segments left out, compared in narrower"
            " bands:"
        )
        yield _trials(fit.bands)
    if fit.least_speeds and fit.least_speed is not None:
        # A slide has m/s where a joint that turns has rad/s.
        units = [unit.speed for unit in fit.dynamics.chain.joint_units]
        speeds = listed([f"{speed:.3g}" for speed in fit.least_speed], units)
        yield f"least speeds {speeds}, chosen in the same way, compared at higher speeds:"
        yield _trials(fit.least_speeds)


def _trials(trials: Iterable[FitTrial]) -> Table:
    return Table(
        ("", "equations", "standard errors", "against", ""),
        [trial.row for trial in trials],
        words=(4,),
    )


def warnings_of(fit: Any) -> list[str]:
    """Doubts about a `TorqueFit`, one line each: causes before their effects."""
    # 1. The fit as a whole: an arm that cannot be explains all that follows.
    # Friction brakes: a level that is clearly negative means a wrong sign or unit.
    deviation = dict(zip(fit.names, fit.std, strict=True))
    negative = [
        name for name, value in fit.free.items() if value < -SETTINGS.brakes * deviation[name]
    ]
    lines = [*(cause.line for cause in fit.causes), *fit.doubts]
    if negative:
        lines.append(
            f"friction must not be negative; check signs and units ({', '.join(negative)})"
        )
    # No arm leaves so much: columns, units or signs do.
    if fit.relative_error > SETTINGS.poor:
        lines.append(
            f"{fit.relative_error:.0%} of the torque is not explained; check units (rad, joint"
            " side N m), signs and the order of the joints"
        )
    # The best kind alone: the others are judged beside it by the next fit.
    lines += [f"{trial.advice} (fit.friction[0])" for trial in fit.friction[:1] if trial.clear]

    # 2. Logs that differ in numbers of the arm, which are the same in all of them.
    # A single log has nothing to differ from.
    apart = 0.0 if fit.between is None else fit.between.groups.get("f", 0.0)
    if apart > SETTINGS.apart:
        lines.append(
            f"the logs differ in f by {apart:.2g} standard deviations of one: the model lacks"
            " something, or a load (find_load), or another robot; fit each alone"
        )

    # 3. Stated numbers that the torques contradict: in their error, and in size.
    for (label, value), name in zip(_short_known(fit), fit.known, strict=True):
        estimate, std = fit.freed.get(name, (value, 0.0))
        # Both must hold: a precise estimate may differ significantly by a negligible amount.
        size = max(abs(estimate), abs(value))
        if abs(estimate - value) > max(SETTINGS.doubted * std, SETTINGS.different * size):
            lines.append(
                f"{label} is stated as {value:.4g}, but these torques ask for {estimate:.4g} +-"
                f" {std:.2g}: check it, its unit and its sign"
            )
    # Later ones may be effects of these.
    return lines[: SETTINGS.lines]
