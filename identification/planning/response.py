"""Measured frequency responses: of the arm and of its closed loop, from logs of periodic
excitation.

At each excited frequency the amplitudes of joint angles Y, torques U and excitations E, a column
per record, give the plant Y U^-1, and the loop. Under a sampled law torques are held from sample to
sample, and so is the plant the sampled one; under fast hardware it is, well below half the sampling
rate, the continuous one. The feedback makes Y and U alike noisy, so both are means over periods of
an excitation that repeats exactly.

Source: R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed.
(2012), ch. 2 and 7.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.torque_logs import measured_torque
from identification.planning.gear_response import Resonances, resonances
from plant import Drive, Record
from plant.parts.arguments import choice, instance, known_options, real, whole
from plant.parts.fields import Floats
from plant.parts.figures import colour_of, legend_above, literal, row_by_row
from plant.parts.frozen import Frozen
from plant.parts.shown import Piece, Shown
from plant.parts.tables import Table

if TYPE_CHECKING:
    import control

Complex = NDArray[np.complex128]

# times what the rounding of the reference makes of a line: above it, the line is excited
_ABOVE = 10.0

_FAINT = 1e-3  # share of the strongest line of an injected torque, above which a line is excited


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FrequencyResponse(Shown, Frozen):
    """Measured frequency responses with their standard deviations (of the complex number: both
    parts together).

    Attributes
    ----------
    frequency : (F,) numpy.ndarray
        Excited lines [Hz].
    plant, plant_std : (n, n, F) numpy.ndarray
        From joint torques [N m] to joint angles [rad].
    loop, loop_std : (n, n, F) numpy.ndarray
        From commanded to measured angles [rad/rad]; where torque was injected, from that to the
        whole torque: the input sensitivity [N m/(N m)].
    period : float
        Of the samples [s].
    joints : tuple of str
        Labels.
    held : float
        How long a torque is held [s]; 0 under fast hardware.
    """

    frequency: Floats
    plant: Complex
    plant_std: Floats
    loop: Complex
    loop_std: Floats
    period: float
    joints: tuple[str, ...]
    held: float

    def resonances(self, drive: Drive) -> Resonances:
        """Lowest resonance of each joint on its gear, for `Elasticity.from_resonance` at the pose
        of the records.

        Of a drive with encoders on its motors: `hz`, `damping_ratio` and their standard deviations,
        `_std`, each (n,).
        """
        return resonances(self.frequency, self.plant, self.plant_std, self.held, drive)

    def to_control(self, which: str = "plant") -> "control.FrequencyResponseData":
        """One of both responses, "plant" or "loop", as python-control's FRD, sampled."""
        import control

        response = getattr(self, choice("which", which, ("plant", "loop")))
        return control.FrequencyResponseData(response, 2 * np.pi * self.frequency, dt=self.period)

    @literal
    def plot(self, ax: Any = None, *, model: Any = None) -> Any:
        """Draw magnitude and phase of the plant, each joint by its own torque, with two standard
        deviations.

        Parameters
        ----------
        ax : array of 2 matplotlib Axes, optional
        model : python-control system, optional
            Drawn beside it, such as a state space or transfer function from torques to angles.
        """
        axes = row_by_row(ax, 2, 1, time=False)[:, 0]
        modelled = (
            None
            if model is None
            else model(np.exp(2j * np.pi * self.frequency * self.period), squeeze=False)
        )
        for joint, label in enumerate(self.joints):
            response = self.plant[joint, joint]
            colour = colour_of(joint)
            axes[0].errorbar(
                self.frequency,
                np.abs(response),
                2 * self.plant_std[joint, joint],
                fmt=".",
                color=colour,
            )
            axes[1].plot(
                self.frequency, np.degrees(np.angle(response)), ".", color=colour, label=label
            )
            if modelled is not None:
                axes[0].plot(self.frequency, np.abs(modelled[joint, joint]), color=colour)
                axes[1].plot(
                    self.frequency, np.degrees(np.angle(modelled[joint, joint])), color=colour
                )
        axes[0].set(
            xscale="log", yscale="log", xlabel="frequency [Hz]", ylabel="angle / torque [rad/(N m)]"
        )
        axes[1].set(xscale="log", xlabel="frequency [Hz]", ylabel="phase [degrees]")
        legend_above(axes[1])
        return axes

    def _short(self) -> str:
        return (
            f"{len(self.frequency)} lines, {self.frequency[0]:.3g} to {self.frequency[-1]:.3g} Hz"
        )

    def _shown(self) -> Iterator[Piece]:
        head = (
            "plant [rad/(N m)]",
            *(f"at {self.frequency[k]:.3g} Hz" for k in (0, -1)),
            "std, median",
        )
        sizes = [(np.abs(self.plant[j, j]), self.plant_std[j, j]) for j in range(len(self.joints))]
        rows = [
            (f"{a[0]:.3g}", f"{a[-1]:.3g}", f"{100 * np.median(std / a):.2g} %") for a, std in sizes
        ]
        yield Table(head, [(joint, *row) for joint, row in zip(self.joints, rows, strict=True)])


@known_options
def frequency_response(
    records: Record | Sequence[Record], *, period: float | None = None, skip: int = 1
) -> FrequencyResponse:
    """Frequency responses of an arm and of its closed loop, measured in logs of periodic
    excitation.

    Each record repeats one excitation: of its reference (`plant.Harmonics`), or a torque that was
    injected while the reference moved slowly enough to leave the lines alone. An arm of n joints
    needs n records, each excited otherwise.

    Parameters
    ----------
    records : Record or sequence of Record
        Of one rig, with torque or current; at least two whole periods after those that are skipped.
    period : float, optional
        Of the excitation [s]; by default that of the reference.
    skip : int
        Periods at the beginning that are left out, while the arm settles.

    Returns
    -------
    FrequencyResponse
        Standard deviations are from the differences between periods, at least what rounding to
        counts makes of one.

    Raises
    ------
    ValueError
        Too few records or periods, a period that is no whole number of samples, samples that are
        missing, records without torque or excitation, or that excite the same.

    See Also
    --------
    identification.design_motion, plant.linearise

    Examples
    --------
    >>> import numpy as np
    >>> from identification import frequency_response
    >>> from plant import Harmonics, puma560, simulate
    >>> rig, lines = puma560.rig(), np.zeros((2, 2, 20))
    >>> lines[0, 0, 9] = lines[1, 1, 9] = 0.01
    >>> paths = [Harmonics(period=1.4, offset=(0.3, -0.4), cosine=each, sine=0 * each) for each in lines]
    >>> log = [simulate(puma560.arm(), rig, puma560.p_law(), path, duration=5.6) for path in paths]
    >>> measured = frequency_response(log)
    >>> measured.to_control("loop").ninputs
    2
    """
    logs = [records] if isinstance(records, Record) else list(records)
    for each in logs:
        instance("each record", each, Record, "Give what simulate returns, or Record.read.")
    n = logs[0].rig.n if logs else 0
    if len(logs) < max(n, 1):
        raise ValueError(
            f"records must be as many as joints, {n}; got {len(logs)}. Use design_motion(...)."
        )
    if any(each.rig != logs[0].rig for each in logs):
        raise ValueError("records must be of one rig; they differ. Measure each arm apart.")
    injected = [each.injected is not None for each in logs]
    if any(injected) != all(injected):
        raise ValueError(
            "records must all have an injected torque, or none; got both. Measure both apart."
        )
    spans = {_samples(each, period) for each in logs}
    if len(spans) > 1:
        raise ValueError(
            f"records must have one period; got {sorted(spans)} samples. Give records of one"
            " excitation."
        )
    (samples,), skip = spans, whole("skip", skip, "Periods that are left out.", least=0)
    signals = [_lines(each, samples, skip) for each in logs]
    lines, excitation = _excited(signals, logs, samples, injected[0])
    return _responses(signals, lines, excitation, logs, samples, injected[0])


def _samples(record: Record, period: float | None) -> int:
    """Samples of one period of the excitation."""
    step = record.rig.period
    if (
        not np.allclose(np.diff(record.t), step, rtol=0, atol=1e-3 * step)
        or (record.valid < 1).any()
    ):
        raise ValueError(
            "records must have every sample; some are missing or invalid. Give a part without gaps."
        )
    own = getattr(record.reference, "period", None)
    if period is None and own is None:
        raise ValueError(
            "period must be given; the reference states none. It is that of the excitation [s]."
        )
    span = (
        real("period", own if period is None else period, "Of the excitation [s].", positive=True)
        / step
    )
    if abs(span - round(span)) > 1e-6 * span:
        raise ValueError(
            f"period must be a whole number of samples of {step:g} s; got {span:.6g}. Choose"
            " another."
        )
    return round(span)


def _lines(record: Record, samples: int, skip: int) -> dict[str, Complex]:
    """Amplitudes (P, F, n) of each signal in every period but the first `skip`."""
    rig = record.rig
    periods = len(record) // samples - skip
    if periods < 2:
        got = f"{len(record) / samples:.3g} periods, of which {skip} are skipped"
        raise ValueError(
            f"records must have two periods at least after those skipped; got {got}. Log for"
            " longer."
        )
    reference = record.reference_pulses
    signals = {
        "angle": rig.to_angle(reference - record.error_pulses),
        "torque": measured_torque(record),
    }
    signals["excitation"] = rig.to_angle(reference) if record.injected is None else record.injected
    cut = slice(skip * samples, (skip + periods) * samples)
    return {
        name: (
            2
            / samples
            * np.fft.rfft(np.asarray(each)[cut].reshape(periods, samples, -1), axis=1)[:, 1:]
        )
        for name, each in signals.items()
    }


def _rounding(record: Record, samples: int) -> Floats:
    """Standard deviation (n,) [rad] of the amplitude of a line that comes from rounding to
    counts, in one period.
    """
    one = np.abs(np.stack([record.rig.to_angle(each) for each in np.eye(record.rig.n)], axis=1))
    return np.sqrt((one**2).sum(axis=1) / 12 * 4 / samples)


def _excited(
    signals: list[dict[str, Complex]], logs: list[Record], samples: int, injected: bool
) -> tuple[NDArray[np.intp], Complex]:
    """Excited lines, and the excitation (F, n, M) there."""
    mean = np.stack([each["excitation"].mean(axis=0) for each in signals], axis=2)
    least = (
        _FAINT * np.abs(mean).max() if injected else _ABOVE * _rounding(logs[0], samples)[:, None]
    )
    singular = np.linalg.svd(
        mean / np.maximum(np.broadcast_to(least, mean.shape[1:]), 1e-300), compute_uv=False
    )
    lines = np.flatnonzero(singular[:, -1] > 1) if np.abs(mean).max() > 0 else np.array([], int)
    if not len(lines):
        raise ValueError(
            "records must excite all joints, each differently; no frequency has it. Excite them in"
            " turn."
        )
    return lines, mean[lines]


def _responses(
    signals: list[dict[str, Complex]],
    lines: NDArray[np.intp],
    E: Complex,
    logs: list[Record],
    samples: int,
    injected: bool,
) -> FrequencyResponse:
    """Both responses and their standard deviations, by what differs from period to period."""
    rounding = _rounding(logs[0], samples)
    Y, U = (
        np.stack([s[name].mean(axis=0)[lines] for s in signals], axis=2)
        for name in ("angle", "torque")
    )
    plant = Y @ np.linalg.pinv(U)
    loop = (U if injected else Y) @ np.linalg.pinv(E)
    own = np.zeros((2, *Y.shape))  # variances of what no response explains: plant, loop
    for m, each in enumerate(signals):
        angle, torque = (
            each[name][:, lines] - each[name][:, lines].mean(axis=0) for name in ("angle", "torque")
        )
        periods = len(angle)
        left = angle - np.einsum("fij,pfj->pfi", plant, torque), torque if injected else angle
        for k in range(2):
            own[k, :, :, m] = (np.abs(left[k]) ** 2).sum(axis=0) / (periods * (periods - 1))
    own[0] += rounding[:, None] ** 2
    own[1] += 0 if injected else rounding[:, None] ** 2
    std = [np.sqrt(own[k] @ np.abs(np.linalg.pinv(which)) ** 2) for k, which in enumerate((U, E))]
    frequency = (lines + 1) / (samples * logs[0].rig.period)
    ordered = [np.moveaxis(each, 0, -1) for each in (plant, std[0], loop, std[1])]
    law = logs[0].law
    rig = logs[0].rig
    held = rig.period if law is None else law.period or 0.0
    return FrequencyResponse(
        frequency=frequency,
        plant=ordered[0],
        plant_std=ordered[1],
        loop=ordered[2],
        loop_std=ordered[3],
        period=rig.period,
        joints=tuple(rig.joint_labels),
        held=held,
    )
