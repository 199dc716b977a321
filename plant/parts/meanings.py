"""What docstrings say of the fields of a part: for robot files, and for C."""

import functools
import re

_HEAD = re.compile(r"^    (\w+(?:, \w+)*) : .*$")


@functools.cache
def meanings(cls: type) -> dict[str, str]:
    """Field -> its description, in one line; that of a class itself before those of its bases."""
    found: dict[str, str] = {}
    names: list[str] = []
    for line in "\n".join(base.__doc__ or "" for base in reversed(cls.__mro__)).splitlines():
        if head := _HEAD.match(line):
            names = head[1].split(", ")
            found |= dict.fromkeys(names, "")
        elif line.startswith("        ") and names:
            found |= {name: f"{found[name]} {line.strip()}".strip() for name in names}
        elif line.strip():
            names = []
    return found
