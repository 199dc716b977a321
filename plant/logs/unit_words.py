"""Words for units, as headings of tables and users spell them."""

import re

# The name of a unit in this library -> other spellings of it, in lower case without blanks. Units
# of speed and the like have no field in a record, but headings and rows of units hold them.
_SPELLINGS = {
    "s": "sec secs second seconds sek sekunden",
    "ms": "msec msecs millisecond milliseconds",
    "us": "µs μs usec microsecond microseconds",
    "ns": "nsec nanosecond nanoseconds",
    "rad": "radian radians",
    "deg": "° degree degrees",
    "turns": "turn rev revs revolution revolutions rot rotations u umdr",
    "gon": "gons gradian gradians",
    "mrad": "milliradian milliradians",
    "m": "metre metres meter meters",
    "mm": "millimetre millimetres millimeter millimeters",
    "pulses": "pulse count counts cnt cnts cts inc incs incr increments tick ticks lsb",
    "N m": "nm newtonmetre newtonmetres newtonmeter newtonmeters",
    "mN m": "mnm",
    "motor N m": "motornm",
    "N": "newton newtons",
    "A": "amp amps ampere amperes arms a_rms",
    "mA": "milliamp milliamps milliampere",
    "per cent": "% percent",
    "per mille": "‰ permille promille",
    "rpm": "1/min r/min min-1 min^-1 u/min rev/min",
    "rad/s": "rads-1 rads^-1 rad/sec radians/second",
    "deg/s": "°/s deg/sec degrees/second",
    "turns/s": "rev/s rps",
    "rad/s2": "rad/s^2 rad/s²",
    "deg/s2": "°/s^2 °/s² deg/s^2 deg/s²",
    "m/s": "",
    "mm/s": "",
    "V": "volt volts",
    "mV": "",
    "W": "watt watts",
    "Hz": "hertz",
    "degC": "°c celsius c",
    "K": "kelvin",
    "1": "- none",
}
_NAMES = {
    spelling: name
    for name, spellings in _SPELLINGS.items()
    for spelling in (name.lower().replace(" ", ""), *spellings.split())
}
# Longer names have no unit; the expression would take long on them.
_LONGEST_NAME = 200
_BRACKETED = re.compile(r"(.*?)\s*[\[(]([^\[\]()]{1,20})[\])]\s*")


def unit_named(text: str) -> str | None:
    """The library's name of a unit, None of any other word.

    Examples
    --------
    >>> from plant.logs.unit_words import unit_named
    >>> unit_named("Nm"), unit_named("[°]"), unit_named("shoulder")
    ('N m', 'deg', None)
    """
    word = text[:_LONGEST_NAME].strip()
    if word[:1] in ("[", "(") and word[-1:] in ("]", ")"):
        word = word[1:-1]
    # "N m", "N·m" and "N*m" are one word.
    return _NAMES.get(re.sub(r"[\s·*]", "", word).lower())


def without_unit(heading: str) -> tuple[str, str | None]:
    """The name in a heading such as ``q1 [deg]``, and the unit in its brackets.

    Brackets with anything else, such as the index of ``q[1]``, are part of the name.
    """
    match = _BRACKETED.fullmatch(heading) if len(heading) <= _LONGEST_NAME else None
    unit = unit_named(match[2]) if match and not match[2].strip().isdigit() else None
    return (match[1], unit) if match and unit is not None and match[1] else (heading, None)
