"""The result in groups, and its table and figure for an arm of long names: short names, joints
by their labels.
"""

import dataclasses
import re
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from identification import fit_torque, identify, pulse_budget
from identification.equation_error import units as units_of
from identification.results import INTERVALS, Diagnostics, drifting, plots, summary
from identification.search import Fit, Search
from plant import Dynamics, LoggedTorque, puma560, simulate

RIG, LAW, PATH = puma560.rig(), puma560.p_law(), puma560.reference()
JOINTS = ("shoulder_lift_joint", "elbow_joint")


@cache
def renamed():
    """The physical PUMA 560, links 2 and 3, by its base parameters, with joints of long names."""
    chain = puma560.dynamics().chain
    links = tuple(
        dataclasses.replace(link, name=name) for link, name in zip(chain.links, JOINTS, strict=True)
    )
    return Dynamics.from_chain(dataclasses.replace(chain, links=links))


@cache
def found():
    record = simulate(puma560.literature_arm(1.5), RIG, LAW, PATH, steps_per_sample=16)
    return identify(renamed(), record, method="equation_error", progress=False)


def test_groups_hold_what_the_result_gives_at_the_top():
    result = found()
    assert (type(result.fit), type(result.search), type(result.diagnostics)) == (
        Fit,
        Search,
        Diagnostics,
    )
    for group, names in (
        (result.fit, ("candidates", "covariance")),
        (result.search, ("evaluations", "seconds", "message", "history")),
        (result.search, ("initial_objective", "initial_population")),
        (result.diagnostics, ("objective",)),
        (result.arm, ("f",)),
    ):
        for name in names:
            np.testing.assert_array_equal(getattr(result, name), getattr(group, name))
    np.testing.assert_allclose(np.diag(result.fit.correlation), 1.0, rtol=1e-12)


def test_many_unknowns_fit_on_a_screen(monkeypatch):
    """All values side by side, no line too long; the whole table on request, as of few unknowns."""
    result = found()
    whole = result.summary()
    assert whole == str(result) == result.summary(full=True)
    monkeypatch.setattr(summary, "SETTINGS", summary.SummarySettings(unknowns=3))
    screen = str(result)
    assert len(screen.splitlines()) < 0.7 * len(whole.splitlines())
    assert max(map(len, screen.splitlines())) <= 80
    assert all(f"{name} " in screen for name in result.short_names)
    pairs = zip(result.fit.values, result.fit.std, strict=True)
    assert all(f"{value:.4g}  +- {std:.2g}" in screen for value, std in pairs)
    assert "found.summary(full=True)" in " ".join(screen.split())
    assert "95 % interval  " not in screen
    assert result.summary(full=True) == whole


def test_every_value_has_its_unit(monkeypatch):
    """In the row of a table, or by its name where values stand side by side."""
    result = found()
    units = dict(
        zip(result.short_names, units_of(result.arm.dynamics, result.fit.unknown), strict=True)
    )
    record = result.records[0]
    q = RIG.cell_centre(record.counts)
    torque_fit = fit_torque(renamed(), q, record.torque, rig=RIG, cutoff=100, band=20, every=20)
    for text in (result.summary(), str(torque_fit)):
        lines = text.splitlines()
        for name, unit in units.items():
            assert re.match(rf"{name} +\S+  {unit}  ", next(x for x in lines if x.startswith(name)))
    monkeypatch.setattr(summary, "SETTINGS", summary.SummarySettings(unknowns=3))
    screen = " ".join(str(result).split())
    for name, unit in units.items():
        assert re.search(rf"in {unit}: [^:;]*\b{name}\b", screen)


@pytest.mark.parametrize("doubts", [1, 2, 7])
def test_the_verdict_counts_the_warnings_below_it(doubts, monkeypatch):
    """Lines that hold for any log doubt no value: they are notes, and not counted."""
    result = dataclasses.replace(found())
    lines = {f"line {i} doubts.": True for i in range(doubts)} | {"a note.": False}
    # As a file keeps them.
    result.__dict__["_warnings"] = lines
    monkeypatch.setattr(summary, "SETTINGS", summary.SummarySettings(unknowns=3))
    for full, first in ((True, doubts), (False, min(doubts, 5))):
        shown = result.summary(full=full).splitlines()
        assert re.search(r"\d+", shown[0])[0] == str(doubts)
        assert (f"first {first} below" in shown[0]) == (first < doubts)
        assert len([line for line in shown if line.startswith("warning: ")]) == first
        assert [line for line in shown if line.startswith("note: ")] == ["note: a note."]


def test_sixty_two_values_of_seven_joints_take_23_lines():
    friction = (f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(7))
    names = (*(f"f{i + 1}" for i in range(48)), *friction)
    of_arm = SimpleNamespace(dynamics=SimpleNamespace(names=names[:48]))
    fit = SimpleNamespace(
        unknown=names, values=np.linspace(-9.8765, 9, 62), std=np.full(62, 1.23e-3), prior=None
    )
    seven = SimpleNamespace(arm=of_arm, fit=fit, short_names=names, covariance=np.eye(62))
    lines = [line for table in summary._abreast(seven) for line in table.lines()]
    assert (len(lines), max(map(len, lines)) <= 80) == (23, True)
    assert [word for line in lines for word in line.split()].count("+-") == 62


def test_a_value_without_standard_deviation_says_why():
    """Gears that may be rigid are bounded; any other such value was not varied."""
    fit = found().fit
    covariance = np.array(fit.covariance)
    covariance[2:4] = covariance[:, 2:4] = 0
    bounds = SimpleNamespace(bounds=lambda name: name == fit.unknown[3])
    fit = dataclasses.replace(fit, covariance=covariance)
    fields = {field.name: getattr(fit, field.name) for field in dataclasses.fields(fit)}
    shown = SimpleNamespace(**fields | {"resonance": bounds, "std": fit.std})
    result = SimpleNamespace(
        fit=shown, arm=found().arm, short_names=found().short_names, covariance=covariance
    )
    (table, _) = summary._abreast(result)
    words = " ".join(table.lines()).split()
    names = result.short_names
    assert words[words.index(names[2]) + 2] == "known"
    assert words[words.index(names[3]) + 2] == "bounded"
    assert words.count("+-") == len(names) - 2


def test_a_fit_without_covariance_says_why():
    fit = dataclasses.replace(found().fit, covariance=None, fallback_reason="the fit is no arm")
    for name in ("std", "correlation"):
        with pytest.raises(
            ValueError, match="need a covariance; this fit provides none: the fit is no arm"
        ):
            getattr(fit, name)


def test_tables_name_parameters_shortly_and_say_once_what_they_mean():
    dynamics, p = renamed(), renamed().p
    assert max(map(len, dynamics.names)) > 40
    record = found().records[0]
    torque_fit = fit_torque(
        dynamics,
        RIG.cell_centre(record.counts),
        record.torque,
        rig=RIG,
        cutoff=100,
        band=20,
        every=20,
    )
    for text, head in (
        (found().summary(), 4),
        (str(pulse_budget(dynamics.arm(found().f), RIG, LAW, PATH)), 2),
        (str(torque_fit), 1),
    ):
        lines = text.splitlines()
        assert [line.split()[0] for line in lines[head : head + p]] == [
            f"f{i + 1}" for i in range(p)
        ]
        assert max(map(len, lines)) <= 80
        assert " ".join(text.split()).endswith(" ".join(dynamics.legend.split()))


def test_figure_of_long_names_is_short_at_its_ticks_and_apart_in_its_texts():
    import matplotlib

    matplotlib.use("Agg")
    figure = found().plot()[0].figure
    figure.draw_without_rendering()
    titles = {axis.get_title(loc="left"): axis for axis in figure.axes}
    assert set(renamed().chain.joint_labels) <= set(titles)
    assert [tick.get_text() for tick in titles[INTERVALS].get_yticklabels()] == list(
        found().short_names
    )
    texts = [
        *(axis._left_title for axis in titles.values()),
        *titles[INTERVALS].get_yticklabels(),
    ]
    legends = [axis.get_legend() for axis in figure.axes if axis.get_legend() is not None]
    boxes = [
        each.get_window_extent()
        for each in (*texts, *legends)
        if not hasattr(each, "get_text") or each.get_text()
    ]
    overlapping = [
        (a, b) for i, a in enumerate(boxes) for b in boxes[:i] if a.shrunk(0.9, 0.9).overlaps(b)
    ]
    assert not overlapping
    matplotlib.pyplot.close(figure)


def test_the_transient_of_the_observer_hides_no_innovation(monkeypatch):
    import matplotlib

    matplotlib.use("Agg")
    innovations = plots.Prediction.innovations

    def with_transient(self, values):
        rows = innovations(self, values)
        rows[0] = 1000.0
        return rows

    monkeypatch.setattr(plots.Prediction, "innovations", with_transient)
    axes = found().plot()
    assert axes[2].get_ylim()[1] < 10.0
    matplotlib.pyplot.close(axes[0].figure)


@pytest.mark.parametrize("joint", [0, 1])
def test_a_motor_that_stands_still_is_named_by_its_joint(joint):
    record = found().records[0]
    errors, reference = record.error_pulses.copy(), record.reference_pulses.copy()
    errors[:, joint] = reference[:, joint] = 0
    still = dataclasses.replace(
        record, error_pulses=errors, reference_pulses=reference, reference=None
    )
    with pytest.raises(ValueError, match=rf"that of {JOINTS[joint]} \(q\[{joint}\]\) moves by 0"):
        identify(renamed(), still, progress=False)


def test_of_a_replayed_torque_the_difference_is_called_a_drift():
    """It grows in open loop by errors that no innovation shows: "two roundings" say nothing."""
    rig, law, path = puma560.rig(), puma560.p_law(), puma560.reference()
    record = simulate(puma560.arm(), rig, law, path, duration=1.0)
    replayed = dataclasses.replace(record, law=LoggedTorque())
    quick = {"method": "prediction_error", "progress": False}
    found = identify(puma560.dynamics(), replayed, **quick)
    assert "LoggedTorque drives the simulated arm in open loop" in " ".join(str(found).split())
    assert not drifting(identify(puma560.dynamics(), record, **quick))


def test_of_several_logs_it_says_that_the_last_is_held_out_and_how_none_is():
    rig, law, path = puma560.rig(), puma560.p_law(), puma560.reference()
    records = [
        simulate(puma560.arm(), rig, law, path.later(start), duration=0.8) for start in (0.0, 1.0)
    ]
    quick = {"method": "prediction_error", "progress": False}
    found = identify(puma560.dynamics(), records, **quick)
    assert len(found.held_out) == 1
    assert "by default the last of several logs, held_out=()" in " ".join(str(found).split())
    every = identify(puma560.dynamics(), records, held_out=(), **quick)
    assert "held_out=()" not in str(every)
