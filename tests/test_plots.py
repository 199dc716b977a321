"""Every public plot: draws on the axes that it is given and returns them, names every axis,
writes on no curve.
"""

import dataclasses
import functools
import inspect
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from uncertain import with_uncertainty

import ctc
import identification
import plant
from ctc import (
    ComputedTorque,
    Fleet,
    certify,
    compare,
    evaluate,
    margins,
    plot_arm,
    plot_record,
    sweep_resonance,
)
from identification import GeneticSettings, fit_torque, frequency_response, identify, oscillation
from identification.results import draw_intervals
from plant import Harmonics, puma560, read_robot, simulate
from plant.parts import COLOURS

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")
plt = pytest.importorskip("matplotlib.pyplot")

ARM, RIG, PATH, P_LAW = puma560.arm(), puma560.rig(), puma560.reference(), puma560.p_law()
LAW = ComputedTorque(ARM, RIG)
SHORT = {"duration": 0.3, "steps_per_sample": 4}
FAR = {"hz": (50, 100, 200), "within": 50, **SHORT}


@functools.cache
def record():
    return simulate(ARM, RIG, P_LAW, PATH, duration=1.0)


@functools.cache
def evaluation():
    return evaluate(ARM, RIG, P_LAW, PATH, backend="numba", **SHORT)


@functools.cache
def compared(count):
    return compare(ARM, RIG, {f"P {i}": P_LAW for i in range(count)}, PATH, **SHORT)


@functools.cache
def motions():
    paths = {f"motion {i}": PATH for i in range(6)}
    return evaluate(ARM, RIG, P_LAW, paths, backend="numba", **SHORT)


@functools.cache
def found():
    tiny = GeneticSettings(individuals=8, subpopulations=1, generations=2)
    return identify(ARM.dynamics, record(), settings=tiny, progress=False)


@functools.cache
def certificate(**options):
    drawn = {"covariance": np.diag((0.02 * ARM.f) ** 2), "samples": 40, "progress": False}
    return certify(
        ARM,
        RIG,
        LAW,
        PATH,
        **with_uncertainty(**drawn, **SHORT | {"steps_per_sample": 8}, **options),
    )


@functools.cache
def response():
    lines = 0.01 * np.eye(2)[:, :, None] * np.ones(3)
    paths = [
        Harmonics(period=0.7, offset=(0.3, -0.4), cosine=each, sine=0 * each) for each in lines
    ]
    return frequency_response([simulate(ARM, RIG, P_LAW, path, duration=2.8) for path in paths])


@functools.cache
def fleet():
    made = Fleet(Path(tempfile.mkdtemp()) / "fleet.sqlite")
    fit = fit_torque(ARM.dynamics, record(), band=20.0)
    for i in range(8):
        log = dataclasses.replace(record(), t=record().t * (1 + 1e-6 * i))
        values = fit.values * (1 + 0.5 * (i == 7))
        made.add(
            log,
            dataclasses.replace(fit, values=values),
            notes={"robot": f"$r_{{{i % 2}}}$", "time": 1e9 + 1e6 * i},
        )
    return made


def models(ax=None):
    return plot_record(record(), models=([record(), record()], record()), ax=ax)


def whole_arm(ax=None):
    dynamics = read_robot("puma560").dynamics
    return plot_arm(dynamics.arm(dynamics.f()), (0.3, -0.6, 0.5, 0, 0.3, 0), tip=(0, 0, 0.1), ax=ax)


# name -> what draws it, and the shape of what it returns
PLOTS = {
    "Evaluation.plot": (lambda ax=None: evaluation().plot(ax=ax), (2, 2)),
    "Evaluations.plot": (lambda ax=None: motions().plot(ax=ax), (6,)),
    "Comparison.plot": (lambda ax=None: compared(2).plot(ax=ax), (2, 2)),
    "Comparison.plot, many": (lambda ax=None: compared(5).plot(ax=ax), (5, 2)),
    "Margins.plot": (lambda ax=None: margins(ARM, RIG, LAW).plot(ax=ax), (3,)),
    "ResonanceSweep.plot": (
        lambda ax=None: sweep_resonance(ARM, RIG, {"P": P_LAW}, PATH, **FAR).plot(ax=ax),
        (2,),
    ),
    "Certificate.plot": (lambda ax=None: certificate().plot(ax=ax), (3,)),
    "Certificate.plot, resonances": (
        lambda ax=None: certificate(resonance=(200, 300)).plot(ax=ax),
        (4,),
    ),
    "Identification.plot": (lambda ax=None: found().plot(ax=ax), (8,)),
    "FrequencyResponse.plot": (lambda ax=None: response().plot(ax=ax), (2,)),
    "Oscillation.plot": (lambda ax=None: oscillation(record(), ARM).plot(ax=ax), (3,)),
    "Evaluation.plot, phase": (lambda ax=None: evaluation().plot(ax=ax, phase=True), (2,)),
    "Fleet.plot": (lambda ax=None: fleet().plot(ax=ax), (3, 1)),
    "plot_record": (lambda ax=None: plot_record(record(), ax=ax), (2, 2)),
    "plot_record, models": (models, (2, 2)),
    "plot_arm": (lambda ax=None: plot_arm(ARM, (0.3, -0.6), tip=(0, -0.4, 0), ax=ax), ()),
    "plot_arm, in space": (whole_arm, ()),
}


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def test_all_that_draws_is_here():
    public = {
        getattr(package, name)
        for package in (plant, identification, ctc)
        for name in package.__all__
        if not inspect.ismodule(getattr(package, name))
    }
    classes = {
        each
        for name, module in sys.modules.items()
        if name.split(".")[0] in ("plant", "identification", "ctc")
        for each in vars(module).values()
        if inspect.isclass(each) and each.__module__ == name
    }
    drawing = {f"{each.__name__}.plot" for each in classes if hasattr(each, "plot")}
    drawing |= {
        each.__name__
        for each in public
        if inspect.isfunction(each) and each.__name__.startswith("plot")
    }
    assert drawing == {name.split(",")[0] for name in PLOTS}


def new_axes(name, count):
    """So many axes side by side, with others on both sides that nobody may touch."""
    space = {"projection": "3d"} if "space" in name else {}
    figure, axes = plt.subplots(1, count + 2, subplot_kw=space)
    for axis in (axes[0], axes[-1]):
        axis.set_title("$x^2$")
    return figure, axes


@pytest.mark.parametrize("name", PLOTS)
def test_given_axes_are_drawn_on_and_returned(name):
    draw, shape = PLOTS[name]
    count = int(np.prod(shape))
    figure, axes = new_axes(name, count)
    size = tuple(figure.get_size_inches())
    given = axes[1 : count + 1] if shape else axes[1]
    got = draw(ax=given)
    assert np.shape(got) == shape
    assert list(np.ravel(got)) == list(axes[1 : count + 1])
    assert all(axis.has_data() for axis in np.ravel(got))
    assert not any(axis.has_data() for axis in (axes[0], axes[-1]))
    assert plt.get_fignums() == [figure.number]  # no other figure, and this one as it was
    assert tuple(figure.get_size_inches()) == size
    assert not figure.get_suptitle()
    assert figure.axes == list(axes)
    assert axes[0].title.get_parse_math()
    figure.canvas.draw()


@pytest.mark.parametrize("name", PLOTS)
@pytest.mark.parametrize("more", [-1, 1])
def test_another_number_of_axes_is_refused_before_anything_is_drawn(name, more):
    draw, shape = PLOTS[name]
    count = int(np.prod(shape)) + more
    _, axes = plt.subplots(1, max(count, 1), squeeze=False)
    wanted = f"{count - more} matplotlib Axes" if shape else "a matplotlib Axes"
    with pytest.raises(
        ValueError, match=rf"^ax must be {wanted}; got {count}\. .*, or leave ax out\.$"
    ):
        draw(ax=axes.ravel()[:count])
    assert not any(axis.has_data() for axis in axes.flat)


def test_an_arm_in_space_needs_axes_in_space():
    flat, deep = plt.figure().add_subplot(), plt.figure().add_subplot(projection="3d")
    with pytest.raises(
        ValueError, match=r"three-dimensional for this arm; got a rectilinear one.*projection='3d'"
    ):
        whole_arm(ax=flat)
    with pytest.raises(ValueError, match="flat for this arm, which lies in a plane; got a 3d one"):
        plot_arm(ARM, (0.3, -0.6), tip=(0, -0.4, 0), ax=deep)


@pytest.mark.parametrize("name", PLOTS)
def test_every_axis_has_a_name_and_a_unit(name):
    axes = PLOTS[name][0]()
    grid = np.atleast_2d(axes) if np.ndim(axes) == 2 else np.reshape(axes, (-1, 1))
    listed = ("sensitivity", "every sample", "95 % intervals")
    categories = [axis for axis in grid.flat if axis.get_title(loc="left").startswith(listed)]
    for axis in grid[:, 0]:
        label = axis.get_ylabel()
        assert (
            axis in categories
            or ("[" in label and len(label.splitlines()[-1]) > 5)
            or name.startswith("plot_arm")
        )
    for axis in np.ravel(axes) if name.startswith("plot_arm") else ():
        assert axis.get_xlabel() == "x [m]"
        assert axis.get_ylabel() in ("z [m]", "y [m]")
    for axis in grid[-1]:
        assert "[" in axis.get_xlabel()


@pytest.mark.parametrize("name", PLOTS)
def test_no_text_and_no_legend_lies_on_a_curve(name):
    axes = np.ravel(PLOTS[name][0]())
    axes[0].figure.draw_without_rendering()
    for axis in axes if "space" not in name else ():
        assert not axis.texts or not axis.lines
        for text in axis.texts:
            assert not any(
                text.get_window_extent().shrunk(0.9, 0.5).overlaps(bar.get_window_extent())
                for bar in axis.patches
                if bar.get_zorder() > 0.5
            )
        if axis.get_legend() is not None:
            box, inside = axis.get_legend().get_window_extent(), axis.get_window_extent()
            curves = [
                axis.transData.transform(line.get_xydata())
                for line in axis.lines
                if len(line.get_xydata()) > 2
            ]
            assert not any(
                box.contains(*point) and inside.contains(*point)
                for curve in curves
                for point in curve
            )


def test_a_value_that_is_next_to_unknown_has_a_bar():
    """Values of zero, and beyond any share: without a bar they would look known."""
    identified = found()
    fit = identified.fit
    values = np.array(fit.values)
    values[[0, 1]] = 0.0, 1e-9
    variances = np.ones(len(values))
    variances[2] = 0.0
    spread = dataclasses.replace(
        fit, values=values, covariance=np.diag(variances), noise_covariance=np.diag(variances)
    )
    axis = plt.figure().add_subplot()
    draw_intervals(axis, dataclasses.replace(identified, fit=spread))
    bars = {round(bar.get_y() + bar.get_height() / 2): bar for bar in axis.patches}
    assert sorted(bars) == [i for i in range(len(values)) if i != 2]
    longest = max(bar.get_x() + bar.get_width() for bar in bars.values())
    for i in (0, 1):
        assert bars[i].get_x() + bars[i].get_width() == longest
    (marks,) = [line for line in axis.lines if line.get_marker() == ">"]
    assert marks.get_ydata().tolist() == [0, 1]


def test_a_panel_without_intervals_names_no_line():
    identified = found()
    fit = dataclasses.replace(identified.fit, covariance=None, noise_covariance=None)
    axis = plt.figure().add_subplot()
    draw_intervals(axis, dataclasses.replace(identified, fit=fit))
    assert not axis.lines
    assert "dashed" not in axis.get_xlabel()


def test_cells_of_the_documentation_draw_in_the_colours_of_the_library():
    rc = matplotlib.rc_params_from_file(
        Path(__file__).parents[1] / "docs" / "matplotlibrc", use_default_template=False
    )
    assert tuple(rc["axes.prop_cycle"].by_key()["color"]) == COLOURS


def test_the_robot_is_seen_beside_the_model_that_lies_on_it():
    """The same curve twice: the lower one is wider, and pale."""
    for axis in models()[:, 1]:
        robot, model = (
            next(line for line in axis.lines if line.get_label() == name)
            for name in ("robot", "best model")
        )
        assert robot.get_linewidth() > 2 * model.get_linewidth()
        assert [*axis.lines].index(robot) < [*axis.lines].index(model)
