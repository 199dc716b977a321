"""The simulator: an arm with a rig under a law, following a reference, gives a record."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.laws import Law
from plant.logs import Record
from plant.machine import Rig, unlikely_statements
from plant.mechanics import Arm
from plant.motion import Reference
from plant.parts import Floats, array, choice, instance, known_options, real, require_room, warn
from plant.simulation.cautions import (
    warn_of_missing_rotors,
    warn_of_stiff_gears,
    warn_of_unstable_lag,
)
from plant.simulation.clock import Clock
from plant.simulation.closed_loop import closed_loop
from plant.simulation.followed_path import Path, path_of, start_of
from plant.simulation.logged_run import logged_run

# (N, n) [N m], joint side, one row per sample; or a function that gives them at the times (N,) of
# the samples.
Injected: TypeAlias = Callable[[NDArray[Any]], ArrayLike] | ArrayLike

# Columns with the motors' total torque: a law that repeats one of them repeats an injected torque,
# too.
_OF_MOTORS = "torque", "current"


@known_options
def simulate(
    arm: Arm,
    rig: Rig,
    law: Law,
    reference: Reference,
    *,
    duration: float | None = None,
    steps_per_sample: int = 4,
    sweeps: int = 3,
    initial: ArrayLike | None = None,
    injected: Injected | None = None,
    backend: str = "numba",
) -> Record:
    """Simulate the closed loop and log it as the experiment does.

    Parameters
    ----------
    arm : Arm
    rig : Rig
    law : Law
    reference : Reference
    duration : float, optional
        [s]; by default the reference's own. There are ceil(duration / period) samples, at t_k = k
        period from 0.
    steps_per_sample : int
        Integration steps between two samples; 4 is accurate to the noise of the encoder, 16 is
        nearly converged.
    sweeps : int
        Gauss-Seidel sweeps of the friction law over the joints, per integration step;
        docs/background/speed.md has a table of the errors, in pulses, of fewer or more of both.
    initial : (2, n) array_like, optional
        Position [rad] and velocity [rad/s] at t = 0; by default those of the reference.
    injected : (N, n) array_like or callable, optional
        Known torque that is added to the law's at the amplifier [N m], joint side, held from its
        sample to the next; or a function that gives it at the times (N,) of all samples. The law
        does not know of it; the amplifier's limit holds for the law's own torque and again for the
        sum, which is what the record's `torque` and `current` hold.
    backend : {"numba", "casadi"}
        The compiled kernel, or casadi evaluating the same step.

    Returns
    -------
    Record
        With torque, current and the true joint motion.

    Raises
    ------
    ValueError
        Bad input, or, as `DivergenceError`, a loop that does not stay bounded (with time and
        joint).

    See Also
    --------
    plant.replay, ctc.evaluate, plant.Record

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> arm, rig, law = puma560.arm(), puma560.rig(), puma560.p_law()
    >>> record = simulate(arm, rig, law, puma560.reference(), duration=0.5)
    >>> record.error_pulses.shape
    (715, 2)
    """
    choice("backend", backend, ("numba", "casadi"))
    return run(
        arm, rig, law, reference, duration, steps_per_sample, initial, backend, sweeps, injected
    ).record


@dataclass(frozen=True)
class Trace:
    """A record, and the true error at the middle of every sub-step.

    The error (N steps_per_sample, n) [pulses] is not rounded.
    """

    record: Record
    true_error_pulses: Floats


def run(
    arm: Arm,
    rig: Rig,
    law: Law,
    reference: Reference,
    duration: float | None,
    steps_per_sample: int,
    initial: ArrayLike | None,
    backend: str,
    sweeps: int = 3,
    injected: Injected | None = None,
) -> Trace:
    """`simulate`, with the errors of the sub-steps."""
    kinds = {
        "arm": (arm, Arm),
        "rig": (rig, Rig),
        "law": (law, Law),
        "reference": (reference, Reference),
    }
    # Arguments in another order are the usual mistake, so the message gives the order.
    for name, (value, kind) in kinds.items():
        instance(name, value, kind, "The order is arm, rig, law, reference.")
    # A drive that is to be identified may lack its friction; a simulation needs it.
    rig.drive.require_friction()
    if law.replays:
        raise ValueError(
            f"the law must be a controller; {type(law).__name__} repeats a log. Use replay(arm,"
            " record)."
        )
    loop = closed_loop(
        dynamics=arm.dynamics,
        rig=rig,
        law=law,
        injected=injected is not None,
        steps_per_sample=steps_per_sample,
        sweeps=sweeps,
    )
    # Here, since only now the reference is known to be one.
    if duration is None:
        duration = reference.duration
    duration = real(
        "duration", duration, "Leave it out for one period of the reference.", positive=True
    )
    # Rounding must not add a sample; a limit keeps the number finite.
    samples = math.ceil(min(duration / rig.period, 1e18) - 1e-9)
    # Bytes of tables and log at the peak.
    bytes_per_sample = 8.0 * (steps_per_sample * (8 * rig.n + 4) + 16 * rig.n)
    require_room(
        f"a simulation of {samples:,} samples",
        samples,
        bytes_per_sample,
        "Simulate {most} samples or fewer at once.",
    )
    # An ideal clock; uneven stamps are those of a log, which `replay` keeps.
    clock = Clock.regular(samples, rig.period)
    path = Path(reference, rig)
    # Without a stated start the arm begins on its reference.
    start: Any = path.start()
    if initial is not None:
        initial = start = array("initial", initial, (2, rig.n), advice="Give q and qd at t = 0.")
    # Warnings come before the run, which may take long or diverge.
    motion = reference.links(clock.t)
    for line in unlikely_statements(
        rig, motion.q, motion.qd, [link.prismatic for link in arm.dynamics.chain.links]
    ):
        warn(line)
    warn_of_missing_rotors(arm, rig, start[0])
    warn_of_stiff_gears(arm, rig, start[0], steps_per_sample)
    warn_of_unstable_lag(arm, rig, law, start[0])
    # A function is evaluated at the samples, since torque is held between them.
    added = injected_at(injected, clock.t, rig.n)
    # The loop runs; a divergence raises here.
    log, true_error = logged_run(loop, arm, (path, clock, None, added), start, backend)
    # The layout of the loop names the rows of its log.
    columns = _columns(rig, loop.log_fields.read(log.T, loop.n))
    record = Record(
        t=clock.t,
        reference_pulses=path(clock.t)[1],
        rig=rig,
        law=law,
        reference=reference,
        initial=initial,
        injected=added,
        **columns,
    )
    return Trace(record, true_error)


@known_options
def replay(
    arm: Arm,
    record: Record,
    *,
    rig: Rig | None = None,
    law: Law | None = None,
    steps_per_sample: int = 4,
    sweeps: int = 3,
    backend: str = "numba",
) -> Record:
    """Simulate the experiment of a record with another arm: the log that this arm would have given.

    Parameters
    ----------
    arm : Arm
    record : Record
        Its law is simulated on what the record commanded, beside the torque that was injected, or
        repeats its torque or current (`LoggedTorque`); its time stamps are kept, also where they
        are uneven.
    rig, law : optional
        In place of the record's, as `found.rig`.
    steps_per_sample, sweeps, backend
        As for `simulate`.

    Returns
    -------
    Record
        With the samples, the reference and the weights of the original.

    Raises
    ------
    ValueError
        Bad input, or a loop that diverges (with time and joint).

    See Also
    --------
    plant.simulate, identification.Objective

    Examples
    --------
    >>> from plant import puma560, replay, simulate
    >>> arm, rig, law = puma560.arm(), puma560.rig(), puma560.p_law()
    >>> record = simulate(arm, rig, law, puma560.reference(), duration=0.3)
    >>> other = replay(puma560.literature_arm(1.5), record)
    >>> print((other.error_pulses != record.error_pulses).any())
    True
    """
    choice("backend", backend, ("numba", "casadi"))
    instance("arm", arm, Arm, "The order is arm, record.")
    instance("record", record, Record, "The order is arm, record.")
    if rig is None:
        rig = record.rig
    if law is None:
        law = record.law
    law = cast(Law, instance("law", law, Law, "Pass law= here or with the record."))
    # Also in the result, which states with what it was made.
    record = replace(record, rig=rig, law=law)
    added = injected_beside(record)
    loop = closed_loop(
        dynamics=arm.dynamics,
        rig=rig,
        law=law,
        injected=added is not None,
        steps_per_sample=steps_per_sample,
        sweeps=sweeps,
    )
    clock = Clock.of(record)
    # Driven as the experiment was: its path and clock, and the column that its law repeats.
    path = path_of(record, clock)
    driven = path, clock, law.replayed(record), added
    log, _ = logged_run(loop, arm, driven, start_of(record, path), backend)
    # The log has more samples than the record, where these bridge a gap.
    samples = loop.log_fields.read(log[clock.rows].T, loop.n)
    return replace(record, **_columns(rig, samples))


def _columns(rig: Rig, log: Any) -> dict[str, Any]:
    """Columns of a record, from the log of a run: `log_fields`, (n, N) each."""
    torque = log.torque.T
    # The log has a row per quantity and joint; a record has a row per sample.
    q = log.q.T
    counts = None
    # Joints with a second encoder, on the link, have its counts beside the motor's.
    both = rig.encoder.on_links(rig.n)
    if both.any():
        counts = np.where(both, rig.true_counts(q), np.nan)
    return {
        "error_pulses": log.error.T,
        "torque": torque,
        "current": rig.drive.current(torque),
        "link_counts": counts,
        "true_q": q,
        "true_qd": log.qd.T,
    }


def injected_at(injected: Injected | None, t: NDArray[Any], n: int) -> Floats | None:
    """Injected torque (N, n) [N m] at the samples t (N,), or None."""
    if injected is None:
        return None
    name = "injected"
    if callable(injected):
        injected = injected(t)
        name = "injected(t)"
    advice = "Give one row per sample, one joint torque per column [N m]."
    return array(name, injected, (len(t), n), advice=advice)


def injected_beside(record: Any) -> Floats | None:
    """Torque (N, n) [N m] that acts beside the command of a record's law, or None.

    A law that repeats the motors' own torque has none beside it.
    """
    if record.law is not None and record.law.replays in _OF_MOTORS:
        return None
    return record.injected
