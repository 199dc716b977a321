"""Cells that state an instant: a date and a time of day (ISO 8601), or a time of day alone."""

import datetime
import re

# 2026-05-03T10:00:00.25+02:00, 2026/05/03 10:00:00, 03.05.2026 10:00:00,25 or 10:00:00.25. A date
# such as 03/05/2026 is another day in another country, and is not read.
_INSTANT = re.compile(
    r"(?:(?:(?P<year>\d{4})[-/](?P<month>\d\d)[-/](?P<day>\d\d)"
    r"|(?P<day_of>\d\d)\.(?P<month_of>\d\d)\.(?P<year_of>\d{4}))[T ]\s*)?"
    r"(?P<hour>\d\d?):(?P<minute>\d\d):(?P<second>\d\d)(?:[.,](?P<fraction>\d{1,9}))?"
    r"\s*(?:Z|(?P<sign>[+-])(?P<hours>\d\d):?(?P<minutes>\d\d))?",
    re.ASCII,
)
_DAY = 86_400_000_000_000  # [ns]; whole nanoseconds keep the differences of dates exact


def is_instant(cell: str) -> bool:
    """Whether a cell states an instant.

    Examples
    --------
    >>> is_instant("2026-05-03T10:00:00.25Z"), is_instant("10:00"), is_instant("0.25")
    (True, False, False)
    """
    try:
        nanoseconds(cell)
    except ValueError:
        return False
    return True


def nanoseconds(cell: str) -> int:
    """The instant of a cell in UTC [ns]: since the year 0, or since midnight without a date.

    Raises
    ------
    ValueError
        If the cell states no instant.
    """
    match = _INSTANT.fullmatch(cell.strip().strip('"'))
    if match is None:
        raise ValueError
    part = match.groupdict(default="0")
    hour, minute, second = (int(part[name]) for name in ("hour", "minute", "second"))
    # A leap second is 60.
    if hour > 23 or minute > 59 or second > 60:
        raise ValueError
    days = 0
    if match["year"] or match["year_of"]:
        suffix = "" if match["year"] else "_of"
        year, month, day = (int(part[name + suffix]) for name in ("year", "month", "day"))
        days = datetime.date(year, month, day).toordinal()
    # A zone of +02:00 is two hours ahead of UTC.
    zone = 60 * int(part["hours"]) + int(part["minutes"])
    ahead = zone if part["sign"] == "+" else -zone
    minutes = 60 * hour + minute - ahead
    whole = (60 * minutes + second) * 1_000_000_000 + int(part["fraction"].ljust(9, "0"))
    return days * _DAY + whole


class ClockTimes:
    """Instants of a table as seconds after the midnight before its first one.

    A float of this size resolves nanoseconds; a float of the seconds since 1970 does not.
    """

    def __init__(self) -> None:
        self._midnight: int | None = None

    def __call__(self, cell: str) -> float:
        """The instant of a cell [s]; ValueError if it states none."""
        instant = nanoseconds(cell)
        if self._midnight is None:
            self._midnight = instant // _DAY * _DAY
        return (instant - self._midnight) / 1e9
