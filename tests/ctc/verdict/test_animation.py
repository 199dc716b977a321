"""What is drawn is where the arm is: the end point against pinocchio, the GIF against Pillow."""

import dataclasses
import functools

import numpy as np
import pytest
from packaged_arms import planar
from packaged_arms import puma560 as whole_puma560

from ctc import animate, evaluate, plot_arm
from plant import Body, Dynamics, PointToPoint, puma560

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")


TIP = (0.0, -0.43, 0.0)


@functools.cache
def run():
    path = PointToPoint(start=(0.2, -0.3), goal=(-0.6, 0.9), duration=0.42)
    return evaluate(
        puma560.arm(), puma560.rig(), puma560.p_law(), path, backend="numba", steps_per_sample=4
    )


@functools.cache
def short_run():
    path = puma560.reference()
    return evaluate(
        puma560.arm(),
        puma560.rig(),
        puma560.p_law(),
        path,
        duration=0.03,
        backend="numba",
        steps_per_sample=4,
    )


def end_point(chain, q, tip):
    """Of the last link, by pinocchio."""
    pin = pytest.importorskip("pinocchio")
    from pinocchio_arm import pinocchio_model

    model = pinocchio_model(chain, [Body(mass=1.0, com=(0, 0, 0))] * chain.n)
    data = model.createData()
    pin.forwardKinematics(model, data, np.asarray(q, float))
    return data.oMi[chain.n].act(np.array(tip, float))


def links(axis):
    """Points of the thick line."""
    line = max(axis.get_lines(), key=lambda line: line.get_linewidth())
    return np.array(line.get_data_3d() if hasattr(line, "get_data_3d") else line.get_data())


@pytest.mark.parametrize("seed", range(3))
def test_the_drawn_end_point_is_pinocchios(seed):
    random = np.random.default_rng(seed)
    dynamics = Dynamics.from_chain(whole_puma560())
    q, tip = random.uniform(-np.pi, np.pi, 6), random.normal(size=3)
    drawn = links(plot_arm(dynamics.arm(dynamics.f()), q, tip=tip))
    assert drawn.shape == (3, 8)
    np.testing.assert_allclose(drawn[:, -1], end_point(dynamics.chain, q, tip), atol=1e-12)
    # The paper's two joints: axis 2 is along y of the base, so its plane is that of x and z.
    q = random.uniform(-np.pi, np.pi, 2)
    drawn = links(plot_arm(puma560.arm(), q, tip=TIP))
    assert drawn.shape == (2, 4)
    np.testing.assert_allclose(
        drawn[:, -1], end_point(puma560.dynamics().chain, q, TIP)[[0, 2]], atol=1e-12
    )
    matplotlib.pyplot.close("all")


def test_without_a_tip_the_last_link_ends_twice_as_far_as_its_centre_of_mass():
    dynamics = Dynamics.from_chain(planar(2, length=0.4))
    drawn = links(plot_arm(dynamics.arm(dynamics.f()), (np.pi / 2, -np.pi / 2)))
    # up, then to the right
    np.testing.assert_allclose(drawn, [[0, 0, 0, 0.4], [0, 0, 0.4, 0.4]], atol=1e-12)
    matplotlib.pyplot.close("all")


def test_every_picture_shows_the_arm_and_its_error_at_that_time(tmp_path, monkeypatch):
    """0.42 s at a fifth of the speed and 10 pictures a second: one every 20 ms, 21, and the last
    sample.
    """
    image = pytest.importorskip("PIL.Image")
    from matplotlib.animation import PillowWriter

    seen, grab = [], PillowWriter.grab_frame

    def look(writer, **options):
        arm, *errors = writer.fig.axes
        seen.append(
            (links(arm)[:, -1], [axis.get_lines()[1].get_xydata().copy() for axis in errors])
        )
        grab(writer, **options)

    monkeypatch.setattr(PillowWriter, "grab_frame", look)
    record, file = run().record, tmp_path / "run.gif"
    pictures = animate(run(), file, arm=puma560.arm(), tip=TIP, fps=10, speed=0.2)
    assert pictures == len(seen) == 22
    with image.open(file) as gif:
        assert gif.format == "GIF"
        assert gif.n_frames == 22
        assert gif.info["duration"] == 100  # ms
        first = np.asarray(gif.convert("RGB"), int)
        gif.seek(21)
        assert np.abs(np.asarray(gif.convert("RGB"), int) - first).max() > 100
    for k, (end, errors) in zip([0, 285, -1], (seen[0], seen[10], seen[-1]), strict=True):
        count = k % len(record) + 1
        expected = end_point(puma560.dynamics().chain, record.true_q[k], TIP)[[0, 2]]
        np.testing.assert_allclose(end, expected, atol=1e-12)
        for joint, drawn in enumerate(errors):
            np.testing.assert_array_equal(drawn[:, 0], record.t[:count])
            np.testing.assert_array_equal(drawn[:, 1], record.error_pulses[:count, joint])
    assert matplotlib.pyplot.get_fignums() == []


@pytest.mark.parametrize(
    ("fps", "speed"), [(15, 0.03), (40, 0.1), (50, 0.01)], ids=["66.7 ms", "25 ms", "slow"]
)
def test_the_gif_takes_as_long_as_the_run_at_its_speed(tmp_path, fps, speed):
    """A picture lasts whole hundredths of a second, and shows one sample at least."""
    image = pytest.importorskip("PIL.Image")
    file = tmp_path / "run.gif"
    pictures = animate(short_run(), file, arm=puma560.arm(), tip=TIP, fps=fps, speed=speed)
    with image.open(file) as gif:
        assert gif.n_frames == pictures
        lasts = gif.info["duration"] / 1e3
    # Up to the last sample, which is one more picture.
    duration = short_run().record.t[-1] / speed
    assert duration <= (pictures - 1) * lasts < duration + lasts


def test_a_joint_with_dollars_and_braces_is_animated(tmp_path):
    dynamics = puma560.dynamics()
    first, second = dynamics.chain.links
    links = dataclasses.replace(first, name="$x_{$"), second
    chain = dataclasses.replace(dynamics.chain, links=links)
    arm = dataclasses.replace(puma560.arm(), dynamics=dataclasses.replace(dynamics, chain=chain))
    named = dataclasses.replace(short_run(), arm=arm)
    assert "$x_{$" in named.joint_labels[0]
    assert animate(named, tmp_path / "run.gif", arm=arm, tip=TIP) > 1


def test_the_phase_plot_has_the_rate_of_the_error():
    axes = run().plot(phase=True)
    h = 0.7e-3 / 4
    for joint, axis in enumerate(axes):
        error, rate = axis.get_lines()[0].get_data()
        np.testing.assert_array_equal(error, run().true_error_pulses[:, joint])
        # The trapezoidal rule over all of it; the ends differ by what two central differences
        # smooth.
        moved = np.sum((rate[1:] + rate[:-1]) / 2) * h
        np.testing.assert_allclose(moved, error[-1] - error[0], atol=2 * np.abs(rate).max() * h)
        assert np.abs(rate).max() > 100
    matplotlib.pyplot.close("all")


def test_the_limit_of_the_amplifier_is_beside_the_torque():
    """Source: 12 A, motor gain and gear; two dashed lines per joint, inside what is shown."""
    for joint, limit in enumerate(12 * np.array([0.228 * 107.8, 0.238 * 53.7])):
        axis = run().plot()[joint, 1]
        dashed = [line.get_ydata()[0] for line in axis.get_lines() if line.get_linestyle() == "--"]
        np.testing.assert_allclose(dashed, [limit, -limit], rtol=1e-12)
        assert axis.get_ylim()[1] > limit
        matplotlib.pyplot.close("all")


@pytest.mark.parametrize("name", ["run.png", "run", "run.jpg", "none/run.gif", ""])
def test_a_place_for_no_gif_is_refused_before_anything_is_drawn(tmp_path, name):
    file = tmp_path / name
    with pytest.raises(ValueError, match="must be"):
        animate(short_run(), file, arm=puma560.arm(), tip=TIP)
    assert not file.is_file()
    assert matplotlib.pyplot.get_fignums() == []


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda file: animate(run(), 7, arm=puma560.arm(), tip=TIP), "path must be a path; got 7"),
        (
            lambda file: animate(run(), file, arm=puma560.arm()),
            "tip must be given, as no body says where link 3 ends",
        ),
        (
            lambda file: animate(run(), file, arm=puma560.arm(), tip=(0, 1)),
            r"tip must have shape \(3,\)",
        ),
        (
            lambda file: animate(run(), file, arm=puma560.arm(), tip=TIP, fps=100),
            "fps must be 50 at most",
        ),
        (
            lambda file: animate(run(), file, arm=puma560.arm(), tip=TIP, speed=0),
            "speed must be a positive number",
        ),
        (lambda file: animate(run(), file, arm=puma560.rig(), tip=TIP), "arm must be of type Arm"),
        (
            lambda file: animate(run().record, file, arm=puma560.arm()),
            "evaluation must be of type Evaluation",
        ),
        (lambda file: animate(run(), file), "missing a required argument: 'arm'"),
        (lambda file: plot_arm(puma560.arm(), (0, 0, 0), tip=TIP), r"q must have shape \(2,\)"),
    ],
)
def test_bad_input_is_refused_in_one_line(tmp_path, call, message):
    with pytest.raises(ValueError, match=message) as refusal:
        call(tmp_path / "no.gif")
    assert "\n" not in str(refusal.value)
    assert matplotlib.pyplot.get_fignums() == []
