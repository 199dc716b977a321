"""A fleet as a figure and as one page, of a size that grows neither with logs nor with robots."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.campaigns.effects import APART, Effect
from ctc.campaigns.judgement import Judgement, chance_of, day_of
from ctc.report.page import figure, page, section
from plant.parts.figures import BAND, colour_of, dressed, legend_above, literal, row_by_row
from plant.parts.shown import table, text

# of the figure; and logs of a robot that it is compared with
_PANELS = 3
_CURVES = 3
_PLACES = 60
_FIRST = 3
_ROWS = 15  # robots in a table
_CAPTION = (
    "Change of each robot against its own first logs: the band holds nine in ten of all robots,"
    " curves with 95 % intervals, if there are any, are the robots that need attention first."
)


@literal
def plot_fleet(
    effects: Sequence[Effect], order: Sequence[Judgement], ax: Any = None
) -> NDArray[Any]:
    """The parameters that changed most, over time; Axes (panels, 1)."""
    surest = sorted(
        (each for judgement in order for each in judgement.looked),
        key=lambda each: each.false_alarm,
    )
    names = [
        *dict.fromkeys([*(each.name for each in surest), *(effect.of.name for effect in effects)])
    ][:_PANELS]
    if not names:
        raise ValueError("the fleet must hold identifications; it is empty. Add some first.")
    shown = [judgement.robot for judgement in order if judgement.changes][:_CURVES]
    axes = row_by_row(ax, len(names), 1, time=False)
    for name, axis in zip(names, axes[:, 0], strict=True):
        _panel(axis, next(effect for effect in effects if effect.of.name == name), shown)
    axes[-1, 0].set_xlabel("time [date, UTC]")
    legend_above(axes[0, 0], columns=_CURVES + 1)
    return axes


def _panel(axis: Any, effect: Effect, shown: Sequence[str]) -> None:
    of = effect.of
    known = np.median(np.abs(of.value)) > 3 * np.median(of.std)
    dressed(axis, of.label).set_ylabel("change [%]" if known else f"change [{of.unit}]")
    change = np.empty_like(of.value)
    std = np.empty_like(of.value)
    for robot in range(len(of.robots)):
        own = np.flatnonzero(of.robot == robot)
        first = of.value[own[:_FIRST]].mean()
        change[own] = of.value[own] - first
        scale = 100 / abs(first) if known and first else 1.0
        change[own], std[own] = scale * change[own], scale * of.std[own]
    edges = np.linspace(of.time.min(), of.time.max() + 1, min(_PLACES, len(np.unique(of.time))) + 1)
    place = np.digitize(of.time, edges[1:-1])
    places = np.unique(place)
    when = (1e3 * np.array([of.time[place == p].mean() for p in places])).astype("datetime64[ms]")
    low, high = np.array([np.quantile(change[place == p], (0.05, 0.95)) for p in places]).T
    axis.fill_between(when, low, high, color=BAND, label="nine in ten robots")
    for i, name in enumerate(shown):
        if name in of.robots:
            own = of.robot == of.robots.index(name)
            at = [p for p in places if (own & (place == p)).any()]
            middle = np.array([change[own & (place == p)].mean() for p in at])
            wide = np.array([1.96 * std[own & (place == p)].mean() for p in at])
            axis.errorbar(
                when[np.isin(places, at)],
                middle,
                wide,
                color=colour_of(i),
                marker="o",
                markersize=3,
                linewidth=1.2,
                elinewidth=0.7,
                label=name,
            )
    axis.tick_params(axis="x", labelsize=7)


def fleet_page(title: str, effects: Sequence[Effect], order: Sequence[Judgement], logs: int) -> str:
    """The page."""
    if not effects:
        raise ValueError("the fleet must hold identifications; it is empty. Add some first.")
    ends = [
        day_of(time) for each in effects[:1] for time in (each.of.time.min(), each.of.time.max())
    ]
    subtitle = f"{len(order)} robots, {logs} identifications, {ends[0]} to {ends[1]}"
    return page(title, subtitle, _parts(effects, order))


def _parts(effects: Sequence[Effect], order: Sequence[Judgement]) -> Iterator[str]:
    changed = [each for each in order if each.changes]
    lines = [
        f'<li class="bad"><b>✗ {text(each.robot)}, {each.day}</b>{text(each.verdict)}</li>'
        for each in changed[:_ROWS]
    ]
    unknown = sum(bool(each.unknown) for each in order)
    rest = (
        f"{len(order) - len(changed) - unknown} of {len(order)} robots: the last log shows the"
        " same arm"
    )
    rest += f"; {unknown} cannot be judged yet." if unknown else "."
    more = f" {len(changed) - _ROWS} more changed." * (len(changed) > _ROWS)
    lines.append(f'<li class="good"><b>✓ {text(rest + more)}</b></li>')
    level = order[0].level
    said = (
        "Each robot's last log against its own past, at a probability of a false alarm of"
        f" {level:g} a log."
    )
    yield section(
        "What needs attention first", '<ul class="verdict">', *lines, "</ul>", f"<p>{said}</p>"
    )
    yield section("Changes", figure(plot_fleet(effects, order), "changes of the fleet", _CAPTION))
    rows = [
        (
            each.robot,
            each.day,
            each.looked[0] if each.looked else each.unknown,
            chance_of(each.looked[0].false_alarm) if each.looked else "",
        )
        for each in order[:_ROWS]
    ]
    head = ("robot", "last log", "surest change", "probability of a false alarm")
    yield section("Robots", table(head, rows, words=(0, 1, 2)), _first_of(len(order)))
    parts = (
        table(_HEAD, [_row(each) for each in effects]),
        f"<p>{text(_MEANING)}</p>",
        *_apart(effects),
    )
    yield section("The fleet", *parts)


_HEAD = ("", "mean", "unit", "robots differ by", "weeks of a robot by", "per °C, 95 % from", "to")
_MEANING = (
    "Standard deviations, by restricted maximum likelihood; a slope with temperature is of logs of"
    " one robot at several temperatures, and is taken out before a log is judged."
)


def _row(effect: Effect) -> tuple[str, ...]:
    scale, unit = (
        (100 / abs(effect.mean), " %") if abs(effect.mean) > np.median(effect.std) else (1.0, "")
    )
    slope = ("", "")
    if np.isfinite(effect.slope):
        ends = effect.slope + 1.96 * effect.slope_std * np.array([-1, 1])
        slope = tuple(f"{scale * each:+.2g}{unit}" for each in ends)  # type: ignore[assignment]  # two of them
    spread = [
        f"{scale * each:.2g}{unit}" if np.isfinite(each) else ""
        for each in (effect.robots, effect.weeks)
    ]
    return (effect.of.label, f"{effect.mean:.4g}", effect.of.unit, *spread, *slope)


def _apart(effects: Sequence[Effect]) -> Iterator[str]:
    """Robots unlike the others."""
    found = sorted(
        (chance, effect.of.robots[j], effect.of.label, effect.means[j], effect.mean)
        for effect in effects
        for j, chance in enumerate(effect.apart * len(effects))
        if chance < APART
    )
    rows = [
        (robot, label, f"{own:.4g}", f"{mean:.4g}", chance_of(chance))
        for chance, robot, label, own, mean in found
    ]
    yield "<h3>Robots unlike the others</h3>"
    if not rows:
        yield "<p>None.</p>"
    else:
        yield table(
            ("robot", "", "its mean", "the fleet's", "false alarm"), rows[:_ROWS], words=(0, 1)
        )
        yield _first_of(len(rows))


def _first_of(count: int) -> str:
    return f"<p>The first {_ROWS} of {count}.</p>" if count > _ROWS else ""
