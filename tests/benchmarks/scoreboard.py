"""Public logs of real machines in the metrics of their communities: published figures beside ours.

    python tests/benchmarks/scoreboard.py DATA [--only NAME ...] [--arms] [--write]

DATA is the folder of the logs, one folder inside per set (`public_logs.py` names the files). A set
that lacks a file is named, and the others go on. "default" is one call with the records of the
set's own split, "advised" the call again with what the library itself advised. Errors of torques
are `fit.error_on(kept)`: all rows, low-pass of 10 Hz or what the sample rate carries. Intervals
agree where two values differ by less than the root of the sum of their squared half-widths, of two
fits of disjoint records. With --arms each log of torques is identified as well, and the arm driven
along the log by computed torque.
With --write the rows become docs/scoreboard.md.
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

from ctc import ComputedTorque
from identification import fit_torque, identify
from identification.equation_error.possible_bodies import with_possible_bodies
from plant import Spline, replay, simulate

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))
PAGE = Path(__file__).parents[2] / "docs" / "scoreboard.md"
MARK = "<!-- scoreboard: {} -->"
HALF_WIDTH = 1.96
"""Standard deviations of an interval of 95 %."""


@dataclasses.dataclass(frozen=True)
class Row:
    """One line of the table; texts, as they are shown."""

    name: str
    metric: str
    published: str
    default: str
    advised: str = "nothing advised"
    seconds: float = np.nan
    agreement: str = ""

    @property
    def cells(self):
        seconds = "" if np.isnan(self.seconds) else f"{self.seconds:.1f}"
        values = (self.name, self.metric, self.published, self.default, self.advised, seconds)
        return (*values, self.agreement)


HEADS = ("log", "metric", "published", "default call", "as advised", "s", "intervals that agree")


# -- torques -------------------------------------------------------------------------------------
def advised(log: Log, fit):
    """The fit again with what its warnings advise: friction of another kind, bodies of the model.

    None where they advise nothing of either.
    """
    better, stated, prior = None, {}, None
    # A second kind may show once the first is there; more are no advice that one follows.
    for _ in range(3):
        if any("prior=" in line for line in fit.warnings) and prior is None:
            prior = 0.3
        elif fit.friction and fit.friction[0].advice in fit.warnings:
            try:
                stated = {"drive": fit.friction[0].drive(fit.rig.drive)}
            except ValueError:
                # A second Stribeck speed cannot be stated.
                break
        else:
            break
        records = [
            dataclasses.replace(r, rig=dataclasses.replace(r.rig, **stated)) for r in log.fitted
        ]
        # What a stated drive leaves open is named; else the fit finds it again.
        names = fit.names[: len(fit.names) - len(log.extra)] if stated else None
        fit = better = fit_torque(
            log.dynamics, records, unknown=names, extra=log.extra, prior=prior
        )
    return better


def agreement(first, second):
    """How many intervals of two fits agree, of those that both have."""
    names = [name for name in first.names if name in second.names]
    values, widths = (
        np.array([get(fit, name) for name in names for fit in (first, second)]).reshape(-1, 2)
        for get in (
            lambda fit, name: fit[name],
            lambda fit, name: HALF_WIDTH * fit.std[fit.names.index(name)],
        )
    )
    agree = np.abs(values[:, 0] - values[:, 1]) < np.hypot(*widths.T)
    return f"{agree.sum()} of {len(agree)}"


def percent(error):
    return f"{100 * error.total:.2f} %"


def torques(name, log, published, part="second half"):
    """Held-out error of the torque, fitted and kept apart; intervals of both."""
    began = time.perf_counter()
    fit = fit_torque(log.dynamics, log.fitted, extra=log.extra)
    seconds = time.perf_counter() - began
    error = fit.error_on(log.kept)
    metric = f"relative error of the torque on the {part}, {error.band:.3g} Hz"
    obeyed = advised(log, fit)
    other = fit_torque(log.dynamics, log.kept, extra=log.extra)
    shown = {} if obeyed is None else {"advised": percent(obeyed.error_on(log.kept))}
    return Row(name, metric, published, percent(error), seconds=seconds,
               agreement=agreement(fit, other), **shown)  # fmt: skip


def emps(folder):
    log = public_logs.emps(folder)
    yield torques("EMPS, force", log, "5.98 %", "file with pulses")
    yield open_loop(log)


EMPS_START = 20
"""Samples by which the benchmark lets a simulation begin."""


def open_loop(log):
    """RMSE of the simulated position on the second file, from its force alone."""
    began = time.perf_counter()
    found = identify(log.dynamics, log.fitted, progress=False)
    seconds = time.perf_counter() - began
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
    yield torques("KR300, inverse", dataclasses.replace(log, fitted=log.fitted[::5]), "none",
                  "test blocks")  # fmt: skip


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
    """The arm that `identify` makes of the first log, as controller of the arm of the log kept."""
    log = SETS_OF_TORQUES[name](folder)
    began = time.perf_counter()
    found = identify(log.dynamics, log.fitted[:1], held_out=(), progress=False)
    seconds = time.perf_counter() - began
    values = "the torque equation" if found.fit.fallback_reason else "the prediction"
    # In place of the machine: the nearest bodies to a fit of the log that the controller never saw.
    kept = log.kept[0]
    fit = fit_torque(log.dynamics, kept)
    other = with_possible_bodies(log.dynamics, fit.rig, fit)
    real = fit.rig.filled(dict(zip(other.names, other.values, strict=True)))
    fast = [dataclasses.replace(rig, period=PERIOD) for rig in (found.rig, real)]
    # Some seconds of the log's own motion.
    rows = [int(np.searchsorted(kept.t, at)) for at in np.arange(0, SECONDS, KNOTS) + kept.t[0]]
    points = kept.rig.cell_centre(kept.counts[[row for row in rows if row < len(kept)]])
    path = Spline(times=KNOTS * np.arange(len(points)), points=points)
    law = ComputedTorque(found.arm, fast[0])
    peaks = [peak(*machine, law, path) for machine in ((found.arm, fast[0]), (other.arm, fast[1]))]
    return name, values, percent(found.error_on(log.kept)), *peaks, f"{seconds:.0f}"


def peak(arm, rig, law, path):
    """Peak tracking error of an arm under a law."""
    try:
        driven = simulate(arm, rig, law, path)
    except ValueError as error:
        # Another arm may be one that no law made of the first holds; that is a result.
        return str(error).partition(";")[2].partition(".")[0].strip() or str(error)
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
    rows = []
    names = [name for name in given.only if not given.arms or name in SETS_OF_TORQUES]
    for name in names:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of the logs; what helps is obeyed
                if given.arms:
                    made = [arm(name, given.data)]
                else:
                    made = [row.cells for row in SETS[name](given.data)]
                print(*map(line, made), sep="\n", flush=True)
                rows += made
        except FileNotFoundError as missing:
            print(f"{name}: {missing} is missing; the other sets go on.", flush=True)
    if given.write:
        write(rows, *(("arms", ARM_HEADS) if given.arms else ("logs", HEADS)))


def line(cells):
    return f"| {' | '.join(cells)} |"


def write(rows, part, heads):
    """A table between its marks in the page."""
    text = PAGE.read_text()
    begin, end = (MARK.format(f"{part}, {place}") for place in ("begin", "end"))
    table = [line(heads), line(["---"] * len(heads)), *map(line, rows)]
    before, after = text.partition(begin)[0], text.partition(end)[2]
    PAGE.write_text("\n".join([f"{before}{begin}", "", *table, "", f"{end}{after}"]))


if __name__ == "__main__":
    main()
