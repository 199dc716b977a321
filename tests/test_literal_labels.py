"""A robot may call its joints as it likes: figures show the name."""

import numpy as np
import pytest

from ctc import plot_record
from plant import puma560, simulate
from plant.parts import literal

NAMES = ("$x_{$", "50 % \\frac")


def test_a_joint_with_dollars_and_braces_is_drawn():
    record = simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.02
    )
    figure = plot_record(record, NAMES)[0, 0].figure
    figure.canvas.draw()
    assert any(
        "$x_{$" in text.get_text()
        for text in figure.findobj(lambda artist: hasattr(artist, "get_text"))
    )


def test_numbers_at_ticks_keep_their_mathematics_and_names_at_ticks_are_literal():
    plt = pytest.importorskip("matplotlib.pyplot")

    @literal
    def plot():
        figure, (left, right) = plt.subplots(1, 2)
        left.loglog(np.geomspace(1, 1e4, 9), np.arange(1, 10))
        right.set_yticks([0, 1], NAMES)
        right.set_title(NAMES[0])
        return np.array([left, right])

    figure = plot()[0].figure
    figure.canvas.draw()
    powers = [text for text in figure.axes[0].get_xticklabels() if "10^" in text.get_text()]
    assert powers
    assert all(text.get_parse_math() for text in powers)
    assert not any(text.get_parse_math() for text in figure.axes[1].get_yticklabels())


def test_the_power_of_ten_beside_an_axis_keeps_its_mathematics():
    plt = pytest.importorskip("matplotlib.pyplot")

    @literal
    def plot():
        axis = plt.subplots()[1]
        axis.plot([0, 1], [0, 1e8])
        axis.set_title(NAMES[0])
        return axis

    with plt.rc_context({"axes.formatter.use_mathtext": True}):
        axis = plot()
        axis.figure.canvas.draw()
    power = axis.yaxis.get_offset_text()
    assert "10^{8}" in power.get_text()
    assert power.get_parse_math()
