"""Xacro: macros that make a URDF; expanded by `xacrodoc` where that is installed."""

from pathlib import Path

from plant.mechanics.xml_file import Element


def is_xacro(element: Element) -> bool:
    """Whether an element, or one within it, is a macro."""
    return element.tag.startswith("xacro:") or any(is_xacro(child) for child in element.children)


def expanded(path: Path) -> bytes:
    """The URDF that a xacro file makes; its macros may read other files, and evaluate expressions.

    Raises
    ------
    ValueError
        `xacrodoc` is not installed, or cannot expand the file.
    """
    try:
        import xacrodoc
    except ImportError:
        raise ValueError(
            f"{path} must be a URDF file; it is xacro. Expand it (xacro {path.name} > robot.urdf), or pip install "
            "xacrodoc."
        ) from None
    try:
        text: str = xacrodoc.XacroDoc.from_file(str(path)).to_urdf_string()
    except Exception as error:
        raise ValueError(f"{path} must be xacro that can be expanded; {error}. Expand it by hand.") from error
    return text.encode()
