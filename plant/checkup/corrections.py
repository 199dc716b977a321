"""Advice is tried before it is given: what a finding suggests is applied, and the checks run again.

The correction is kept after which the fewest checks find something, if they are fewer and the
motion explains no less of the torque; the text names what it changed. What it leaves is told of the
corrected record: a cause, not its effects.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from plant.checkup.finding import Finding
from plant.checkup.signals import Signals
from plant.checkup.wiring import error_column, torque_column
from plant.machine.rig import Rig
from plant.parts.fields import Floats

# Factor, and share, by which what is unexplained of the torque may rise: chance, and counts rounded
# again; and of a sign, with which the sums of angles change that stand for gravity.
_WORSE = 1.02
_CHANCE = 1e-3
_SUMS = 1e-2

# corrections that are tried of one log; a log with more to correct is wrong throughout
_TRIALS = 12

_IN_VAIN = (
    "; correcting that was tried and does not make the log explain more, so leave it: look for"
    " another cause."
)

_SIGN = ": change the sign of "


def tried(record: Any, examined: Callable[[Any], list[Finding]]) -> tuple[tuple[Finding, ...], Any]:
    """Findings about a record, each with what its correction does, and the record with all
    corrections that help.

    `examined`: the findings about a record.
    """
    told = dict[Any, Finding]()
    vain = set[Any]()
    trials = 0
    findings = examined(record)
    left = unexplained(record)
    while (
        k := next(
            (k for k, x in enumerate(findings) if not x.ok and _key(x) not in {*told, *vain}), -1
        )
    ) >= 0:
        options = list(_corrections(record, findings, k))[: max(0, _TRIALS - trials)]
        trials += len(options)
        explains = [unexplained(option) for *_, option in options]
        seen = [
            (
                examined(option)
                if share <= _WORSE * left + (_SUMS if changed else _CHANCE)
                else findings
            )
            for (_, changed, option), share in zip(options, explains, strict=True)
        ]
        fewest = min(map(_odd, seen), default=_odd(findings))
        if fewest == _odd(findings):
            vain.add(_key(findings[k]))
            if options and findings[k].check in ("delay", "period"):
                findings[k] = _said(findings[k], findings[k].advice.partition(";")[0] + _IN_VAIN)
            continue
        best = [j for j, after in enumerate(seen) if _odd(after) == fewest]
        changed = ", or of ".join(options[j][1] for j in best)
        of, _, record = options[best[0]]
        more = "fewer checks find something"
        if left - explains[best[0]] > _CHANCE:
            more = (
                f"the motion explains {1 - explains[best[0]]:.2%} of the torque, before"
                f" {1 - left:.2%}"
            )
        for finding in (findings[i] for i in of):
            head, sign, _ = finding.advice.partition(_SIGN)
            advice = f"{head}{sign}{changed}." if sign and changed else finding.advice
            told[_key(finding)] = _said(finding, f"{advice} Corrected so, {more}.")
        findings = seen[best[0]]
        left = explains[best[0]]
        vain = set()
    return (*told.values(), *(each for each in findings if _key(each) not in told)), record


def _key(finding: Finding) -> tuple[str, int | None]:
    return finding.check, finding.joint


def _odd(findings: Sequence[Finding]) -> int:
    return sum(not each.ok for each in findings)


def _said(finding: Finding, advice: str) -> Finding:
    return dataclasses.replace(finding, advice=advice)


def unexplained(record: Any) -> float:
    """Share of the logged torques' variance that the motion does not explain, mean over joints;
    1 where none can be.
    """
    signals = Signals(record)
    if not signals.long_enough or signals.torque is None:
        return 1.0
    return float(
        np.mean([1.0 if each is None else each.unexplained for each in signals.regressions])
    )


def _corrections(
    record: Any, findings: Sequence[Finding], k: int
) -> Iterator[tuple[Sequence[int], str, Any]]:
    """Findings that a correction mends, what has its sign changed, and the record so; of what
    finding k suggests.

    None where its law runs at one period.
    """
    finding = findings[k]
    i = -1 if finding.joint is None else finding.joint
    rig = record.rig
    value = finding.value or 0.0
    if any(each.check == "copied columns" and each.joint == i and not each.ok for each in findings):
        return  # of another motor: no change of it mends that
    if finding.check == "rounding":
        encoder = dataclasses.replace(
            rig.encoder, rounding="floor" if rig.encoder.rounding == "fix" else "fix"
        )
        yield (k,), "", dataclasses.replace(record, rig=dataclasses.replace(rig, encoder=encoder))
    elif finding.check == "delay":  # of all joints, as a logger makes it, or of this one alone
        late = [
            each for each, other in enumerate(findings) if other.check == "delay" and not other.ok
        ]
        for of in dict.fromkeys((tuple(late), (k,))):
            moved = record
            for each in of:
                moved = _counting(moved, findings[each].joint, _read_later(moved, findings[each]))
            yield of, "", moved
    elif (
        finding.check == "period"
        and (power := 1e3 ** np.round(np.log10(value / 1e3 / rig.period) / 3)) != 1
    ):
        yield (k,), "", dataclasses.replace(record, t=record.t / power)
    elif finding.check == "period" and getattr(record.law, "period", None) is None:
        yield (
            (k,),
            "",
            dataclasses.replace(record, rig=dataclasses.replace(rig, period=value / 1e3)),
        )
    # as counts, or as angles that were converted by each other's gears
    elif finding.check == "swapped joints":
        for each, other in enumerate(findings):
            if other.check == finding.check and not other.ok and each != k:
                order = np.arange(record.n)
                pair = np.array([i, other.joint], int)
                order[pair] = pair[::-1]
                exchanged = (
                    record.counts[:, order],
                    rig.counts(rig.cell_centre(record.counts)[:, order]),
                )
                error = min(
                    (record.reference_pulses - counts for counts in exchanged),
                    key=lambda x: np.abs(x).sum(),
                )
                yield (k, each), "", dataclasses.replace(record, error_pulses=error)
    elif finding.check in ("gear sign", "drive sign"):
        turns = _turned_counts if finding.check == "gear sign" else _turned_torque
        yield from (((k,), *each) for each in turns(record, i))


def _turned_counts(record: Any, i: int) -> Iterator[tuple[str, Any]]:
    """What may be turned where counts and reference of joint i disagree, and the record with it
    turned back.
    """
    signals = Signals(record)
    columns = record.columns or {}
    turned = np.where(np.arange(record.n) == i, -1.0, 1.0)
    angles = "position" in columns, "reference_position" in columns
    counts = _counting(record, i, _reversed(record.rig, record.counts, angles[0])[:, i])
    asked = np.where(
        turned < 0,
        _reversed(record.rig, record.reference_pulses, angles[1]),
        record.reference_pulses,
    )
    reference = dataclasses.replace(
        record, reference=None, reference_pulses=asked, error_pulses=asked - record.counts
    )
    if angles[0] != angles[1]:  # the gear turns only the one that it made pulses of
        drive = dataclasses.replace(record.rig.drive, gear=turned * record.rig.drive.gear)
        rig = dataclasses.replace(record.rig, drive=drive)
        yield "the gear", dataclasses.replace(counts if angles[0] else reference, rig=rig)
        yield signals.column("counts", i), counts
    else:
        yield f"{signals.column('counts', i)}, or of the gear", counts
    yield signals.column("reference", i), reference


def _reversed(rig: Rig, pulses: Floats, angles: bool) -> Floats:
    """Pulses (N, n) with the other sign; of angles, as the encoder would count those."""
    return rig.counts(-rig.cell_centre(pulses)) if angles else -pulses


def _turned_torque(record: Any, i: int) -> Iterator[tuple[str, Any]]:
    """What may be turned where torque and counts of joint i disagree, and the record with it
    turned back.
    """
    signals = Signals(record)
    turned = np.where(np.arange(record.n) == i, -1.0, 1.0)
    given = {name: x for name in ("torque", "current") if (x := getattr(record, name)) is not None}
    if given:
        changed = "" if signals.reference is None else torque_column(signals, i)
        yield (
            changed,
            dataclasses.replace(record, **{name: turned * x for name, x in given.items()}),
        )
    if error := error_column(signals, i):
        yield error, dataclasses.replace(record, error_pulses=turned * record.error_pulses)


def _counting(record, i, counts):
    """The record with other counts (N,) of joint i."""
    error = np.array(record.error_pulses)
    error[:, i] = record.reference_pulses[:, i] - counts
    return dataclasses.replace(record, error_pulses=error)


def _read_later(record, finding):
    """Counts (N,) of the joint of a finding that were so many samples late, as its encoder would
    count them in time.
    """
    encoder = record.rig.encoder
    rows = np.arange(len(record))
    centres = encoder.position_in_pulses(encoder.cell_centre(record.counts))[:, finding.joint]
    return encoder.quantised(np.interp(rows + finding.value, rows, centres))
