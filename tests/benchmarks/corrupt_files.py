"""Spoilt files of every format: how many are read, how many are refused, how long it takes, and
what memory.

    python tests/benchmarks/corrupt_files.py [mutations] [--cold] [--strangers]

One small log per format, compressed and not, and 500 files made from them: bits flipped, cut off,
zeros, a block twice, something behind the end. Half of those that hold messages or are data sets
are spoilt as their format understands it: records that are gone, lengths that lie, other types,
lists of several lengths. Each must give a record or one `LoadError` of one line, within 5 s, and
leave this process alive. All but CSV and NPZ are read by children that are forked from one that has
imported their libraries; --cold starts each anew. With --strangers the sound files are those of
`strangers_tables.py`, by their endings, and every third is described instead of read.
"""

import contextlib
import io
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

from plant import LoadError, Record, read_table


def oracles():
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "oracles"))
    import message_files
    import spoilt_files

    return spoilt_files, message_files


def attempt(files, kind, path):
    """Whether the file was read, and the time [s]."""
    start = time.perf_counter()
    try:
        read = len(files.read(kind, path)) > 0
    except LoadError as error:
        if "\n" in str(error) or len(str(error)) > 600 or str(path) not in str(error):
            raise RuntimeError(f"not a message: {error!r}") from None
        read = False
    return read, time.perf_counter() - start


def main(mutations, cold):
    tables, messages = oracles()
    warnings.simplefilter("ignore")
    print(f"{'format':12}{'read':>8}{'refused':>9}{'slowest [s]':>13}{'peak of a child [MB]':>22}")
    for files in (tables, messages):
        for kind in files.FORMATS:
            rng = np.random.default_rng(1)
            with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
                path = Path(folder) / f"log.{kind}"
                sound = []
                for compress in (True, False):
                    files.write(kind, path, files.log(), compress)
                    sound.append(messages.contents(path))
                children = (
                    None
                    if cold or kind in ("csv", "npz")
                    else stack.enter_context(tables.WarmChildren())
                )
                # The first file would wait for the imports of the process that forks.
                attempt(files, kind, path)
                results = []
                for i in range(mutations):
                    if i == mutations // 2:  # files of a folder have other names
                        files.write(kind, path, files.log(), False)
                    half = sound[int(i >= mutations // 2)]
                    if files is messages:
                        messages.spoilt(path, half, rng)
                    else:
                        path.write_bytes(files.spoil(half[""], rng))
                    results.append(attempt(files, kind, path))
            read = sum(r for r, _ in results)
            peak = f"{children.peak / 1024:.0f}" if children else "-"
            print(
                f"{kind:12}{read:8}{mutations - read:9}{max(t for _, t in results):13.2f}{peak:>22}",
                flush=True,
            )


def of_strangers(mutations):
    """Spoil the files of all variants of tables, by their endings."""
    sys.path.insert(0, str(Path(__file__).parent))
    import strangers_tables
    from spoilt_files import WarmChildren, spoil

    warnings.simplefilter("ignore")
    print(f"{'ending':12}{'read':>8}{'refused':>9}{'slowest [s]':>13}")
    rng = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder, WarmChildren() as children:
        sound = dict[str, list[bytes]]()
        for k, write in enumerate(strangers_tables.VARIANTS.values()):
            place = Path(folder, str(k))
            place.mkdir()
            with contextlib.redirect_stdout(io.StringIO()):
                write(strangers_tables.drawn((1, k), place))
            for file in place.iterdir():
                sound.setdefault(file.suffix, []).append(file.read_bytes())
        for suffix, files in sound.items():
            path = Path(folder, f"log{suffix}")
            path.write_bytes(files[0])
            attempt(Table, suffix, path)
            results = []
            for i in range(mutations):
                data = spoil(files[rng.integers(len(files))], rng)
                path.write_bytes(spoil(data, rng) if i % 2 and data else data)
                results.append(attempt(Described if i % 3 == 0 else Table, suffix, path))
            read = sum(r for r, _ in results)
            slowest = max(t for _, t in results)
            print(f"{suffix:12}{read:8}{mutations - read:9}{slowest:13.2f}", flush=True)
        print(f"peak of a child: {children.peak / 1024:.0f} MB")


class Table:
    """Reads all columns of a file."""

    @staticmethod
    def read(kind, path):
        return read_table(path)


class Described:
    """Describes a file."""

    @staticmethod
    def read(kind, path):
        with contextlib.redirect_stdout(io.StringIO()):
            return Record.read(path).roles


if __name__ == "__main__":
    if "--strangers" in sys.argv:
        count = [int(argument) for argument in sys.argv[1:] if argument.isdigit()]
        oracles()
        of_strangers(count[0] if count else 500)
        sys.exit(0)
    numbers = [int(argument) for argument in sys.argv[1:] if argument.isdigit()]
    main(numbers[0] if numbers else 500, "--cold" in sys.argv)
