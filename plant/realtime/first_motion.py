"""First motion of an arm: a small torque on each motor in turn shows wires turned or swapped."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from plant.machine.rig import Rig
from plant.mechanics.arm import Arm
from plant.parts.arguments import array, instance, known_options, real
from plant.parts.fields import Floats
from plant.parts.messages import TURNS
from plant.parts.settings import frozen_settings
from plant.realtime.guards import Guards


@frozen_settings
class FirstMotionSettings:
    """Numbers of the first motion; all are chosen by hand.

    Parameters
    ----------
    counts : int
        Counts that are a motion, and no flicker at the edge of a cell.
    ramp : float
        Time from no torque to the largest [s].
    settle : float
        Longest time to come to rest [s].
    still : float
        Time without a count at rest [s].
    share : float
        Largest torque, relative to the change that leaves a joint at rest: that goes from one
        direction of friction to the other.
    """

    counts: int = 4
    ramp: float = 0.8
    settle: float = 0.5
    still: float = 0.05
    share: float = 0.8


SETTINGS = FirstMotionSettings()


@known_options
class FirstMotion:
    """Push each motor a little, and name turned signs, swapped wires and dead encoders.

    One motor after another gets a torque that rises from nothing until some encoder has counted
    `travel` pulses, then none until the arm rests. The counts that move must be its own, upwards.
    Before any path, with the arm's brakes released and nobody near: ``while not probe.done:
    apply(probe.step(read()))``. Afterwards ``probe.fine``, and ``print(probe.status)``.

    Parameters
    ----------
    rig : Rig
    pulses : (n,) array_like
        Encoder counts now, at rest.
    arm : Arm, optional
        Its weight, and that of springs, at these counts is held all the time; without it the
        torques begin at zero.
    torque : (n,) array_like, optional
        Largest torque beside that [N m], joint side; by default 0.8 of `Guards.rest`, the band of
        static friction: 1.6 times the friction that is stated, or 1.6 % of the amplifier's limit if
        that is more.
    travel : float
        Pulses that end the push of a motor; any joint that goes ten times as far ends all.

    Attributes
    ----------
    done : bool
        Whether all motors were pushed, or the test was given up; `step` then gives the weight's
        torque, or zero.
    fine : bool
        Whether each motor moved its own counts upwards.
    status : str
        The findings, motor by motor.

    Raises
    ------
    ValueError
        Bad input; no default for `torque`, where neither friction nor a limit of the current is
        stated.

    Notes
    -----
    The torque is at most that of the weight plus `torque`, for at most 2 s a motor. A sign that is
    turned at the encoder cannot be told from one that is turned at the amplifier: either looks like
    counts that fall. An arm whose weight is not that of `arm` by more than friction bears moves by
    itself, and the test ends in zero torque.

    See Also
    --------
    plant.Guards

    Examples
    --------
    >>> from plant import FirstMotion, puma560
    >>> probe = FirstMotion(puma560.rig(), (0, 0), arm=puma560.arm())
    >>> probe.done, probe.step((0, 0)).shape
    (False, (2,))
    """

    def __init__(
        self,
        rig: Rig,
        pulses: ArrayLike,
        *,
        arm: Arm | None = None,
        torque: ArrayLike | None = None,
        travel: float = 12.0,
    ) -> None:
        instance("rig", rig, Rig, "Pass found.rig.")
        n = rig.n
        advice = "Give one torque above 0 per joint [N m]."
        # The default stays within the band of static friction of `Guards`, so that it can hardly
        # move a joint that friction holds at rest.
        largest = (
            SETTINGS.share * Guards().rest_band(rig)
            if torque is None
            else array("torque", torque, (n,), advice=advice)
        )
        if not (np.isfinite(largest) & (largest > 0)).all():
            raise ValueError(f"torque must be above 0 and finite; got {largest}. {advice}")
        self.travel = real("travel", travel, "Give pulses, such as 12.", positive=True)
        # Else a push would end before its counts can be told from a flicker.
        if travel < SETTINGS.counts:
            raise ValueError(
                f"travel must be at least {SETTINGS.counts} pulses; got {travel:g}."
                " Fewer are a cell's edge."
            )
        self.rig = rig
        self.n = n
        self.done = False
        # A line for each motor that was judged, in the order of the pushes.
        self._lines: list[str] = []
        self._weight = np.zeros(n)
        self._largest = largest
        counts = self._counts(pulses)
        # Without a model the arm must be held by friction or a counterweight; with one, its weight
        # is compensated at the initial counts.
        if arm is not None:
            instance("arm", arm, Arm, "Pass found.arm.")
            q = rig.cell_centre(counts)
            self._weight = arm.h(q, np.zeros(n)) - rig.spring_torque(q)
        # `_begin` bounds the motion of the whole test, `_latest` are the counts of the last call.
        self._begin = self._latest = counts
        self._labels = rig.joint_labels
        self._units = [TURNS] * n if arm is None else arm.dynamics.chain.joint_units
        self._plan = self._motors()
        self._torque = self._weight
        # The generator runs to its first torque, so that the first call of `step` sends it counts.
        next(self._plan)

    def step(self, pulses: ArrayLike) -> Floats:
        """Torque (n,) [N m], joint side, until the next call, one period of the rig later.

        Parameters
        ----------
        pulses : (n,) array_like
            Encoder counts, read now.

        Raises
        ------
        ValueError
            Wrong shape, or no finite number; nothing has changed then.
        """
        self._latest = self._counts(pulses)
        if not self.done:
            try:
                self._torque = next(self._plan)
            except StopIteration:
                self.done = True
        return np.array(self._torque)

    @property
    def fine(self) -> bool:
        # A finding on any motor: wires of the others may be swapped with it.
        return self.done and all(line.endswith(": fine") for line in self._lines)

    @property
    def status(self) -> str:
        return "\n".join(self._lines) if self._lines else "nothing was pushed yet"

    def __repr__(self) -> str:
        latest = self.status.splitlines()[-1]
        return (
            f"FirstMotion({'done' if self.done else 'at work'}, {len(self._lines)} findings;"
            f" {latest:.60})"
        )

    def _counts(self, pulses: ArrayLike) -> Floats:
        return np.array(
            array("pulses", pulses, (self.rig.n,), advice="Give the encoder counts."), dtype=float
        )

    def _motors(self) -> Iterator[Floats]:
        """The torques, one after another; between two of them the counts are new."""
        yield self._weight
        for motor in range(self.n):
            # 1. The arm must rest, so that the counts that follow belong to the push.
            push = self._push(motor)
            yield from self._rest()
            if self._gave_up(
                motor, "moved by itself before it was pushed; brake it, and check its weight"
            ):
                return
            # 2. Raise the torque until some encoder has counted, not only the motor's own: it may
            # be dead, or swapped.
            start = self._latest
            for share in (
                np.arange(1, round(SETTINGS.ramp / self.rig.period) + 1)
                * self.rig.period
                / SETTINGS.ramp
            ):
                yield self._weight + share * push
                if np.abs(self._latest - start).max() >= self.travel:
                    break
            # 3. Judge the counts at rest, since another joint may still swing during the push.
            yield from self._rest()
            moved = self._latest - start
            if self._gave_up(
                motor, "did not come to rest after its push; brake it, and check the signs"
            ):
                return
            self._lines.append(
                f"motor of {self._labels[motor]}: {self._finding(motor, moved, push)}"
            )

    def _push(self, motor: int) -> Floats:
        """The largest torque (n,) on the joints that turns one motor so that its counts rise."""
        # Column of the motor in the pulses per joint angle: power is conserved, so the torques that
        # turn this motor alone are in this proportion. The joint that reaches its largest torque
        # first scales them.
        per_joint = np.array([self.rig.position_in_pulses(unit) for unit in np.eye(self.n)])[
            :, motor
        ]
        return per_joint / np.abs(per_joint / self._largest).max()

    def _rest(self) -> Iterator[Floats]:
        """The weight's torque until no count has changed for a while."""
        still = 0.0
        counts = self._latest
        for _ in range(round(SETTINGS.settle / self.rig.period)):
            if still >= SETTINGS.still:
                return
            yield self._weight
            # A flicker by one count at the edge of a cell is no motion.
            still = (
                still + self.rig.period
                if np.abs(self._latest - counts).max() < SETTINGS.counts / 2
                else 0.0
            )
            counts = counts if still else self._latest

    def _gave_up(self, motor: int, why: str) -> bool:
        # From the beginning of the whole test: small moves of many pushes add up.
        far = np.abs(self._latest - self._begin) > 10 * self.travel
        if far.any():
            label = self._labels[int(np.argmax(far))]
            self._lines.append(f"motor of {self._labels[motor]}: {label} {why}")
            # No torque at all: the weight of a model that does not hold is no help.
            self._torque = np.zeros(self.n)
        return bool(far.any())

    def _finding(self, motor: int, moved: Floats, push: Floats) -> str:
        """Finding from the counts (n,) that moved when one motor was pushed to raise its own."""
        # The joint that moved most; others follow it by the arm's inertia.
        mover = int(np.abs(moved).argmax())
        if abs(moved[mover]) < SETTINGS.counts:
            largest = np.abs(push).max()
            unit = self._units[motor].effort
            return (
                f"no count moved up to {largest:.3g} {unit}: a brake, an encoder or an amplifier"
                " without power?"
            )
        if mover != motor:
            dead = "" if abs(moved[motor]) >= SETTINGS.counts else ", or its own encoder is dead"
            return (
                f"the counts of {self._labels[mover]} moved by {moved[mover]:+.0f}, its own by"
                f" {moved[motor]:+.0f}: encoders or amplifiers are swapped{dead}"
            )
        if moved[motor] < 0:
            return (
                f"its counts fell by {-moved[motor]:.0f}: turn the sign of gear, resolution or"
                " amplifier"
            )
        return "fine"
