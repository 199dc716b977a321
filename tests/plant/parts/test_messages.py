"""Progress bars on a terminal, and not one byte of them in a file or a pipe; the one name of a
joint.
"""

import io
import re
import sys
import time
from pathlib import Path

import pytest

from plant.parts import joint_label, joint_labels, messages, progress_bar

ROOT = Path(__file__).resolve().parents[3]


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("kind", "shown", "drawn"),
    [
        (Terminal, True, True),
        (Terminal, False, False),
        (io.StringIO, True, False),
        (io.StringIO, False, False),
    ],
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


def bars(monkeypatch):
    """All texts that a bar draws on a terminal."""
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    # Else a bar that is over within a tenth of a second is drawn once.
    monkeypatch.setattr(messages.tqdm, "monitor_interval", 0)
    return stream


def test_a_bar_inside_a_part_of_another_one_moves_that_one(monkeypatch):
    stream = bars(monkeypatch)
    with progress_bar(10, "all", "step", True) as outer:
        with outer.part(4, "first"), progress_bar(8, "inner", "step", True) as inner:
            inner.update(2)
            assert outer.n == pytest.approx(1)
            # A bar of what the inner work calls has no part of its own: it moves nothing.
            with progress_bar(3, "deeper", "step", False) as deeper:
                deeper.update(3)
            assert outer.n == pytest.approx(1)
            inner.update(100)
            assert outer.n == pytest.approx(4)
        # Work that ends early, or has no bar, is done at the end of its part.
        with outer.part(3, "second"):
            pass
        assert outer.n == pytest.approx(7)
        outer.move_to(5)
        assert outer.n == pytest.approx(7)
    assert "inner" not in stream.getvalue()
    assert "second" in stream.getvalue()


def test_a_bar_says_the_time_left_after_its_first_step(monkeypatch):
    stream = bars(monkeypatch)
    with progress_bar(10, "tune", "step", True) as bar:
        time.sleep(0.12)
        bar.update(5)
    assert re.search(r"tune:  50 %\|.*\| 00:00, 00:00 left", stream.getvalue())


def test_no_other_file_makes_bars():
    paths = [
        path
        for package in ("plant", "identification", "ctc")
        for path in (ROOT / package).rglob("*.py")
    ]
    makers = [
        path.name
        for path in paths
        if re.search(r"^\s*(import|from) tqdm\b", path.read_text(), re.MULTILINE)
    ]
    assert makers == ["messages.py"]


@pytest.mark.parametrize(
    ("names", "joint", "label"),
    [
        ((), 0, "joint q[0]"),
        (("2", "3"), 0, "joint 2 (q[0])"),
        (("base", "elbow_joint"), 1, "elbow_joint (q[1])"),
        (("base", "elbow_joint"), 0, "joint base (q[0])"),
        (("Joint_A1",), 0, "Joint_A1 (q[0])"),  # says itself that it is one
    ],
)
def test_label(names, joint, label):
    assert joint_label(names, joint) == label
    assert joint_labels(names, len(names) or 1)[joint] == label


def test_labels_tell_joints_apart():
    assert joint_labels((), 3) == ["joint q[0]", "joint q[1]", "joint q[2]"]
    assert len(set(joint_labels(("a", "a"), 2))) == 2
