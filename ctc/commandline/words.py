"""Translate messages of the library from keyword arguments to options of the shell."""

import html
import re
from collections.abc import Iterable

# Class of a saved result -> the command that writes its file, the commands that read it.
_FILES = {
    "Identification": ("onepulse identify", "onepulse certify, tune and report, without an option"),
    "Certificate": ("onepulse certify or tune", "onepulse report --certificate"),
    "Certificates": ("onepulse certify or tune", "onepulse report --certificate"),
}

# Options of one command that messages of another command mention.
_ELSEWHERE = ("prior", "resonance")

# Calls without an option of the same name: pattern (a space matches any white space) -> words.
_PHRASES = {
    r'identify\(\.\.\., unknown=\\?"friction\\?"\)': "identify with --unknown friction",
    r"; tolerances=Tolerances\(gear=\.\.\.\) states yours": "",
    r"State those of your data sheet: identify\(.*?\)\)": "In Python, tolerances= states yours",
    r"identify\(\.\.\., elasticity=True\)": "identify with --elasticity",
    r"held_out=\(\) identifies": "--held-out without a log identifies",
    r"spread of the prior\b": "--prior",
    r", or \(bodies or f, 0\.3\)": "",
    r"; found\.assumed\(\)": "; more of it: onepulse report",
    r", bounds, correlations([^:]*: )print\(found\.summary\(full=True\)\)": r"\1onepulse report",
    r"everyday_motions\(arm, rig\) gives others": "--everyday gives others",
}


def in_the_shell(text: str, options: Iterable[str] = ()) -> str:
    """A text with ``--option`` in place of each keyword argument of that name."""
    for python, replacement in _PHRASES.items():
        text = re.sub(python.replace(" ", r"\s+"), replacement, text)
    # A file of the wrong command is named by its command, not by its Python class.
    text = re.sub(
        r"must hold a (\w+); it holds a '[\w.]*?(\w+)'\. Use \w+\.load\.", _other_file, text
    )
    names = "|".join({*options, *_ELSEWHERE})
    # Pairs lose their brackets, values get a blank: resonance=(15, 60) is --resonance 15 60.
    text = re.sub(rf"\b({names})=\(([^,()]+),\s+([^,()]+)\)", r"\1=\2 \3", text)
    text = re.sub(rf"\b({names})=(?=[\d.'-])", r"\1= ", text)
    keyword = rf"^({names})(?= (?:must|cannot|needs) )|\b({names})="
    return re.sub(keyword, lambda match: "--" + (match[1] or match[2]).replace("_", "-"), text)


def page_in_the_shell(page: str) -> str:
    """An HTML page with its sentences in words of the shell; drawings and code stay."""

    def translated(match: re.Match[str]) -> str:
        if match[1]:  # a drawing, code or a style sheet
            return match[0]
        return html.escape(in_the_shell(html.unescape(match[0])))

    return re.sub(r"(?s)<(svg|pre|style)\b.*?</\1>|(?<=>)[^<]+", translated, page)


def _other_file(match: re.Match[str]) -> str:
    expected, got = match.groups()
    if not {expected, got} <= {*_FILES}:
        return match[0]
    maker, taker = _FILES[got]
    return f"must be a file of {_FILES[expected][0]}; it is one of {maker}. Give that to {taker}."
