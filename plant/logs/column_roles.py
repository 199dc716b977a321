"""What the columns of a foreign log likely are, by the words in their names, units and values."""

import dataclasses
import re
from collections.abc import Iterable, Mapping

import numpy as np

from plant.logs.unit_words import unit_named, without_unit
from plant.logs.units import TIME
from plant.parts import Floats

# Quantity -> words of names that mean it. A name with words of several quantities has the first of
# these: `joint_position_error` is an error, `motor_current_position` a current.
_QUANTITIES = {
    "time": "t time times timestamp stamp zeit zeitstempel uhrzeit clock",
    "valid": "valid",
    "temperature": "temp temps temperature temperatures temperatur",
    "acceleration": "qdd ddq qddot acc accel acceleration accelerations beschleunigung beschl",
    "speed": "qd dq qdot vel vels velocity velocities speed speeds omega rpm drehzahl"
    " geschwindigkeit geschw",
    "torque": "tau torque torques trq effort efforts moment moments drehmoment drehmomente mom",
    "error": "error errors err deviation schleppfehler schlepp regelabweichung following",
    "current": "current currents cur curr amps iq strom stroeme ströme motorstrom i",
    "counts": "c count counts enc encoder encoders pulses ticks inc increments inkremente"
    " inkr impulse zaehler zähler geber drehgeber",
    "position": "q qm ql qg pos position positions angle angles theta phi lage joint joints qpos"
    " winkel gelenk gelenke ang stellung achswinkel lageist lagesoll",
}
_WORDS = {word: quantity for quantity, words in _QUANTITIES.items() for word in words.split()}
_ORDER = tuple(_QUANTITIES)
# A column that is called by a joint alone holds its position.
_JOINTS = frozenset(
    [
        "waist",
        "base",
        "shoulder",
        "elbow",
        "forearm",
        "wrist",
        "hip",
        "knee",
        "ankle",
        "axis",
        "achse",
        "schulter",
        "ellbogen",
        "ellenbogen",
        "unterarm",
        "hand",
        "handgelenk",
        "basis",
        "sockel",
        "hub",
        "linear",
        "slide",
        "lift",
        "quill",
        "schlitten",
        "gripper",
        "j",
    ]
)
_COMMANDED = frozenset(
    [
        "target",
        "ref",
        "reference",
        "cmd",
        "command",
        "commanded",
        "commands",
        "desired",
        "des",
        "set",
        "setpoint",
        "soll",
        "sollwert",
        "sollwerte",
        "vorgabe",
        "fuehrung",
        "action",
        "goal",
        "demand",
        "asked",
        "lagesoll",
    ]
)
# German logs call commanded and measured positions by these words alone: `soll_1`, `ist_1`.
_GERMAN = frozenset(["soll", "sollwert", "sollwerte", "ist", "istwert", "istwerte"])
# Words of positions whose names have no word of a quantity.
_WITHOUT_QUANTITY = _JOINTS | _GERMAN
_MEASURED = frozenset(
    [
        "actual",
        "act",
        "measured",
        "meas",
        "feedback",
        "state",
        "observation",
        "ist",
        "istwert",
        "istwerte",
        "lageist",
        "motor",
        "link",
    ]
)
# Words after which a single letter names a joint, as in `ang_c`. After "joint" a letter is a
# quantity, as in `joint_q`.
_BEFORE_LETTERS = _GERMAN | {word for word in _WORDS if "joint" not in word}
# The letter c as a word of its own, as in `joint_c`, `jointC` and `c1_pos`.
_LETTER_C = re.compile(r"((?<![^\W\d_])[cC]|(?<=[a-z])C)(?![^\W\d_])")
# The names of one group's columns share these words; their other words name the joints.
_VOCABULARY = _WORDS.keys() | _COMMANDED | _MEASURED
# A unit says more than a name, except of an error.
_OF_UNITS = {
    "time": ("s", "ms", "us", "ns"),
    "position": ("rad", "deg", "turns", "gon", "mrad", "m", "mm"),
    "counts": ("pulses",),
    "torque": ("N m", "mN m", "motor N m"),
    "current": ("A", "mA"),
    "speed": ("rpm", "rad/s", "deg/s", "turns/s", "m/s", "mm/s"),
    "acceleration": ("rad/s2", "deg/s2"),
    "temperature": ("degC", "K"),
    "other": ("V", "mV", "W", "Hz"),
}
_UNIT_QUANTITIES = {unit: quantity for quantity, units in _OF_UNITS.items() for unit in units}
# Words of names that are units. Letters and words such as `rot` may also be those of a joint.
_UNIT_NAMES = "rad radian radians mrad deg degree degrees gon rev revs turns mm sec ms msec us ns"
_UNIT_WORDS = frozenset(_UNIT_NAMES.split())
# Times that start above such a number may be Unix times in its unit, of the year 2001 or later;
# smaller ones are rather those of a clock that started with the machine.
_UNIX = {"ns": 1e18, "us": 1e15, "ms": 1e12, "s": 1e9}


@dataclasses.dataclass(frozen=True, kw_only=True)
class RoleSettings:
    """Sizes of values that decide between units; all chosen by hand.

    Parameters
    ----------
    periods : tuple of pair of float
        Ranges of sampling periods [s]: usual ones, and all that occur.
    max_radians : float
        Largest angle that is likely in rad; two turns.
    max_turns : float
        Largest number that may be an angle in turns as well as in rad.
    max_normalised : float
        Largest value of a percentage.
    max_amperes : float
        Largest current that is likely in ampere.
    max_torque : float
        Largest torque [N m] that is likely; larger numbers may be per mille of a rated torque.
    min_counts : float
        Whole numbers are counts if their range is larger than this.
    """

    periods: tuple[tuple[float, float], ...] = ((2e-4, 0.05), (5e-6, 2.0))
    max_radians: float = 4 * np.pi
    max_turns: float = 2.0
    max_normalised: float = 100.0
    max_amperes: float = 100.0
    max_torque: float = 900.0
    min_counts: float = 100.0


SETTINGS = RoleSettings()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Role:
    """What a column likely is.

    Parameters
    ----------
    quantity : str
        Of `_QUANTITIES`, or "other".
    commanded : bool
        The value was asked for, not measured.
    units : tuple of str
        The unit that the file states; else the likely ones, the likeliest first, or none, as for
        speeds.
    group : tuple of str
        Its folder or topic, and the words of its name that do not name its joint.
    """

    quantity: str
    commanded: bool
    units: tuple[str, ...]
    group: tuple[str, ...]

    def __str__(self) -> str:
        name = f"commanded {self.quantity}" if self.commanded else self.quantity
        return f"{name} [{' or '.join(self.units)}]" if self.units else name


def written_out(names: Iterable[str]) -> dict[str, str]:
    """Name -> the name in words: the letters s and i of a pair become `soll` and `ist`.

    The letter d of `q_d_1` becomes `desired` if there is a `q_1`. The letter c of a joint becomes
    its number, 3 (`_numbered`). A command of a position that names no quantity gets the word
    "position" (`_of_positions`).
    """
    every = set(names)
    written = _numbered(every)
    for name in every:
        match = re.search(r"_([si])(?=\d*$|_[^_]+$)", name)
        if match is not None:
            front, end = name[: match.start(1)], name[match.end(1) :]
            # Without its partner the letter is that of a joint.
            if {f"{front}s{end}", f"{front}i{end}"} <= every:
                written[name] = front + {"s": "soll", "i": "ist"}[match[1]] + end
        match = re.search(r"_d(?=[_.\[\]\d]*$)", name)
        if match is not None and name[: match.start()] + name[match.end() :] in every:
            written[name] = f"{name[: match.start()]}_desired{name[match.end() :]}"
    return written | _of_positions(written)


def _numbered(names: Iterable[str]) -> dict[str, str]:
    """Name -> the name, in which the number 3 replaces the letter c of the joints a, b and c.

    Elsewhere the letter means counts: `joint_c` without `joint_a` and `joint_b`, or `c1`.
    """
    spelt = {name: tuple(_tokens(name)) for name in names}
    present = set(spelt.values())
    numbered = {}
    for name, words in spelt.items():
        others = {tuple(letter if word == "c" else word for word in words) for letter in "ab"}
        is_joint = "c" in words and others <= present and len(set(_words(name))) > 1
        numbered[name] = _LETTER_C.sub("_3_", name) if is_joint else name
    return numbered


def _of_positions(called: Mapping[str, str]) -> dict[str, str]:
    """Commands of positions that name no quantity: name -> the name with "position" added.

    Such a command names the joint of a column of positions: `cmd_1` beside `count_1`.
    """
    words = {name: set(_words(text)) for name, text in called.items()}
    quantities = {name: {_WORDS[word] for word in words[name] & _WORDS.keys()} for name in called}
    commands = {name for name in called if not _COMMANDED.isdisjoint(words[name])}
    of_positions = {"position", "counts"}
    # Where some commands say that they are positions, the others command something else.
    if any(quantities[name] & of_positions for name in commands):
        return {}
    # A column that is called by its joint alone holds a position, too; one of a word that is not
    # known, such as `pwm_1`, does not.
    measured = {
        _joint(called[name])
        for name in called.keys() - commands
        if quantities[name] <= of_positions
        and (quantities[name] or not _WITHOUT_QUANTITY.isdisjoint(words[name]))
    }
    return {
        name: f"{without_unit(called[name])[0]}_position"
        for name in commands
        if not quantities[name] and _joint(called[name]) in measured
    }


def role_of(name: str, values: Floats, unit: str | None) -> Role:
    """The likely role of a column (N,) or block (N, k), whose unit the file may state."""
    words = _words(name)
    # The letter of a joint is no quantity: `ang_i`, `soll_c`.
    front = words[:-1]
    lettered = bool(front) and len(words[-1]) == 1 and front[-1] in _BEFORE_LETTERS
    words = front if lettered else words
    quantities = {_WORDS[word] for word in words if word in _WORDS}
    # LeRobot data sets call positions `observation.state`, and goals `action`.
    if {"observation", "state"} <= set(words) or words == ["action"]:
        quantities |= {"position"}
    quantity = next((q for q in _ORDER if q in quantities), "other")
    # Exports by hand often have a column per joint, called by its name.
    if quantity == "other" and not _WITHOUT_QUANTITY.isdisjoint(words):
        quantity = "position"
    # A single letter such as i numbers joints as often as it means a current.
    if quantity == "current" and "position" in quantities and not {"q", "pos"}.isdisjoint(words):
        quantity = "position" if "i" in words else quantity
    # The file states a unit on purpose, while words of a name may be accidental. An error has the
    # unit of what deviates.
    if quantity != "error":
        quantity = _UNIT_QUANTITIES.get(unit or "", quantity)
    unit = unit if unit is not None else _unit_in(name, words, quantity)
    # Whole numbers over a wide range are counts, even where the name says position.
    if quantity == "position" and unit is None and _are_counts(values):
        quantity = "counts"
    return Role(
        quantity=quantity,
        commanded=not _COMMANDED.isdisjoint(words),
        units=(unit,) if unit is not None else _likely_units(quantity, words, values),
        group=(folder_of(name), *(word for word in words if word in _VOCABULARY)),
    )


def _unit_in(name: str, words: Iterable[str], quantity: str) -> str | None:
    """The unit that is part of a name, such as deg of `q1_deg`; None without one."""
    # A multiple of a unit, as in `q1 [deg/10]`, is stated as it is: no rule says how large it is.
    bracketed = re.search(r"[\[(]([^\[\]()]*)[\])]$", name)
    if bracketed is not None and not _UNIT_WORDS.isdisjoint(_words(bracketed[1])):
        return bracketed[1]
    named = (unit_named(word) or "" for word in words if word in _UNIT_WORDS)
    return next((unit for unit in named if _UNIT_QUANTITIES[unit] == quantity), None)


def folder_of(name: str) -> str:
    """The topic of a column of messages, or the HDF5 group of a column; else an empty text."""
    if name.startswith("/"):
        return name.partition(".")[0]
    # The slash of a unit in brackets, known or not, is none of a folder: `qd_1 [rad/s]`.
    return re.sub(r"[\[(][^\[\]()]*[\])]$", "", name).rpartition("/")[0]


def time_unit(values: Floats) -> str:
    """The likely unit of times (N,)."""
    # The median of the steps that are positive: rows may repeat a time, or be missing.
    steps = np.diff(values)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    # Unix times of each unit are of another order of magnitude, and so are their starts.
    start = float(np.nanmin(values)) if np.isfinite(values).any() else 0.0
    unix = next((unit for unit, least in _UNIX.items() if start > least), None)
    # A clock of the machine may come there, too: its steps would be too long in this unit.
    if unix is not None and step / TIME[unix] <= SETTINGS.periods[-1][1]:
        return unix
    # The usual periods are tried in all units before the rare ones: 1 is 1 ms rather than 1 s.
    for shortest, longest in SETTINGS.periods:
        for unit, per in TIME.items():
            if shortest <= step / per <= longest:
                return unit
    return unix or "s"


def _words(name: str) -> list[str]:
    """Words of a name, in lower case: ``actualQ_1`` and ``actual.q[1]`` have actual and q."""
    # Digits number the joints.
    return [token for token in _tokens(name) if not token.isdigit()]


def _joint(name: str) -> tuple[str, ...]:
    """What a name says of its joint: its number, and words that say nothing else."""
    return tuple(token for token in _tokens(name) if token not in _VOCABULARY)


def _tokens(name: str) -> list[str]:
    """Words and numbers of a name without its bracketed unit, in lower case."""
    plain = re.sub(r"([a-z])([A-Z])", r"\1 \2", without_unit(name)[0])
    return [token.lower() for token in re.findall(r"[^\W\d_]+|\d+", plain)]


def is_whole(values: Floats) -> bool:
    """The values are whole numbers, and there are such."""
    present = values[np.isfinite(values)]
    return len(present) > 0 and bool((present == np.round(present)).all())


def _are_counts(values: Floats) -> bool:
    # Encoders count, so positions that are all whole and cover a range are no angles.
    wide = SETTINGS.min_counts
    return is_whole(values) and float(np.ptp(values[np.isfinite(values)])) > wide


def _likely_units(quantity: str, words: Iterable[str], values: Floats) -> tuple[str, ...]:
    """Units that values of this size may have."""
    # One broken sample, such as an infinite one, says nothing of the others.
    largest = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
    if quantity == "time":
        return (time_unit(values),) if values.ndim == 1 else ()
    if quantity == "position":
        if largest > SETTINGS.max_radians:
            shares = ("-100 to 100 of a range",) if largest <= SETTINGS.max_normalised else ()
            return ("deg", *shares)
        return ("rad", "turns") if largest <= SETTINGS.max_turns else ("rad",)
    if quantity == "torque":
        # Both units are offered, since the size of a torque does not show on which side of a gear
        # it is.
        if "motor" in set(words):
            return ("motor N m", "N m")
        # Drivers of ROS publish currents, or a share of a rated torque, as an effort.
        return (
            ("N m",) if largest <= SETTINGS.max_torque else ("N m", "per mille of a rated torque")
        )
    if quantity == "current":
        return ("A",) if largest <= SETTINGS.max_amperes else ("mA",)
    # Errors are small in every unit, so their size tells none; pulses are whole.
    if quantity == "counts" or (quantity == "error" and is_whole(values)):
        return ("pulses",)
    # Speeds and the like have no field in a record, and need no unit.
    return ()


def groups_of(
    roles: Mapping[str, Role],
) -> dict[tuple[str, bool, tuple[str, ...]], list[str]]:
    """Columns that differ by their joint alone."""
    groups = dict[tuple[str, bool, tuple[str, ...]], list[str]]()
    for name, role in roles.items():
        # The joints of one signal share all three; their names differ only by the joint.
        groups.setdefault((role.quantity, role.commanded, role.group), []).append(name)
    return groups


def fields_of(roles: Mapping[str, Role], n: int | None) -> dict[str, list[str]]:
    """Mapping to begin with: field of a record -> its likely columns, one per joint.

    `roles` are of single columns, in the order of the file; `n` is the number of joints, if it is
    known.
    """
    groups = groups_of(roles)

    def best(*quantities: str, commanded: bool = False, size: int | None = None) -> list[str]:
        """The largest group of a quantity; of groups of one size, one that is named as measured."""
        candidates = [
            (
                size is not None and len(names) == size,
                len(names),
                not _MEASURED.isdisjoint(key[2]),
                names,
            )
            for key, names in groups.items()
            if key[0] in quantities and key[1] == commanded and size in (None, len(names))
        ]
        return max(candidates, key=lambda c: c[:3], default=(0, 0, 0, []))[3]

    # Counts come before as many angles, which a converter may have rounded; fewer columns of them
    # count something else, such as samples.
    measured = max(best("counts", size=n), best("position", size=n), key=len)
    # Other columns must have as many joints as the measured one, else they belong to another arm.
    size = len(measured) or n
    fields = {
        "t": best("time")[:1],
        "counts" if measured and roles[measured[0]].quantity == "counts" else "position": measured,
        "reference_position": best("position", "counts", commanded=True, size=size),
        "torque": best("torque", size=size),
        "current": best("current", size=size),
    }
    # Angles of motors have fields of their own; counts are those of motors anyway.
    of_motors = {
        field: field.replace("position", "motor_position")
        for field in ("position", "reference_position")
        for name in fields.get(field, ())[:1]
        if roles[name].quantity == "position" and "motor" in roles[name].group
    }
    return {of_motors.get(field, field): names for field, names in fields.items() if names}
