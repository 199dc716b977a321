"""MCAP files: messages of ROS 2 (CDR with their definition in the file) and JSON."""

import json
from collections.abc import Collection, Iterator
from typing import Any

from .columns import RefusalError
from .messages import columns_of


def read(
    path: str, names: Collection[str] | None, prefix: str, max_bytes: int, clock: str | None = None
) -> tuple[list[str], dict[str, Any]]:
    """Names and wanted columns of the topics of an MCAP file; see `messages`."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with open(path, "rb") as file:
        # The magic bytes stand at both ends; a recording that was interrupted lacks those at its
        # end.
        if file.read(8) != b"\x89MCAP0\r\n":
            raise RefusalError("must be an MCAP file; its first bytes are not. Check its name.")
        file.seek(-8, 2)
        if file.read(8) != b"\x89MCAP0\r\n":
            raise RefusalError(
                "must be complete; its last bytes are not those of MCAP. Run mcap recover on it."
            )
        file.seek(0)
        reader, decoders = make_reader(file, validate_crcs=True), DecoderFactory()
        # The summary lists the topics without a pass through all messages.
        summary = reader.get_summary()
        if summary is None or not summary.channels:
            raise RefusalError(
                "must hold a summary with its topics; it does not. Run mcap recover on it."
            )

        def messages(wanted: list[str]) -> Iterator[tuple[str, int, Any]]:
            decode = dict[int, Any]()
            for schema, channel, message in reader.iter_messages(topics=wanted) if wanted else ():
                # A decoder is built once per channel, not once per message.
                if channel.id not in decode:
                    kind = channel.message_encoding
                    decode[channel.id] = (
                        json.loads if kind == "json" else decoders.decoder_for(kind, schema)
                    )
                if decode[channel.id] is not None:
                    yield channel.topic, message.log_time, decode[channel.id](message.data)
                elif names is not None:
                    # Without names other encodings are skipped; a topic that was asked for must be
                    # readable.
                    encoding = (
                        f"{channel.message_encoding} with"
                        f" {schema.encoding if schema else 'no schema'}"
                    )
                    raise RefusalError(
                        "must hold ROS 2 messages (cdr with ros2msg) or JSON;"
                        f" {channel.topic!r:.60} is {encoding:.60}. Convert it."
                    )

        topics = (channel.topic for channel in summary.channels.values())
        return columns_of(topics, messages, names, prefix, max_bytes, clock)
