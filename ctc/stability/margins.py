"""How far the loop of each joint is from instability: margins, sensitivity, and their figure."""

from __future__ import annotations

import dataclasses

import numpy as np

from ctc.figures import plot_margins
from ctc.stability.error_loop import open_loops, opened
from plant.parts.arguments import known_options

__all__ = ["Margins", "margins"]

_POINTS = 4000

_KEPT = 1e-9
"""How far outside 1 rounding may put the eigenvalue of what a law keeps, such as parameters that do not adapt now."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Margins:
    """Margins of every joint, each with the loops of the others closed.

    Attributes
    ----------
    stable : bool
        Of all loops closed, without any change; the margins mean nothing where this is not so.
    gain_down, gain_up : (n,) numpy.ndarray
        Factors on the loop's gain (on the inertia that is really there, inverse) between which it stays stable; 0 and
        infinity where nothing ends it.
    phase : (n,) numpy.ndarray
        Smallest phase lag that makes it unstable [deg].
    delay : (n,) numpy.ndarray
        Smallest delay that does [s].
    crossover : (n,) numpy.ndarray
        Highest frequency of gain 1 [Hz].
    sensitivity : (n,) numpy.ndarray
        Peak of abs(1 / (1 + L)).
    period : float
        [s]
    frequency : (F,) numpy.ndarray
        [Hz]
    response : (n, F) complex numpy.ndarray
        L there.
    """

    stable: bool
    gain_down: np.ndarray
    gain_up: np.ndarray
    phase: np.ndarray
    delay: np.ndarray
    crossover: np.ndarray
    sensitivity: np.ndarray
    period: float
    frequency: np.ndarray
    response: np.ndarray

    def __str__(self):
        lines = ["joint   crossover   gain down   gain up   phase   delay              sensitivity peak"]
        for i in range(len(self.phase)):
            delay = f"{1e3 * self.delay[i]:.2f} ms ({self.delay[i] / self.period:.1f} samples)"
            lines.append(
                f"{i + 1:<5} {self.crossover[i]:8.1f} Hz {self.gain_down[i]:11.2f} {self.gain_up[i]:9.2f} "
                f"{self.phase[i]:6.1f}°   {delay:<21} {self.sensitivity[i]:13.2f}"
            )
        return "\n".join(lines if self.stable else ["The closed loop is not stable.", *lines])

    def plot(self):
        """Bode diagram of the loops and their sensitivity, one line per joint.

        Returns
        -------
        matplotlib.figure.Figure
        """
        return plot_margins(self)


@known_options
def margins(law, rig, *, arm=None, pose=None):
    """Stability margins of the loop of every joint under a sampled law.

    Parameters
    ----------
    law : Law
        With a period, such as `ComputedTorque`.
    rig : Rig
    arm : Arm, optional
        What is controlled; by default the law's own, as if f were known.
    pose : (n,) array_like, optional
        q at rest [rad]; zeros by default.

    Returns
    -------
    Margins

    Raises
    ------
    ValueError
        As `ctc.stability.error_loop.error_loop`.
    """
    import control

    A, B, C, period = open_loops(law, rig, arm, pose)
    omega = np.geomspace(1e-4, 1, _POINTS, endpoint=False) * np.pi / period
    found = []
    for joint in range(len(C)):
        a, b, c = opened(A, B, C, joint)
        z = np.exp(1j * omega * period)[:, None, None] * np.eye(len(a))
        response = -(c @ np.linalg.solve(z - a, b + 0j))[:, 0, 0]
        gain, phase, _, _, crossing, _ = control.stability_margins(control.frd(response, omega), returnall=True)
        lag = np.mod(phase, 360)  # what is missing to -180 degrees, counted as a lag
        found.append(
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
        stable=bool(np.abs(np.linalg.eigvals(A + B @ C)).max() < 1 + _KEPT),
        period=period,
        frequency=omega / (2 * np.pi),
        **{name: np.array([each[name] for each in found]) for name in found[0]},
    )
