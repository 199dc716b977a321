"""Loop transfer function of each joint under a sampled controller, linearised, and its margins.

The loop of a joint is opened at its encoder; all other loops stay closed. Its input is the counts
that the controller reads. Its output is minus the position, in pulses, so that the sensitivity
function is 1 / (1 + L). `plant.analysis.sampled_loops` linearises the loops.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.figures import plot_margins
from ctc.verdict import (
    HIGHEST,
    LowestResonance,
    above,
    arm_of,
    damping_of,
    gear_numbers,
    with_gears,
)
from identification import Identification
from plant import Arm, Elasticity, Law, Rig
from plant.analysis import SampledLoops
from plant.machine import DAMPING_RATIO
from plant.parts import Floats, Piece, Shown, Table, Verdict, frozen, instance, known_options

if TYPE_CHECKING:
    from control import StateSpace


@known_options
def error_loop(
    arm: Arm | Identification | None,
    rig: Rig,
    law: Law,
    *,
    joint: int = 0,
    pose: ArrayLike | None = None,
) -> "StateSpace":
    """Loop transfer function L of one joint, the loops of the others closed.

    Parameters
    ----------
    arm : Arm, Identification or None
        The arm that is controlled; None takes that of the law, as if its f were exact.
    rig : Rig
    law : Law
        With a period, such as `ComputedTorque`.
    joint : int
        Counted from 0.
    pose : (n,) array_like, optional
        q at rest [rad]; zeros by default.

    Returns
    -------
    control.StateSpace
        Discrete; from the counts that the law reads to minus the position, both in pulses.

    Raises
    ------
    ValueError
        A law without a period, a joint that is not there, an arm that the law cannot hold at the
        pose.

    See Also
    --------
    ctc.margins, plant.linearise

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, error_loop
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> loop = error_loop(arm, rig, ComputedTorque(arm, rig, bandwidth=60), joint=0)
    >>> loop.ninputs, loop.noutputs, loop.dt
    (1, 1, 0.0007)
    """
    import control

    loops = SampledLoops(controlled(arm, law), rig, law, pose)
    # True is an int in Python, but never meant as a joint.
    known = isinstance(joint, (int, np.integer)) and not isinstance(joint, bool)
    if not known or not 0 <= joint < rig.n:
        raise ValueError(
            f"joint must be a whole number from 0 to {rig.n - 1}; got {joint!r}. Joints count"
            " from 0."
        )
    # The position is -c x: with this sign a stable loop has the sensitivity 1 / (1 + L).
    A, b, c = opened(*loops.matrices(), joint)
    name = f"loop of {controlled(arm, law).dynamics.chain.joint_labels[joint]}"
    ends = {"inputs": [f"pulses[{joint}]"], "outputs": [f"position[{joint}]"]}
    return control.StateSpace(A, b, -c, 0, loops.period, name=name, **ends)


def controlled(arm: Arm | Identification | None, law: Law) -> Arm:
    """The arm itself, that of an identification, or, for None, that of the law."""
    instance("law", law, Law, "Give a law, such as ComputedTorque(arm, rig).")
    return arm_of(getattr(law, "arm", None) if arm is None else arm, ", or None for the law's own")


def opened(A: Floats, B: Floats, C: Floats, joint: int) -> tuple[Floats, Floats, Floats]:
    """Matrices of one open loop, the others closed: A (m, m), b (m, 1), c (1, m)."""
    # Closing a loop feeds its output to its input: x' = A x + b c x.
    closed = [i for i in range(len(C)) if i != joint]
    return A + B[:, closed] @ C[closed], B[:, [joint]], C[[joint]]


@frozen
class Margins(Shown):
    """Stability margins of every joint with the other loops closed. Print them for a table.

    Attributes
    ----------
    stable : bool
        Whether the arm is stable with all loops closed; if not, the margins mean nothing.
    gain_down, gain_up : (n,) numpy.ndarray
        Factors on the loop's gain (inverse factors on the true inertia) between which it stays
        stable; 0 and infinity without such a limit.
    phase : (n,) numpy.ndarray
        Smallest phase lag that makes it unstable [deg].
    delay : (n,) numpy.ndarray
        Smallest additional delay that makes it unstable [s].
    crossover : (n,) numpy.ndarray
        Highest frequency of gain 1 [Hz].
    sensitivity : (n,) numpy.ndarray
        Peak of abs(1 / (1 + L)).
    period : float
        [s]
    frequency : (F,) numpy.ndarray
        [Hz]
    response : (n, F) complex numpy.ndarray
        L at these frequencies.
    joint_labels : list of str
        Names of the joints in tables and figures.
    lowest_resonance : float or None
        Locked-rotor resonance of the gears [Hz], all joints alike, above which the loops stay
        stable at this pose: 10 where they do at every one of 10 to 500 Hz, infinite where they do
        not at 500, NaN where it cannot be told; None for a rig whose gears are elastic.
    damping_ratio : float
        Of these gears.
    """

    stable: bool
    gain_down: Floats
    gain_up: Floats
    phase: Floats
    delay: Floats
    crossover: Floats
    sensitivity: Floats
    period: float
    frequency: Floats
    response: NDArray[np.complex128]
    joint_labels: list[str]
    lowest_resonance: float | None
    damping_ratio: float

    def _short(self) -> str:
        if not self.stable:
            return "not stable"
        phase = f"least phase margin {self.phase.min():.1f}°"
        return f"stable, {phase}, largest sensitivity {self.sensitivity.max():.2f}"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(
            "The closed loop is stable." if self.stable else "The closed loop is not stable.",
            self.stable,
        )
        rows = []
        # The delay is printed in samples, too: a controller is late by whole ones.
        for i, label in enumerate(self.joint_labels):
            delay = f"{1e3 * self.delay[i]:.2f} ms ({self.delay[i] / self.period:.1f} samples)"
            numbers = (
                f"{self.gain_down[i]:.2f}",
                f"{self.gain_up[i]:.2f}",
                f"{self.phase[i]:.1f}°",
                delay,
            )
            rows.append(
                (label, f"{self.crossover[i]:.1f} Hz", *numbers, f"{self.sensitivity[i]:.2f}")
            )
        yield Table(
            ("", "crossover", "gain down", "gain up", "phase", "delay", "sensitivity peak"), rows
        )
        # Elastic gears of the rig are in the model already, and no gears help an unstable loop.
        if self.lowest_resonance is not None and self.stable:
            gears = LowestResonance(
                hz=self.lowest_resonance, damping_ratio=self.damping_ratio, within=None
            )
            yield f"rigid gears assumed; {gears}, at this pose"

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Bode diagram of the loops and their sensitivity, one line per joint, on (3,) Axes."""
        return plot_margins(self, ax)


@known_options
def margins(
    arm: Arm | Identification | None,
    rig: Rig,
    law: Law,
    *,
    pose: ArrayLike | None = None,
    damping_ratio: float = DAMPING_RATIO,
) -> Margins:
    """Stability margins of the loop of every joint under a sampled controller.

    Parameters
    ----------
    arm, rig, law, pose
        As of `error_loop`.
    damping_ratio : float
        Of the gears for which the lowest resonance is stated.

    Returns
    -------
    Margins

    Raises
    ------
    ValueError
        As `error_loop`.

    See Also
    --------
    ctc.error_loop, plant.linearise

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, margins
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> margins(arm, rig, ComputedTorque(arm, rig, bandwidth=60)).stable
    True
    """
    import control

    model = controlled(arm, law)
    loops = SampledLoops(model, rig, law, pose)
    A, B, C = loops.matrices()
    period = loops.period
    # Four decades below the Nyquist frequency, 1000 points each: neighbours are 0.23 % apart. Zero
    # and the Nyquist frequency are left out, where the response is real.
    omega = np.geomspace(1e-4, 1, 4000, endpoint=False) * np.pi / period
    rows = []
    for joint in range(len(C)):
        # 1. The response of the open loop on the unit circle.
        a, b, c = opened(A, B, C, joint)
        response = _response(a, b, c, omega * period)
        # 2. All crossings: a controller with integral action has margins downwards, too.
        gain, phase, _, _, crossing, _ = control.stability_margins(
            control.frd(response, omega), returnall=True
        )
        gain = np.append(gain, _real_gains(a, b, c))
        # 3. The lag that is missing to -180 degrees: a phase margin of -1 is a lag of 359.
        lag = np.mod(phase, 360)
        rows.append(
            {
                "gain_down": gain[gain < 1].max(initial=0.0),
                "gain_up": gain[gain > 1].min(initial=np.inf),
                "phase": lag.min(initial=np.inf),
                "delay": (np.deg2rad(lag) / crossing).min(initial=np.inf),
                "crossover": crossing.max(initial=0.0) / (2 * np.pi),
                "sensitivity": np.abs(1 / (1 + response)).max(),
                "response": response,
            }
        )
    return Margins(
        # Margins come from open loops; only the poles of the closed one tell stability.
        stable=loops.unstable_pole() is None,
        period=period,
        frequency=omega / (2 * np.pi),
        joint_labels=model.dynamics.chain.joint_labels,
        damping_ratio=damping_ratio,
        lowest_resonance=_lowest_resonance(arm, rig, law, pose, damping_ratio),
        **{name: np.array([row[name] for row in rows]) for name in rows[0]},
    )


def _response(a: Floats, b: Floats, c: Floats, angles: Floats) -> NDArray[np.complex128]:
    """L of one joint at points of the unit circle, by their angles [rad]."""
    z = np.exp(1j * angles)[:, None, None] * np.eye(len(a))
    response: NDArray[np.complex128] = -(c @ np.linalg.solve(z - a, b + 0j))[:, 0, 0]
    return response


def _real_gains(a: Floats, b: Floats, c: Floats) -> Floats:
    """Gain margins at zero and the Nyquist frequency, which no crossing of the phase shows."""
    # So near zero, an integrator has a response without limit, and the matrix still an inverse.
    ends = _response(a, b, c, np.array([1e-12, np.pi]))
    negative = (ends.real < 0) & (np.abs(ends.imag) < 1e-3 * np.abs(ends.real))
    gains = -1 / ends.real[negative]
    # Beyond a factor of a million, the response is that of an integrator, or rounding.
    return gains[np.abs(np.log10(gains)) < 6]


def _lowest_resonance(
    arm: Arm | Identification | None,
    rig: Rig,
    law: Law,
    pose: ArrayLike | None,
    damping_ratio: float,
) -> float | None:
    """Resonance [Hz] of elastic gears above which the loops stay stable; see `Margins`."""
    # The model is linear, so its poles decide; no simulation is needed.
    ratio = damping_of(damping_ratio)
    if rig.drive.elasticity is not None:
        return None
    try:
        # Numbers of stiffness replace these gears; they only give the loop its form.
        gears: Any = Elasticity.from_resonance(controlled(arm, law), HIGHEST, ratio, q=pose)
        elastic = with_gears(rig, gears)
    except ValueError:  # motors that weigh more than the arm
        return np.nan
    loops = SampledLoops(controlled(arm, law), elastic, law, pose)

    def unstable(hz: Any) -> Any:
        """Whether the loops are unstable at each of these resonances [Hz], all joints alike."""
        names, rows = gear_numbers(gears, rig.drive, hz)
        numbers = [dict(zip(names, row, strict=True)) for row in rows]
        return np.array([loops.unstable_pole(values) is not None for values in numbers])

    # 60 resonances from 10 to 500 Hz are 7 % apart, and 30 more in the gap 0.2 %.
    return above(unstable, 60)
