"""`frequency_response`: responses of arm and closed loop from logs of periodic excitation.

At each excited frequency the amplitudes of joint angles Y, torques U and excitations E, a column
per record, give the plant Y U^-1, and the loop. Under a sampled law torques are held from sample to
sample, and the plant is the sampled one; under fast hardware it is the continuous one, well below
half the sampling rate. The feedback makes both Y and U noisy, so both are means over the periods of
an excitation that repeats exactly.

Source: R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed.
(2012), ch. 2 and 7.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from identification.equation_error import measured_torque
from identification.planning.gear_resonances import Resonances, resonances
from plant import Drive, Record
from plant.parts import (
    Floats,
    Frozen,
    Piece,
    Shown,
    Table,
    choice,
    colour_of,
    frozen,
    instance,
    known_options,
    legend_above,
    literal,
    real,
    row_by_row,
    whole,
)

if TYPE_CHECKING:
    import control

Complex = NDArray[np.complex128]

# A line of the reference is excited if it is this many times the line that rounding causes: the
# standard deviation of the response is then below a tenth. Chosen by hand.
_ABOVE = 10.0

# A line of an injected torque, which is not rounded, is excited if it exceeds this share of the
# strongest line. Chosen by hand.
_FAINT = 1e-3

# Title of the response of an arm; a rig does not tell which joints slide.
_PLANT = "angle / torque [rad/(N m), of slides m/N]"


@frozen
class FrequencyResponse(Shown, Frozen):
    """Measured frequency responses of plant and loop, with standard deviations.

    A standard deviation is that of the complex number: both parts together.

    Attributes
    ----------
    frequency : (F,) numpy.ndarray
        Excited lines [Hz].
    plant, plant_std : (n, n, F) numpy.ndarray
        From joint torques [N m] to joint angles [rad].
    loop, loop_std : (n, n, F) numpy.ndarray
        From commanded to measured angles [rad/rad]; with an injected torque, from that to the sum
        of torques: the input sensitivity [N m/(N m)].
    period : float
        Sample period [s].
    joints : tuple of str
        Labels.
    held : float
        Time for which a torque is held [s]; 0 under fast hardware.
    """

    # The responses, by line.
    frequency: Floats
    plant: Complex
    plant_std: Floats
    loop: Complex
    loop_std: Floats
    # The conditions of the measurement.
    period: float
    joints: tuple[str, ...]
    held: float

    def resonances(self, drive: Drive) -> Resonances:
        """Lowest resonance of each joint on its gear, for `Elasticity.from_resonance`.

        They are those at the pose of the records, of a drive with encoders on its motors: `hz`,
        `damping_ratio` and their standard deviations, `_std`, each (n,).
        """
        return resonances(self.frequency, self.plant, self.plant_std, self.held, drive)

    def to_control(self, which: str = "plant") -> "control.FrequencyResponseData":
        """Response "plant" or "loop" as python-control's sampled FRD."""
        import control

        response = getattr(self, choice("which", which, ("plant", "loop")))
        return control.FrequencyResponseData(response, 2 * np.pi * self.frequency, dt=self.period)

    @literal
    def plot(self, ax: Any = None, *, model: Any = None) -> Any:
        """Plot magnitude and phase of the plant's diagonal, with two standard deviations.

        Parameters
        ----------
        ax : array of 2 matplotlib Axes, optional
        model : python-control system, optional
            For comparison: a state space or transfer function from torques to angles.
        """
        axes = row_by_row(ax, 2, 1, time=False)[:, 0]
        magnitude, phase = axes
        frequency = self.frequency
        modelled = None
        if model is not None:
            # A sampled model is a function of z.
            modelled = model(np.exp(2j * np.pi * frequency * self.period), squeeze=False)
        for joint, label in enumerate(self.joints):
            # The diagonal alone: n^2 curves would hide each other.
            response = self.plant[joint, joint]
            colour = colour_of(joint)
            bars = 2 * self.plant_std[joint, joint]
            magnitude.errorbar(frequency, np.abs(response), bars, fmt=".", color=colour)
            angle = np.degrees(np.angle(response))
            phase.plot(frequency, angle, ".", color=colour, label=label)
            if modelled is not None:
                curve = modelled[joint, joint]
                magnitude.plot(frequency, np.abs(curve), color=colour)
                phase.plot(frequency, np.degrees(np.angle(curve)), color=colour)
        magnitude.set(xscale="log", yscale="log", xlabel="frequency [Hz]", ylabel=_PLANT)
        phase.set(xscale="log", xlabel="frequency [Hz]", ylabel="phase [degrees]")
        legend_above(phase)
        return axes

    def _short(self) -> str:
        return (
            f"{len(self.frequency)} lines, {self.frequency[0]:.3g} to {self.frequency[-1]:.3g} Hz"
        )

    def _shown(self) -> Iterator[Piece]:
        low, high = self.frequency[0], self.frequency[-1]
        head = (_PLANT, f"at {low:.3g} Hz", f"at {high:.3g} Hz", "std, median")
        rows = []
        for j, joint in enumerate(self.joints):
            # Both ends of the band show whether inertia or gears dominate.
            size = np.abs(self.plant[j, j])
            std = 100 * np.median(self.plant_std[j, j] / size)
            rows.append((joint, f"{size[0]:.3g}", f"{size[-1]:.3g}", f"{std:.2g} %"))
        yield Table(head, rows)


@known_options
def frequency_response(
    records: Record | Sequence[Record], *, period: float | None = None, skip: int = 1
) -> FrequencyResponse:
    """Frequency responses of an arm and of its closed loop, from logs of periodic excitation.

    Each record repeats one excitation: of its reference (`plant.Harmonics`), or an injected torque
    while the reference moves too slowly to reach the lines. An arm of n joints needs n records,
    each with another excitation.

    Parameters
    ----------
    records : Record or sequence of Record
        Of one rig, with torque or current; at least two periods after the skipped ones.
    period : float, optional
        Of the excitation [s]; by default that of the reference.
    skip : int
        Periods at the beginning that do not count, since the arm settles.

    Returns
    -------
    FrequencyResponse
        Standard deviations come from the differences between periods; they are at least those that
        rounding to counts causes.

    Raises
    ------
    ValueError
        Too few records or periods, a period of a fraction of a sample, missing samples, records
        without torque or excitation, or with the same excitation.

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
    >>> pose = {"period": 1.4, "offset": (0.3, -0.4), "sine": np.zeros((2, 20))}
    >>> paths = [Harmonics(cosine=cosine, **pose) for cosine in lines]
    >>> log = [simulate(puma560.arm(), rig, puma560.p_law(), path, duration=5.6) for path in paths]
    >>> measured = frequency_response(log)
    >>> measured.to_control("loop").ninputs
    2
    """
    # 1. Records of one rig, with one kind of excitation, as many as joints.
    logs = [records] if isinstance(records, Record) else list(records)
    for log in logs:
        instance("each record", log, Record, "Give what simulate returns, or Record.read.")
    # With fewer records than joints, U has no inverse.
    n = logs[0].rig.n if logs else 0
    if len(logs) < max(n, 1):
        raise ValueError(
            f"records must be as many as joints, {n}; got {len(logs)}. Use design_motion(...)."
        )
    if any(log.rig != logs[0].rig for log in logs):
        raise ValueError("records must be of one rig; they differ. Measure each arm apart.")
    injected = [log.injected is not None for log in logs]
    if any(injected) != all(injected):
        raise ValueError(
            "records must all have an injected torque, or none; got both. Measure both apart."
        )
    # Lines of different periods do not coincide.
    spans = {_samples(log, period) for log in logs}
    if len(spans) > 1:
        raise ValueError(
            f"records must have one period; got {sorted(spans)} samples. Give records of one"
            " excitation."
        )
    (samples,) = spans
    skip = whole("skip", skip, "Periods that are left out.", least=0)

    # 2. Amplitudes of each period, the excited lines, and the responses there.
    signals = [_lines(log, samples, skip) for log in logs]
    lines, excitation = _excited(signals, logs, samples, injected[0])
    return _responses(signals, lines, excitation, logs, samples, injected[0])


def _samples(record: Record, period: float | None) -> int:
    """Number of samples of one period of the excitation."""
    # A missing sample shifts all later ones against the lines.
    step = record.rig.period
    if (
        not np.allclose(np.diff(record.t), step, rtol=0, atol=1e-3 * step)
        or (record.valid < 1).any()
    ):
        raise ValueError(
            "records must have every sample; some are missing or invalid. Give a part without gaps."
        )
    if period is None:
        period = getattr(record.reference, "period", None)
    if period is None:
        raise ValueError(
            "period must be given; the reference states none. It is that of the excitation [s]."
        )
    span = real("period", period, "Of the excitation [s].", positive=True) / step
    # A fraction of a sample would spread each line over its neighbours.
    if abs(span - round(span)) > 1e-6 * span:
        raise ValueError(
            f"period must be a whole number of samples of {step:g} s; got {span:.6g}. Choose"
            " another."
        )
    return round(span)


def _lines(record: Record, samples: int, skip: int) -> dict[str, Complex]:
    """Amplitudes (P, F, n) of angle, torque and excitation in each period but the skipped ones."""
    rig = record.rig
    # Two periods are the least whose difference shows the noise.
    periods = len(record) // samples - skip
    if periods < 2:
        got = f"{len(record) / samples:.3g} periods, of which {skip} are skipped"
        raise ValueError(
            f"records must have two periods at least after those skipped; got {got}. Log for"
            " longer."
        )
    # Measured angle = reference - error.
    reference = record.reference_pulses
    signals = {
        "angle": rig.to_angle(reference - record.error_pulses),
        "torque": measured_torque(record),
    }
    signals["excitation"] = rig.to_angle(reference) if record.injected is None else record.injected
    cut = slice(skip * samples, (skip + periods) * samples)
    amplitudes = {}
    for name, signal in signals.items():
        rows = np.asarray(signal)[cut].reshape(periods, samples, -1)
        # Line 0, the mean, has no phase.
        amplitudes[name] = 2 / samples * np.fft.rfft(rows, axis=1)[:, 1:]
    return amplitudes


def _rounding(record: Record, samples: int) -> Floats:
    """Standard deviation (n,) of the amplitude of a line of one period by rounding [rad].

    Rounding has a variance of 1 / 12 count^2, spread evenly over the lines.
    """
    rig = record.rig
    # A coupling turns a count of one motor into angles of several joints.
    count = np.abs(np.stack([rig.to_angle(motor) for motor in np.eye(rig.n)], axis=1))
    return np.sqrt((count**2).sum(axis=1) / 12 * 4 / samples)


def _excited(
    signals: list[dict[str, Complex]], logs: list[Record], samples: int, injected: bool
) -> tuple[NDArray[np.intp], Complex]:
    """Excited lines, and the excitation (F, n, M) there."""
    mean = np.stack([signal["excitation"].mean(axis=0) for signal in signals], axis=2)
    if injected:
        least = _FAINT * np.abs(mean).max()
    else:
        least = _ABOVE * _rounding(logs[0], samples)[:, None]
    # Relative to that, the weakest combination of joints must be excited: the smallest singular
    # value of the matrix (n, M) of a line.
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
    """Both responses, and their standard deviations by the differences between periods."""
    # 1. Responses of the means over periods.
    rounding = _rounding(logs[0], samples)
    Y = np.stack([signal["angle"].mean(axis=0)[lines] for signal in signals], axis=2)
    U = np.stack([signal["torque"].mean(axis=0)[lines] for signal in signals], axis=2)
    # Numpy inverts the matrices (n, n) of all lines at once.
    plant = Y @ np.linalg.pinv(U)
    loop = (U if injected else Y) @ np.linalg.pinv(E)

    # 2. Variances of the means of the output that no response explains. The torque of a period
    # explains a part of the angle; the excitation repeats exactly and explains no difference.
    plant_variance = np.zeros(Y.shape)
    loop_variance = np.zeros(Y.shape)
    for m, signal in enumerate(signals):
        angle = signal["angle"][:, lines] - signal["angle"][:, lines].mean(axis=0)
        torque = signal["torque"][:, lines] - signal["torque"][:, lines].mean(axis=0)
        residual = angle - np.einsum("fij,pfj->pfi", plant, torque)
        output = torque if injected else angle
        freedom = len(angle) * (len(angle) - 1)
        plant_variance[:, :, m] = (np.abs(residual) ** 2).sum(axis=0) / freedom
        loop_variance[:, :, m] = (np.abs(output) ** 2).sum(axis=0) / freedom
    # Rounding may repeat from period to period, so that differences do not show it.
    plant_variance += rounding[:, None] ** 2
    if not injected:
        loop_variance += rounding[:, None] ** 2

    # 3. They act on the responses through the inverse of the input.
    plant_std = np.sqrt(plant_variance @ np.abs(np.linalg.pinv(U)) ** 2)
    loop_std = np.sqrt(loop_variance @ np.abs(np.linalg.pinv(E)) ** 2)
    law = logs[0].law
    rig = logs[0].rig
    # Without a law, a sampled controller is assumed.
    held = rig.period if law is None else law.period or 0.0
    return FrequencyResponse(
        frequency=(lines + 1) / (samples * rig.period),
        plant=np.moveaxis(plant, 0, -1),
        plant_std=np.moveaxis(plant_std, 0, -1),
        loop=np.moveaxis(loop, 0, -1),
        loop_std=np.moveaxis(loop_std, 0, -1),
        period=rig.period,
        joints=tuple(rig.joint_labels),
        held=held,
    )
