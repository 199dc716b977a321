"""Messages as columns: ``topic.field``, ``topic.field[2]``, by joint name ``topic.field.elbow``.

Each topic has columns ``stamp``, from the header of its messages, and ``log_time``, when they were
recorded, both in whole nanoseconds. Arrays beside a list of names (``name`` of a JointState,
``joint_names``) are told apart by these. So are arrays of messages, such as the interfaces of the
joints of a DynamicJointState: ``topic.interface_values.elbow.current``, or, where that means one
column, ``topic.elbow.current``; without names, ``topic.motor_state[2].current``.
"""

import array
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from .columns import Block, RefusalError, home_of, picked, require_size

_NAMES = ("name", "names", "joint_names", "interface_names")
# What a message of an array may be called by itself.
_OWN_NAMES = ("name", "joint_name", "id")
# Arrays with more elements hold pictures or point clouds, not joints; chosen by hand.
_MAX_ELEMENTS = 256
# Bound on the recursion into nested messages, JSON of any depth among them; chosen by hand.
_MAX_DEPTH = 6
_TIMES = ("stamp", "log_time")
# Of a message: its stamp and when it was logged [ns], its numbers, and the names of the elements of
# arrays.
_Row = tuple[int, int, dict[str, Any], dict[str, Any]]


def columns_of(
    listed_topics: Iterable[str],
    messages: Callable[[list[str]], Iterable[tuple[str, int, Any]]],
    names: Collection[str] | None,
    prefix: str,
    max_bytes: int,
    clock: str | None,
) -> tuple[list[str], dict[str, Any]]:
    """Names of all columns of a file of messages, and the wanted ones.

    `listed_topics` may repeat a topic. `messages` yields the topic, log time [ns] and decoded
    message of the topics that it receives.
    """
    # Several channels may carry one topic.
    topics = list(dict.fromkeys(listed_topics))
    numbers = 0
    rows = dict[str, list[_Row]]()
    for topic, log_time, message in messages(_wanted_topics(names, prefix, topics)):
        fields = list(_flat(message, "", (), 0))
        numbers += sum(len(value) if isinstance(value, list) else 1 for _, value, _ in fields)
        # The size is checked at each message, since a bag does not declare it; 2 more for the two
        # times.
        require_size(8 * (numbers + 2), max_bytes)
        values = {name: value for name, value, _ in fields}
        labels = {name: elements for name, _, elements in fields if elements}
        rows.setdefault(topic, []).append((_stamp(message), log_time, values, labels))
    blocks = {topic: _blocks(of_topic) for topic, of_topic in rows.items()}
    of_topics = [
        (f"{topic}.", name, block)
        for topic, of_topic in blocks.items()
        for name, block in of_topic.items()
    ]
    available = [
        f"{topic}{column}"
        for topic, name, block in of_topics
        for column in (name, *block.elements(name))
    ]
    # Topics that were not decoded are offered by their own names.
    available += [topic for topic in topics if topic not in blocks]
    if names is not None:
        return available, _sampled(blocks, names, clock)
    columns = {f"{topic}{name}": block.values for topic, name, block in of_topics}
    return available, {name: values for name, values in columns.items() if name.startswith(prefix)}


def _wanted_topics(names: Collection[str] | None, prefix: str, topics: Iterable[str]) -> list[str]:
    """The topics that hold something that is wanted."""
    if names is None:
        return [
            topic
            for topic in topics
            if f"{topic}.".startswith(prefix) or prefix.startswith(f"{topic}.")
        ]
    # Decoding takes most of the time, so topics without a wanted column are skipped.
    homes = {home_of(name, topics) for name in names}
    return [topic for topic in topics if topic in homes]


def _sampled(
    blocks: Mapping[str, Mapping[str, Block]], names: Collection[str], clock: str | None
) -> dict[str, Any]:
    """The wanted columns at the messages of the column `clock`; other topics hold their value."""
    chosen = dict[str, dict[str, Any]]()
    times = {}
    for name in names:
        topic = home_of(name, blocks)
        values = None if topic is None else _column(name[len(topic) + 1 :], blocks[topic])
        if topic is not None and values is not None:
            chosen.setdefault(topic, {})[name] = values
    for topic, columns in chosen.items():
        # A message without any wanted number, as of a second publisher, is no sample.
        rows = _kept(topic, columns)
        chosen[topic] = {name: values[rows] for name, values in columns.items()}
        times[topic] = {
            name: blocks[topic][name].values[rows] for name in _TIMES if name in blocks[topic]
        }
    # Topics have their own rates; the topic of the measurement gives the instants of all.
    clock_topic = next((topic for topic, columns in chosen.items() if clock in columns), None)
    if clock_topic is not None:
        for topic in chosen.keys() - {clock_topic}:
            chosen[topic] = _held(chosen[topic], times[topic], times[clock_topic])
    return {name: columns[name] for name in names for columns in chosen.values() if name in columns}


def _column(wanted: str, blocks: Mapping[str, Block]) -> Any:
    """A column of a topic; also without the first part of its name, and as ``q.1`` for ``q[1]``."""
    tails = [name.partition(".")[2] for name in blocks]
    short = {
        tail: block
        for tail, block in zip(tails, blocks.values(), strict=True)
        if tail and tails.count(tail) == 1
    }
    indexed = re.sub(r"\.(\d{1,9})(?=\.|$)", r"[\1]", wanted)
    for name in (wanted, indexed):
        for named in (blocks, short):
            values = picked(name, named)
            if values is not None:
                return values
    return None


def _items(message: Any) -> Iterable[tuple[str, Any]]:
    """Fields of a message: of an object of some class, or of a dictionary."""
    if isinstance(message, Mapping):
        return ((str(name), value) for name, value in message.items())
    # Decoded classes declare their fields in slots; others keep them in a dictionary.
    names: Any = getattr(type(message), "__slots__", None) or getattr(message, "__dict__", ())
    return ((name, getattr(message, name)) for name in names if not name.startswith("_"))


def _flat(
    message: Any, prefix: str, labels: tuple[str, ...], deep: int
) -> Iterator[tuple[str, Any, tuple[str, ...]]]:
    """Name, number or list of numbers, and names of its elements, of all fields."""
    if deep > _MAX_DEPTH:
        return
    fields = list(_items(message))
    # Names first: they label all arrays beside them, in whatever order the fields come.
    for name, value in fields:
        if (
            name in _NAMES
            and isinstance(value, (list, tuple))
            and all(isinstance(label, str) for label in value)
        ):
            labels = tuple(value)
    for name, value in fields:
        # The stamp of the header has a column of its own.
        if _is_stamp(name, value, deep):
            continue
        if isinstance(value, (bool, int, float)) or getattr(value, "shape", None) == ():
            yield f"{prefix}{name}", value, ()
        elif isinstance(value, (list, tuple, array.array)) or getattr(value, "ndim", None) == 1:
            # Larger arrays hold no joints.
            if not 0 < len(value) <= _MAX_ELEMENTS:
                continue
            if hasattr(value, "dtype") or isinstance(value[0], (bool, int, float)):
                numbers = value.tolist() if hasattr(value, "tolist") else list(value)
                yield f"{prefix}{name}", numbers, labels if len(labels) == len(numbers) else ()
            elif not isinstance(value[0], (str, bytes, list, tuple)) and value[0] is not None:
                yield from _of_messages(value, f"{prefix}{name}", labels, deep + 1)
        elif not isinstance(value, (str, bytes, bytearray)) and value is not None:
            yield from _flat(value, f"{prefix}{name}.", labels, deep + 1)


def _of_messages(
    messages: Any, prefix: str, labels: tuple[str, ...], deep: int
) -> Iterator[tuple[str, Any, tuple[str, ...]]]:
    """Fields of an array of messages, each message by its name or by its index."""
    labels = labels if len(labels) == len(messages) else _own_labels(messages)
    for k, message in enumerate(messages):
        place = f"{prefix}.{labels[k]}" if labels else f"{prefix}[{k}]"
        fields = list(_flat(message, "", (), deep))
        # A list of names and one of numbers are all that such a message is: interfaces and values.
        is_list = len(fields) == 1
        for name, value, inner in fields:
            # Joints may have different interfaces, so each number is a column.
            if inner:
                home = place if is_list else f"{place}.{name}"
                yield from ((f"{home}.{x}", v, ()) for x, v in zip(inner, value, strict=True))
            else:
                yield f"{place}.{name}", value, ()


def _own_labels(messages: Any) -> tuple[str, ...]:
    """Different names that messages of an array have as a field; () where they have none."""
    for field in _OWN_NAMES:
        labels = [dict(_items(message)).get(field) for message in messages]
        texts = tuple(label for label in labels if isinstance(label, str) and label)
        if len(set(texts)) == len(messages):
            return texts
    return ()


def _is_stamp(name: str, value: Any, deep: int) -> bool:
    return name == "header" and deep == 0 and dict(_items(value)).get("stamp") is not None


def _stamp(message: Any) -> int:
    """The time in a message's header [ns]; 0 where it has none."""
    header = dict(_items(message)).get("header")
    stamp = None if header is None else dict(_items(header)).get("stamp")
    if stamp is None:
        return 0
    # ROS 2 and ROS 1 differ in the name of the nanoseconds.
    parts = {name: value for name, value in _items(stamp) if isinstance(value, int)}
    # Integers, since a float64 resolves only some 200 ns of Unix time.
    return parts.get("sec", 0) * 10**9 + parts.get("nanosec", parts.get("nsec", 0))


def _blocks(rows: list[_Row]) -> dict[str, Block]:
    """The messages of one topic as columns; what a message lacks is NaN."""
    stamps = np.array([row[0] for row in rows], np.int64)
    # Zero stamps are those of a publisher that does not set them.
    blocks = {"stamp": Block(stamps)} if stamps.any() else {}
    blocks["log_time"] = Block(np.array([row[1] for row in rows], np.int64))
    for name in dict.fromkeys(name for row in rows for name in row[2]):
        cells = [row[2].get(name) for row in rows]
        if not any(isinstance(cell, list) for cell in cells):
            blocks[name] = Block(_array([np.nan if cell is None else cell for cell in cells]))
            continue
        # Publishers may send joints in another order or some of them only: columns follow the
        # names.
        labels = tuple(dict.fromkeys(label for row in rows for label in row[3].get(name, ())))
        width = len(labels) or max(len(cell) for cell in cells if isinstance(cell, list))
        position = {label: i for i, label in enumerate(labels)}
        lines = []
        for row, cell in zip(rows, cells, strict=True):
            own_labels = row[3].get(name, ())
            line = [np.nan] * width
            # Lists without names cannot be assigned to named columns, and stay NaN.
            if isinstance(cell, list) and bool(own_labels) == bool(labels):
                for i, value in zip(
                    [position[label] for label in own_labels] if own_labels else range(width),
                    cell,
                    strict=False,
                ):
                    line[i] = value
            lines.append(line)
        blocks[name] = Block(_array(lines), labels)
    return blocks


def _array(values: list[Any]) -> Any:
    block = np.array(values)
    # Integers keep their type: times in nanoseconds do not fit a float64.
    return block if block.dtype.kind in "biuf" else block.astype(float)


def _kept(topic: str, columns: Mapping[str, Any]) -> Any:
    """Which messages hold any of the wanted numbers."""
    # Each message has times, so they do not decide.
    wanted = [values for name, values in columns.items() if name[len(topic) + 1 :] not in _TIMES]
    if not wanted:
        return slice(None)
    present = np.column_stack(
        [~np.isnan(values.reshape(len(values), -1).astype(float)) for values in wanted]
    )
    # If no message holds all wanted columns, two publishers share the topic, and their rows do not
    # belong together.
    if not present.all(axis=1).any():
        lacking = " and ".join(repr(name) for name in list(columns)[:2])
        got = f"none of {topic!r} has all of {lacking:.120} and what else is mapped"
        advice = "Map columns of one publisher, or join them first."
        raise RefusalError(f"must hold what is mapped in one message; {got}. {advice}")
    return present.any(axis=1)


def _held(
    columns: dict[str, Any], times: Mapping[str, Any], sample_times: Mapping[str, Any]
) -> dict[str, Any]:
    """Columns as they were at other times: the last value, NaN before the first."""
    # Stamps are of the measurement, log times include the transport; both topics must have the one
    # that is used.
    clock = "stamp" if "stamp" in times and "stamp" in sample_times else "log_time"
    # Messages are logged as they arrive, not by their stamps.
    order = np.argsort(times[clock], kind="stable")
    previous = np.searchsorted(times[clock][order], sample_times[clock], side="right") - 1
    held = {}
    for name, values in columns.items():
        latest = values[order][np.maximum(previous, 0)]
        if (previous < 0).any():
            # An integer column has no NaN.
            latest = latest.astype(float)
            latest[previous < 0] = np.nan
        held[name] = latest
    return held
