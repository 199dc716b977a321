"""What an identification shows: values, intervals, what contradicts the model, what was assumed."""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from identification.equation_error.between_runs import ONE_LOG
from identification.equation_error.law_memory import along_log
from identification.equation_error.least_squares import NORMAL
from identification.equation_error.torque_fit import TorqueFit
from identification.results.seen import of_prior, origins
from identification.results.trust import MANY, pairs_of, warnings_of
from identification.search.problem import LONG, PARTS, is_long
from plant.mechanics.lumping import STANDARD
from plant.parts.messages import warn
from plant.parts.shown import Aside, Piece, Verdict, Warned, inside
from plant.parts.tables import WIDTH, Table


class IdentificationWarning(UserWarning):
    """What was found has warnings: it is unreliable.

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
    >>> warnings.simplefilter("error", IdentificationWarning)    # an unreliable result stops a script
    >>> warnings.simplefilter("default", IdentificationWarning)
    """


def doubts(found: Any) -> list[str]:
    """The warnings of a `TorqueFit`, or of an `Identification` without what is so with any log."""
    return found.warnings if isinstance(found, TorqueFit) else warnings_of(found, always=False)


def warn_of_doubts(found: Any, user: str) -> None:
    """Warn if what was identified is unreliable; `user` is what takes it."""
    lines = doubts(found)
    if lines:
        what = "1 warning" if len(lines) == 1 else f"{len(lines)} warnings"
        warn(
            f"{user}: identified with {what}:\n" + "\n".join(f"- {line}" for line in lines),
            IdentificationWarning,
        )


_MANY = 20  # unknowns up to which everything is shown; of more, what fits on a screen

_WARNED = 5  # warnings that a screen shows


def said_of(found: Any, full: bool) -> Iterator[Piece]:
    """Of an `Identification`: its verdict, each value with its interval, what was tested, what was
    assumed.

    Not full, and of many unknowns: their values side by side, and of the rest the most important.
    """
    full = full or len(found.fit.values) <= _MANY
    warnings = found.warnings
    doubtful = len(doubts(found))
    count = f"{doubtful} warning{'s' * (doubtful > 1)}"
    clear = "Nothing in the log contradicts what was stated."
    yield Verdict(f"Unreliable: {count}, below." if doubtful else clear, not doubtful)
    yield f"{found.search.method}, {len(found.records)} record(s): {found.message}"
    if any(is_long(along_log(record)) for record in (*found.records, *found.held_out)):
        yield (
            f"values are fitted to all samples; of a record longer than {LONG:,} the rig is tested,"
            f" and the genetic algorithm run, on {PARTS} parts of {LONG // PARTS:,}, spread over it"
        )
    if found.held_out:
        named = ", ".join(
            record.name or f"a record of {len(record)} samples" for record in found.held_out
        )
        yield f"validation, only simulated: {named}"
    if full:
        yield _values(found)
    else:
        yield from _abreast(found)
        yield _links_of(found.arm.dynamics)
    yield from origins(found, full)
    if 0 < len(pairs := pairs_of(found)) <= MANY:
        told = ", nor ".join(f"{one} from {other}" for one, other in pairs)
        yield (
            f"the log hardly tells {told}; the covariance counts it, and design_motion or prior="
            " tells more"
        )
    if found.fit.between is not None:
        yield from inside(found.fit.between)
    elif found.covariance is not None:
        one = f"{ONE_LOG}{' (held_out=() takes the one that is held out)' * bool(found.held_out)}"
        yield (
            one if len(found.records) == 1 else "what differs between runs is not in the intervals"
        )
    yield from inside(found.diagnostics)
    if found.fit.noise_covariance is not None:
        yield f"intervals count noise and {found.search.tolerances}"
    if found.covariance is not None and found.diagnostics.detection.assumed:
        yield from inside(found.assumed()) if full else _most_moved(found)
    if any(_torque_of_law(record) for record in found.records):
        yield (
            "the torque is the stated law's, none was logged: if all its gains are 1 % larger, f is"
            " 1 % larger, and friction that is unknown"
        )
    if found.fit.resonance is not None:
        yield from inside(found.fit.resonance)
    yield Warned(warnings if full else warnings[:_WARNED])
    if full:
        yield Aside("What the parameters mean", found.arm.dynamics.legend.splitlines())
        return
    more = f"{len(warnings) - _WARNED} more warnings, " if len(warnings) > _WARNED else ""
    yield (
        f"{more}95 % intervals, bounds, correlations, and what the names of parameters mean: "
        "print(found.summary(full=True))"
    )


def _abreast(found: Any) -> Iterator[Table]:
    """Values and standard deviations, those of f and then the others, in as many columns as a
    line holds.
    """
    std = [0.0] * len(found.fit.values) if found.covariance is None else found.fit.std
    rows = list(zip(found.fit.unknown, found.short_names, found.fit.values, std, strict=True))
    prior = of_prior(found)
    for of_f in (True, False):
        cells = [
            (
                short,
                f"{value:.4g}",
                (
                    f"+- {own:.2g}{' prior' * (short in prior)}"
                    if own > 0
                    else "known" * (std is found.fit.std)
                ),
            )
            for name, short, value, own in rows
            if (name in found.arm.dynamics.names) == of_f
        ]
        tables = [_in_columns(cells, columns) for columns in (4, 3, 2, 1)]
        fits = [
            table for table in tables if max(map(len, table.lines(10 * WIDTH)), default=0) <= WIDTH
        ]
        yield (fits or tables[-1:])[0]


def _links_of(dynamics: Any) -> str:
    """Which parameters begin with numbers of which link."""
    first = [np.flatnonzero(row)[0] // len(STANDARD) for row in np.array(dynamics.lumping.matrix)]
    runs = [
        [k for k, _ in run]
        for _, run in itertools.groupby(enumerate(first), key=lambda pair: pair[1])
    ]
    names = dynamics.short_names
    labels = dynamics.chain.joint_labels
    return "; ".join(
        f"{names[run[0]]}{f' to {names[run[-1]]}' * (len(run) > 1)}: {labels[first[run[0]]]}"
        for run in runs
    )


def _in_columns(cells: Sequence[tuple[str, ...]], columns: int) -> Table:
    """A table of so many columns of cells, read downwards."""
    height = -(-len(cells) // columns)
    filled = [*cells, *[("", "", "")] * (columns * height - len(cells))]
    rows = [[text for cell in filled[i::height] for text in cell] for i in range(height)]
    return Table((), rows, words=[3 * i + j for i in range(columns) for j in (0, 2)])


def _most_moved(found: Any) -> Iterator[str]:
    """Of each kind of assumed number, the value that it moves most."""
    assumed = found.assumed()
    share = np.abs(assumed.moves) / np.where(assumed.std > 0, assumed.std, np.inf)
    kinds = [name.partition("[")[0] for name in assumed.names]
    told = []
    for kind in dict.fromkeys(kinds):
        own = np.where([each == kind for each in kinds], share.max(axis=1), -1.0)
        row = int(own.argmax())
        most = int(share[row].argmax())
        told.append(f"{assumed.unknown[most]} by {share[row, most]:.2g} ({assumed.names[row]})")
    yield (
        f"1 % more of an assumed number moves, in standard deviations, at most: {', '.join(told)};"
        " found.assumed()"
    )


def _torque_of_law(record: Any) -> bool:
    """Whether nothing but the law says with which torque an arm was moved, a law whose gains are
    not told apart.
    """
    logged = record.torque is not None or record.current is not None
    return (
        not logged
        and record.law is not None
        and not record.law.replays
        and record.law.has_memory(record.n)
    )


def _values(found: Any) -> Table:
    names = found.short_names
    values = [f"{value:.5g}" for value in found.fit.values]
    if found.covariance is None:
        return Table(("", "value"), list(zip(names, values, strict=True)))
    try:  # the bound is that of the logs alone
        alone = not found.fit.resumptions and found.fit.prior is None
        bounds = found.bound() if alone else np.full(len(values), np.nan)
    except ValueError:  # no reference, or numbers that are not separately identifiable
        bounds = np.full(len(values), np.nan)
    prior = of_prior(found)
    others = found.fit.correlation - np.eye(len(values))
    rows = list[tuple[str, ...]]()
    for i, (value, std) in enumerate(zip(found.fit.values, found.fit.std, strict=True)):
        if not std > 0:
            said = (
                "bounded"
                if found.fit.resonance is not None and found.fit.resonance.bounds(names[i])
                else "known"
            )
            rows.append((names[i], values[i], said, "", "", ""))
            continue
        most = int(np.argmax(np.abs(others[i])))
        interval = f"[{value - NORMAL * std:.5g}, {value + NORMAL * std:.5g}]"
        together = f"{names[most]} ({others[i, most]:+.2f})"
        rows.append(
            (
                names[i],
                values[i],
                f"{std:.2g}{' prior' * (names[i] in prior)}",
                f"{bounds[i]:.2g}",
                interval,
                together,
            )
        )
    head: tuple[str, ...] = (
        "",
        "value",
        "std",
        "Cramér-Rao bound",
        "95 % interval",
        "largest correlation",
    )
    if not np.isfinite(bounds).all():
        head = head[:3] + head[4:]
        rows = [row[:3] + row[4:] for row in rows]
    return Table(head, rows, words=(len(head) - 1,))
