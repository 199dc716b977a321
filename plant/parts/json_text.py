"""Plain data as JSON that people can read and any program can parse: a row of numbers is a line, infinity is an object.

JSON has no infinity and no NaN; they are written ``{"float": "inf"}``.
"""

import json
import math
from collections.abc import Iterator
from typing import Any

_SPECIAL = ("inf", "-inf", "nan", "-nan")


def written(data: Any, indent: str = "") -> Iterator[str]:
    """The text of plain data, in pieces."""
    deeper = indent + " "
    if isinstance(data, dict) and data:
        for i, (key, value) in enumerate(data.items()):
            yield f"{',' if i else '{'}\n{deeper}{json.dumps(key)}: "
            yield from written(value, deeper)
        yield f"\n{indent}}}"
    elif isinstance(data, list) and any(isinstance(each, (list, dict)) for each in data):
        for i, value in enumerate(data):
            yield f"{',' if i else '['}\n{deeper}"
            yield from written(value, deeper)
        yield f"\n{indent}]"
    elif isinstance(data, list):
        try:
            yield json.dumps(data, allow_nan=False)
        except ValueError:
            yield f"[{', '.join(map(_scalar, data))}]"
    else:
        yield _scalar(data)


def _scalar(value: Any) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        sign = "-" if math.copysign(1.0, value) < 0 else ""
        return json.dumps({"float": f"{sign}{'nan' if math.isnan(value) else 'inf'}"})
    return json.dumps(value)


def parsed(data: bytes) -> Any:
    """Plain data of a text.

    Raises
    ------
    ValueError
        No JSON, a key twice, or nested too deep; without the path.
    """
    try:
        return json.loads(data.decode("utf-8"), object_pairs_hook=_object, parse_constant=_refused)
    except RecursionError:
        raise ValueError("must be JSON; it is nested too deep. Save it again.") from None
    except json.JSONDecodeError as error:
        cut = error.pos >= len(error.doc.rstrip())
        raise ValueError(
            f"must be JSON; {'it ends too early' if cut else error.msg} at line {error.lineno}. Save it again."
        ) from None
    except UnicodeDecodeError:
        raise ValueError("must be JSON in UTF-8; it is not. Save it again.") from None


def _object(pairs: list[tuple[str, Any]]) -> Any:
    made = dict(pairs)
    if len(made) < len(pairs):
        twice = next(key for i, (key, _) in enumerate(pairs) if key in dict(pairs[:i]))
        raise ValueError(f"must have each key once; {twice!r:.40} comes twice. Save it again.")
    if set(made) == {"float"}:
        if made["float"] not in _SPECIAL:
            raise ValueError(f"must have numbers; got {made['float']!r:.40}. Save it again.")
        return float(made["float"])
    return made


def _refused(constant: str) -> Any:
    raise ValueError(f"must be JSON, which has no {constant}. Save it again.")
