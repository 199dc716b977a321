"""MCAP files of ROS 2 messages in CDR (numbers per joint, text), complete after every chunk.

Behind the last chunk stand the summary and the footer; the next chunk is written over them with new
ones, in one call, so that a process that is killed leaves a file with an index.

Source: MCAP version 0, https://mcap.dev/spec; OMG DDS-XTypes 1.3, section 7.4, for CDR.
"""

import contextlib
import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from plant.parts.files import path_of
from plant.parts.messages import warn

Topics = Mapping[str, tuple[str, Mapping[str, int]]]

STATUS: Topics = {"/status": ("std_msgs/msg/String", {})}

_MAGIC = b"\x89MCAP0\r\n"
_DATA_END = b"\x0f" + struct.pack("<QI", 4, 0)

_ENCAPSULATION = b"\0\1\0\0"  # of CDR, little endian

# bytes of a chunk, or the index's if that is longer: so rewriting it at most doubles what is
# written
_CHUNK = 1 << 16

_DEFINITION = (
    "std_msgs/Header header\nstring[] name\n{}\n"
    f"{'=' * 80}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


def _opened(path: str | Path) -> Any:
    """A file opened for writing; only an earlier MCAP file may be overwritten."""
    place = path_of("path", path)
    if place.is_file():
        with place.open("rb") as file:
            begins = file.read(len(_MAGIC))
    if place.exists() and not (place.is_file() and begins == _MAGIC):
        raise ValueError(
            f"{place} must not exist, or be an MCAP file; it is something else. Name a new file."
        )
    if not place.absolute().parent.is_dir():
        raise ValueError(
            f"{place} must be in a folder that exists; there is no {place.parent}. Make it."
        )
    return open(place, "wb", buffering=0)


class McapFile:
    """A file that messages are appended to; a context manager, which closes it.

    Each message of numbers has the names of the n `joints`, ``joint_1`` and so on where there are
    none. `topics`: topic -> type of its messages, and their fields with the length of each one's
    array; text has none.
    """

    def __init__(self, path: str | Path, joints: Sequence[str], n: int, topics: Topics) -> None:
        self._file = _opened(path)
        # The end of the last chunk, and the summary and footer that stand behind it at present.
        self._end = 0
        self._tail = b""
        self._count = 0
        names = joints or [f"joint_{k + 1}" for k in range(n)]
        self._messages = {
            topic: (k, *_message(names, description[1]))
            for k, (topic, description) in enumerate(topics.items(), 1)
        }
        self._totals = dict.fromkeys(range(1, len(topics) + 1), 0)
        self._chunks = 0
        self._index = b""
        self._described = b""
        for k, (topic, (kind, fields)) in enumerate(topics.items(), 1):
            text = (
                _DEFINITION.format("\n".join(f"float64[] {name}" for name in fields))
                if fields
                else "string data"
            )
            # Schema (3) and channel (4) of each topic; the summary repeats them.
            self._described += _record(3, _pack("H", k), _text(kind), _text("ros2msg"), _text(text))
            self._described += _record(4, _pack("HH", k, k), _text(topic), _text("cdr"), _text(""))
        self._begin = self._last = 0
        self._begin_chunk()
        self._write(_MAGIC + _record(1, _text("ros2"), _text("onepulse")) + self._described)

    def _begin_chunk(self) -> None:
        self._size = 0
        self._records: list[bytes] = []
        self._times: list[int] = []
        self._entries: dict[int, list[bytes]] = {channel: [] for channel in self._totals}

    def append(self, topic: str, time: int, values: Sequence[Any] | str) -> None:
        """Append a message, its arrays in order or its text; times [ns] must not decrease."""
        channel, message, places = self._messages[topic]
        if isinstance(values, str):
            message = bytearray(_ENCAPSULATION + _text(f"{values}\0"))
        else:
            # The time stamp of the header; the remaining header never changes.
            struct.pack_into("<II", message, len(_ENCAPSULATION), *divmod(time, 10**9))
            for place, values_of_field in zip(places, values, strict=True):
                message[place] = np.asarray(values_of_field, "<f8").tobytes()
        # Statistics need the times of the first and the last message of the file.
        self._begin = self._begin if self._count else time
        self._last = time
        self._times.append(time)
        self._entries[channel].append(_pack("QQ", time, self._size))
        self._records.append(
            _record(5, _pack("HIQQ", channel, self._count % 2**32, time, time), message)
        )
        self._size += len(self._records[-1])
        self._count += 1
        # Write when the chunk is at least as long as the index, which is rewritten with it.
        if self._size >= max(_CHUNK, len(self._index)):
            self._flush()

    def close(self) -> None:
        """Write the remaining messages, and close the file."""
        if self._records:
            self._flush()
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _flush(self) -> None:
        """Write the messages that have come as a chunk, with an index for each topic."""
        records = b"".join(self._records)
        times = _pack("QQ", self._times[0], self._times[-1])
        plain = _text("")
        size = _pack("Q", len(records))
        # Chunk (6): times, size, checksum, no compression, the messages (5).
        chunk = _record(6, times, size, _pack("I", zlib.crc32(records)), plain, size, records)
        indexes = b""
        offsets = b""
        # Message index (7) of each channel, behind its chunk; the chunk index (8) holds their
        # offsets.
        for channel, entries in self._entries.items():
            self._totals[channel] += len(entries)
            offsets += _pack("HQ", channel, self._end + len(chunk) + len(indexes))
            indexes += _record(7, _pack("H", channel), _text(b"".join(entries)))
        place = _pack("QQ", self._end, len(chunk))
        self._index += _record(
            8, times, place, _text(offsets), _pack("Q", len(indexes)), plain, size, size
        )
        self._chunks += 1
        self._begin_chunk()
        self._write(chunk + indexes)

    def _write(self, data: bytes) -> None:
        """Write records and a new end of the file; after an OSError restore the previous end."""
        if self._file.closed:
            return
        channels = len(self._totals)
        # Statistics (11): counts of messages, schemas, channels and chunks; no attachments or
        # metadata.
        totals = b"".join(_pack("HQ", *total) for total in self._totals.items())
        counts = _pack(
            "QHIIIIQQ", self._count, channels, channels, 0, 0, self._chunks, self._begin, self._last
        )
        # Footer (2): where the summary begins; no offsets and no checksum of it.
        footer = _record(2, _pack("QQI", self._end + len(data) + len(_DATA_END), 0, 0)) + _MAGIC
        tail = b"".join(
            [_DATA_END, self._described, _record(11, counts, _text(totals)), self._index, footer]
        )
        try:
            # One call, so that a process killed between chunk and summary is improbable.
            self._put(data + tail)
            self._end += len(data)
            self._tail = tail
        except OSError as error:
            # The previous end stood at this place before, so it fits on a full disk as well. The
            # ``with`` closes the file: later messages are dropped.
            with contextlib.suppress(OSError), self._file:
                self._put(self._tail)
                self._file.truncate()
            warn(
                f"{self._file.name} ends here, since it cannot be written: {error}. Make room; log"
                " to another file."
            )

    def _put(self, data: bytes) -> None:
        self._file.seek(self._end)
        remaining = memoryview(data)
        # An unbuffered write may take only part of the data.
        while remaining:
            remaining = remaining[self._file.write(remaining) :]


def joint_topics(n: int, columns: Mapping[str, int]) -> Topics:
    """Topics of a record: measured and commanded joint states [rad, N m], and all its columns.

    `columns`: name of a column -> its width.
    """
    fields = {"position": n, "velocity": 0, "effort": columns.get("torque", 0)}
    states = {"/joint_states": fields, "/reference": fields | {"effort": 0}}
    topics: dict[str, Any] = {
        topic: ("sensor_msgs/msg/JointState", widths) for topic, widths in states.items()
    }
    return topics | {"/sample": ("onepulse_msgs/msg/Sample", columns)}


def _pack(kinds: str, *values: int) -> bytes:
    return struct.pack(f"<{kinds}", *values)


def _text(value: str | bytes) -> bytes:
    """Text, or bytes, behind their length."""
    data = value.encode() if isinstance(value, str) else value
    return _pack("I", len(data)) + data


def _record(opcode: int, *parts: bytes | bytearray) -> bytes:
    return b"".join([_pack("BQ", opcode, sum(map(len, parts))), *parts])


def _message(names: Sequence[str], fields: Mapping[str, int]) -> tuple[bytearray, list[slice]]:
    """A message of numbers, all 0, and where the arrays of its fields stand in it."""
    begin = len(_ENCAPSULATION)
    data = bytearray(_ENCAPSULATION + bytes(8) + _text("\0"))  # a time of 0, an empty frame_id
    places = []

    def align(size: int) -> None:
        # CDR counts alignment from behind the encapsulation header.
        data.extend(bytes(-(len(data) - begin) % size))

    # Names and lengths are constant, so a message is packed once and later only its numbers change.
    align(4)
    data += _pack("I", len(names))
    for name in names:
        align(4)
        data += _text(f"{name}\0")
    for length in fields.values():
        align(4)
        data += _pack("I", length)
        # CDR aligns doubles to 8 bytes, but an empty sequence has no doubles to align.
        if length:
            align(8)
        places.append(slice(len(data), len(data) + 8 * length))
        data += bytes(8 * length)
    return data, places
