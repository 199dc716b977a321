"""Two real logs, a UR10's and a Panda's, spoilt one mistake at a time: what is named first.

    CTC_DATA=FOLDER python tests/benchmarks/spoilt_bags.py [--identify] [--logs 1] [--only PART ...]
    python tests/benchmarks/spoilt_bags.py --corpus FOLDER ...

The second takes the logs from a frozen corpus (``verdicts.py``), the first needs the robots' model
files (extra ``robots``). One row per mistake: whether it is the first cause of `fit_torque` (with `--identify`, of `identify`
as well), and all causes with their odds. A right log has none. Exits with 1 where one is missed
that such a log can show, or a right log is accused.
"""

import argparse
import functools
import sys
import warnings
from pathlib import Path

import corpus
import verdicts

from identification import fit_torque, identify
from plant import Dynamics

NAMES = {
    "healthy": (),
    "swapped columns": ("exchanged positions",),
    "exchanged torques": ("exchanged torques",),
    "sign of one torque": ("torque sign",),
    "torque that the joint feels": ("sign of the torques",),
    "torque late": ("late torques",),
    "degrees": ("unit of positions",),
    "zero off": ("joint zero",),
    "tilted base": ("tilted base",),
    "torque 1.96": ("torque scale",),
    "torque 4": ("torque scale",),
    "per mille": ("torque scale",),
    "without gravity": ("gravity removed",),
    "torque of a model": ("torques without friction",),
}
"""Mistake -> names of the cause that is right; lost rows and stamps are those of `record.check()`."""

HIDDEN = {
    (
        "UR10",
        "zero off",
    ): "friction alone moves its wrists: 9 to 177 times the torque of the bodies",
    ("Panda bag", "torque 1.96"): "its bodies need 1.26 times the measured torque, 0.65 times this",
}
"""Mistakes that a log cannot show, with the reason."""


def named(find, dynamics, record):
    """Causes of a log, as texts, and their names."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            causes = find(dynamics, record).causes
        except ValueError as refusal:
            return [str(refusal)], [str(refusal)]
    return [cause.name for cause in causes], [str(cause._short()) for cause in causes]


def searched(dynamics, record):
    """`identify` without a progress bar, and without records that are held out."""
    return identify(dynamics, record, held_out=(), progress=False)


def logs(options):
    """Robot and mistake of each log, and a function that gives its model and record."""
    if options.corpus is None:
        entries = [*corpus.bags(options.logs)]

        def made(draw):
            case = draw()
            return case.dynamics, case.records[0]

    else:
        entries = [(e["key"], e) for e in verdicts.lines(options.corpus / "manifest.jsonl")]

        def made(entry):
            place = options.corpus / entry["folder"]
            return Dynamics.load(place / "dynamics.json"), verdicts.records_of(entry, place)[0]

    for key, source in entries:
        law, robot, mistake, number = key.split("/")
        wanted = mistake in NAMES and int(number) < options.logs
        if law == "logged" and wanted and verdicts.chosen(key, options.only):
            yield robot, mistake, functools.partial(made, source)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--identify", action="store_true", help="ask identify() too: minutes a log")
    parser.add_argument("--logs", type=int, default=1, help="of each mistake that is drawn")
    parser.add_argument("--only", nargs="*", default=[], help="parts of robot/mistake/number")
    parser.add_argument("--corpus", type=Path, help="folder of a frozen corpus")
    options = parser.parse_args()
    ways = {"fit_torque": fit_torque} | ({"identify": searched} if options.identify else {})
    wrong = 0
    for robot, mistake, read in logs(options):
        dynamics, record = read()
        for way, find in ways.items():
            names, texts = named(find, dynamics, record)
            right = tuple(names[:1]) == NAMES[mistake]
            hidden = HIDDEN.get((robot, mistake), "") if not names else ""
            wrong += not right and not hidden
            verdict = "right" if right else f"cannot show it ({hidden})" if hidden else "WRONG"
            print(f"{robot:9} {mistake:27} {way:10} {verdict}: {'; '.join(texts)}", flush=True)
    print(f"{wrong} wrong")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
