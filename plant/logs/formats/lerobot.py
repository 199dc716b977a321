"""LeRobot data sets, version 2 or 3: a folder with ``meta/info.json`` and Parquet episodes."""

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

from .columns import Block, RefusalError, picked
from .parquet import read_blocks

# A bound on meta/info.json [bytes], which the parent process parses too; chosen by hand.
_MAX_INFO = 1 << 24
_EPISODE = "episode_index"


def read(
    path: str, names: Collection[str] | None, prefix: str, max_bytes: int, episode: int = 0
) -> tuple[list[str], dict[str, Any]]:
    """Names and wanted columns of one episode; ``action.elbow``, ``action[1]`` are elements."""
    info = _info(path)
    features: Any = info.get("features")
    # A file that does not describe its features can still be read by names.
    features = features if isinstance(features, dict) else {}
    # Videos and texts are features as well; a log of numbers has no use for them.
    numeric = [
        name
        for name, feature in features.items()
        if name.startswith(prefix) and _is_numeric(feature)
    ]
    # The episode of each row is read as well: version 3 keeps several episodes in one file.
    wanted = [*(numeric if names is None else names), _EPISODE]
    available, blocks = read_blocks(_file_of(path, info, episode, max_bytes), wanted, "", max_bytes)
    if _EPISODE not in blocks:
        raise RefusalError(
            "must name the episode of each row; its data has no column 'episode_index'. Convert it."
        )
    rows = blocks[_EPISODE].values == episode
    if not rows.any():
        raise RefusalError(
            f"must hold the rows of episode {episode}; its data file has none. Download it again."
        )
    chosen = {}
    for name, block in blocks.items():
        # Labels that do not fit the width of the list are worse than indices.
        labels = _labels(features.get(name))
        fits = block.values.ndim == 2 and len(labels) == block.values.shape[1]
        chosen[name] = Block(block.values[rows], labels if fits else ())
    # Elements of lists are names that a message may offer.
    elements = [element for name, block in chosen.items() for element in block.elements(name)]
    if names is None:
        columns = {name: chosen[name].values for name in numeric if name in chosen}
        return [*columns, *elements], columns
    available = [*available, *elements]
    columns = {name: picked(name, chosen) for name in names}
    return available, {name: values for name, values in columns.items() if values is not None}


def episodes_of(path: str) -> int:
    """Number of episodes of a data set."""
    # From the index: counting files would count what is not downloaded.
    count = _info(path).get("total_episodes")
    if not isinstance(count, int) or count < 1:
        raise RefusalError(
            f"must state total_episodes in meta/info.json; got {count!r:.20}. Download it again."
        )
    return count


def _info(path: str) -> dict[str, Any]:
    info_file = Path(path, "meta", "info.json")
    if not info_file.is_file():
        raise RefusalError(
            "must be a LeRobot data set; it has no meta/info.json. Give the folder that holds"
            " meta/."
        )
    if info_file.stat().st_size > _MAX_INFO:
        raise RefusalError(
            f"must have a meta/info.json below {_MAX_INFO >> 20} MiB; it is larger. Write it again."
        )
    try:
        info = json.loads(info_file.read_bytes())
    except (ValueError, RecursionError):
        raise RefusalError(
            "must have a meta/info.json that is JSON; it is not. Download it again."
        ) from None
    # The layout of files differs between versions, so an unknown one is refused.
    version = str(info.get("codebase_version", "")) if isinstance(info, dict) else ""
    if not version.startswith(("v2.", "v3.")):
        raise RefusalError(
            f"must be of version 2 or 3; got {version!r:.20} in meta/info.json. Convert it."
        )
    return dict(info)


def _file_of(path: str, info: dict[str, Any], episode: int, max_bytes: int) -> str:
    """The Parquet file with an episode, inside of the folder."""
    count = episodes_of(path)
    if not 0 <= episode < count:
        raise RefusalError(
            f"must hold episode {episode}; it has 0 to {count - 1}. Choose one of those."
        )
    pattern = str(info.get("data_path", ""))
    version = str(info["codebase_version"])
    # Version 2 computes the file from the episode; version 3 looks it up in a table.
    if version.startswith("v2."):
        size = info.get("chunks_size")
        if not isinstance(size, int) or size < 1:
            raise RefusalError(
                f"must state chunks_size in meta/info.json; got {size!r:.20}. Download it again."
            )
        keys = {"episode_chunk": episode // size, "episode_index": episode}
    else:
        keys = _place_of(path, episode, max_bytes)
    # The pattern comes from the data set: a long one is no path.
    if len(pattern) > 200:
        raise RefusalError(
            "must have a data_path below 200 characters in meta/info.json. Download it again."
        )
    try:
        name = pattern.format(**keys)
    except (LookupError, ValueError, AttributeError, TypeError):
        got = f"got {pattern!r:.80}"
        raise RefusalError(
            f"must have a data_path that names files by episode; {got}. Correct it."
        ) from None
    # A data set must not lead to a file outside of its folder.
    if not name or Path(name).is_absolute() or ".." in Path(name).parts:
        raise RefusalError(
            f"must have its data inside of its folder; data_path gives {name!r:.80}. Correct it."
        )
    if not Path(path, name).is_file():
        raise RefusalError(
            f"must hold {name!r:.80}, the data of episode {episode}; it does not. Download it."
        )
    return str(Path(path, name))


def _place_of(path: str, episode: int, max_bytes: int) -> dict[str, int]:
    """Where version 3 keeps an episode, from its table of episodes."""
    columns = {"data/chunk_index": "chunk_index", "data/file_index": "file_index"}
    # Large data sets split the table, so the file that lists the episode is searched.
    for table in sorted(Path(path, "meta", "episodes").glob("*/*.parquet")):
        _, blocks = read_blocks(str(table), [_EPISODE, *columns], "", max_bytes)
        if not {_EPISODE, *columns} <= blocks.keys():
            break
        rows = blocks[_EPISODE].values == episode
        if rows.any():
            return {short: int(blocks[name].values[rows][0]) for name, short in columns.items()}
    raise RefusalError(
        f"must list episode {episode} in meta/episodes; it does not. Download it again."
    )


def _is_numeric(feature: Any) -> bool:
    return isinstance(feature, dict) and str(feature.get("dtype")).startswith(
        ("float", "int", "uint", "bool")
    )


def _labels(feature: Any) -> tuple[str, ...]:
    """Names of a feature's elements: a list, or a list in a dictionary; () where it has none."""
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):
        lists = [value for value in names.values() if isinstance(value, list)]
        names = lists[0] if len(lists) == 1 else None
    # Labels become names of columns, so each must be text and unique.
    sound = (
        isinstance(names, list)
        and all(isinstance(name, str) for name in names)
        and len(set(names)) == len(names)
    )
    return tuple(names) if sound and names else ()
