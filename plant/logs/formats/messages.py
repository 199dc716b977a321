"""Messages of topics as columns: ``topic.field``, ``topic.field[2]``, and by the joint's name
``topic.field.elbow``.

Each topic has columns ``stamp``, from the header of its messages, and ``log_time``, when they were
recorded, both in whole nanoseconds. Arrays beside a list of names (``name`` of a JointState,
``joint_names``) are told apart by these.
"""

import array
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from .columns import Block, RefusalError, home_of, picked, require_size

_NAMES = ("name", "names", "joint_names")
_WIDEST = 256  # elements of an array that may be joints; more are pictures or clouds of points
_DEEPEST = 6
_OWN = ("stamp", "log_time")
# Of a message: its stamp and when it was logged [ns], its numbers, and the names of the elements of
# arrays.
_Row = tuple[int, int, dict[str, Any], dict[str, Any]]


def columns_of(
    every: Iterable[str],
    messages: Callable[[list[str]], Iterable[tuple[str, int, Any]]],
    names: Collection[str] | None,
    prefix: str,
    most: int,
    clock: str | None,
) -> tuple[list[str], dict[str, Any]]:
    """Names of all columns of a file of messages, and the wanted ones.

    `every` topic of the file may stand there twice; `messages` gives, for the topics that hold
    something wanted, topic, `log_time` [ns] and decoded message, one after the other.
    """
    topics = list(dict.fromkeys(every))
    numbers = 0
    rows = dict[str, list[_Row]]()
    for topic, log_time, message in messages(_wanted_topics(names, prefix, topics)):
        fields = list(_flat(message, "", (), 0))
        numbers += sum(len(value) if isinstance(value, list) else 1 for _, value, _ in fields)
        require_size(8 * (numbers + 2), most)
        values = {name: value for name, value, _ in fields}
        labels = {name: own for name, _, own in fields if own}
        rows.setdefault(topic, []).append((_stamp(message), log_time, values, labels))
    blocks = {topic: _blocks(of_topic) for topic, of_topic in rows.items()}
    of_topics = [(f"{topic}.", *each) for topic in blocks for each in blocks[topic].items()]
    known = [
        f"{topic}{each}"
        for topic, name, block in of_topics
        for each in (name, *block.elements(name))
    ]
    known += [topic for topic in topics if topic not in blocks]
    if names is not None:
        return known, _sampled(blocks, names, clock)
    columns = {f"{topic}{name}": block.values for topic, name, block in of_topics}
    return known, {name: values for name, values in columns.items() if name.startswith(prefix)}


def _wanted_topics(names: Collection[str] | None, prefix: str, known: Iterable[str]) -> list[str]:
    """The topics that hold something that is wanted."""
    if names is None:
        return [
            topic
            for topic in known
            if f"{topic}.".startswith(prefix) or prefix.startswith(f"{topic}.")
        ]
    homes = {home_of(name, known) for name in names}
    return [topic for topic in known if topic in homes]


def _sampled(
    blocks: Mapping[str, Mapping[str, Block]], names: Collection[str], clock: str | None
) -> dict[str, Any]:
    """The wanted columns. The messages of the column `clock` are the samples: other topics hold
    their last value.
    """
    found = dict[str, dict[str, Any]]()
    times = {}
    for name in names:
        topic = home_of(name, blocks)
        values = None if topic is None else picked(name[len(topic) + 1 :], blocks[topic])
        if topic is not None and values is not None:
            found.setdefault(topic, {})[name] = values
    for topic, columns in found.items():
        kept = _kept(topic, columns)
        found[topic] = {name: values[kept] for name, values in columns.items()}
        times[topic] = {
            name: blocks[topic][name].values[kept] for name in _OWN if name in blocks[topic]
        }
    held = next((topic for topic, columns in found.items() if clock in columns), None)
    if held is not None:
        for topic in found.keys() - {held}:
            found[topic] = _held(found[topic], times[topic], times[held])
    return {name: columns[name] for name in names for columns in found.values() if name in columns}


def _items(message: Any) -> Iterable[tuple[str, Any]]:
    """Fields of a message: of an object of some class, or of a dictionary."""
    if isinstance(message, Mapping):
        return ((str(name), value) for name, value in message.items())
    names: Any = getattr(type(message), "__slots__", None) or getattr(message, "__dict__", ())
    return ((name, getattr(message, name)) for name in names if not name.startswith("_"))


def _flat(
    message: Any, prefix: str, labels: tuple[str, ...], deep: int
) -> Iterator[tuple[str, Any, tuple[str, ...]]]:
    """Name, number or list of numbers, and names of its elements, of all fields."""
    if deep > _DEEPEST:
        return
    fields = list(_items(message))
    for name, value in fields:
        if (
            name in _NAMES
            and isinstance(value, (list, tuple))
            and all(isinstance(each, str) for each in value)
        ):
            labels = tuple(value)
    for name, value in fields:
        if _is_stamp(name, value, deep):
            continue
        if isinstance(value, (bool, int, float)) or getattr(value, "shape", None) == ():
            yield f"{prefix}{name}", value, ()
        elif isinstance(value, (list, tuple, array.array)) or getattr(value, "ndim", None) == 1:
            if 0 < len(value) <= _WIDEST and (
                hasattr(value, "dtype") or isinstance(value[0], (bool, int, float))
            ):
                numbers = value.tolist() if hasattr(value, "tolist") else list(value)
                yield f"{prefix}{name}", numbers, labels if len(labels) == len(numbers) else ()
        elif not isinstance(value, (str, bytes, bytearray)) and value is not None:
            yield from _flat(value, f"{prefix}{name}.", labels, deep + 1)


def _is_stamp(name: str, value: Any, deep: int) -> bool:
    return name == "header" and deep == 0 and dict(_items(value)).get("stamp") is not None


def _stamp(message: Any) -> int:
    """The time in a message's header [ns]; 0 where it has none."""
    header = dict(_items(message)).get("header")
    stamp = None if header is None else dict(_items(header)).get("stamp")
    if stamp is None:
        return 0
    parts = {name: value for name, value in _items(stamp) if isinstance(value, int)}
    return parts.get("sec", 0) * 10**9 + parts.get("nanosec", parts.get("nsec", 0))


def _blocks(rows: list[_Row]) -> dict[str, Block]:
    """The messages of one topic as columns; what a message lacks is NaN."""
    stamps = np.array([row[0] for row in rows], np.int64)
    blocks = {"stamp": Block(stamps)} if stamps.any() else {}
    blocks["log_time"] = Block(np.array([row[1] for row in rows], np.int64))
    for name in dict.fromkeys(name for row in rows for name in row[2]):
        cells = [row[2].get(name) for row in rows]
        if not any(isinstance(cell, list) for cell in cells):
            blocks[name] = Block(_array([np.nan if cell is None else cell for cell in cells]))
            continue
        labels = tuple(dict.fromkeys(label for row in rows for label in row[3].get(name, ())))
        width = len(labels) or max(len(cell) for cell in cells if isinstance(cell, list))
        place = {label: i for i, label in enumerate(labels)}
        whole = []
        for row, cell in zip(rows, cells, strict=True):
            own = row[3].get(name, ())
            line = [np.nan] * width
            if isinstance(cell, list) and bool(own) == bool(labels):
                for i, value in zip(
                    [place[label] for label in own] if own else range(width), cell, strict=False
                ):
                    line[i] = value
            whole.append(line)
        blocks[name] = Block(_array(whole), labels)
    return blocks


def _array(values: list[Any]) -> Any:
    found = np.array(values)
    return found if found.dtype.kind in "biuf" else found.astype(float)


def _kept(topic: str, columns: Mapping[str, Any]) -> Any:
    """Which messages hold any of the wanted numbers."""
    wanted = [values for name, values in columns.items() if name[len(topic) + 1 :] not in _OWN]
    if not wanted:
        return slice(None)
    given = np.column_stack(
        [~np.isnan(values.reshape(len(values), -1).astype(float)) for values in wanted]
    )
    if not given.all(axis=1).any():
        lacking = " and ".join(repr(name) for name in list(columns)[:2])
        got = f"none of {topic!r} has all of {lacking:.120} and what else is mapped"
        advice = "Map columns of one publisher, or join them first."
        raise RefusalError(f"must hold what is mapped in one message; {got}. {advice}")
    return given.any(axis=1)


def _held(
    columns: dict[str, Any], own: Mapping[str, Any], others: Mapping[str, Any]
) -> dict[str, Any]:
    """Columns as they were at other times: the last value, NaN before the first."""
    clock = "stamp" if "stamp" in own and "stamp" in others else "log_time"
    order = np.argsort(own[clock], kind="stable")
    last = np.searchsorted(own[clock][order], others[clock], side="right") - 1
    held = {}
    for name, values in columns.items():
        found = values[order][np.maximum(last, 0)]
        if (last < 0).any():
            found = found.astype(float)
            found[last < 0] = np.nan
        held[name] = found
    return held
