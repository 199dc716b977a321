"""Progress bars: drawn on a terminal, and not one byte of them in a file or a pipe."""

import io
import re
import sys
from pathlib import Path

import pytest

from plant.parts.progress import progress_bar

ROOT = Path(__file__).resolve().parents[3]


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("kind", "shown", "drawn"),
    [(Terminal, True, True), (Terminal, False, False), (io.StringIO, True, False), (io.StringIO, False, False)],
)
def test_a_bar_is_drawn_on_a_terminal_alone(monkeypatch, kind, shown, drawn):
    stream = kind()
    monkeypatch.setattr(sys, "stderr", stream)
    with progress_bar(3, "identify", "generation", shown) as bar:
        for _ in range(3):
            bar.set_postfix_str("best 7 pulses^2")
            bar.update()
    assert ("identify" in stream.getvalue()) == drawn
    assert bool(stream.getvalue()) == drawn


def test_no_other_file_makes_bars():
    paths = [path for package in ("plant", "identification", "ctc") for path in (ROOT / package).rglob("*.py")]
    makers = [path.name for path in paths if re.search(r"^\s*(import|from) tqdm\b", path.read_text(), re.MULTILINE)]
    assert makers == ["progress.py"]
