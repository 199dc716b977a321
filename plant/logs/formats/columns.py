"""Names of columns: blocks, ``block``, and elements of them, ``block[2]`` or ``block.elbow``."""

import contextlib
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any, NamedTuple


class RefusalError(ValueError):
    """A refusal of what a file holds; the caller puts the path of the file before its text."""


@contextlib.contextmanager
def refusals_left_out(numbers_only: bool) -> Iterator[None]:
    """Leave out a column that is refused, where only columns of numbers are asked for."""
    try:
        yield
    except RefusalError:
        if not numbers_only:
            raise


# One element of an array, ``name[2]`` or ``name.2``. At most 9 digits: int() of a long text of
# digits is slow.
_ELEMENT = re.compile(r"(.+?)(?:\[(\d{1,9})\]|\.(\d{1,9}))")
# A class of MATLAB whose objects hide their numbers -> the statements that save them as arrays.
_SAVED_AS = {
    "timetable": (
        "s = table2struct(timetable2table({0}), 'ToScalar', true);"
        " s.Time = seconds(s.Time - s.Time(1)); save('log.mat', '-struct', 's')"
    ),
    "table": "s = table2struct({0}, 'ToScalar', true); save('log.mat', '-struct', 's')",
    "timeseries": "t = {0}.Time; q = {0}.Data; save('log.mat', 't', 'q')",
    "Simulink.SimulationData.Dataset": (
        "t = {0}{{1}}.Values.Time; q = {0}{{1}}.Values.Data; save('log.mat', 't', 'q')"
    ),
    "datetime": "t = seconds({0} - {0}(1)); save('log.mat', 't', '-append')",
    "duration": "t = seconds({0}); save('log.mat', 't', '-append')",
    "char": "x = str2double(string({0})); save('log.mat', 'x', '-append')",
    "string": "x = str2double({0}); save('log.mat', 'x', '-append')",
}


def choice_of(names: Collection[str] | None, prefix: str) -> Callable[[str], bool]:
    """Predicate of the wanted columns: those of `names`, or all with this prefix where it is None.

    An array is wanted if one of its elements is.
    """
    # Without names the prefix chooses; the caller has put the prefix before each given name.
    if names is None:
        return lambda name: name.startswith(prefix)
    homes = {match[1] for name in names if (match := _ELEMENT.fullmatch(name))}
    return homes.union(names).__contains__


def homes_of(names: Iterable[str], available: Collection[str]) -> dict[str, str]:
    """The arrays that hold the wanted columns: their names as wanted -> as available.

    A wanted name may be that of an element of an array, and may have points in place of slashes.
    """
    homes = dict[str, str]()
    for name in names:
        match = _ELEMENT.fullmatch(name)
        spellings = (name, match[1]) if match else (name,)
        places = {called: called.replace(".", "/") for called in spellings}
        places |= {called: called for called in spellings if called in available}
        homes |= dict([pair for pair in places.items() if pair[1] in available][:1])
    return homes


def require_no_object(name: str, matlab_class: str) -> None:
    """Refuse an object of MATLAB, and say what saves its numbers."""
    saved = _SAVED_AS.get(matlab_class, "x = double({0}); save('log.mat', 'x', '-append')")
    article = "an" if matlab_class[:1].lower() in tuple("aeiou") else "a"
    raise RefusalError(
        f"must hold arrays or structures; {name!r:.60} is {article} MATLAB {matlab_class:.40}."
        f" Save arrays: {saved.format(name):.300}"
    )


def require_size(size: int, max_bytes: int) -> None:
    """Refuse columns of more than `max_bytes`."""
    if size > max_bytes:
        declared = f"it declares {size >> 20}"
        raise RefusalError(
            f"must hold at most {max_bytes >> 20} MiB; {declared}. Cut the log into several files."
        )


def require_real(name: str, kind: Any, is_real: bool) -> None:
    """Refuse a column whose kind holds no real numbers; the caller knows which kinds do."""
    if not is_real:
        raise RefusalError(
            f"must hold real numbers; got {kind} in column {name!r}. Leave it out with names=."
        )


class Block(NamedTuple):
    """Columns (N,) or (N, k); the labels are those of the k columns, or none."""

    values: Any
    labels: tuple[str, ...] = ()

    def elements(self, name: str) -> Iterator[str]:
        """Names of the columns of this block, if its own is `name`; none of a single column."""
        if self.values.ndim != 2:
            return
        # Labels or numbers, never both, since a message offers each column once.
        if self.labels:
            yield from (f"{name}.{label}" for label in self.labels)
        else:
            yield from (f"{name}[{i}]" for i in range(self.values.shape[1]))


def home_of(wanted: str, names: Iterable[str]) -> str | None:
    """The longest name of a block that `wanted` equals, or of which it is an element."""
    # Names may contain dots and brackets themselves, so the longest match is the block.
    return max(
        (name for name in names if wanted == name or wanted.startswith((f"{name}.", f"{name}["))),
        key=len,
        default=None,
    )


def picked(wanted: str, blocks: Mapping[str, Block]) -> Any:
    """A block (N, k), or one of its columns (N,); None where there is none of that name."""
    name = home_of(wanted, blocks)
    if name is None:
        return None
    block = blocks[name]
    rest = wanted[len(name) :]
    if not rest:
        return block.values
    if block.values.ndim != 2:
        return None
    # A label may hold any character, so it is compared as a whole and not parsed.
    if rest[1:] in block.labels and rest[0] == ".":
        return block.values[:, block.labels.index(rest[1:])]
    # The pattern needs a name before the element: any letter will do.
    match = _ELEMENT.fullmatch(f"_{rest}")
    if match is None or match[1] != "_":
        return None
    index = int(match[2] or match[3])
    return block.values[:, index] if index < block.values.shape[1] else None


def oriented(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Arrays with their samples along the rows.

    An array of more than two axes loses those of length one. The axis of the samples is the one
    that is as long as a vector; if both are, or if there are no vectors, it is the longer one.
    """
    arrays = {
        name: column.squeeze() if column.ndim > 2 else column for name, column in columns.items()
    }
    # One row is a vector too, as MATLAB stores time.
    arrays = {
        name: array[0] if array.ndim == 2 and len(array) == 1 else array
        for name, array in arrays.items()
    }
    sizes = {max(a.shape) for a in arrays.values() if 0 < a.ndim < 3 and a.size == max(a.shape) > 1}

    def is_across(array: Any) -> bool:
        if array.ndim != 2 or (sizes and sizes.isdisjoint(array.shape)):
            return False
        rows, width = array.shape
        # Gains of the joints are vectors too, so that both axes may be as long as one.
        if (rows in sizes) != (width in sizes):
            return width in sizes
        return bool(width > rows)

    return {name: array.T if is_across(array) else array for name, array in arrays.items()}
