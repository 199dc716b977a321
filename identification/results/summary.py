"""Summary of an identification: values, intervals, contradictions, assumptions."""

import contextlib
import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from identification.equation_error import NORMAL, ONE_LOG, TorqueFit, along_log
from identification.equation_error import units as units_of
from identification.results.seen import counted, drifting, of_prior, origins
from identification.results.trust import SETTINGS as WARNING_SETTINGS
from identification.results.trust import pairs_of
from identification.search import LONG, PARTS, is_long
from plant.mechanics import STANDARD
from plant.parts import WIDTH, Aside, Piece, Table, Verdict, Warned, frozen_settings, inside, warn


class IdentificationWarning(UserWarning):
    """The result of an identification has warnings: it is unreliable.

    Given once by `identify`, and by each law that is built on the identification;
    ``found.warnings`` has the lines. ``warnings.simplefilter("error", IdentificationWarning)``
    makes it an error. An arm and a rig, as in ``ComputedTorque(found.arm, found.rig)``, are taken
    as they are: so they are accepted.

    See Also
    --------
    identification.identify

    Examples
    --------
    >>> import warnings
    >>> from identification import IdentificationWarning
    >>> warnings.simplefilter("error", IdentificationWarning)  # an unreliable result ends a script
    >>> warnings.simplefilter("default", IdentificationWarning)
    """


@frozen_settings
class SummarySettings:
    """Lengths at which a summary still fits on a screen; chosen by hand.

    Parameters
    ----------
    unknowns : int
        Unknowns up to which everything is shown.
    warnings : int
        Warnings that are shown of more unknowns.
    """

    unknowns: int = 20
    warnings: int = 5


SETTINGS = SummarySettings()


def doubts(result: Any) -> list[str]:
    """Warnings of a `TorqueFit`, or of an `Identification` without those that hold for any log."""
    return result.warnings if isinstance(result, TorqueFit) else result.doubts


def notes(result: Any) -> list[str]:
    """Those lines of an `Identification` that hold for any log, and doubt no value."""
    return [line for line in result.warnings if line not in result.doubts]


def warn_of_doubts(result: Any, user: str) -> None:
    """Warn if a result is unreliable; `user` is the function or law that takes it."""
    lines = doubts(result)
    if lines:
        # All warnings in one, so that a filter that raises an error shows all.
        count = "1 warning" if len(lines) == 1 else f"{len(lines)} warnings"
        warn(
            f"{user}: identified with {count}:\n" + "\n".join(f"- {line}" for line in lines),
            IdentificationWarning,
        )


def verdict_of(result: Any, shown: int | None = None) -> Verdict:
    """Whether the log of an `Identification` contradicts what was stated.

    `shown`: the warnings that stand below at most, if not all.
    """
    # Notes hold for any log: they are printed, but do not make a result unreliable.
    doubtful = len(doubts(result))
    if doubtful:
        first = f"the first {shown} " if shown is not None and doubtful > shown else ""
        return Verdict(
            f"Unreliable: {doubtful} warning{'s' * (doubtful > 1)}, {first}below.", False
        )
    # Silence is no evidence where the tests could not be made.
    if result.diagnostics.detection.reason is not None:
        return Verdict("Nothing contradicts what was stated, but the rig was not tested.")
    return Verdict("Nothing in the log contradicts what was stated.", True)


def summary_of(result: Any, full: bool) -> Iterator[Piece]:
    """Pieces of the summary of an `Identification`: verdict, values, tests, assumptions.

    Not full, and of many unknowns: their values in columns, and the most important of the rest.
    """
    full = full or len(result.fit.values) <= SETTINGS.unknowns
    most = None if full else SETTINGS.warnings

    # 1. Verdict, and how the values were found.
    yield verdict_of(result, most)
    yield f"{result.search.method}, {len(result.records)} record(s): {result.message}"
    yield from _noise_of_torque(result)
    if any(is_long(along_log(record)) for record in (*result.records, *result.held_out)):
        yield (
            f"values are fitted to all samples; of a record longer than {LONG:,} the rig is tested,"
            f" and the genetic algorithm run, on {PARTS} parts of {LONG // PARTS:,}, spread over it"
        )
    if result.held_out:
        names = [record.name or f"a record of {len(record)} samples" for record in result.held_out]
        yield (
            f"validation, only simulated: {', '.join(names)}; by default the last of several logs,"
            " held_out=() identifies from all"
        )

    # 2. Values and their origin.
    if full:
        yield _values(result)
    else:
        yield from _abreast(result)
        yield _in_units(result)
        yield _links_of(result.arm.dynamics)
    yield from origins(result, full)
    pairs = pairs_of(result)
    if 0 < len(pairs) <= WARNING_SETTINGS.pairs:  # more are a warning
        listed = ", nor ".join(f"{name} from {partner}" for name, partner in pairs)
        yield (
            f"the log hardly tells {listed}; the covariance counts it, and design_motion or prior="
            " tells more"
        )
    if result.fit.between is not None:
        yield from inside(result.fit.between)
    elif result.covariance is not None:
        # One log cannot show what differs between logs, such as temperature.
        if len(result.records) == 1:
            yield ONE_LOG
        else:
            yield "what differs between runs is not in the intervals"

    # 3. Tests, and assumptions that no test can reveal.
    yield from explained_torque(result)
    yield from inside(result.diagnostics)
    if drift := drifting(result):
        yield drift
    # The tolerances are in the intervals only where the covariance was widened.
    if result.fit.noise_covariance is not None:
        yield counted(result)
    if result.covariance is not None and result.diagnostics.detection.assumed:
        if full:
            yield from inside(result.assumed())
        else:
            # Lengths take long: they are asked for by name.
            yield _most_moved(result.assumed(lengths=False))
    if any(_torque_of_law(record) for record in result.records):
        yield (
            "the torque is the stated law's, none was logged: if all its gains are 1 % larger, f is"
            " 1 % larger, and friction that is unknown"
        )
    if result.fit.resonance is not None:
        yield from inside(result.fit.resonance)

    # 4. Warnings, as many as the verdict counts, then notes; the meaning of the names.
    yield Warned(doubts(result)[:most])
    yield from (f"note: {line}" for line in notes(result)[:most])
    if full:
        yield Aside("What the parameters mean", result.arm.dynamics.legend.splitlines())
        return
    # A short summary hides things: it tells how to see them.
    hidden = len(doubts(result)) - SETTINGS.warnings
    remark = f"{hidden} more warnings, " if hidden > 0 else ""
    yield (
        f"{remark}95 % intervals, bounds, correlations, and what the names of parameters mean: "
        "print(found.summary(full=True))"
    )


def _abreast(result: Any) -> Iterator[Table]:
    """Values and standard deviations, those of f first, in as many columns as a line holds."""
    # Without a covariance, every value stands alone.
    std = [None] * len(result.fit.values) if result.covariance is None else result.fit.std
    prior = of_prior(result)
    cells_of_f = list[tuple[str, ...]]()
    further_cells = list[tuple[str, ...]]()
    for name, short, value, deviation in zip(
        result.fit.unknown, result.short_names, result.fit.values, std, strict=True
    ):
        if deviation is None:
            note = ""
        elif deviation > 0:
            note = f"+- {deviation:.2g}{' prior' * (short in prior)}"
        else:
            note = _without_std(result.fit, name)
        cells = cells_of_f if name in result.arm.dynamics.names else further_cells
        cells.append((short, f"{value:.4g}", note))
    for cells in (cells_of_f, further_cells):
        # The widest table that fits on a screen; one column in any case.
        tables = [_in_columns(cells, columns) for columns in (4, 3, 2, 1)]
        fitting = [
            # Wide enough not to wrap: the lines show the width that the table needs.
            table
            for table in tables
            if max(map(len, table.lines(10 * WIDTH)), default=0) <= WIDTH
        ]
        yield (fitting or tables[-1:])[0]


def _in_units(result: Any) -> str:
    """The names of the values, by their units; those of all joints once."""
    names_in = dict[str, list[str]]()
    units = units_of(result.arm.dynamics, result.fit.unknown)
    for short, unit in zip(result.short_names, units, strict=True):
        names_in.setdefault(unit, []).append(short.partition("[")[0])
    return "; ".join(
        f"in {unit}: {', '.join(dict.fromkeys(names))}" for unit, names in names_in.items() if unit
    )


def _without_std(fit: Any, name: str) -> str:
    """What stands for the standard deviation of a value that has none."""
    # The log bounds gears that may be rigid; any other value was not varied.
    return "bounded" if fit.resonance is not None and fit.resonance.bounds(name) else "known"


def _links_of(dynamics: Any) -> str:
    """Runs of parameters that begin with numbers of the same link, with the joint of it."""
    # The place of the leading standard parameter tells the link.
    matrix = np.array(dynamics.lumping.matrix)
    links = [np.flatnonzero(row)[0] // len(STANDARD) for row in matrix]
    names = dynamics.short_names
    labels = dynamics.chain.joint_labels
    texts = []
    # Parameters come link by link, from the base.
    for link, run in itertools.groupby(range(len(links)), key=links.__getitem__):
        places = list(run)
        end = f" to {names[places[-1]]}" if len(places) > 1 else ""
        texts.append(f"{names[places[0]]}{end}: {labels[link]}")
    return "; ".join(texts)


def _noise_of_torque(result: Any) -> Iterator[Piece]:
    """The noise of the torques that a fit repeated, of each motor."""
    fit = result.fit
    if fit.torque_noise is None or not fit.torque_noise.any():
        return
    # A model that follows the torque far closer than noise of this size would allow: the
    # controller chatters so, and the arm feels it.
    if fit.rms_innovation is not None and fit.noise_innovation > 3 * fit.rms_innovation:
        return
    drive = result.rig.drive
    labels = result.arm.dynamics.chain.joint_labels
    noise = np.abs(drive.motor_torque(fit.torque_noise))
    sizes = ", ".join(f"{size:.2g} at {label}" for size, label in zip(noise, labels, strict=True))
    effect = "the law gives the torque without it"
    if fit.noise_innovation:
        effect = f"it adds {fit.noise_innovation:.2g} pulses to the innovations"
    yield f"noise of the logged torque: {sizes} [N m of the motor, rms]; {effect}"


def explained_torque(result: Any) -> Iterator[str]:
    """How much of the torque of each joint the values explain."""
    labels = result.arm.dynamics.chain.joint_labels
    shares = [
        f"{min(share, 99.99):.4g} % at {label}"
        for share, label in zip(result.explained, labels, strict=True)
        if np.isfinite(share)
    ]
    if shares:
        yield f"fit of the torque: {', '.join(shares)}"


def _in_columns(cells: Sequence[tuple[str, ...]], columns: int) -> Table:
    """A table of so many columns of cells, read downwards."""
    height = -(-len(cells) // columns)  # rounded up
    # The last column may be shorter: empty cells fill it.
    filled = [*cells, *[("", "", "")] * (columns * height - len(cells))]
    rows = [[text for cell in filled[i::height] for text in cell] for i in range(height)]
    # Names and notes are words, the values between them are numbers.
    return Table((), rows, words=[3 * i + j for i in range(columns) for j in (0, 2)])


def _most_moved(assumed: Any) -> str:
    """The value that each kind of assumed number moves most."""
    # A value without standard deviation is known: nothing moves it.
    share = np.abs(assumed.moves) / np.where(assumed.std > 0, assumed.std, np.inf)
    kinds = [name.partition("[")[0] for name in assumed.names]
    texts = []
    for kind in dict.fromkeys(kinds):
        rows = np.flatnonzero([kind_of_row == kind for kind_of_row in kinds])
        row = int(rows[share[rows].max(axis=1).argmax()])
        column = int(share[row].argmax())
        texts.append(
            f"{assumed.unknown[column]} by {share[row, column]:.2g} ({assumed.names[row]})"
        )
    return (
        f"1 % more of an assumed number moves, in standard deviations, at most: {', '.join(texts)};"
        " found.assumed()"
    )


def _torque_of_law(record: Any) -> bool:
    """Whether the torque follows only from the law, and scales f with all its gains.

    A law without memory is fitted to the counts of its loop instead.
    """
    logged = record.torque is not None or record.current is not None
    law = record.law
    return not logged and law is not None and not law.replays and law.has_memory(record.n)


def _values(result: Any) -> Table:
    """Every value with its unit, standard deviation, bound, interval and largest correlation."""
    names = result.short_names
    fit = result.fit
    values = [f"{value:.5g}" for value in fit.values]
    units = units_of(result.arm.dynamics, fit.unknown)
    if result.covariance is None:
        rows_of_values = list(zip(names, values, units, strict=True))
        return Table(("", "value", "unit"), rows_of_values, words=(2,))
    bounds = np.full(len(values), np.nan)
    # The bound is that of one log alone, so it does not apply with a prior or from a later start.
    if not fit.resumptions and fit.prior is None:
        # There is none without a reference, or of numbers that are not separately identifiable.
        with contextlib.suppress(ValueError):
            bounds = result.bound()
    prior = of_prior(result)
    # Without the correlation of each value with itself.
    correlation = fit.correlation - np.eye(len(values))
    rows = list[tuple[str, ...]]()
    for i, (value, std) in enumerate(zip(fit.values, fit.std, strict=True)):
        if not std > 0:
            without_std = _without_std(fit, fit.unknown[i])
            rows.append((names[i], values[i], units[i], without_std, "", "", ""))
            continue
        partner = int(np.argmax(np.abs(correlation[i])))
        rows.append(
            (
                names[i],
                values[i],
                units[i],
                f"{std:.2g}{' prior' * (names[i] in prior)}",
                f"{bounds[i]:.2g}",
                f"[{value - NORMAL * std:.5g}, {value + NORMAL * std:.5g}]",
                f"{names[partner]} ({correlation[i, partner]:+.2f})",
            )
        )
    head: tuple[str, ...] = (
        "",
        "value",
        "unit",
        "std",
        "Cramér-Rao bound",
        "95 % interval",
        "largest correlation",
    )
    if not np.isfinite(bounds).all():  # without that column
        head = head[:4] + head[5:]
        rows = [row[:4] + row[5:] for row in rows]
    return Table(head, rows, words=(2, len(head) - 1))
