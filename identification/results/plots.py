"""What an identification has made of a log: fit, surprises, spectrum, intervals. matplotlib is imported when drawn."""

from __future__ import annotations

import numpy as np

from identification.replay.prediction import Prediction
from plant import simulate

__all__ = ["plot_identification", "plot_oscillation"]

_MEASURED, _MODEL, _LEFT = "#444444", "#c8553d", "#1f6f8b"


def plot_identification(found):
    """Draw the first record of an `Identification`.

    Top: tracking errors measured and simulated with what was found, a short stretch of them, one row per joint.
    Below: what is left when every sample is predicted from those before; the spectrum of the errors and of what is
    left; the values with their 95 % intervals, as shares of the values.

    Returns
    -------
    matplotlib figure
    """
    import matplotlib.pyplot as plt

    record, n = found.records[0], found.arm.n
    figure = plt.figure(figsize=(11, 2.1 * n + 5.2), layout="constrained")
    grid = figure.add_gridspec(n + 2, 2, height_ratios=[*[1.0] * n, 1.3, 1.3])
    names = [link.name for link in found.arm.dynamics.chain.links]
    model = None
    if record.reference is not None:
        model = simulate(found.arm, found.rig, found.law, record.reference, duration=len(record) * record.rig.period)
    for joint in range(n):
        for column, (start, end) in enumerate(((0.0, 1.0), (0.30, 0.36))):
            axis = _axis(figure, grid[joint, column])
            some = slice(int(start * len(record)), int(end * len(record)))
            for log, colour, label in ((record, _MEASURED, "measured"), (model, _MODEL, "model")):
                if log is not None:
                    axis.plot(log.t[some], log.error_pulses[some, joint], color=colour, linewidth=0.8, label=label)
            axis.set_ylabel(f"error, joint {names[joint]} [pulses]" if column == 0 else "")
            axis.set_xlabel("time [s]" if joint == n - 1 else "")
            if joint == 0:
                title = "tracking error, whole record" if column == 0 else "a stretch of it"
                axis.set_title(title, fontsize=9, loc="left")
    figure.axes[1].legend(frameon=False, fontsize=8, ncols=2, loc="upper left")
    prediction = Prediction(found.arm.dynamics, record, found.unknown)
    left = prediction.surprises(np.append(found.values, prediction.nuisances)).reshape(-1, n)
    axis = _axis(figure, grid[n, :])
    axis.plot(record.t, left, linewidth=0.5, label=[f"joint {name}" for name in names])
    axis.set_title("surprise: counted minus predicted from all samples before", fontsize=9, loc="left")
    axis.set_xlabel("time [s]")
    axis.set_ylabel("[pulses]")
    axis.legend(frameon=False, fontsize=8, ncols=n, loc="upper right")
    axis = _axis(figure, grid[n + 1, 0])
    for signal, colour, label in ((record.error_pulses, _MEASURED, "tracking error"), (left, _LEFT, "surprise")):
        axis.loglog(*_spectrum(signal, record.rig.period), color=colour, linewidth=0.7, label=label)
    axis.set_title("spectrum", fontsize=9, loc="left")
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("amplitude [pulses]")
    axis.legend(frameon=False, fontsize=8)
    axis = _axis(figure, grid[n + 1, 1])
    place = np.arange(len(found.unknown))
    if found.covariance is not None:
        axis.errorbar(place, np.zeros(len(place)), yerr=196 * found.std / np.abs(found.values), fmt="o", markersize=4,
                      color=_LEFT, capsize=3)  # fmt: skip
        axis.set_ylim(*np.clip(axis.get_ylim(), -120, 120))
    axis.axhline(0, color="0.6", linewidth=0.6)
    axis.set_xticks(place, found.unknown, rotation=0 if len(place) < 12 else 90, fontsize=8)
    axis.set_title("95 % intervals", fontsize=9, loc="left")
    axis.set_ylabel("[% of the value]")
    return figure


def _axis(figure, place):
    axis = figure.add_subplot(place)
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, linewidth=0.5)
    return axis


def plot_oscillation(found):
    """Draw an `Oscillation`: errors measured and without it, one row per joint, and their spectrum below.

    Source: paper Figs. 10-11.

    Returns
    -------
    matplotlib figure
    """
    import matplotlib.pyplot as plt

    record = found.record
    n, quiet = record.n, found.removed(record.error_pulses)
    figure = plt.figure(figsize=(9, 2.0 * n + 2.6), layout="constrained")
    grid = figure.add_gridspec(n + 1, 1, height_ratios=[*[1.0] * n, 1.2])
    for joint in range(n):
        axis = _axis(figure, grid[joint])
        axis.plot(record.t, record.error_pulses[:, joint], color="0.7", linewidth=0.6, label="measured")
        axis.plot(record.t, quiet[:, joint], color=_MODEL, linewidth=1.0, label="without the oscillation")
        axis.set_ylabel(f"error, joint {joint + 1} [pulses]")
        if joint == 0:
            axis.legend(frameon=False, fontsize=8, ncols=2, loc="upper right")
    axis.set_xlabel("time [s]")
    axis = _axis(figure, grid[n])
    for signal, colour in ((record.error_pulses, "0.5"), (quiet, _MODEL)):
        axis.loglog(*_spectrum(signal, record.rig.period), color=colour, linewidth=0.7)
    for low, high in found.modes:
        axis.axvspan(low, high, color="#e9e4d4", zorder=0)
    axis.axvline(found.frequency, color="0.3", linewidth=0.8, linestyle="--")
    bands = "; shaded: modes of the linearised loop" if found.modes else ""
    axis.set_title(f"spectrum; dashed: {found.frequency:.1f} Hz{bands}", fontsize=9, loc="left")
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("amplitude [pulses]")
    return figure


def _spectrum(signal, period):
    """Frequencies [Hz] and amplitudes [pulses] of a signal (N, n), joints together."""
    centred = (signal - signal.mean(axis=0)) * np.hanning(len(signal))[:, None]
    amplitude = np.sqrt((np.abs(np.fft.rfft(centred, axis=0)) ** 2).sum(axis=1)) * 4 / len(signal)
    return np.fft.rfftfreq(len(signal), period)[1:], amplitude[1:]
