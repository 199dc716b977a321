"""What a command answers: a text for people, plain data for programs, and whether the verdict is good."""

import dataclasses
import math
from typing import Any


@dataclasses.dataclass(frozen=True)
class Answer:
    """An answer of a command: printed as text, or as JSON; exit code 0 if `good`, else 1."""

    text: str
    data: dict[str, Any]
    good: bool = True


def plain_number(value: Any) -> float | None:
    """A number for JSON, which has no infinity and no NaN: then none."""
    return float(value) if value is not None and math.isfinite(value) else None
