"""Guards of a running controller: what they monitor, and when and how they stop the arm."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.machine.rig import Rig
from plant.parts.arguments import array, choice, known_options, real
from plant.realtime import safety
from plant.realtime.torque_monitor import WINDOW

__all__ = ["Guards"]

STOPS = ("hold", "gravity", "zero")


@known_options
@dataclasses.dataclass(frozen=True, kw_only=True)
class Guards:
    """Settings of the guards of a running controller; ``np.inf`` switches one of them off.

    A bad sample is bridged; more than `patience` of them in a row stop the arm. A stop lasts until `Running.reset`.
    `saturation` and `chatter` are shares of the amplifier's limit, or of the controller's ``torque_limit``, on the
    shafts; they monitor laws with a period, and others where the calls are given `now`.

    Parameters
    ----------
    jump : float or (n,) array_like, optional
        Largest innovation [pulses]: count minus the one predicted from the last speed; as much again as the joint
        moves in a sample is allowed. By default 8 and four times what the amplifiers can add to the motion within one
        sample, on the rotor inertias alone; a tenth of a turn of the motor where one of these is not known (infinite,
        or zero). Bridged by the predicted count.
    stuck : float or (n,) array_like, optional
        Pulses by which the reference may move while the counts do not and the torque leaves a band of three times
        static friction. By default a fortieth of a turn of the motor. Stops at once.
    error : float or (n,) array_like, optional
        Largest tracking error [pulses]. By default one turn of the motor. Stops at once.
    saturation : float or (n,) array_like, optional
        Share of the last 100 ms at the limit. Stops as soon as it is reached, without a hold; None, too, for off.
    chatter : float or (n,) array_like, optional
        Mean distance of the torque from its mean over the last 10 ms, averaged over 50 ms, as a share of the limit: an
        oscillation of some three quarters of the limit, at which a sound loop does not work. Stops as soon as it is
        reached, without a hold; None, too, for off.
    late : float
        Share of a period by which a call may come late, if it is given `now`. A later one counts as one bad sample per
        missing period, and the law is given the time that really passed.
    patience : int
        Bad samples in a row that are bridged.
    stop : {"hold", "gravity", "zero"}
        Brake to a standstill under the law and hold there; or stop with gravity compensation (laws with an ``arm``), or
        without torque: the torque ramps there within a tenth of `duration`, with damping by the measured speeds. A hold
        becomes such a ramp (to gravity compensation where the law has an arm) where there is no feedback to hold by: an
        encoder stands still, goes on jumping, the law gives no finite torque, or one that saturates or chatters; then
        the ramp begins at the mean torque.
    duration : float
        Of the braking [s].

    Raises
    ------
    ValueError
    """

    jump: ArrayLike | None = None
    stuck: ArrayLike | None = None
    error: ArrayLike | None = None
    saturation: ArrayLike | None = 0.5
    chatter: ArrayLike | None = 0.45
    late: float = 0.5
    patience: int = 3
    stop: str = "hold"
    duration: float = 0.2

    def __post_init__(self) -> None:
        for name in ("jump", "stuck", "error", "late"):
            value = getattr(self, name)
            if value is None and name != "late":
                continue
            given = array(name, value, np.shape(value)[:1], finite=False, advice="Give pulses; np.inf switches it off.")
            if not (given > 0).all():
                raise ValueError(f"{name} must be positive; got {value}. np.inf switches it off.")
        for name in ("saturation", "chatter"):
            self._share(name)
        if isinstance(self.patience, bool) or not isinstance(self.patience, (int, np.integer)) or self.patience < 0:
            raise ValueError(f"patience must be a whole number of samples, 0 or more; got {self.patience!r}. Try 3.")
        if np.ndim(self.late):
            raise ValueError(f"late must be one number; got {self.late}. Give a share of the period.")
        choice("stop", self.stop, STOPS)
        real("duration", self.duration, "Give seconds.", positive=True)

    def limits(self, rig: Rig) -> NDArray[np.float64]:
        """Limits of jump, stuck and error on this rig [pulses], and the band of static friction [N m]: (4, n)."""
        drive, turn = rig.drive, rig.encoder.resolution
        inertia, torque = drive.reflected_inertia(), drive.torque_limit()
        jump, friction = turn / 10, drive.coupling.joint_torque(drive.joint_coulomb())
        if (inertia > 0).all() and np.isfinite(torque).all():
            # D is at least the motors' inertia, so D^-1 at most its inverse: |qdd_i| <= sum_j tau_j / sqrt(J_i J_j).
            added = np.sum(torque / np.sqrt(inertia)) / np.sqrt(inertia) * rig.period**2
            jump = 8 + 4 * np.abs(rig.position_in_pulses(drive.coupling.joint(added)))
        given = [self._each(name, default) for name, default in (("jump", jump), ("stuck", turn / 40), ("error", turn))]
        return np.array([*given, 3 * np.abs(friction)])

    def torque_limits(self, rig: Rig) -> NDArray[np.float64]:
        """Limits of time at the torque limit [s] and of the torque's swing, on the shaft [N m]: (2, n)."""
        share, swing = (self._each(name, np.full(rig.n, np.inf)) for name in ("saturation", "chatter"))
        return np.array([share * WINDOW, swing * rig.drive.torque_limit()])

    def _share(self, name: str) -> None:
        value, advice = getattr(self, name), "Give a share of the limit; np.inf switches it off."
        given = array(name, np.inf if value is None else value, np.shape(value)[:1], finite=False, advice=advice)
        if not ((given > 0) & ((given <= 1) | (given == np.inf))).all():
            raise ValueError(f"{name} must be above 0 and at most 1; got {value}. {advice}")

    def _each(self, name: str, default: NDArray[np.float64]) -> NDArray[np.float64]:
        value = getattr(self, name)
        if value is None:
            return default
        value = np.full(len(default), value) if np.ndim(value) == 0 else value
        return array(name, value, default.shape, finite=False, advice="Give one number, or one per joint.")


def wording(cause: float, joint: str, amount: float) -> str:
    """A cause in words, with the joint's label; `amount` is what the core noted with it."""
    return {
        safety.WAS_LATE: f"a call that came {1e3 * amount:.3g} ms late",
        safety.HAD_GAPS: "a reference that is no finite position",
        safety.HAS_JUMPED: f"a jump of {abs(amount):.0f} pulses of {joint}",
        safety.IS_STUCK: f"the encoder of {joint} stands still while its reference moved by {abs(amount):.0f} pulses",
        safety.IS_OFF: f"{joint} is {abs(amount):.0f} pulses from its reference",
        safety.NO_TORQUE: "the law gives no finite torque",
        safety.IS_SATURATED: f"the torque of {joint} was at its limit for {1e3 * amount:.0f} of 100 ms",
        safety.CHATTERS: f"the torque of {joint} swings by {amount:.0f} N m about its mean",
    }[int(cause)]
