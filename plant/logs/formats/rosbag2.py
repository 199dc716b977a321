"""Bags of ROS 2, a folder with ``metadata.yaml`` or one of its files, and of ROS 1 (``.bag``)."""

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from .columns import RefusalError
from .messages import columns_of

# definitions of the standard messages, for bags that do not hold those of their own
_STORE = "ROS2_HUMBLE"


def read(
    path: str, names: Collection[str] | None, prefix: str, max_bytes: int, clock: str | None = None
) -> tuple[list[str], dict[str, Any]]:
    """Names and wanted columns of the topics of a bag; see `messages`."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    # rosbags would report a missing file of its own; the cure is to write the index again.
    if Path(path).is_dir() and not Path(path, "metadata.yaml").is_file():
        raise RefusalError(
            "must be a bag of ROS 2; the folder has no metadata.yaml. Run ros2 bag reindex on it."
        )
    with AnyReader(
        [Path(path)], default_typestore=get_typestore(getattr(Stores, _STORE))
    ) as reader:

        def messages(wanted: list[str]) -> Iterator[tuple[str, int, Any]]:
            chosen = [connection for connection in reader.connections if connection.topic in wanted]
            defined = [
                connection for connection in chosen if connection.msgtype in reader.typestore.types
            ]
            # A topic that was asked for must have a definition; without names such topics are
            # skipped.
            for connection in chosen:
                if names is not None and connection not in defined:
                    got = f"{connection.topic!r:.60} is of {connection.msgtype:.60}"
                    advice = "Record it again as MCAP, or convert it."
                    raise RefusalError(
                        f"must hold messages whose types are defined; {got}. {advice}"
                    )
            # `messages` of an empty list of connections would read all topics.
            for connection, log_time, data in (
                reader.messages(connections=defined) if defined else ()
            ):
                yield connection.topic, log_time, reader.deserialize(data, connection.msgtype)

        topics = (connection.topic for connection in reader.connections)
        return columns_of(topics, messages, names, prefix, max_bytes, clock)
