"""XML with places: elements that know which bytes of their file they are, and edits of these
bytes alone.
"""

import dataclasses
import re
import xml.parsers.expat
from collections.abc import Iterable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from plant.mechanics.placement import turn
from plant.parts.fields import Floats
from plant.parts.files import read_bounded

Edit = tuple[int, int, bytes]  # from this byte to that one, and what stands there instead

_LARGEST = 5 << 20  # bytes; the largest real files have a few hundred thousand

_DEEPEST = 200  # elements within each other; a chain of 40 bodies has 40

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)

_ATTRIBUTE = re.compile(rb"""([^\s=/>"']+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclasses.dataclass
class Element:
    """An XML element, and the bytes of its file that it takes: its start tag `start:opened`, all
    of it `start:stop`.
    """

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

    def attribute_edit(self, data: bytes, name: str, value: str | None) -> Edit:
        """The edit that gives an attribute this value, or takes it away (None); data: the bytes
        of the file.
        """
        for match in _ATTRIBUTE.finditer(
            data, self.start + 1 + len(self.tag.encode()), self.opened
        ):
            if match[1].decode() == name:
                start, stop = match.span(2)
                if value is None:
                    return len(data[: match.start()].rstrip()), stop, b""
                return start, stop, quoteattr(value).encode()
        place = self.start + 1 + len(self.tag.encode())
        return place, place, b"" if value is None else f" {name}={quoteattr(value)}".encode()

    def child_edit(self, data: bytes, text: str, *, first: bool = False) -> Edit:
        """The edit that adds a child of this text at the end, or as the first, indented like its
        neighbour.
        """
        if not self.children:
            name = data[self.start + 1 : self.start + 1 + len(self.tag.encode())]
            if self.opened == self.stop:
                place = data.rfind(b"/", self.start, self.stop)
                return place, self.stop, b">" + text.encode() + b"</" + name + b">"
            return self.opened, self.opened, text.encode()
        neighbour = self.children[0 if first else -1]
        before = len(data[: neighbour.start].rstrip())
        place = before if first else neighbour.stop
        return place, place, data[before : neighbour.start] + text.encode()


def parsed(
    path: str | Path, root_tag: str | None, what: str, data: bytes | None = None
) -> tuple[Element, bytes]:
    """The root of a file and its bytes, or a refusal: nothing is executed, expanded or fetched.

    `root_tag`: that the file must have, None for any; `what` kind of file it is, for messages;
    `data`: its content, where that is not what the file has. Refused are another root, a document
    type, entities, malformed XML, and a file that is too large or too deep.
    """
    if isinstance(path, str) and path.lstrip().startswith("<"):
        raise ValueError(
            f"path must be the name of a {what} file; got its text. Write it to a file first."
        )
    path = Path(path)
    try:
        data = read_bounded(path, _LARGEST) if data is None else data
    except FileNotFoundError:
        raise ValueError(f"{path} must be a file; there is none. Check the path.") from None
    except ValueError as error:
        raise ValueError(f"{path} {error}") from None
    root: list[Element] = []
    open_elements: list[Element] = []
    parser = xml.parsers.expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        at = parser.CurrentByteIndex
        element = Element(tag, attributes, [], path, at, _tag_end(data, at))
        (open_elements[-1].children if open_elements else root).append(element)
        open_elements.append(element)
        if len(open_elements) > _DEEPEST:
            raise ValueError(
                f"{path} must nest at most {_DEEPEST} elements; it has more. Give a {what} file."
            )

    def end(_: str) -> None:
        element = open_elements.pop()
        empty = data[element.opened - 2 : element.opened] == b"/>"
        element.stop = element.opened if empty else data.find(b">", parser.CurrentByteIndex) + 1

    def refuse(*_: object) -> None:
        raise ValueError(
            f"{path} must not declare a document type or entities; it does. Remove them."
        )

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except xml.parsers.expat.ExpatError as error:
        raise ValueError(f"{path} must be well-formed XML; {error}. Correct the file.") from None
    if root_tag is not None and root[0].tag != root_tag:
        raise ValueError(
            f"{path} must hold a <{root_tag}>; got <{root[0].tag}>. Give a {what} file."
        )
    return root[0], data


def _tag_end(data: bytes, start: int) -> int:
    """Where a start tag ends: behind the first > that stands in no value."""
    match = re.compile(rb"""<(?:[^"'>]|"[^"]*"|'[^']*')*>""").match(data, start)
    return match.end() if match else start


def numbers_of(
    element: Element | None, attribute: str, count: int, default: str | None, where: str
) -> Floats:
    """So many finite numbers of an attribute."""
    text = default if element is None else element.attributes.get(attribute, default)
    if text is None:
        raise ValueError(f"{where} must have {attribute}; it has none. Add it.")
    words = text.split()
    values = np.array([float(word) for word in words if _NUMBER.fullmatch(word)])
    if len(words) != count or values.shape != (count,) or not np.isfinite(values).all():
        what = "one finite number" if count == 1 else f"{count} finite numbers"
        raise ValueError(
            f"{where} must have {what} in {attribute}; got {text!r:.60}. Write them like 17.4 or"
            " 1e-3."
        )
    return values


def spliced(data: bytes, edits: Iterable[Edit]) -> bytes:
    """The bytes with these edits, all others as they were."""
    pieces = []
    at = 0
    for start, stop, text in sorted(edits, key=lambda edit: edit[:2]):
        pieces += [data[at:start], text]
        at = stop
    return b"".join([*pieces, data[at:]])


ORIENTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")


def rotation_of(element: Element, where: str, *, degrees: bool, sequence: str) -> Floats:
    """Rotation matrix (3, 3) of an MJCF element: its axes as columns, in the parent's frame.

    ``sequence`` is ``eulerseq``: three of xyz, axes that turn along, or of XYZ, fixed axes. Two
    orientations at once are refused.
    """
    given = [name for name in ORIENTATIONS if name in element.attributes]
    if len(given) > 1:
        raise ValueError(
            f"{where} must have one orientation; it has {' and '.join(given)}. Leave one out."
        )
    if not given:
        return np.eye(3)
    name = given[0]
    count = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}[name]
    values = numbers_of(element, name, count, None, where)
    unit = np.pi / 180 if degrees else 1.0
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
    if min(np.linalg.norm(part) for part in parts) < 1e-9:
        raise ValueError(
            f"{where} must have a direction in {name}; got {values.tolist()}. Correct it."
        )
    if name == "axisangle":
        return turn(values[:3], values[3] * unit)
    if name == "quat":
        w = values[0]
        vector = values[1:]
        length = np.linalg.norm(vector)
        return turn(vector, 2 * np.arctan2(length, w)) if length else np.eye(3)
    if name == "zaxis":
        z = values / np.linalg.norm(values)
        axis = np.cross((0, 0, 1), z)
        angle = np.arccos(np.clip(z[2], -1, 1))
        return turn(axis if np.linalg.norm(axis) > 1e-10 else (1, 0, 0), angle)
    x = values[:3] / np.linalg.norm(values[:3])
    y = values[3:] - x * (x @ values[3:])
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])
