"""Drawing of an arm in a pose, and animation (GIF) of a run with its tracking error.

matplotlib is imported only when a figure is drawn.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ctc.figures import draw_band
from ctc.verdict.evaluation import Evaluation
from plant import Arm
from plant.mechanics import joint_positions
from plant.parts import (
    Floats,
    array,
    axes_of,
    colour_of,
    dressed,
    instance,
    known_options,
    path_of,
    real,
    require_new,
)

# Poses that determine the plane of a planar arm, and poses of a motion that determine the ranges of
# the axes. Chosen by hand: three suffice for a plane, and 200 points of a motion leave no visible
# gap.
_POSES = 200


@known_options
def plot_arm(arm: Arm, q: ArrayLike, *, tip: ArrayLike | None = None, ax: Any = None) -> Any:
    """Draw an arm in one pose, base, joints and tip joined by lines, in its plane or in space.

    Parameters
    ----------
    arm : Arm
    q : (n,) array_like
        [rad]
    tip : (3,) array_like, optional
        End of the last link in its frame [m]; by default at twice the distance of its body's centre
        of mass.
    ax : matplotlib Axes, optional
        Where to draw (three-dimensional for an arm without a plane); a new figure by default.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    ValueError
        No tip and no bodies to tell the end of the last link; several Axes, flat Axes for an arm
        without a plane, or Axes in space for one with a plane.

    See Also
    --------
    ctc.animate, plant.Arm

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import plot_arm
    >>> drawn = plot_arm(puma560.arm(), (0.3, -0.4), tip=(0, -0.43, 0))
    """
    instance("arm", arm, Arm, "The order is arm, q.")
    pose = array("q", q, (arm.n,), advice="Give one angle per joint [rad].")
    scene = _Scene(arm, tip)

    def new_axis() -> Any:
        import matplotlib.pyplot as plt

        return plt.figure(figsize=(5, 5), layout="constrained").add_subplot(
            projection=scene.projection
        )

    # Axes of the caller must have the projection that the scene needs.
    advice = f"Make it by plt.figure().add_subplot(projection={scene.projection!r})"
    axis = axes_of(ax, (), new_axis, advice).item()
    if (axis.name == "3d") != (scene.projection == "3d"):
        kind = "flat for this arm, which lies in a plane"
        if scene.projection:
            kind = "three-dimensional for this arm"
        raise ValueError(f"ax must be {kind}; got a {axis.name} one. {advice}, or leave ax out.")
    # One pose is the whole motion: it sets the ranges of the axes.
    scene.prepare(axis, pose[None])
    scene.draw(pose)
    return axis


@known_options
def animate(
    evaluation: Evaluation,
    path: str | Path,
    *,
    arm: Arm,
    tip: ArrayLike | None = None,
    fps: float = 15,
    speed: float = 1.0,
) -> int:
    """Write a GIF of a run: the arm on its path, and the encoder error of every joint in pulses.

    Parameters
    ----------
    evaluation : Evaluation
    path : str or Path
        Of the GIF, ``.gif``; an old file is overwritten.
    arm : Arm
        Whose links are drawn.
    tip : (3,) array_like, optional
        As for `plot_arm`.
    fps : float
        Pictures per second, 50 at most (what GIF viewers show). A picture lasts 1 / fps, rounded
        to hundredths of a second, but not less than one sample of the run at this `speed`.
    speed : float
        Speed of the animation: 0.2 is slow motion, five times as long as the run.

    Returns
    -------
    int
        Number of pictures; the last one shows the last sample of the run.

    Raises
    ------
    ValueError
        Bad input; no tip and no bodies to tell the end of the last link.

    See Also
    --------
    ctc.plot_arm, ctc.evaluate

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, animate, evaluate
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> report = evaluate(arm, rig, ComputedTorque(arm, rig), puma560.reference(), duration=0.2)
    >>> animate(report, "run.gif", arm=arm, tip=(0, -0.43, 0))
    4
    """
    instance("evaluation", evaluation, Evaluation, "Pass what evaluate(...) returned.")
    instance("arm", arm, Arm, "Pass the arm that was evaluated.")
    # 1. The samples that are shown.
    record = evaluation.record
    # Positions of the arm, unrounded; the errors below are counts.
    q = np.asarray(record.true_q)
    if arm.n != record.n:
        raise ValueError(
            f"arm must have {record.n} joints like the run; got {arm.n}. Pass the arm that was"
            " evaluated."
        )
    # Most viewers show no picture for less than 20 ms.
    if real("fps", fps, "15 is smooth enough.", positive=True) > 50:
        raise ValueError(
            f"fps must be 50 at most; got {fps}. Viewers show a GIF no faster; lower speed instead."
        )
    speed = real("speed", speed, "1 is as fast as the arm.", positive=True)
    # GIF files count hundredths of a second, and a picture shows at least one new sample.
    period = record.rig.period
    hundredths = max(round(100 / fps), math.ceil(100 * period / speed))
    # Samples of the run between two pictures.
    step = speed * hundredths / 100 / period
    last_sample = len(record) - 1
    samples = np.append(np.arange(0, last_sample, step).astype(int), last_sample)
    # matplotlib takes the format from the name, and would find out after the last picture.
    if path_of("path", path).suffix.lower() != ".gif":
        raise ValueError(f"path must be a .gif file; got {str(path)!r:.80}. Name a GIF.")
    file = require_new(path, overwrite=True)

    import matplotlib.pyplot as plt
    from matplotlib.animation import PillowWriter

    scene = _Scene(arm, tip)
    # 2. One figure, whose lines move from picture to picture.
    # The arm on the left over the whole height; errors on the right, one below the other.
    figure = plt.figure(figsize=(8.5, max(3.6, 1.1 * record.n)), layout="constrained")
    grid = figure.add_gridspec(record.n, 2, width_ratios=(1, 1) if scene.projection else (1, 1.25))
    scene.prepare(figure.add_subplot(grid[:, 0], projection=scene.projection), q)
    cursors = [_error_axis(figure.add_subplot(grid[i, 1]), evaluation, i) for i in range(record.n)]
    title = figure.suptitle(" ", fontsize=10)
    scene.draw(q[0])
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # a layout for every picture would take most of the time
    # 3. A picture for each of them: only links, lines and title change.
    # The writer drops fractions of a millisecond: half of one more guards against rounding.
    rate: Any = 1000 / (10 * hundredths + 0.5)
    writer = PillowWriter(fps=rate)
    with writer.saving(figure, str(file), dpi=80):
        for k in samples:
            scene.draw(q[k])
            for line, values in cursors:
                line.set_data(record.t[: k + 1], values[: k + 1])
            worst = np.abs(record.error_pulses[: k + 1]).max()
            instant = f"{type(record.law).__name__}, t = {record.t[k]:.2f} s"
            title.set_text(f"{instant}, largest error so far [pulses]: {worst:.0f}")
            writer.grab_frame()
    plt.close(figure)
    return len(samples)


def _error_axis(axis: Any, evaluation: Evaluation, joint: int) -> tuple[Any, Floats]:
    """Draw a joint's error (N,) of the whole run in grey, and an empty line for the run so far.

    Returned are this line and the error.
    """
    record = evaluation.record
    values = record.error_pulses[:, joint]
    axis.spines[["top", "right"]].set_visible(False)
    axis.plot(record.t, values, drawstyle="steps-post", color="0.7", linewidth=0.6)
    (line,) = axis.plot([], [], drawstyle="steps-post", color=colour_of(joint), linewidth=0.9)
    draw_band(axis)
    head = "encoder error [pulses]; shaded: ±1\n" if joint == 0 else ""
    title = f"{head}{evaluation.joint_labels[joint]}"
    # A joint may be named ``$x_{$``, which is no formula.
    axis.set_title(title, fontsize=8, loc="left", pad=2, parse_math=False)
    # Joints share one axis of time, the lowest.
    if joint < record.n - 1:
        axis.tick_params(labelbottom=False)
    else:
        axis.set_xlabel("time [s]")
    return line, values


class _Scene:
    """Drawing of an arm's links, in the plane in which they always lie, or in space."""

    def __init__(self, arm: Arm, tip: ArrayLike | None) -> None:
        chain = arm.dynamics.chain
        if tip is None and not chain.bodies:
            end = f"no body says where link {chain.links[-1].name} ends"
            raise ValueError(f"tip must be given, as {end}. Pass tip=(x, y, z) in its frame [m].")
        # A uniform link ends at twice the distance of its centre of mass.
        if tip is None:
            frame = chain.links[-1].frame
            com = np.array(chain.bodies[-1].com)
            tip = 2 * (np.array(frame.position) + np.array(frame.rotation) @ com)
        self.positions = joint_positions(chain, tip)
        # Seeded: the same arm always has the same view.
        poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (_POSES, chain.n))
        self.view = _plane(self.all(poses), -np.array(chain.gravity))
        self.projection = "3d" if len(self.view) == 3 else None

    def all(self, poses: Floats) -> Floats:
        """Points (N, n + 2, 3) of poses (N, n) [m]."""
        return np.array([self.positions(q).full().T for q in poses])

    def prepare(self, axis: Any, motion: Floats) -> None:
        """Axes that hold a motion (N, n), and the path of the tip."""
        # A long motion has many more points than its curve needs.
        points = self.all(motion[:: max(1, len(motion) // _POSES)]) @ self.view.T
        self.links = axis.plot(
            *np.zeros((len(self.view), 1)), "-o", color="#444444", linewidth=4, markersize=6
        )[0]
        # The base, then the path of the tip.
        axis.plot(*points[:1, 0].T, "s", color="#444444", markersize=10)
        axis.plot(*points[:, -1].T, color=colour_of(1), linewidth=1, alpha=0.6)
        low = points.min(axis=(0, 1))
        high = points.max(axis=(0, 1))
        middle = (low + high) / 2
        # The same range on all axes, a tenth larger than the motion, and not zero at rest.
        half = 0.55 * max((high - low).max(), 1e-3)
        for name, centre, direction in zip("xyz", middle, self.view, strict=False):
            limits = centre - half, centre + half
            axis.set(**{f"{name}lim": limits, f"{name}label": f"{_label(direction)} [m]"})
        axis.set_aspect("equal")
        if self.projection:
            axis.set_box_aspect(None, zoom=0.88)  # without it the labels are cut off
            axis.locator_params(nbins=5)
        dressed(axis)

    def draw(self, q: Floats) -> None:
        """Move the links to a pose (n,)."""
        # The view projects the points onto the plane, or keeps all three coordinates.
        points = self.view @ self.positions(q).full()
        if len(points) == 3:
            self.links.set_data_3d(*points)
        else:
            self.links.set_data(*points)


def _plane(points: Floats, up: Floats) -> Floats:
    """Rows of a view: both axes of the plane through the base that holds all points.

    If no plane does, the rows are those of the identity. Where the plane is not level, the second
    axis is upwards; the first axis is towards positive x, or towards positive y where x is zero.
    """
    # Singular values are the extents of the points; in a plane through the base the third is zero.
    _, spread, axes = np.linalg.svd(points.reshape(-1, 3), full_matrices=False)
    # Only rounding may lead out of a plane.
    if spread[2] > 1e-9 * spread[0]:
        return np.eye(3)
    normal = axes[2]
    # A level plane, or an arm without gravity, has no upward axis: y takes its place, or z.
    if np.linalg.norm(np.cross(normal, up)) <= 1e-6 * np.linalg.norm(up):
        up = np.eye(3)[1 if abs(normal[1]) < 0.9 else 2]
    # Upwards within the plane: without the part along its normal.
    up = up - normal * (normal @ up)
    up = up / np.linalg.norm(up)
    across = np.cross(up, normal)
    # The sign of x decides, or of y where x is zero; of the singular vectors it is arbitrary.
    across = across * np.sign(across[np.argmax(np.abs(across[:2]) > 1e-6)] or 1.0)
    return np.array([across, up])


def _label(direction: Floats) -> str:
    """Name of a direction: an axis of the base, or words for one between them."""
    i = int(np.argmax(np.abs(direction)))
    if np.abs(direction[i]) < 1 - 1e-9:
        return "across" if np.abs(direction[2]) < 1e-9 else "along the plane"
    return f"{'-' if direction[i] < 0 else ''}{'xyz'[i]}"
