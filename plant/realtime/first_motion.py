"""First motion of an arm: a small torque on each motor in turn shows wires turned or swapped."""

from collections.abc import Generator, Iterator

import numpy as np
from numpy.typing import ArrayLike

from plant.machine import Rig
from plant.mechanics import Arm
from plant.parts import TURNS, Floats, array, frozen_settings, instance, known_options, real
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
        Largest torque of a push, relative to the band of static friction, which reaches from full
        friction in one direction to full friction in the other.
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

    One motor after another gets an added torque that rises from zero until some encoder has counted
    `travel` pulses or the torque is at its largest. The added torque is then zero until the arm
    rests. A motor is fine if its own counts moved most, and upwards. Run the test before any path,
    with the arm's brakes released and nobody near: ``while not probe.done:
    apply(probe.step(read()))``. Then read ``probe.fine``, and ``print(probe.status)``.

    Parameters
    ----------
    rig : Rig
    pulses : (n,) array_like
        Encoder counts now, at rest.
    arm : Arm, optional
        Model for the torque that holds the arm's weight, less that of the springs, at `pulses`.
        The test applies this torque until the test is given up. Without `arm` the torque is zero.
    torque : (n,) array_like, optional
        Largest torque of a push, added to that of the weight [N m], joint side. By default it is
        0.8 of `Guards.rest`, the band of static friction: 1.76 times the stated friction, or 8 % of
        the amplifier's limit if that is more.
    travel : float
        Pulses of any encoder that end a push; of a finer encoder than the motor's own as many as
        its own would need to show the motion. The test is given up at once if an encoder is more
        than ten times `travel` from `pulses`.

    Attributes
    ----------
    done : bool
        Whether all motors were pushed, or the test was given up. `step` then gives the weight's
        torque in the first case, and zero in the second.
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
    counts that fall. If the weight of `arm` is wrong by more than friction bears, the arm moves by
    itself, and the test ends with zero torque. It also ends so if the arm does not come to rest
    before or after a push, since its counts would say nothing of the push.

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
        # The default exceeds the stated friction, so that it can move a joint, and stays below the
        # width of the band of static friction of `Guards`.
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
        # Angle of a pulse [rad]: pulses of two encoders may differ in size. A metre of a slide
        # counts as a radian, since arms are about a metre long.
        self._pulse = np.abs(1 / rig.encoder.position_in_pulses(rig.drive.gear))
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
        # What is said of a joint that runs away now: of which motor's push, and why.
        self._motor = 0
        self._runaway = ""
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
        # From the beginning of the whole test: small moves of many pushes add up.
        moved = np.abs(self._latest - self._begin)
        if not self.done and moved.max() > 10 * self.travel:
            self._give_up(int(moved.argmax()), self._runaway)
        if not self.done:
            try:
                self._torque = next(self._plan)
            except StopIteration:
                self.done = True
        return np.array(self._torque)

    @property
    def fine(self) -> bool:
        # One bad motor fails the test, since its wires may be swapped with those of another motor.
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
        for motor in range(self.n):
            # 1. The arm must rest, so that the counts that follow belong to the push.
            self._motor = motor
            self._runaway = "moved by itself before it was pushed; brake it, and check its weight"
            mover = yield from self._rest()
            if mover is not None:
                self._give_up(mover, self._runaway)
                return
            # 2. Raise the torque until some encoder has counted, not only the motor's own: it may
            # be dead, or swapped. A finer one may count before the motor's own can.
            bound = f"{10 * self.travel:g} counts"
            self._runaway = f"went farther than {bound}; brake it, and check signs and travel"
            push = self._push(motor)
            start = self._latest
            for share in self._shares():
                yield self._weight + share * push
                moved = np.abs(self._latest - start)
                shown = (moved * self._pulse).max() >= SETTINGS.counts * self._pulse[motor]
                if moved.max() >= self.travel and shown:
                    break
            # 3. Judge the counts at rest, since another joint may still swing during the push.
            mover = yield from self._rest()
            if mover is not None:
                self._give_up(
                    mover, "did not come to rest after its push; brake it, and check the signs"
                )
                return
            finding = self._finding(motor, self._latest - start, push)
            self._lines.append(f"motor of {self._labels[motor]}: {finding}")

    def _shares(self) -> Floats:
        """Shares of the largest torque, sample by sample; the last one is 1 at any period."""
        steps = max(1, round(SETTINGS.ramp / self.rig.period))
        return np.arange(1, steps + 1) / steps

    def _push(self, motor: int) -> Floats:
        """The largest torque (n,) on the joints that turns one motor so that its counts rise."""
        # Column of the motor in the pulses per joint angle: power is conserved, so the torques that
        # turn this motor alone are in this proportion. The joint that reaches its largest torque
        # first scales them.
        per_joint = np.array([self.rig.position_in_pulses(unit) for unit in np.eye(self.n)])[
            :, motor
        ]
        return per_joint / np.abs(per_joint / self._largest).max()

    def _rest(self) -> Generator[Floats, None, int | None]:
        """The weight's torque until the counts rest; returns the joint that moves after `settle`.

        It returns None where the arm rests.
        """
        still = 0.0
        counts = self._latest
        mover = None
        # A flicker at the edge of a cell is no motion, nor is the noise of a fine encoder, to which
        # the user adapts `travel`. A sixth of the usual `travel` is half of `counts`.
        flicker = max(SETTINGS.counts / 2, self.travel / 6)
        for _ in range(max(1, round(SETTINGS.settle / self.rig.period))):
            yield self._weight
            moved = np.abs(self._latest - counts)
            if moved.max() < flicker:
                still += self.rig.period
                if still >= SETTINGS.still:
                    return None
            else:
                still = 0.0
                counts = self._latest
                mover = int(moved.argmax())
        return mover

    def _give_up(self, joint: int, why: str) -> None:
        """End the test, since this joint moves as it must not."""
        self._lines.append(f"motor of {self._labels[self._motor]}: {self._labels[joint]} {why}")
        # No torque at all: the weight of a model that does not hold is no help.
        self._torque = np.zeros(self.n)
        self.done = True

    def _finding(self, motor: int, moved: Floats, push: Floats) -> str:
        """Finding from the counts (n,) that moved when one motor was pushed to raise its own."""
        counted = np.abs(moved) >= SETTINGS.counts
        if not counted.any():
            largest = np.abs(push).max()
            unit = self._units[motor].effort
            return (
                f"no count moved up to {largest:.3g} {unit}: a brake, an encoder or an amplifier"
                " without power?"
            )
        # The joint that moved most, by its angle; others follow it by the arm's inertia.
        mover = int(np.where(counted, np.abs(moved) * self._pulse, 0.0).argmax())
        if mover != motor:
            dead = "" if counted[motor] else ", or its own encoder is dead"
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
