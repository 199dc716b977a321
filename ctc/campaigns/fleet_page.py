"""A fleet as a figure and as one page, whose size grows neither with logs nor with robots."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.campaigns.effects import EFFECTS, Effect
from ctc.campaigns.judgement import Judgement, chance_of, day_of
from ctc.report import figure, page, section
from plant.parts import (
    BAND,
    colour_of,
    dressed,
    frozen_settings,
    legend_above,
    literal,
    row_by_row,
    table,
    text,
)


@frozen_settings
class FleetPageSettings:
    """Size of the page of a fleet; chosen by hand.

    Parameters
    ----------
    panels : int
        Parameters in the figure.
    curves : int
        Robots in a panel, beside the band of all.
    instants : int
        Intervals of time over which values are gathered.
    start : int
        Logs at the start of each robot with which the later ones are compared.
    rows : int
        Robots in a table.
    """

    panels: int = 3
    curves: int = 3
    instants: int = 60
    start: int = 3
    rows: int = 15


PAGE = FleetPageSettings()

_CAPTION = (
    "Change of each robot against its own first logs. The band holds nine in ten of all robots."
    " Curves, with 95 % intervals, are the robots that need attention first, if there are any."
)
_HEAD = ("", "mean", "unit", "robots differ by", "weeks of a robot by", "per °C, 95 % from", "to")
_MEANING = (
    "Differences are standard deviations, by restricted maximum likelihood. The slope with"
    " temperature comes from logs of one robot at several temperatures; it is taken out before a"
    " log is judged."
)


def _empty() -> ValueError:
    return ValueError("the fleet must hold identifications; it is empty. Add some first.")


@literal
def plot_fleet(
    effects: Sequence[Effect], order: Sequence[Judgement], ax: Any = None
) -> NDArray[Any]:
    """Draw the parameters with the surest changes over time; return the Axes (panels, 1)."""
    # Parameters that no robot was judged by come last.
    changes = [change for judgement in order for change in judgement.looked]
    changes.sort(key=lambda change: change.false_alarm)
    names = [change.name for change in changes] + [effect.of.name for effect in effects]
    names = list(dict.fromkeys(names))[: PAGE.panels]
    if not names:
        raise _empty()
    robots = [judgement.robot for judgement in order if judgement.changes][: PAGE.curves]
    # Changes name parameters; a panel needs the fleet's distribution of its parameter.
    by_name = {effect.of.name: effect for effect in effects}
    axes = row_by_row(ax, len(names), 1, time=False)
    for name, axis in zip(names, axes[:, 0], strict=True):
        _panel(axis, by_name[name], robots)
    axes[-1, 0].set_xlabel("time [date, UTC]")
    # All panels have the same curves: one legend.
    legend_above(axes[0, 0], columns=PAGE.curves + 1)
    return axes


def _panel(axis: Any, effect: Effect, robots: Sequence[str]) -> None:
    of = effect.of
    # 1. Change of each robot against its own start: robots may differ by more than they change.
    logs_of = [np.flatnonzero(of.robot == robot) for robot in range(len(of.robots))]
    # The mean of several logs: a single one would shift the whole curve by its own error.
    starts = np.array([of.value[logs[: PAGE.start]].mean() for logs in logs_of])
    # A value that its own uncertainty may explain has no meaningful percentage, and zero has none.
    certain = np.median(np.abs(of.value)) > 3 * np.median(of.std)
    relative = certain and starts.all()
    dressed(axis, of.label).set_ylabel("change [%]" if relative else f"change [{of.unit}]")
    change = np.empty_like(of.value)
    std = np.empty_like(of.value)
    for logs, start in zip(logs_of, starts, strict=True):
        scale = 100 / abs(start) if relative else 1.0
        change[logs] = scale * (of.value[logs] - start)
        std[logs] = scale * of.std[logs]

    # 2. Gather in equal intervals of time, so that the drawing does not grow with the logs.
    instants = min(PAGE.instants, len(np.unique(of.time)))
    edges = np.linspace(of.time.min(), of.time.max() + 1, instants + 1)
    interval = np.digitize(of.time, edges[1:-1])
    # Intervals without a log are left out, not drawn as gaps.
    intervals = np.unique(interval)
    seconds = np.array([of.time[interval == i].mean() for i in intervals])
    when = (1e3 * seconds).astype("datetime64[ms]")

    # 3. The band of all robots, and above it the robots that need attention.
    # Quantiles: a few robots that changed do not widen the band of all others.
    quantiles = [np.quantile(change[interval == i], (0.05, 0.95)) for i in intervals]
    low, high = np.array(quantiles).T
    axis.fill_between(when, low, high, color=BAND, label="nine in ten robots")
    for curve, name in enumerate(robots):
        # A robot without this parameter has an empty curve: the legend still names it.
        own = np.array(of.robots)[of.robot] == name
        groups = [own & (interval == i) for i in intervals]
        present = [group.any() for group in groups]
        groups = [group for group in groups if group.any()]
        axis.errorbar(
            when[present],
            np.array([change[group].mean() for group in groups]),
            np.array([1.96 * std[group].mean() for group in groups]),
            color=colour_of(curve),
            marker="o",
            markersize=3,
            linewidth=1.2,
            elinewidth=0.7,
            label=name,
        )
    axis.tick_params(axis="x", labelsize=7)


def fleet_page(title: str, effects: Sequence[Effect], order: Sequence[Judgement], logs: int) -> str:
    """Write the page of a fleet as HTML."""
    if not effects:
        raise _empty()
    # Not every log has every parameter.
    first = min(effect.of.time.min() for effect in effects)
    last = max(judgement.time for judgement in order)
    dates = f"{day_of(first)} to {day_of(last)}"
    subtitle = f"{len(order)} robots, {logs} identifications, {dates}"
    return page(title, subtitle, _parts(effects, order))


def _parts(effects: Sequence[Effect], order: Sequence[Judgement]) -> Iterator[str]:
    # 1. The robots that changed, by name; all others are one line.
    changed = [judgement for judgement in order if judgement.changes]
    lines = [
        f'<li class="bad"><b>✗ {text(judgement.robot)}, {judgement.day}</b>'
        f"{text(judgement.verdict)}</li>"
        for judgement in changed[: PAGE.rows]
    ]
    # Young robots are neither the same nor changed.
    unknown = sum(bool(judgement.unknown) for judgement in order)
    same = len(order) - len(changed) - unknown
    summary = f"{same} of {len(order)} robots: the last log shows the same arm"
    summary += f"; {unknown} cannot be judged yet." if unknown else "."
    if len(changed) > PAGE.rows:
        summary += f" {len(changed) - PAGE.rows} more changed."
    lines.append(f'<li class="good"><b>✓ {text(summary)}</b></li>')
    # All judgements of a page have one level.
    level = order[0].level
    meaning = (
        "Each robot's last log against its own past, at a probability of a false alarm of"
        f" {level:g} a log."
    )
    yield section(
        "What needs attention first", '<ul class="verdict">', *lines, "</ul>", f"<p>{meaning}</p>"
    )
    yield section("Changes", figure(plot_fleet(effects, order), "changes of the fleet", _CAPTION))

    # 2. The surest change of each robot, also where it is not below the level.
    rows = []
    for judgement in order[: PAGE.rows]:
        surest: Any = judgement.unknown
        chance = ""
        if judgement.looked:
            surest = judgement.looked[0]
            chance = chance_of(surest.false_alarm)
        rows.append((judgement.robot, judgement.day, surest, chance))
    head = ("robot", "last log", "surest change", "probability of a false alarm")
    yield section("Robots", table(head, rows, words=(0, 1, 2)), _first_of(len(order)))

    # 3. The fleet that the robots were judged by.
    yield section(
        "The fleet",
        table(_HEAD, [_row(effect) for effect in effects]),
        f"<p>{text(_MEANING)}</p>",
        *_apart(effects),
    )


def _row(effect: Effect) -> tuple[str, ...]:
    # Shares of the mean, unless the mean is smaller than its noise.
    scale = 1.0
    unit = ""
    if abs(effect.mean) > np.median(effect.std):
        scale = 100 / abs(effect.mean)
        unit = " %"
    low = high = ""
    if np.isfinite(effect.slope):
        half_width = 1.96 * effect.slope_std
        low = f"{scale * (effect.slope - half_width):+.2g}{unit}"
        high = f"{scale * (effect.slope + half_width):+.2g}{unit}"
    spread = [
        f"{scale * std:.2g}{unit}" if np.isfinite(std) else ""
        for std in (effect.robots, effect.weeks)
    ]
    # Mean and unit as identified, whatever the scale of the scatter.
    return (effect.of.label, f"{effect.mean:.4g}", effect.of.unit, *spread, low, high)


def _apart(effects: Sequence[Effect]) -> Iterator[str]:
    """Robots that lie apart from the rest of the fleet."""
    # Times the number of parameters (Bonferroni): each of them is a chance of a false alarm.
    outliers = sorted(
        (chance, effect.of.robots[j], effect.of.label, effect.means[j], effect.mean)
        for effect in effects
        for j, chance in enumerate(effect.apart * len(effects))
        if chance < EFFECTS.apart
    )
    rows = [
        (robot, label, f"{robot_mean:.4g}", f"{mean:.4g}", chance_of(chance))
        for chance, robot, label, robot_mean, mean in outliers
    ]
    yield "<h3>Robots unlike the others</h3>"
    if not rows:
        yield "<p>None.</p>"
        return
    head = ("robot", "", "its mean", "the fleet's", "false alarm")
    yield table(head, rows[: PAGE.rows], words=(0, 1))
    yield _first_of(len(rows))


def _first_of(count: int) -> str:
    return f"<p>The first {PAGE.rows} of {count}.</p>" if count > PAGE.rows else ""
