"""Guards of a running controller: the signals that they monitor, and the stops that they begin."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant.machine import Rig
from plant.mechanics import Limits
from plant.parts import Floats, array, choice, instance, known_options, real, warn

# Length of the window in which time at the limit is counted [s].
WINDOW = 0.1


@dataclasses.dataclass(frozen=True, kw_only=True)
class GuardDefaults:
    """Numbers of limits that `Guards` derives from the rig; all are chosen by hand.

    Parameters
    ----------
    rest_band : float
        Change of the torque, relative to static friction, that leaves a joint at rest: from one
        edge of its band to the other, and a tenth more than the rig states.
    rest_share : float
        Share of the torque limit by which the torque of a joint at rest may change, whatever its
        friction.
    hold_speed : float
        Speed that is no rise in a hold [turns of the motor per second].
    arm_turns : float
        Turns, from end to end or per second, that no joint of an arm makes: more are degrees.
    """

    rest_band: float = 2.2
    rest_share: float = 0.1
    hold_speed: float = 5.0
    arm_turns: float = 5.0


DEFAULTS = GuardDefaults()

STOPS = ("hold", "gravity", "zero")

# Options that must be positive, with the advice of their errors.
_POSITIVE = dict.fromkeys(
    ("jump", "stuck", "error", "late"), "Give pulses; np.inf switches it off."
)
# Advice for options that must be positive if they are given.
_POSITIVE |= dict.fromkeys(("rest", "speed", "torque_rate", "rhythm", "braking"), "Give a number.")


@known_options
@dataclasses.dataclass(frozen=True, kw_only=True)
class Guards:
    """Settings of the guards of a running controller; ``np.inf`` switches one of them off.

    A bad sample is bridged; more than `patience` of them in a row stop the arm. A stop lasts until
    `Running.reset`. `saturation` and `chatter` are shares of the amplifier's limit, or of the
    controller's ``torque_limit``, on the shafts. They and `rest` monitor laws with a period, and
    others where the calls are given `now`.

    Parameters
    ----------
    jump : float or (n,) array_like, optional
        Largest innovation [pulses]: count minus the one predicted from the last speed. The motion
        of the joint within a sample is allowed beside it. By default 8 and four times what the
        amplifiers can add to the motion within one sample, on the rotor inertias alone; a tenth of
        a turn of the motor where one of these is not known (infinite, or zero). Bridged by the
        predicted count.
    stuck : float or (n,) array_like, optional
        Pulses by which the reference may move while the counts do not and the torque leaves a band
        of three times static friction. By default a fortieth of a turn of the motor. Stops at once.
    error : float or (n,) array_like, optional
        Largest tracking error [pulses]. By default one turn of the motor. Stops at once.
    saturation : float or (n,) array_like, optional
        Share of the last 100 ms at the limit. Stops as soon as it is reached, without a hold; None,
        too, for off.
    chatter : float or (n,) array_like, optional
        Mean distance of the torque from its mean over the last 10 ms, averaged over 50 ms, as a
        share of the limit: an oscillation of some three quarters of the limit, at which a sound
        loop does not work. Stops as soon as it is reached, without a hold; None, too, for off.
    late : float
        Share of a period by which a call may come late, if it is given `now`. A later one counts as
        one bad sample per missing period, and the law is given the time that really passed.
    patience : int
        Bad samples in a row that are bridged.
    stop : {"hold", "gravity", "zero"}
        Brake to a standstill under the law and hold there; or stop with gravity compensation (laws
        with an ``arm``), or without torque: the torque ramps there within a tenth of `duration`,
        with damping by the measured speeds. A hold becomes such a ramp (to gravity compensation
        where the law has an arm) where there is no feedback to hold by: an encoder stands still,
        goes on jumping, the law gives no finite torque, or one that saturates or chatters. In the
        last two cases the ramp begins at the mean torque.
    duration : float
        Of the braking [s].
    rest : float or (n,) array_like, optional
        Change of the joint torque [N m] that leaves a joint at rest. A larger one, for 20 ms
        without a count, stops: the encoder is dead, or the joint blocked. What the law's model
        needs for the motion of the other joints is allowed beside it, within half of that; a law
        without a model is monitored only while no reference moves. By default 2.2 times the rig's
        friction, assuming that static friction is at most a tenth above it, and a tenth of the
        limit at least.
    rhythm : float
        Share by which the reference may be slower or faster than its speed ``qd_r`` says, averaged
        over ten samples in which it moves by a pulse and more. It shows lost and doubled calls
        without `now`, where the reference is a function of time. Stops at once.
    position : (2, n) array_like, optional
        Lowest and highest joint position [rad]. Stops at once.
    speed : float or (n,) array_like, optional
        Largest measured joint speed [rad/s]. Stops at once.
    torque_rate : float or (n,) array_like, optional
        Largest rate of the joint torque [N m/s]. A faster change is given in part. If it goes on,
        it stops the arm.
    braking : float
        Total time [s] for which a torque may be at its limit in a stop. After that, or once a joint
        is faster than the stop can make it, there is no torque until `Running.reset`, and
        ``status.brake`` asks for the brake.
    limits_of : Limits, optional
        Such as ``chain.limits`` of a model file: its positions and speeds, where `position` and
        `speed` are not given. Its efforts are for ``law.start(torque_limit=chain.limits.effort)``.

    See Also
    --------
    plant.FirstMotion, plant.Law

    Examples
    --------
    >>> from plant import Guards, puma560
    >>> law, rig = puma560.p_law(), puma560.rig()
    >>> guards = Guards(stop="zero", speed=2.0)
    >>> controller = law.start(rig, (0, 0), guards=guards, torque_limit=(100, 50))
    >>> print(controller.status)
    running
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
    rest: ArrayLike | None = None
    rhythm: float = 0.4
    position: ArrayLike | None = None
    speed: ArrayLike | None = None
    torque_rate: ArrayLike | None = None
    braking: float = 0.05
    limits_of: Limits | None = None

    def __post_init__(self) -> None:
        if self.limits_of is not None:
            advice = "Give chain.limits, or position= and speed=."
            instance("limits_of", self.limits_of, Limits, advice)
        for name, advice in _POSITIVE.items():
            value = self._stated(name)
            # These two hold for the arm as a whole, the others for each joint.
            single = name in ("rhythm", "braking")
            # None selects a default that depends on the rig (`limits`, `rest_band`) or no limit.
            if value is None and not single and name != "late":
                continue
            shape = () if single else np.shape(value)[:1]
            if not (array(name, value, shape, finite=False, advice=advice) > 0).all():
                raise ValueError(f"{name} must be positive; got {value}. np.inf switches it off.")
        for name in ("saturation", "chatter"):
            value = getattr(self, name)
            advice = "Give a share of the limit; np.inf switches it off."
            share = array(
                name,
                # None switches these off, as infinity does.
                np.inf if value is None else value,
                np.shape(value)[:1],
                finite=False,
                advice=advice,
            )
            # An infinite share switches off; any other above 1 is a percentage or a torque.
            if not ((share > 0) & ((share <= 1) | (share == np.inf))).all():
                raise ValueError(f"{name} must be above 0 and at most 1; got {value}. {advice}")
        if (
            isinstance(self.patience, bool)
            or not isinstance(self.patience, (int, np.integer))
            or self.patience < 0
        ):
            raise ValueError(
                f"patience must be a whole number of samples, 0 or more; got {self.patience!r}."
                " Try 3."
            )
        # One clock serves all joints.
        if np.ndim(self.late):
            raise ValueError(
                f"late must be one number; got {self.late}. Give a share of the period."
            )
        choice("stop", self.stop, STOPS)
        real("duration", self.duration, "Give seconds.", positive=True)

        # From 1 on, `rhythm_limits` would allow a reference that stands still, and divide by zero.
        if not (self.rhythm < 1 or self.rhythm == np.inf):
            raise ValueError(f"rhythm must be below 1; got {self.rhythm}. np.inf switches it off.")
        position = self._stated("position")
        if position is not None:
            low, high = array(
                "position",
                position,
                (2, None),
                finite=False,
                advice="Give lowest and highest.",
            )
            if not (low < high).all():
                raise ValueError(
                    f"position must be (lowest, highest); got {low} and {high}. Exchange them."
                )

    def warn_of_units(self, rig: Rig) -> None:
        """Warn of limits that stop no arm: angles in degrees, or positions in mm."""
        low, high, speed, _ = self.motion_limits(rig)
        # No joint of an arm turns so far, from end to end, nor so far in a second.
        limit = 2 * np.pi * DEFAULTS.arm_turns
        for i, label in enumerate(rig.joint_labels):
            # Infinite limits are no limits, and no mistake.
            if np.isfinite(high[i] - low[i]) and high[i] - low[i] > limit:
                warn(
                    f"position of Guards lets {label} move from {low[i]:g} to {high[i]:g}, in rad"
                    " or m: is it in degrees or mm?"
                )
            if limit < speed[i] < np.inf:
                warn(
                    f"speed of Guards lets {label} move at {speed[i]:g}, in rad/s or m/s: is it in"
                    " degrees or mm per second?"
                )

    def limits(self, rig: Rig) -> Floats:
        """Limits of jump, stuck and error [pulses], and band of static friction [N m]: (4, n)."""
        drive = rig.drive
        turn = rig.encoder.resolution
        inertia = drive.reflected_inertia()
        torque = drive.torque_limit()
        # A tenth of a turn of the motor, unless inertia and torque tell how far a sample can go.
        jump = turn / 10
        friction = _of_all_motors(rig, drive.joint_coulomb())
        if (inertia > 0).all() and np.isfinite(torque).all():
            # D is at least the motors' inertia, so D^-1 at most its inverse: |qdd_i| <= sum_j tau_j
            # / sqrt(J_i J_j).
            added = np.sum(torque / np.sqrt(inertia)) / np.sqrt(inertia) * rig.period**2
            jump = 8 + 4 * np.abs(rig.position_in_pulses(drive.coupling.joint(added)))
        # By default a fortieth of a turn without a count, and a turn of tracking error.
        limits = [
            self._per_joint(name, default)
            for name, default in (("jump", jump), ("stuck", turn / 40), ("error", turn))
        ]
        # Three times static friction: the band has twice its level, and the rest is a margin.
        return np.array([*limits, 3 * friction])

    def rest_band(self, rig: Rig) -> Floats:
        """Change of torque (n,) [N m] that leaves a joint at rest."""
        limit = _of_all_motors(rig, rig.drive.torque_limit())
        # An infinite limit has no share.
        floor = np.where(np.isfinite(limit), DEFAULTS.rest_share * limit, np.inf)
        # `limits` has three times the friction.
        band = DEFAULTS.rest_band / 3 * self.limits(rig)[3]
        # Without a limit of the torque only friction bounds the band; without friction, too, the
        # band is infinite and the guard off.
        return self._per_joint(
            "rest", np.where(np.isfinite(floor) | (band == 0), np.fmax(band, floor), band)
        )

    def motion_limits(self, rig: Rig) -> Floats:
        """Lowest, highest position [rad], largest speed [rad/s], torque rate [N m/s]: (4, n)."""
        # An arm without limits of its own moves freely.
        free = np.full(rig.n, np.inf)
        position = self._stated("position")
        position = array(
            "position",
            [-free, free] if position is None else position,
            (2, rig.n),
            finite=False,
            advice="Give one of each per joint.",
        )
        return np.array(
            [*position, self._per_joint("speed", free), self._per_joint("torque_rate", free)]
        )

    def rhythm_limits(self) -> tuple[float, float]:
        """Lowest and highest rate of the reference, relative to its speed."""
        # The upper limit is the inverse of the lower, so lost and doubled calls count alike.
        return (
            (-np.inf, np.inf) if self.rhythm == np.inf else (1 - self.rhythm, 1 / (1 - self.rhythm))
        )

    def slack(self, rig: Rig) -> Floats:
        """Speed (n,) [pulses/s] that is no rise in a hold: some turns of the motor, two pulses."""
        return DEFAULTS.hold_speed * rig.encoder.resolution + 2 / rig.period

    def torque_limits(self, rig: Rig) -> Floats:
        """Limits of the time at the torque limit [s] and of the shaft's swing [N m]: (2, n)."""
        share, swing = (
            self._per_joint(name, np.full(rig.n, np.inf)) for name in ("saturation", "chatter")
        )
        # Both limits apply on the shafts, where the amplifiers end.
        return np.array([share * WINDOW, swing * rig.drive.torque_limit()])

    def _stated(self, name: str) -> Any:
        """A field; where it is not given, what `limits_of` has in its place."""
        value = getattr(self, name)
        # Not stored in the field: a copy with other `limits_of` has theirs.
        if value is None and self.limits_of is not None:
            limits = self.limits_of
            value = {"position": (limits.lower, limits.upper), "speed": limits.velocity}.get(name)
        return value

    def _per_joint(self, name: str, default: Floats) -> Floats:
        value = self._stated(name)
        if value is None:
            return default
        # One number holds for every joint.
        value = np.full(len(default), value) if np.ndim(value) == 0 else value
        return array(
            name, value, default.shape, finite=False, advice="Give one number, or one per joint."
        )


def _of_all_motors(rig: Rig, levels: Floats) -> Floats:
    """Largest joint torques (n,) [N m] of levels (n,) [N m] on the shafts, of either sign."""
    # Where motors are coupled, several of them hold one joint: one row per motor alone.
    return np.abs(rig.drive.coupling.joint_torque(np.diag(levels))).sum(axis=0)


def limited(rig: Rig, torque_limit: ArrayLike | None) -> Rig:
    """A rig whose amplifiers end at these torques (n,) [N m], on the joint (or shaft)."""
    if torque_limit is None:
        return rig
    advice = "Give one torque above 0 per joint [N m]."
    limit = array("torque_limit", torque_limit, (rig.n,), advice=advice, finite=False)
    if not (limit > 0).all():
        raise ValueError(f"torque_limit must be positive; got {limit}. {advice}")
    # Law and guards then know this limit as the amplifier's.
    return dataclasses.replace(rig, drive=rig.drive.limited_to(limit))
