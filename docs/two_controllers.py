"""The moving picture of the README: one arm draws a path under P control and under computed torque.
`python docs/two_controllers.py` makes it from the controllers of the README's code.
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from ctc import ComputedTorque, evaluate
from identification import identify
from plant import puma560, simulate
from plant.mechanics import joint_positions

PICTURE = Path(__file__).with_name("images") / "two_controllers.gif"
TIP = (0.0, -0.43, 0.0)  # end of link 3 in its own frame [m]
MAGNIFIED = 300  # a count moves the tip by some 0.06 mm: nobody sees that at its true size
SLOWER = 2.2  # seconds of the picture per second of the motion
FRAME = 0.08  # [s], a multiple of 10 ms as GIF files need it
PAUSE = 1.6  # of the finished drawing [s]
COLOURS = 48  # of the palette, which all frames share
JOINT_2, JOINT_3, BAND = "#0072b2", "#d55e00", "#e6e1d3"


def runs():
    """Name -> evaluation of the simulated arm under both controllers."""
    arm, rig, path = puma560.arm(), puma560.rig(), puma560.reference()
    measured = simulate(arm, rig, puma560.p_law(), path)
    found = identify(puma560.dynamics(), measured, seed=1, progress=False)
    laws = {"P control": puma560.p_law(), "Computed torque, identified arm": ComputedTorque(found)}
    return {name: evaluate(arm, rig, law, path) for name, law in laws.items()}


def skeleton(q):
    """Shoulder, elbow and tip in the arm's plane, (samples, 3, 2) [m]."""
    positions = joint_positions(puma560.dynamics().chain, TIP)
    return np.array([positions(row).full()[[0, 2], 1:].T for row in q])


class Side:
    """One controller: the arm above, its tracking errors below."""

    def __init__(self, upper, lower, name, run):
        record = run.record
        self.t, self.error = record.t, record.error_pulses
        self.arm = skeleton(record.true_q)
        desired = skeleton(record.reference(record.t).q)[:, 2]
        self.drawn = desired + MAGNIFIED * (self.arm[:, 2] - desired)

        upper.set_title(name, fontsize=13, fontweight="bold")
        upper.plot(*desired.T, color="0.6", linewidth=5, alpha=0.6, solid_capstyle="round")
        (self.trace,) = upper.plot([], [], color="#111111", linewidth=1.0)
        (self.links,) = upper.plot(
            [], [], "-o", color="0.35", linewidth=6, markersize=9, solid_capstyle="round", alpha=0.9
        )
        upper.set(xlim=(-0.5, 1.0), ylim=(-0.06, 0.95), aspect="equal")
        upper.axis("off")

        peak = int(np.abs(self.error).max())
        lower.axhspan(-1, 1, color=BAND, zorder=0)
        lower.set_title(f"largest error: {peak} count{'s' * (peak != 1)}", fontsize=11)
        self.errors = [
            lower.plot([], [], drawstyle="steps-post", color=colour, linewidth=0.8, label=label)[0]
            for colour, label in ((JOINT_2, "joint 2"), (JOINT_3, "joint 3"))
        ]
        lower.set(
            xlim=(0, self.t[-1]), ylim=(-11, 11), xlabel="time [s]", yticks=(-10, -5, 0, 5, 10)
        )
        lower.spines[["top", "right"]].set_visible(False)

    def show(self, sample):
        """Draw everything up to that sample."""
        self.trace.set_data(*self.drawn[: sample + 1].T)
        self.links.set_data(*self.arm[sample].T)
        for joint, line in enumerate(self.errors):
            line.set_data(self.t[: sample + 1], self.error[: sample + 1, joint])


def frames():
    """Every frame as an image of true colours."""
    figure, axes = plt.subplots(
        2, 2, figsize=(8.3, 4.1), dpi=100, height_ratios=(1.8, 1), layout="constrained"
    )
    sides = [Side(*column, *item) for column, item in zip(axes.T, runs().items(), strict=True)]
    figure.get_layout_engine().set(w_pad=0.06, h_pad=0.06)
    axes[1, 0].set_ylabel("error [counts]")
    axes[1, 1].legend(loc="upper right", ncols=2, frameon=False, fontsize=9)
    figure.supxlabel(
        f"grey: the path; black: what the tip draws, its deviation {MAGNIFIED} times as large;"
        " shaded: ±1 encoder count",
        fontsize=9,
    )
    t = sides[0].t
    instants = np.append(np.arange(0, t[-1], FRAME / SLOWER), t[-1])
    for sample in np.searchsorted(t, instants).clip(max=len(t) - 1):
        for side in sides:
            side.show(sample)
        figure.canvas.draw()
        yield Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
    plt.close(figure)


def main():
    shown = list(frames())
    # The finished drawing comes first, since a page that does not move shows the first frame alone.
    shown = [shown[-1], *shown[:-1]]
    # It has every colour: its palette serves all frames, and equal pixels stay equal.
    palette = shown[0].quantize(COLOURS, dither=Image.Dither.NONE)
    images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in shown]
    durations = [round(1000 * PAUSE)] + [round(1000 * FRAME)] * (len(images) - 1)
    images[0].save(
        PICTURE,
        save_all=True,
        append_images=images[1:],
        duration=durations,
        loop=0,
        optimize=True,
    )
    print(f"{PICTURE}: {len(images)} frames, {PICTURE.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
