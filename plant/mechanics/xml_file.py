"""XML elements with their byte positions in the file, and edits of these bytes alone."""

import codecs
import dataclasses
import re
import xml.parsers.expat
from collections.abc import Iterable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from plant.mechanics.placement import turn
from plant.parts import Floats, path_of, read_bounded

Edit = tuple[int, int, bytes]  # start and stop of the bytes to replace, and the new bytes

# Largest size of a file in bytes; the largest real files have a few hundred thousand bytes. The
# limit is needed because a file of unknown origin may be of any size.
_LARGEST = 5 << 20

# Largest depth of nested elements; a chain of 40 nested bodies adds 40 to the depth.
_DEEPEST = 200

# No digit can be matched in two ways: the time would grow with the square of their number.
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)

_INFINITE = re.compile(r"[+-]?inf(inity)?", re.ASCII | re.IGNORECASE)

_ATTRIBUTE = re.compile(rb"""([^\s=/>"']+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclasses.dataclass
class Element:
    """An XML element with its bytes in the file: start tag `start:opened`, whole `start:stop`."""

    tag: str
    attributes: dict[str, str]
    children: "list[Element]"
    path: Path
    start: int = 0
    opened: int = 0
    stop: int = 0

    def find(self, tag: str) -> "Element | None":
        """The first child of this tag."""
        return next((child for child in self.children if child.tag == tag), None)

    def all(self, tag: str) -> "list[Element]":
        """The children of this tag."""
        return [child for child in self.children if child.tag == tag]

    @property
    def _name_end(self) -> int:
        """Index of the first byte after the tag's name, which follows the <."""
        return self.start + 1 + len(self.tag.encode())

    def attribute_edit(self, data: bytes, name: str, value: str | None) -> Edit:
        """The edit that sets an attribute, or removes it (None), in the bytes of the file."""
        # The search starts behind the tag's name and ends with the start tag.
        for match in _ATTRIBUTE.finditer(data, self._name_end, self.opened):
            if match[1].decode() == name:
                start, stop = match.span(2)
                if value is None:
                    # The space ahead of a removed attribute goes with it.
                    return len(data[: match.start()].rstrip()), stop, b""
                return start, stop, quoteattr(value).encode()
        # A new attribute stands directly behind the tag's name.
        text = "" if value is None else f" {name}={quoteattr(value)}"
        return self._name_end, self._name_end, text.encode()

    def child_edit(self, data: bytes, text: str, *, first: bool = False) -> Edit:
        """The edit that adds a child of this text as the last (or the first), indented."""
        if not self.children:
            name = data[self.start + 1 : self._name_end]
            # <tag/> has no content: it is opened, and a closing tag is added.
            if self.opened == self.stop:
                place = data.rfind(b"/", self.start, self.stop)
                return place, self.stop, b">" + text.encode() + b"</" + name + b">"
            return self.opened, self.opened, text.encode()
        neighbour = self.children[0 if first else -1]
        # The white space ahead of the neighbour is copied: the new child is indented like it.
        margin = len(data[: neighbour.start].rstrip())
        place = margin if first else neighbour.stop
        return place, place, data[margin : neighbour.start] + text.encode()


def parsed(
    path: str | Path, root_tag: str | None, kind: str, data: bytes | None = None
) -> tuple[Element, bytes]:
    """The root element of a file, and the content of the file as UTF-8 bytes.

    The root must have the tag `root_tag`, or any tag if this is None. `kind` names the kind of file
    in messages. `data` replaces the content of the file; its size is not checked. Another root, a
    document type, entities, malformed XML, and a file that is too large or nested too deeply raise
    ValueError. Nothing is executed or fetched.
    """
    # A text in place of a path is a usual mistake.
    if isinstance(path, str) and path.lstrip().startswith("<"):
        raise ValueError(
            f"path must be the name of a {kind} file; got its text. Write it to a file first."
        )
    path = path_of("path", path)
    try:
        # Bounded before anything is parsed.
        data = _utf8(read_bounded(path, _LARGEST) if data is None else data)
    except FileNotFoundError:
        raise ValueError(f"{path} must be a file; there is none. Check the path.") from None
    except ValueError as error:
        raise ValueError(f"{path} {error}") from None
    # A stack of the open elements: the parser reports starts and ends in the file's order.
    root: list[Element] = []
    open_elements: list[Element] = []
    # The text is UTF-8 by now, whatever its first line declares.
    parser = xml.parsers.expat.ParserCreate("utf-8")

    def start(tag: str, attributes: dict[str, str]) -> None:
        at = parser.CurrentByteIndex
        element = Element(tag, attributes, [], path, at, _tag_end(data, at))
        (open_elements[-1].children if open_elements else root).append(element)
        open_elements.append(element)
        if len(open_elements) > _DEEPEST:
            raise ValueError(
                f"{path} must nest at most {_DEEPEST} elements; it has more. Give a {kind} file."
            )

    def end(_: str) -> None:
        element = open_elements.pop()
        # <tag/> ends with its start tag, any other element with the > of its closing tag.
        empty = data[element.opened - 2 : element.opened] == b"/>"
        element.stop = element.opened if empty else data.find(b">", parser.CurrentByteIndex) + 1

    def refuse(*_: object) -> None:
        raise ValueError(
            f"{path} must not declare a document type or entities; it does. Remove them."
        )

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    # Entities could expand without bound, or read other files.
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except xml.parsers.expat.ExpatError as error:
        raise ValueError(f"{path} must be well-formed XML; {error}. Correct the file.") from None
    if root_tag is not None and root[0].tag != root_tag:
        other = {"mujoco": "from_mjcf", "robot": "from_urdf"}.get(root[0].tag)
        advice = f"Read it by {other}." if other else f"Give a {kind} file."
        raise ValueError(f"{path} must hold a <{root_tag}>; got <{root[0].tag}>. {advice}")
    return root[0], data


# The encoding that the first line of a file declares.
_DECLARED = re.compile(rb"""\s*<\?xml[^>]*?\sencoding\s*=\s*["']([A-Za-z0-9._-]+)["']""")

# First two bytes of a UTF-16 file, with a byte order mark or without -> its encoding.
_WIDE = {
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
    b"<\x00": "utf-16-le",
    b"\x00<": "utf-16-be",
}


def _encoding(data: bytes) -> str:
    """The encoding that a text declares; UTF-8 by default."""
    declared = _DECLARED.match(data)
    return declared[1].decode() if declared else "utf-8"


def _utf8(data: bytes) -> bytes:
    """Recode a file to UTF-8, but keep its declaration, which tells `spliced` how to encode it."""
    wide = _WIDE.get(data[:2])
    encoding = wide or _encoding(data.removeprefix(codecs.BOM_UTF8))
    try:
        # The declaration was read as single bytes, so the file is neither UTF-16 nor UTF-32.
        if not wide and codecs.lookup(encoding).name.startswith(("utf-16", "utf-32")):
            raise LookupError
        if codecs.lookup(encoding).name in ("utf-8", "ascii"):
            return data
        return data.decode(encoding).removeprefix("\ufeff").encode()
    except (LookupError, UnicodeError):
        raise ValueError(
            f"must be text in the encoding that it declares; it is not {encoding!r:.40}. Save it as"
            " UTF-8."
        ) from None


def _tag_end(data: bytes, start: int) -> int:
    """End of a start tag: behind the first > outside of quotes."""
    # A value in quotes may contain >.
    match = re.compile(rb"""<(?:[^"'>]|"[^"]*"|'[^']*')*>""").match(data, start)
    return match.end() if match else start


def numbers_of(
    element: Element | None,
    attribute: str,
    count: int,
    default: str | None,
    where: str,
    *,
    finite: bool = True,
) -> Floats:
    """The numbers of an attribute, exactly `count` of them; ``finite=False`` also accepts inf."""
    text = default if element is None else element.attributes.get(attribute, default)
    if text is None:
        raise ValueError(f"{where} must have {attribute}; it has none. Add it.")
    words = text.split()
    # float() alone would also accept nan, inf and 1_000.
    values = np.array(
        [
            float(word)
            for word in words
            if _NUMBER.fullmatch(word) or (not finite and _INFINITE.fullmatch(word))
        ]
    )
    if (
        len(words) != count
        or values.shape != (count,)
        or (finite and not np.isfinite(values).all())
    ):
        expected = "one finite number" if count == 1 else f"{count} finite numbers"
        advice = "Write them like 17.4 or 1e-3."
        if "," in text:
            advice = "Write decimals with a point, and blanks between numbers."
        raise ValueError(f"{where} must have {expected} in {attribute}; got {text!r:.60}. {advice}")
    return values


def spliced(data: bytes, edits: Iterable[Edit]) -> bytes:
    """Apply edits to UTF-8 bytes, keep the rest, and encode all of it as declared.

    Only the edits become ASCII in a file that declares it: its own bytes may be UTF-8.
    """
    # The declaration may name what `parsed` has recoded; no edit concerns it.
    encoding = _encoding(data)
    try:
        codec = codecs.lookup(encoding).name
        pieces = []
        at = 0
        # From the start of the file on.
        for start, stop, text in sorted(edits, key=lambda edit: edit[:2]):
            if start < at:
                raise ValueError(
                    f"edits must not overlap; two replace byte {start}. Make one edit of them."
                )
            if codec == "ascii":
                text = text.decode().encode(codec, "xmlcharrefreplace")
            pieces += [data[at:start], text]
            at = stop
        whole = b"".join([*pieces, data[at:]])
        if codec in ("utf-8", "ascii"):
            return whole
        # UTF-16 gets its mark of the order of bytes.
        return whole.decode().encode(encoding, "xmlcharrefreplace")
    except LookupError:
        # A file in UTF-16 is read by its first bytes, whatever it declares.
        raise ValueError(
            f"the XML must declare an encoding of text; got {encoding!r:.40}. Save it as UTF-8."
        ) from None


# Attributes that state an orientation, and how many numbers each of them has.
ORIENTATIONS = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}


def rotation_of(element: Element, where: str, *, degrees: bool, sequence: str) -> Floats:
    """Rotation matrix (3, 3) of an MJCF element: its axes as columns, in the parent's frame.

    ``sequence`` is the ``eulerseq`` of MJCF, three letters: x, y and z name axes of the turning
    frame, X, Y and Z name axes of the parent's frame. Two orientations at once are refused.
    """
    stated = [name for name in ORIENTATIONS if name in element.attributes]
    if len(stated) > 1:
        raise ValueError(
            f"{where} must have one orientation; it has {' and '.join(stated)}. Leave one out."
        )
    if not stated:
        # Without any orientation the frames are parallel.
        return np.eye(3)
    name = stated[0]
    values = numbers_of(element, name, ORIENTATIONS[name], None, where)
    unit = np.pi / 180 if degrees else 1.0
    # Lower case: axes that turn along, multiplied from the right; upper case: fixed axes, from the
    # left.
    if name == "euler":
        rotation = np.eye(3)
        for letter, angle in zip(sequence, values * unit, strict=True):
            step = turn(np.eye(3)["xyz".index(letter.lower())], angle)
            rotation = rotation @ step if letter.islower() else step @ rotation
        return rotation
    parts = {
        "quat": [values],
        "axisangle": [values[:3]],
        "xyaxes": [values[:3], values[3:]],
        "zaxis": [values],
    }[name]
    # A direction of length zero cannot be normalised.
    if min(np.linalg.norm(part) for part in parts) < 1e-9:
        raise ValueError(
            f"{where} must have a direction in {name}; got {values.tolist()}. Correct it."
        )
    if name == "axisangle":
        return turn(values[:3], values[3] * unit)
    # (w, v) turns by 2 atan2(|v|, w) about v; its length does not matter.
    if name == "quat":
        w = values[0]
        vector = values[1:]
        length = np.linalg.norm(vector)
        return turn(vector, 2 * np.arctan2(length, w)) if length else np.eye(3)
    # The smallest turn that takes z to this direction; opposite to z about x.
    if name == "zaxis":
        z = values / np.linalg.norm(values)
        axis = np.cross((0, 0, 1), z)
        angle = np.arccos(np.clip(z[2], -1, 1))
        return turn(axis if np.linalg.norm(axis) > 1e-10 else (1, 0, 0), angle)
    # x as stated, and y made perpendicular to it (Gram-Schmidt).
    x = values[:3] / np.linalg.norm(values[:3])
    y = values[3:] - x * (x @ values[3:])
    if np.linalg.norm(y) < 1e-9 * np.linalg.norm(values[3:]):
        raise ValueError(
            f"{where} must have axes that differ in xyaxes; got {values.tolist()}, which are"
            " parallel. Correct it."
        )
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])
