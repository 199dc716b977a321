"""Figures of the page: every axis has its name and unit; what is drawn is what they say."""

import functools

import numpy as np
import pytest

from ctc import evaluate
from ctc.report.drawings import draw_certainty, draw_errors, draw_fit, draw_innovations, draw_path
from identification import identify
from plant import puma560, simulate

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")
plt = pytest.importorskip("matplotlib.pyplot")

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()


@functools.cache
def found():
    record = simulate(ARM, RIG, puma560.p_law(), PATH, duration=1.5)
    return identify(ARM.dynamics, record, method="equation_error", progress=False)


def path():
    return draw_path(evaluate(ARM, RIG, puma560.p_law(), PATH, backend="numba", duration=0.3))


def errors():
    return draw_errors(evaluate(ARM, RIG, puma560.p_law(), PATH, backend="numba", duration=0.3))


@pytest.mark.parametrize(
    ("draw", "y", "x"),
    [
        (lambda: draw_fit(found()), ("error [pulses]",), ("time [s]", "time [s]")),
        (lambda: draw_innovations(found()), ("innovation [pulses]", "share"), ("time [s]", "innovation [pulses]")),
        (lambda: draw_certainty(found()), ("parameter",), ("half-width [% of the value]",)),
        (errors, ("error [pulses]",), ("time [s]",)),
        (path, ("q [rad]",), ("time [s]",)),
    ],
    ids=["fit", "innovations", "certainty", "errors", "path"],
)
def test_every_axis_has_a_name_and_a_unit(draw, y, x):
    axes = draw()
    for row in axes:
        assert tuple(axis.get_ylabel().splitlines()[-1] for axis in row[: len(y)]) == y
    assert tuple(axis.get_xlabel() for axis in axes[-1]) == x
    plt.close("all")


def test_a_long_record_is_drawn_by_its_extremes():
    """Two samples per place of the axis: the least and the largest of all are there, in their order."""
    record = found().records[0]
    for joint, axis in enumerate(draw_fit(found())[:, 0]):
        measured = next(line for line in axis.lines if line.get_label() == "measured")
        t, drawn = measured.get_data()
        assert (drawn.min(), drawn.max()) == (record.error_pulses[:, joint].min(), record.error_pulses[:, joint].max())
        assert (np.diff(t) > 0).all()
    plt.close("all")
