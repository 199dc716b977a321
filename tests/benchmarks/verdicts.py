"""A frozen corpus of logs, the verdicts of a tree about it, and the comparison of two trees.

    python tests/benchmarks/verdicts.py corpus FOLDER [--logs 5] [--only PART ...] [--laws P PID]
    PYTHONPATH=TREE python tests/benchmarks/verdicts.py judge FOLDER TREE.jsonl [--identify] [--logs 5] [--only ...]
    python tests/benchmarks/verdicts.py compare OLD.jsonl NEW.jsonl [--said]

The corpus is made once: seeds are the numbers of the logs, from 0. Each log is a folder of CSV files (`Record.to_csv`),
with the model that its owner has (`Dynamics.save`); a line of manifest.jsonl says which mistake it has. `judge` goes on
where it stopped. `compare` prints, cause by cause, how many logs are named first rightly, with 90 % intervals, and
every verdict that changed.
"""

import argparse
import collections
import json
import re
import sys
import time
import warnings
from pathlib import Path

import causes
import corpus
import numpy as np
from scipy.stats import beta

from identification import identify
from plant import Dynamics, Record


# -- the corpus ----------------------------------------------------------------------------------
def made(folder, logs, only, laws):
    """Make the logs that the folder lacks."""
    folder.mkdir(parents=True, exist_ok=True)
    manifest = folder / "manifest.jsonl"
    there = {entry["key"] for entry in lines(manifest)}
    for key, draw in corpus.entries(logs, laws):
        if key in there or not chosen(key, only):
            continue
        try:
            case = draw()
        except ValueError as refusal:
            # a model file with lengths in millimetres: no log was needed
            print(f"{key}: refused as it is stated, {str(refusal)[:120]}", flush=True)
            continue
        place = folder / key.replace("/", "__").replace(" ", "_")
        place.mkdir(exist_ok=True)
        for number, record in enumerate(case.records):
            record.to_csv(place / f"record{number}.csv")
        if case.dynamics is not None:
            case.dynamics.save(place / "dynamics.json")
        entry = {
            "key": key,
            "folder": place.name,
            "cause": key.split("/")[2],
            "records": len(case.records),
            "reading": case.reading,
            "right": case.right,
            "torque": case.records[0].torque is not None,
        }
        with manifest.open("a") as file:
            file.write(json.dumps(entry) + "\n")
        print(key, flush=True)


def lines(path):
    """Entries of a file of JSON lines; none where there is none."""
    return [json.loads(line) for line in path.open()] if path.exists() else []


def chosen(key, only):
    """Whether a log is asked for, by parts of its key."""
    return not only or any(part in key for part in only)


# -- the verdicts of a tree ----------------------------------------------------------------------
def judged(folder, out, options):
    """Write the verdicts about the logs that the file lacks."""
    there = {entry["key"] for entry in lines(out)}
    for entry in lines(folder / "manifest.jsonl"):
        key = entry["key"]
        if (
            key in there
            or not chosen(key, options.only)
            or int(key.split("/")[3]) >= options.logs
            or (options.laws and key.split("/")[0] not in options.laws)
        ):
            continue
        place, begun = folder / entry["folder"], time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            verdict = {"check": checked(entry, place)}
            verdict["seconds"] = round(time.perf_counter() - begun, 3)
            if options.identify and (place / "dynamics.json").exists():
                verdict["identify"] = identified(entry, place)
        with out.open("a") as file:
            file.write(json.dumps(entry | verdict) + "\n")
        print(key, [finding["name"] for finding in verdict["check"]][:3], flush=True)


def records_of(entry, place):
    """The records of a log, as its owner reads them."""
    records = [Record.from_csv(place / f"record{k}.csv") for k in range(entry["records"])]
    read = causes.READINGS.get(entry["reading"], lambda record: record)
    return [read(record) for record in records]


def checked(entry, place):
    """Problems that `record.check()` finds: name, joint, value and sentence, the first one first."""
    try:
        return [
            {
                "name": finding.check,
                "joint": finding.joint,
                "value": None if finding.value is None else float(f"{finding.value:.6g}"),
                "text": f"{finding.check}: {finding.advice}",
            }
            for record in records_of(entry, place)
            for finding in record.check().problems
        ]
    except ValueError as refusal:
        return [said("refusal", refusal)]


def identified(entry, place):
    """Warnings of `identify`, or its refusal."""
    try:
        dynamics = Dynamics.load(place / "dynamics.json")
        found = identify(dynamics, records_of(entry, place), progress=False)
    except ValueError as refusal:
        return [said("refusal", refusal)]
    return [said("warning", text) for text in found.warnings]


def said(name, text):
    """A sentence in the form of a finding."""
    return {"name": name, "joint": None, "value": None, "text": str(text)}


# -- two trees -----------------------------------------------------------------------------------
VIEWS = {
    "check": lambda verdict: verdict["check"],
    "identify": lambda verdict: verdict.get("identify"),
    # what a user reads first: `identify` speaks where `check` is silent
    "both": lambda verdict: (
        verdict["check"] + verdict["identify"] if "identify" in verdict else None
    ),
}


def right(verdict, sentences):
    """Whether the right thing is said first; of several mistakes, whether each is said."""
    texts = [with_equals(sentence["text"]) for sentence in sentences]
    mistakes = verdict["right"]
    # of a right log every sentence is an accusation, but those that are its labels
    if mistakes[0][0] == "":
        return all(causes.names_it(text, mistakes[0]) for text in texts)
    if len(mistakes) > 1:
        # A refusal says all in one line.
        texts = [
            sentence for text in texts for sentence in re.split(r"(?<=[.)]) (?=[A-Za-z])", text)
        ]
        return all(any(causes.names_it(text, labels) for text in texts) for labels in mistakes)
    return causes.names_it(texts[0] if texts else "", mistakes[0])


def with_equals(text):
    """A sentence whose causes that the log cannot tell apart are worded as themselves."""
    _, _, rest = text.partition("The log cannot distinguish this from: ")
    names = rest.partition(".")[0].split(", ") if rest else ()
    return " ".join([text, *(EQUALS.get(name, "") for name in names)])


EQUALS = {
    "exchanged references": "The references are exchanged.",
    "gravity direction": "gravity acts the other way",
}
"""The words of a cause, by its name among those that a sentence cannot tell apart."""


def share(good, count):
    """Number, and its share with a 90 % interval [%]."""
    low = beta.ppf(0.05, good, count - good + 1) if good else 0.0
    high = beta.ppf(0.95, good + 1, count - good) if good < count else 1.0
    return f"{good:4d} ({100 * low:3.0f} to {100 * high:3.0f})"


def compared(old, new, view, said):
    """Print how two trees judge the logs that both have judged."""
    pick = VIEWS[view]
    trees = [{entry["key"]: entry for entry in lines(Path(path))} for path in (old, new)]
    keys = [
        key
        for key in trees[0]
        if key in trees[1] and all(pick(tree[key]) is not None for tree in trees)
    ]
    if not keys:
        return
    rows = collections.defaultdict(list)
    changed = []
    for key in keys:
        sentences = [pick(tree[key]) for tree in trees]
        # both by the labels of the first: they say what the mistake is
        good = [right(trees[0][key], each) for each in sentences]
        group = (
            key.split("/")[0],
            trees[0][key]["cause"],
            "torque" if trees[0][key]["torque"] else "none",
        )
        rows[group].append(good)
        names = [[(each["name"], each["joint"]) for each in tree] for tree in sentences]
        # the order of what follows the first is that of the code
        lists = [(tree[:1], set(tree)) for tree in names]
        if good[0] != good[1] or lists[0] != lists[1]:
            changed.append((key, good, sentences))
    print(f"{view}: {len(keys)} logs; named first rightly, of all (90 % interval of the share [%])")
    total = np.zeros((2, 2), int)
    accused = np.zeros(3, int)
    for (law, cause, torque), good in sorted(rows.items()):
        a, b = np.sum(good, axis=0)
        healthy = trees[0][next(k for k in keys if k.split("/")[2] == cause)]["right"][0][0] == ""
        if healthy:
            accused += len(good), len(good) - a, len(good) - b
        else:
            total += [[a, b], [len(good)] * 2]
        mark = "" if a == b else " better" if b > a else " WORSE"
        print(
            f"  {law:16} {cause:28} {torque:7} {len(good):4d}: {share(a, len(good))} {share(b, len(good))}{mark}"
        )
    print(f"  right first: {total[0, 0]} and {total[0, 1]} of {total[1, 0]}")
    print(f"  right logs accused: {accused[1]} and {accused[2]} of {accused[0]}")
    print(f"  {len(changed)} verdicts changed" + ("" if said else " (--said shows them)"))
    for key, good, sentences in changed if said else ():
        print(f"  {key}: {' -> '.join('right' if each else 'WRONG' for each in good)}")
        for mark, each in zip("-+", sentences, strict=True):
            names = ", ".join(f"{s['name']}[{s['joint']}]" for s in each[1:])
            print(f"    {mark} {each[0]['text'][:200] if each else 'nothing'} | {names[:120]}")


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["corpus", "judge", "compare"])
    parser.add_argument("one", type=Path, help="folder of the logs, or verdicts of the old tree")
    parser.add_argument("two", type=Path, nargs="?", help="file of verdicts")
    parser.add_argument("--logs", type=int, default=5, help="of each cause, arm and law")
    parser.add_argument("--only", nargs="*", default=[], help="parts of keys: law/arm/cause/number")
    parser.add_argument("--laws", nargs="*", default=[])
    parser.add_argument("--identify", action="store_true")
    parser.add_argument("--said", action="store_true", help="print every verdict that changed")
    options = parser.parse_args()
    if options.what == "corpus":
        made(options.one, options.logs, options.only, options.laws or list(causes.LAWS))
    elif options.what == "judge":
        judged(options.one, options.two, options)
    else:
        for view in VIEWS:
            compared(options.one, options.two, view, options.said)
    return 0


if __name__ == "__main__":
    sys.exit(main())
