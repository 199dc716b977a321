"""Public logs of real machines in the metrics of their communities: published figures beside ours.

    python tests/benchmarks/scoreboard.py DATA [--only NAME ...] [--arms] [--write]

DATA is the folder of the logs, one folder inside per set (`public_logs.py` names the files). A set
that lacks a file is named, and the others go on. "default" is one call with the records of the
set's own split, "advised" the call again with what the library itself advised, warning by warning.
Errors of torques are `fit.error_on(kept)`: all rows, low-pass of 10 Hz or what the sample rate
carries; "moving" counts a joint only where it is faster than a tenth of its usual speed. Intervals
agree where two values differ by less than the root of the sum of their squared half-widths, of two
fits of disjoint records; those that do not are listed beside what a fit of both records says. With
--arms each log of torques is identified as well, and the arm driven along the log by computed
torque. With --write the rows become docs/scoreboard.md, where those of other logs stay.
"""

import argparse
import dataclasses
import sys
import time
import warnings
from importlib import import_module
from pathlib import Path

import numpy as np
import public_logs
from public_logs import Log
from simulated_logs import closed_loop, forward, machine

from ctc import ComputedTorque
from identification import fit_torque, identify
from identification.equation_error import with_possible_bodies
from plant import Spline, replay, simulate

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))
PAGE = Path(__file__).parents[2] / "docs" / "scoreboard.md"
MARK = "<!-- scoreboard: {} -->"
HALF_WIDTH = 1.96
"""Standard deviations of an interval of 95 %."""


@dataclasses.dataclass(frozen=True)
class Row:
    """One line of the table; texts, as they are shown.

    `warnings`: rows of the table of advice. `apart`: rows of the table of intervals.
    """

    name: str
    metric: str
    published: str
    default: str
    advised: str = "nothing advised"
    seconds: float = np.nan
    agreement: str = ""
    warnings: tuple[tuple[str, ...], ...] = ()
    apart: tuple[tuple[str, ...], ...] = ()

    @property
    def cells(self):
        seconds = "" if np.isnan(self.seconds) else f"{self.seconds:.1f}"
        values = (self.name, self.metric, self.published, self.default, self.advised, seconds)
        return (*values, self.agreement)


HEADS = ("log", "metric", "published", "default call", "as advised", "s", "intervals that agree")
WARNING_HEADS = ("log", "warning", "error before", "obeyed")
APART_HEADS = ("log", "intervals that disagree", "a fit of both records", "disagree beside that")


# -- torques -------------------------------------------------------------------------------------
def obeyed(log: Log, fit):
    """Each friction that a fit advises, and the fit that states it."""
    # A second kind may show once the first is there; more are no advice that one follows.
    for _ in range(3):
        if not fit.friction or fit.friction[0].advice not in fit.warnings:
            return
        trial = fit.friction[0]
        try:
            drive = trial.drive(fit.rig.drive)
        except ValueError:
            # A second Stribeck speed cannot be stated.
            return
        records = [
            dataclasses.replace(r, rig=dataclasses.replace(r.rig, drive=drive)) for r in log.fitted
        ]
        # What a stated drive leaves open is named; else the fit finds it again.
        names = fit.names[: len(fit.names) - len(log.extra)]
        fit = fit_torque(log.dynamics, records, unknown=names, extra=log.extra)
        yield trial.advice, fit


def advice_of(name, log, fit):
    """The last fit that obeys warnings, or None, and a row per warning."""
    before = percent(fit.error_on(log.kept))
    steps = list(obeyed(log, fit))
    lines = [line for line in fit.warnings if line not in dict(steps)]
    # Most ask for something that a log does not have.
    rows = [(name, line, before, "another log") for line in lines]
    for line, better in steps:
        after = percent(better.error_on(log.kept))
        rows.append((name, line.partition(":")[0], before, after))
        before = after
    return (steps[-1][1] if steps else None), tuple(rows)


def apart(first, second, short):
    """Names of the intervals of two fits that do not agree, and how many both have."""
    names = [name for name in first.names if name in second.names]
    disagree = {}
    for name in names:
        widths = [HALF_WIDTH * fit.std[fit.names.index(name)] for fit in (first, second)]
        ratio = abs(first[name] - second[name]) / np.hypot(*widths)
        if ratio >= 1:
            disagree[short.get(name, name)] = ratio
    return disagree, len(names)


def between(log, fit):
    """What a fit of the fitted records and those kept aside says, and what disagrees beside it."""
    both = fit_torque(log.dynamics, [*log.fitted, *log.kept], extra=log.extra,
                      band=[fit.band], least_speed=fit.least_speed)  # fmt: skip
    compared = both.between
    parts = [f"{name} {share:.2g}" for name, share in compared.groups.items() if share > 0]
    # The deviation between logs, which the fit of both has found, is in each interval.
    widths = compared.half_width
    outside = np.ptp(compared.values, axis=0) > np.sqrt(np.sum(widths**2, axis=0))
    count = int((outside & compared.compared).sum()) if len(widths) == 2 else None
    rest = (
        f"{(~compared.agree & compared.compared).sum()} by Cochran's test"
        if count is None
        else (f"{count} of {compared.compared.sum()}")
    )
    return f"{compared._short()}; differences: {', '.join(parts) or 'none'}", rest


def percent(error):
    return f"{100 * error.total:.2f} %"


def moving(log):
    """Speeds below which a joint stands: a tenth of its usual speed in the logs kept aside."""
    speeds = [
        np.gradient(record.rig.cell_centre(record.counts), record.t, axis=0) for record in log.kept
    ]
    return 0.1 * np.sqrt(np.mean(np.concatenate(speeds) ** 2, axis=0))


def torques(name, log, published, part="second half"):
    """Held-out error of the torque, fitted and kept apart; intervals of both."""
    began = time.perf_counter()
    fit = fit_torque(log.dynamics, log.fitted, extra=log.extra)
    seconds = time.perf_counter() - began
    error = fit.error_on(log.kept)
    slowest = moving(log)

    def shown(one):
        moves = one.error_on(log.kept, least_speed=slowest)
        return f"{percent(one.error_on(log.kept))} (moving {percent(moves)})"

    metric = f"relative error of the torque on the {part}, {error.band:.3g} Hz"
    better, warned = advice_of(name, log, fit)
    other = fit_torque(log.dynamics, log.kept, extra=log.extra)
    short = dict(zip(log.dynamics.names, log.dynamics.short_names, strict=True))
    disagree, count = apart(fit, other, short)
    listed = ", ".join(f"{name} ({ratio:.1f})" for name, ratio in disagree.items())
    differing = ((name, listed, *between(log, fit)),) if disagree else ()
    further = {} if better is None else {"advised": shown(better)}
    return Row(name, metric, published, shown(fit), seconds=seconds, warnings=warned,
               apart=differing, agreement=f"{count - len(disagree)} of {count}", **further)  # fmt: skip


def emps(folder):
    log = public_logs.emps(folder)
    yield torques("EMPS, force", log, "5.98 %", "file with pulses")
    began = time.perf_counter()
    found = identify(log.dynamics, log.fitted, progress=False)
    seconds = time.perf_counter() - began
    yield open_loop(log, found, seconds)
    ours, published = closed_loop(folder, found), closed_loop(folder, None)
    yield Row("EMPS, closed loop", "relative error of the force of both files, under the logged law",
              " and ".join(f"{error:.2f}" for error in published) + " % (its values)",
              " and ".join(f"{error:.2f}" for error in ours) + " %")  # fmt: skip


EMPS_START = 20
"""Samples by which the benchmark lets a simulation begin."""


def open_loop(log, found, seconds):
    """RMSE of the simulated position on the second file, from its force alone."""
    kept = log.kept[0]
    again = replay(found.arm, kept, rig=found.rig)
    error = kept.rig.to_angle(again.counts - kept.counts)[EMPS_START:]
    rmse = 1e3 * np.sqrt(np.mean(error**2))
    return Row("EMPS, open loop", "RMSE of the position simulated on the file with pulses",
               "2.64 mm (dynoNet)", f"{rmse:.2f} mm", seconds=seconds)  # fmt: skip


def panda(folder):
    yield torques("Panda bag", public_logs.panda(folder), "none")


def ur10(folder):
    yield torques("UR10 bag", public_logs.ur10(folder), "none")


def tiago(folder):
    yield torques("TIAGo arm", public_logs.tiago(folder), "none on this split")


def kr300(folder):
    log = public_logs.kr300(folder)
    # Every fifth block: a tenth of an hour tells no more.
    few = dataclasses.replace(log, fitted=log.fitted[::5])
    yield torques("KR300, inverse", few, "none", "test blocks")
    began = time.perf_counter()
    ours, linear = forward(few, log.fitted)
    seconds = time.perf_counter() - began
    yield Row("KR300, forward", "RMS of the angles simulated from the torques for 1, 2, 4, 8 s",
              f"{linear} (a linear model, by us)", ours, seconds=seconds)  # fmt: skip


def tx40(folder):
    yield torques("TX40, second half", public_logs.tx40(folder), "none on this split")
    example = import_module("5_real_tx40")
    began = time.perf_counter()
    table, fit = example.compare(Path(folder) / "staubli_tx40")
    seconds = time.perf_counter() - began
    off = np.array([abs(ours - value) / std for _, ours, value, std in table])
    yield Row("TX40, whole log", "published parameters within one published deviation; error",
              "57 of 60; 5.25 % (an independent fit)", f"{(off <= 1).sum()} of 60; {fit.relative_error:.2%}",
              seconds=seconds)  # fmt: skip


def pendulum(folder):
    example = import_module("8_real_double_pendulum")
    public_logs.existing(Path(folder) / "dfki_double_pendulum" / "sysid_C.0.npz")
    began = time.perf_counter()
    found, kept = example.study(Path(folder) / "dfki_double_pendulum", "C.0")
    seconds = time.perf_counter() - began
    shoulder, elbow = example.misses(found, kept)
    yield Row("double pendulum C.0", "RMS of 10 s simulated in open loop, runs 01, 03, 05",
              "0.049, 0.076 rad", f"{shoulder:.3f}, {elbow:.3f} rad", seconds=seconds)  # fmt: skip


SETS = {
    function.__name__: function for function in (emps, pendulum, ur10, panda, tiago, tx40, kr300)
}


# -- arms ----------------------------------------------------------------------------------------
ARM_HEADS = ("log", "values of", "torque kept aside", "own arm", "arm of the other log", "s")
PERIOD, KNOTS, SECONDS = 1e-3, 0.5, 10.0
"""Of the controller [s], whatever the log's; between points of the path [s]; of the path [s]."""


def arm(name, folder):
    """The arm of the first log, as controller of the arm of the log kept aside."""
    log = SETS_OF_TORQUES[name](folder)
    began = time.perf_counter()
    if log.extra:
        # `identify` takes no further columns: the torque equation, and its counterbalance a spring.
        values = "the torque equation"
        own, rig, found = machine(log, log.fitted[::5])
        real, stated, _ = machine(log, log.kept)
    else:
        found = identify(log.dynamics, log.fitted[:1], held_out=(), progress=False)
        values = "the torque equation" if found.fit.fallback_reason else "the prediction"
        own, rig = found.arm, found.rig
        # In place of the machine: the nearest bodies to a fit of the log that the controller never
        # saw.
        fit = fit_torque(log.dynamics, log.kept[0])
        other = with_possible_bodies(log.dynamics, fit.rig, fit)
        real = other.arm
        stated = fit.rig.filled(dict(zip(other.names, other.values, strict=True)))
    seconds = time.perf_counter() - began
    kept = log.kept[0]
    fast = [dataclasses.replace(one, period=PERIOD) for one in (rig, stated)]
    # Some seconds of the log's own motion.
    rows = [int(np.searchsorted(kept.t, at)) for at in np.arange(0, SECONDS, KNOTS) + kept.t[0]]
    points = kept.rig.cell_centre(kept.counts[[row for row in rows if row < len(kept)]])
    path = Spline(times=KNOTS * np.arange(len(points)), points=points)
    law = ComputedTorque(own, fast[0])
    peaks = [peak(*one, law, path) for one in ((own, fast[0]), (real, fast[1]))]
    return name, values, percent(found.error_on(log.kept)), *peaks, f"{seconds:.0f}"


def peak(arm, rig, law, path):
    """Peak tracking error of an arm under a law."""
    try:
        driven = simulate(arm, rig, law, path)
    except ValueError as error:
        # Another arm may be one that no law made of the first holds; that is a result.
        return "diverges" if "diverges" in str(error) else str(error)
    return f"{1e3 * np.abs(rig.to_angle(driven.error_pulses)).max():.2g} mrad"


SETS_OF_TORQUES = {
    name: getattr(public_logs, name) for name in ("ur10", "panda", "tiago", "tx40", "kr300")
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", nargs="*", choices=list(SETS), default=list(SETS))
    parser.add_argument("--arms", action="store_true", help="only the arms of logged torques")
    parser.add_argument("--write", action="store_true", help="the rows become docs/scoreboard.md")
    given = parser.parse_args()
    names = [name for name in given.only if not given.arms or name in SETS_OF_TORQUES]
    for name in names:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of the logs; what helps is obeyed
                made = [arm(name, given.data)] if given.arms else list(SETS[name](given.data))
        except FileNotFoundError as missing:
            print(f"{name}: {missing} is missing; the other sets go on.", flush=True)
            continue
        for row in made:
            tables = {"arms": [row]} if given.arms else tables_of(row)
            for part, lines in tables.items():
                for cells in lines:
                    print(f"{part}: {line(cells)}", flush=True)
                if given.write and lines:
                    write(lines, part)


TABLES = {"logs": HEADS, "warnings": WARNING_HEADS, "apart": APART_HEADS, "arms": ARM_HEADS}


def tables_of(row):
    return {"logs": [row.cells], "warnings": row.warnings, "apart": row.apart}


def line(cells):
    return f"| {' | '.join(cells)} |"


def write(rows, part):
    """Rows into a table between its marks in the page, in place of those of the same log."""
    text = PAGE.read_text()
    begin, end = (MARK.format(f"{part}, {place}") for place in ("begin", "end"))
    before, _, rest = text.partition(begin)
    table, _, after = rest.partition(end)
    log = f"| {rows[0][0]} |"
    others = [one for one in table.split("\n") if one.startswith("|")][2:]
    place = next((i for i, one in enumerate(others) if one.startswith(log)), len(others))
    others = [one for one in others if not one.startswith(log)]
    heads = TABLES[part]
    table = [line(heads), line(["---"] * len(heads))]
    table += [*others[:place], *map(line, rows), *others[place:]]
    PAGE.write_text("\n".join([f"{before}{begin}", "", *table, "", f"{end}{after}"]))


if __name__ == "__main__":
    main()
