"""Laws that repeat a log's torque or current in open loop; commands of a law without memory."""

import functools
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plant.laws.law import Setpoint, StatelessLaw, Step, block_of
from plant.machine import Rig
from plant.parts import evaluated, part, structure


class _OfMotors(StatelessLaw):
    """Base of laws that repeat what the motors did; `held`: as `LoggedTorque` has it."""

    held: bool | None

    @property
    def interpolates(self) -> bool:
        """A faster loop changes its torque between two rows."""
        # Where nothing is stated, a simulation holds: nobody can ask the log.
        return self.held is False


@part
class LoggedTorque(_OfMotors):
    """The logged joint torque, the record's column `torque` [N m], repeated in open loop.

    Parameters
    ----------
    held : bool, optional
        True: the torque of a sample acts from there to the next (zero-order hold), as that of a
        controller with the period of the log does. False: the log has samples of the torque of a
        faster loop, which is on straight lines between them. By default `identify` finds out which
        of the two explains the log better, and a simulation holds the torque.

    See Also
    --------
    plant.LoggedCurrent, identification.fit_torque

    Examples
    --------
    >>> from plant import LoggedTorque, replay, puma560, simulate
    >>> arm = puma560.arm()
    >>> record = simulate(arm, puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.3)
    >>> again = replay(arm, record, law=LoggedTorque())
    >>> again.t.shape == record.t.shape
    True
    """

    held: bool | None = structure(default=None)
    replays = "torque"

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = the logged one."""
        # The column is the torque before friction and gear: it stands in the plant where a
        # controller's torque would.
        return setpoint.logged, state


@part
class LoggedCurrent(_OfMotors):
    """The logged motor currents, the record's column `current` [A], repeated in open loop.

    The rig's motor gain makes torque of them.

    Parameters
    ----------
    held : bool, optional
        Whether the current of a sample acts from there to the next; as `LoggedTorque` has it.

    See Also
    --------
    plant.LoggedTorque, plant.Record

    Examples
    --------
    >>> from plant import LoggedCurrent
    >>> LoggedCurrent()
    LoggedCurrent(held=None)
    """

    held: bool | None = structure(default=None)
    replays = "current"

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = k K_i i."""
        # The current acts on the motor; gain and gear of the rig make a joint torque of it.
        return rig.drive.joint_torque(rig.drive.motor_gain, setpoint.logged), state


# Samples in one call of casadi, chosen by hand: it bounds the memory, and changes no result.
_SAMPLES_PER_CALL = 1000


# A checkup tries hundreds of other laws on one log.
@functools.lru_cache(maxsize=8)
def _of_samples(step: str) -> ca.Function:
    """Steps of many samples; `step` is serialised, the same for laws that differ in numbers."""
    function = ca.Function.deserialize(step)
    columns = ("reference_pulses", "pulses")
    others = [i for i, name in enumerate(function.name_in()) if name not in columns]
    return function.map("samples", "serial", _SAMPLES_PER_CALL, others, [])


def commanded_torque(record: Any, at: Any = None) -> NDArray[np.float64] | None:
    """Torque (N, n) [N m] that a law without memory commanded in a log, before the limit.

    `at` (K,): indices of the rows, all by default. None for other laws: their state in the middle
    of a log is not known.
    """
    law = record.law
    rig = record.rig
    # A law that repeats the log commands nothing of its own, and a state in the middle of a log is
    # unknown.
    if law is None or law.replays or law.has_memory(record.n):
        return None
    block = block_of(law, rig)
    reference = record.reference_pulses
    counts = record.counts
    if at is not None:
        reference, counts = reference[at], counts[at]
    # A law without memory reads counts and reference pulses only: speeds and the last torque are
    # zeros here.
    along = _of_samples(block.step.serialize())
    zero = np.zeros(record.n)
    # The function takes a fixed number of samples; the last call repeats the last one.
    calls = -(-len(counts) // _SAMPLES_PER_CALL)
    rows = np.minimum(np.arange(calls * _SAMPLES_PER_CALL), len(counts) - 1)
    torque = np.empty((rows.size, record.n))
    for call in rows.reshape(calls, _SAMPLES_PER_CALL):
        inputs = zero, zero, zero, reference[call], counts[call], zero
        commanded, _ = evaluated(along, np.empty(0), *inputs, rig.period, block.values)
        torque[call[0] : call[0] + _SAMPLES_PER_CALL] = commanded
    return torque[: len(counts)]
