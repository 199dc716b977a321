"""What all figures share: axes that a caller gives, colours for any colour vision, texts as they
are.
"""

import itertools

import numpy as np
import pytest

from plant.parts import COLOURS, axes_of, colour_of, dressed, legend_above, literal, row_by_row

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")
plt = pytest.importorskip("matplotlib.pyplot")

DEFICIENT = {  # Source: G. M. Machado et al., IEEE TVCG 15 (2009), severity 1
    "protanopia": (
        (0.152286, 1.052583, -0.204868),
        (0.114503, 0.786281, 0.099216),
        (-0.003882, -0.048116, 1.051998),
    ),
    "deuteranopia": (
        (0.367322, 0.860646, -0.227968),
        (0.280085, 0.672501, 0.047413),
        (-0.011820, 0.042940, 0.968881),
    ),
    "tritanopia": (
        (1.255528, -0.076749, -0.178779),
        (-0.078411, 0.930809, 0.147602),
        (0.004733, 0.691367, 0.303900),
    ),
}
TO_XYZ = (
    (0.4124564, 0.3575761, 0.1804375),
    (0.2126729, 0.7151522, 0.0721750),
    (0.0193339, 0.1191920, 0.9503041),
)


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def lab(colour, vision):
    """CIE L*a*b* of a colour as it is seen."""
    value = np.array(matplotlib.colors.to_rgb(colour))
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    xyz = np.array(TO_XYZ) @ np.clip(np.array(vision) @ linear, 0, 1) / (0.95047, 1, 1.08883)
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", ["normal", *DEFICIENT])
def test_colours_differ_with_any_colour_vision_and_from_the_ground(vision):
    seen = [lab(colour, DEFICIENT.get(vision, np.eye(3))) for colour in (*COLOURS, "white")]
    least = min(
        (np.linalg.norm(a - b), i, j)
        for (i, a), (j, b) in itertools.combinations(enumerate(seen), 2)
    )
    assert least[0] > 15, least
    assert colour_of(len(COLOURS)) == COLOURS[0]


def test_given_axes_are_used_in_their_order_and_shape():
    figure, given = plt.subplots(2, 2)
    for form in (given, list(given.flat), given.ravel()):
        axes = row_by_row(form, 2, 2)
        assert axes.shape == (2, 2)
        assert list(axes.flat) == list(given.flat)
    assert axes_of(given[0, 0], (), None).item() is given[0, 0]
    assert axes_of(given[0, 0], (1,), None)[0] is given[0, 0]
    assert plt.get_fignums() == [figure.number]


@pytest.mark.parametrize("projection", ["rectilinear", "polar", "3d"])
def test_axes_of_any_projection_are_dressed(projection):
    axis = plt.subplots(subplot_kw={"projection": projection})[1]
    assert dressed(axis, "title").get_title(loc="left") == "title"
    axis.figure.canvas.draw()
    if projection == "rectilinear":
        seen = [side for side, spine in axis.spines.items() if spine.get_visible()]
        assert sorted(seen) == ["bottom", "left"]


def test_without_them_a_figure_is_made():
    axes = row_by_row(None, 2, 3, width=6)
    assert axes.shape == (2, 3)
    assert axes[0, 0].figure.get_size_inches()[0] == 6
    assert [axis.get_xlabel() for axis in axes.flat] == 3 * [""] + 3 * ["time [s]"]


@pytest.mark.parametrize(
    ("given", "shape", "said"),
    [
        (
            lambda: plt.subplots(1, 3)[1],
            (2, 2),
            r"ax must be 4 matplotlib Axes; got 3. Make them by plt.subplots",
        ),
        (lambda: plt.subplots()[1], (2, 1), "ax must be 2 matplotlib Axes; got 1"),
        (
            lambda: plt.subplots(1, 2)[1],
            (),
            r"ax must be a matplotlib Axes; got 2. Make them by plt.subplots\(\)",
        ),
        (lambda: plt.figure(), (2, 1), "ax must be 2 matplotlib Axes; got Figure"),
        (lambda: "no axes", (), "ax must be a matplotlib Axes; got str"),
        (lambda: [1, 2], (2,), "ax must be 2 matplotlib Axes; got list"),
    ],
)
def test_others_are_refused_in_one_line(given, shape, said):
    with pytest.raises(ValueError, match=said) as refusal:
        axes_of(given(), shape, lambda: pytest.fail("nothing is drawn"))
    assert "\n" not in str(refusal.value)
    assert str(refusal.value).endswith("or leave ax out.")


def test_a_legend_above_covers_no_curve_and_no_title():
    axis = dressed(plt.subplots()[1], "a title")
    axis.plot([0, 1], [0, 1], label="one")
    legend_above(axis)
    axis.figure.draw_without_rendering()
    legend = axis.get_legend().get_window_extent()
    assert legend.y0 >= axis.get_window_extent().y1 - 1
    assert not legend.overlaps(axis._left_title.get_window_extent())
    assert not axis.spines["top"].get_visible()


def test_a_callers_own_texts_keep_their_mathematics():
    figure, (mine, theirs) = plt.subplots(1, 2)
    theirs.set_title("$x^2$")

    @literal
    def plot(text, ax=None):
        ax = plt.subplots()[1] if ax is None else ax
        ax.set_title(text)
        return ax

    for call in (lambda: plot("$x$", mine), lambda: plot("$x$", ax=mine)):
        assert not call().title.get_parse_math()
        assert theirs.title.get_parse_math()
    assert not plot("$x$").title.get_parse_math()
