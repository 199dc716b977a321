"""What the fields of a part mean, and in which unit they are: from its own docstring."""

import functools
import re

_HEAD = re.compile(r"^    (\w+(?:, \w+)*) : .*$")
_UNIT = re.compile(r"\[([^\]]*)\]")


@functools.cache
def _meanings(cls: type) -> dict[str, str]:
    """Field -> its description, in one line."""
    found: dict[str, str] = {}
    names: list[str] = []
    for line in (cls.__doc__ or "").splitlines():
        if head := _HEAD.match(line):
            names = head[1].split(", ")
            found |= dict.fromkeys(names, "")
        elif line.startswith("        ") and names:
            found |= {name: f"{found[name]} {line.strip()}".strip() for name in names}
        elif line.strip():
            names = []
    return found


def meaning_of(cls: type, field: str) -> str:
    """The first sentence of what a field means; empty where nothing is said."""
    return re.split(r"(?<=[^.])\.(?:\s|$)", _meanings(cls).get(field, ""), maxsplit=1)[0]


def unit_of(cls: type, field: str) -> str:
    """What the brackets of its description hold; empty where there are none."""
    match = _UNIT.search(_meanings(cls).get(field, ""))
    return match[1] if match else ""
