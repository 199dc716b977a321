"""`sweep_resonance`: share of samples within a pulse limit over the resonance of the gears."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.figures import plot_sweep
from ctc.verdict.evaluations import require_laws
from ctc.verdict.on_gears import (
    HIGHEST,
    LOWEST,
    RIGID,
    SETTLED,
    arm_of,
    damping_of,
    on_gears,
    require_followed,
)
from identification import Identification
from plant import Arm, Law, Reference, Rig
from plant.compiler import cores
from plant.machine import DAMPING_RATIO
from plant.parts import (
    Floats,
    Frozen,
    Piece,
    Shown,
    Table,
    Verdict,
    array,
    frozen,
    known_options,
    whole,
)


@frozen
class ResonanceSweep(Shown, Frozen):
    """Several controllers on gears of many resonances. Print it for a table.

    Attributes
    ----------
    hz : (H,) numpy.ndarray
        Locked-rotor resonances, all joints alike [Hz].
    damping_ratio : float
    within : float
        Limit [pulses].
    shares : dict of str -> (H,) numpy.ndarray
        By name, share of the samples at which every joint's encoder error is within the limit; 0
        where the loop diverged.
    rigid : dict of str -> float
        The same on rigid gears.
    """

    hz: Floats
    damping_ratio: float
    within: float
    shares: dict[str, Floats]
    rigid: dict[str, float]

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Draw on (2,) Axes the shares over the resonance, and where all samples are within."""
        return plot_sweep(self, ax)

    def _short(self) -> str:
        return (
            f"{len(self.shares)} controllers at {len(self.hz)} resonances, {self.hz[0]:.3g} to"
            f" {self.hz[-1]:.3g} Hz"
        )

    def _shown(self) -> Iterator[Piece]:
        gears = f"gears with a damping ratio of {self.damping_ratio:g}"
        yield Verdict(f"samples within ±{self.within:g} pulse, {gears}")
        # A line has room for seven resonances; `unique` drops repeated columns if there are fewer.
        columns = np.unique(np.linspace(0, len(self.hz) - 1, 7).round().astype(int))
        rows = [
            (name, *map(_percent, share[columns]), _percent(self.rigid[name]))
            for name, share in self.shares.items()
        ]
        yield Table(("", *(f"{self.hz[i]:.3g} Hz" for i in columns), "rigid"), rows)


@known_options
def sweep_resonance(
    arm: Arm | Identification,
    rig: Rig,
    laws: dict[str, Law],
    reference: Reference,
    *,
    hz: ArrayLike | None = None,
    damping_ratio: float = DAMPING_RATIO,
    within: float = 1,
    after: float = SETTLED,
    duration: float | None = None,
    steps_per_sample: int = 16,
    threads: int | None = None,
) -> ResonanceSweep:
    """Simulate an arm on elastic gears of many resonances, under each of several controllers.

    Parameters
    ----------
    arm : Arm or Identification
        The arm that is controlled.
    rig : Rig
        With rigid gears; lag, delay and friction stay as they are.
    laws : dict of str -> Law
        The controllers, by their names.
    reference : Reference
        The resonances `hz` are those at its first pose.
    hz : (H,) array_like, optional
        Locked-rotor resonances, all joints alike, rising [Hz]; by default 79 from 10 to 500.
    damping_ratio : float
        Damping ratio of each gear while its motor is locked.
    within : float
        Limit of the encoder error of the motors [pulses].
    after : float
        Samples before this time do not count [s].
    duration, steps_per_sample, threads
        As in `ctc.certify`.

    Returns
    -------
    ResonanceSweep

    Raises
    ------
    ValueError
        Bad input; a rig whose gears are elastic, or whose motors weigh more than the arm.

    See Also
    --------
    ctc.Evaluation

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, sweep_resonance
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> laws = {"60 rad/s": ComputedTorque(arm, rig, bandwidth=60)}
    >>> sweep = sweep_resonance(arm, rig, laws, puma560.reference(), hz=(30, 100), duration=0.3)
    >>> sweep.shares["60 rad/s"].shape
    (2,)
    """
    require_laws(laws)
    ratio = damping_of(damping_ratio)
    # 79 resonances and rigid gears fill the lanes of the kernel.
    resonances = np.geomspace(LOWEST, HIGHEST, 79)
    if hz is not None:
        resonances = array("hz", hz, ("H",), advice="Give [Hz].")
    # Equal neighbours would leave no interval between them, so the resonances must rise.
    if not len(resonances) or resonances[0] <= 0 or (np.diff(resonances) <= 0).any():
        raise ValueError(
            f"hz must be positive and rising; got {resonances!r:.60}. Give resonances [Hz]."
        )
    # The integrator must follow the fastest gear, or its own error would look like the loop's.
    require_followed("hz", resonances, rig.period, steps_per_sample)
    # The number of threads changes no bit, so all cores may be used.
    threads = cores() if threads is None else whole("threads", threads, "Leave it out.")
    options: dict[str, Any] = {
        "within": within,
        "steps_per_sample": steps_per_sample,
        "after": after,
        "duration": reference.duration if duration is None else duration,
    }
    controlled = arm_of(arm)
    shares = {}
    for name, law in laws.items():
        # One kernel for each law, all its resonances side by side.
        loop = on_gears(controlled, rig, law, reference, ratio, threads, **options)
        runs = loop([*resonances, RIGID])
        # A loop that diverged has all of its samples outside.
        shares[name] = 1 - runs.outside / runs.samples
    # The last lane of each is the rigid one.
    return ResonanceSweep(
        hz=resonances,
        damping_ratio=ratio,
        within=within,
        shares={name: share[:-1] for name, share in shares.items()},
        rigid={name: float(share[-1]) for name, share in shares.items()},
    )


def _percent(share: float) -> str:
    """A share as text, rounded down, so that 100 % means all."""
    # The 1e-9 keeps a rounding error from lowering the last digit.
    return f"{np.floor(share * 1e3 + 1e-9) / 10:.4g} %"
