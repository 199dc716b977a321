"""What the library says in Python's words, in those of the shell."""

import html
import re
from collections.abc import Iterable

# Which command writes the file of a result, and which takes it.
_FILES = {
    "Identification": ("onepulse identify", "onepulse certify, tune and report, without an option"),
    "Certificate": ("onepulse certify or tune", "onepulse report --certificate"),
    "Certificates": ("onepulse certify or tune", "onepulse report --certificate"),
}

_ELSEWHERE = "prior", "resonance"  # options of a command of which another one speaks

# What is no option of the same name: patterns, a space being any white space, and what to say.
_SAID = {
    r'identify\(\.\.\., unknown=\\?"friction\\?"\)': "identify with --unknown friction",
    r"spread of the prior\b": "--prior",
    r", or \(bodies or f, 0\.3\)": "",
    r"; found\.assumed\(\)": "; more of it: onepulse report",
    r", bounds, correlations([^:]*: )print\(found\.summary\(full=True\)\)": r"\1onepulse report",
    r"everyday_motions\(arm, rig\) gives others": "--everyday gives others",
}


def in_the_shell(text: str, own: Iterable[str] = ()) -> str:
    """A text with options, `own` of the command that says it, in place of the keyword arguments
    of their names.
    """
    for python, said in _SAID.items():
        text = re.sub(python.replace(" ", r"\s+"), said, text)
    text = re.sub(
        r"must hold a (\w+); it holds a '[\w.]*?(\w+)'\. Use \w+\.load\.", _other_file, text
    )
    names = "|".join({*own, *_ELSEWHERE})
    text = re.sub(rf"\b({names})=\(([^,()]+),\s+([^,()]+)\)", r"\1=\2 \3", text)
    text = re.sub(rf"\b({names})=(?=[\d.'-])", r"\1= ", text)
    found = rf"^({names})(?= (?:must|cannot|needs) )|\b({names})="
    return re.sub(found, lambda each: "--" + (each[1] or each[2]).replace("_", "-"), text)


def page_in_the_shell(page: str) -> str:
    """An HTML page with its sentences in the shell's words; drawings and code stay."""

    def said(each: re.Match[str]) -> str:
        return each[0] if each[1] else html.escape(in_the_shell(html.unescape(each[0])))

    return re.sub(r"(?s)<(svg|pre|style)\b.*?</\1>|(?<=>)[^<]+", said, page)


def _other_file(found: re.Match[str]) -> str:
    expected, got = found.groups()
    if not {expected, got} <= {*_FILES}:
        return found[0]
    maker, taker = _FILES[got]
    return f"must be a file of {_FILES[expected][0]}; it is one of {maker}. Give that to {taker}."
