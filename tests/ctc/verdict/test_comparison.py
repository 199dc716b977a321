"""Comparison of laws: a row per law with the numbers of its evaluation, one that diverges, and
the figure.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest

from ctc import ComputedTorque, compare, evaluate
from ctc.verdict import Comparison
from plant import puma560
from plant.simulation import DivergenceError

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
UNLIMITED = dataclasses.replace(
    RIG, drive=dataclasses.replace(RIG.drive, current_limit=(np.inf, np.inf))
)
LAWS = {
    "P": puma560.p_law(),
    "wild": puma560.p_law((1e5, 1e5)),
    "computed torque": ComputedTorque(ARM, UNLIMITED),
}


@cache
def compared():
    return compare(ARM, UNLIMITED, LAWS, PATH, duration=0.3, steps_per_sample=4)


def two_digits(values):
    """Whole numbers from 10 on, below with two significant digits."""
    options = {"precision": 2, "fractional": False, "unique": False, "trim": "k"}
    return " / ".join(
        f"{value:.0f}" if value >= 10 else np.format_float_positional(value, **options)
        for value in values
    )


def test_every_row_holds_the_numbers_of_its_evaluation():
    got = compared()
    assert isinstance(got, Comparison)
    assert list(got.evaluations) == ["P", "computed torque"]
    verdict, *lines = str(got).splitlines()
    legend = next(i for i, line in enumerate(lines) if line.startswith("wild"))
    head = next(i for i, line in enumerate(lines) if line.split()[0] == "law")
    rows = lines[head + 1 : legend]
    assert len(set(map(len, lines[:legend]))) == 1
    assert verdict == "1 of 3 controllers within ±1 pulse at every sample: computed torque"
    assert "a / b: joint 2 (q[0]), joint 3 (q[1])" in lines
    assert any(line.startswith("rigid gears assumed") for line in lines)
    for name, row in zip(got.evaluations, rows, strict=True):
        alone = evaluate(
            ARM, UNLIMITED, LAWS[name], PATH, backend="numba", duration=0.3, steps_per_sample=4
        )  # the same run
        torque = alone.record.torque
        expected = [
            alone.share_within(1),
            "{:.0f} / {:.0f}".format(*np.abs(alone.record.error_pulses).max(axis=0)),
            "{:.2f} / {:.2f}".format(*np.sqrt(np.mean(alone.record.error_pulses**2, axis=0))),
            two_digits(np.sqrt(np.mean(torque**2, axis=0))),
            two_digits(np.abs(np.diff(torque, axis=0)).mean(axis=0)),
            "0.00%",
        ]
        assert row.split() == " ".join([name, *expected]).split()


def test_columns_stay_apart_however_many_the_joints():
    """Every cell of every row is set off by two blanks, and rows have one length."""
    one = next(iter(compared().evaluations.values()))
    record = one.record
    wide = {
        name: np.hstack([getattr(record, name)] * 4) * 1000
        for name in ("error_pulses", "torque", "current")
    }

    class Many:
        joint_labels = tuple(f"joint {i + 1} (q[{i}])" for i in range(8))
        within = one.within
        arm = one.arm
        record = one.record
        share_within = one.share_within
        max_error_pulses = np.abs(wide["error_pulses"]).max(axis=0)
        rms_error_pulses = rms_torque = chatter = saturation = np.full(8, 12345.678)

    lines = str(Comparison(evaluations={"some": Many(), "more": Many()}, diverged={})).splitlines()
    rows = [line for line in lines if line.startswith(("some", "more"))]
    assert len({len(row) for row in rows}) == 1
    assert [len(row.split("  ")) - row.split("  ").count("") for row in rows] == [7, 7]
    assert max(map(len, lines)) <= 80


def test_a_law_that_diverges_is_a_row_that_says_so():
    got = compared()
    assert list(got.diverged) == ["wild"]
    assert "diverges after t = 0." in got.diverged["wild"]
    assert f"wild: {got.diverged['wild']}" in " ".join(str(got).split())
    with pytest.raises(DivergenceError, match="diverges"):
        evaluate(ARM, UNLIMITED, LAWS["wild"], PATH, backend="numba", duration=0.3)


def test_a_table_of_divergences_alone():
    got = compare(ARM, UNLIMITED, {"wild": LAWS["wild"]}, PATH, duration=0.1)
    assert str(got).splitlines()[0] == "0 of 1 controllers within ±1 pulse at every sample"
    assert " ".join(str(got).split()).endswith(f"wild: {got.diverged['wild']}")
    with pytest.raises(
        ValueError, match="evaluations must be a dict, one per controller; got none"
    ):
        got.plot()


@pytest.mark.parametrize("count", [2, 6])
def test_the_figure_draws_every_error(count):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    law = LAWS["P"]
    got = compare(
        ARM, RIG, {f"P{i}": law for i in range(count)}, PATH, duration=0.1, steps_per_sample=4
    )
    axes = got.plot()
    figure = axes[0, 0].figure
    width, height = figure.get_size_inches()
    assert max(width, height) < 13
    for i, (name, evaluation) in enumerate(got.evaluations.items()):
        at = [axis for axis in figure.axes if axis.get_title(loc="left").startswith(f"{name}:")]
        assert len(at) == 1, name
        drawn = [line.get_ydata() for axis in figure.axes for line in axis.get_lines()]
        for joint in range(2):
            assert (
                sum(np.array_equal(y, evaluation.record.error_pulses[:, joint]) for y in drawn)
                == count
            ), i
    matplotlib.pyplot.close("all")


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: compare(ARM, RIG, {}, PATH), "laws must be a dict of name -> Law; got {}"),
        (lambda: compare(ARM, RIG, [LAWS["P"]], PATH), "laws must be a dict"),
        (lambda: compare(ARM, RIG, {1: LAWS["P"]}, PATH), "laws must be a dict"),
        (
            lambda: compare(ARM, RIG, {"P": 0.2}, PATH),
            "law 'P' must be of type Law; got a value of type float",
        ),
        (lambda: compare(RIG, ARM, LAWS, PATH), "arm must be of type Arm"),
        (lambda: compare(ARM, RIG, LAWS, PATH, backend="nunba"), "Did you mean 'numba'"),
        (lambda: compare(ARM, RIG, LAWS, PATH, durations=1), "Did you mean 'duration'"),
        (lambda: compare(ARM, RIG, LAWS, {"a": PATH}), "reference must be of type Reference"),
        (lambda: compare(ARM, RIG, LAWS), "missing a required argument: 'reference'"),
    ],
)
def test_bad_input_is_refused_in_one_line(call, said):
    with pytest.raises(ValueError, match=said) as refusal:
        call()
    assert "\n" not in str(refusal.value)
    assert not isinstance(refusal.value, DivergenceError)
