"""`evaluate_float`: the force of a hand that guides an arm, and whether the arm rests afterwards.

The force is quasi-static: at each pose the tool is moved along a random direction of the joints,
and the hand gives the torque that the controller leaves. Released arms are simulated.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ctc.laws import Float
from identification import Identification
from plant import Arm, Chain, Harmonics, Rig, simulate
from plant.mechanics import joint_positions
from plant.parts import (
    Floats,
    Frozen,
    Piece,
    Shown,
    Table,
    Verdict,
    array,
    frozen,
    frozen_settings,
    instance,
)


@frozen_settings
class FloatTrialSettings:
    """Arms, poses and times of `evaluate_float`; all are chosen by hand.

    Parameters
    ----------
    arms : int
        Samples of the uncertainty.
    poses : int
        Poses of each at which the force of the hand is evaluated.
    duration : float
        Time after the release [s].
    drift : float
        Time at its end over which drift is measured [s].
    gravity, friction : float
        Relative standard deviations of gravity and friction of an arm without identification.
    rests : float
        Motion in the time of `drift` up to which an arm rests [pulses].
    """

    arms: int = 20
    poses: int = 100
    duration: float = 2.0
    drift: float = 0.5
    gravity: float = 0.05
    friction: float = 0.15
    rests: float = 1.0


SETTINGS = FloatTrialSettings()

_MOVE = 1e-5  # of the central difference [rad]: the way of a tool is smooth in it


@frozen
class FloatVerdict(Shown, Frozen):
    """How an arm feels in the hand; printed, a table.

    Attributes
    ----------
    limp, floating : (A, P) numpy.ndarray
        Force of the hand along the motion of the tool [N], without the law and with it.
    moved : (A, n) numpy.ndarray
        Way after the release [pulses].
    drift : (A, n) numpy.ndarray
        Motion in the last part of the trial [pulses]; NaN where the simulation diverged.

    See Also
    --------
    ctc.evaluate_float

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import Float, evaluate_float
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> verdict = evaluate_float(arm, Float(arm, rig, assist=0.4))
    >>> bool(abs(verdict.floating).max() < abs(verdict.limp).max())
    True
    """

    limp: Floats
    floating: Floats
    moved: Floats
    drift: Floats

    @property
    def rests(self) -> bool:
        """Whether all released arms move by at most `FloatTrialSettings.rests` at the end."""
        return bool((np.abs(self.drift) <= SETTINGS.rests).all())

    def _short(self) -> str:
        force = f"hand force {_rms(self.limp):.3g} -> {_rms(self.floating):.3g} N rms"
        # NaN of a diverged arm compares false: such an arm does not rest.
        resting = np.all(np.abs(self.drift) <= SETTINGS.rests, axis=1)
        return (
            f"{force}; {np.count_nonzero(resting)} of {len(self.drift)} released arms rest: they"
            f" move by at most {SETTINGS.rests:g} pulse in the last {SETTINGS.drift:g} s of"
            f" {SETTINGS.duration:g} s"
        )

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(self._short(), self.rests)
        # The force without the law comes first: what the law leaves of it is its merit.
        quantities = {
            "hand force, limp [N]": self.limp,
            "hand force, floating [N]": self.floating,
            "moved after release [pulses]": self.moved,
            "drift at the end [pulses]": self.drift,
        }
        rows = [
            (name, f"{_rms(values):.3g}", f"{np.nanmax(np.abs(values)):.3g}")
            for name, values in quantities.items()
        ]
        yield Table(("", "rms", "largest"), rows)


def evaluate_float(
    estimate: Any, law: Float, *, speed: float = 0.5, tip: ArrayLike = (0, 0, 0), seed: int = 0
) -> FloatVerdict:
    """Force of a hand on the tool, and motion after its release, over samples of the uncertainty.

    Parameters
    ----------
    estimate : Identification or Arm
        The arms are drawn from the covariance of an identification; of an arm, gravity within 5 %
        and friction within 15 % (one standard deviation).
    law : Float
    speed : float
        Speed of every joint when the hand lets go [rad/s, or m/s].
    tip : (3,) array_like
        Where the hand holds the last link, in its frame [m].
    seed : int

    Returns
    -------
    FloatVerdict

    Raises
    ------
    ValueError
        A law that is no `Float`.

    See Also
    --------
    ctc.Float, ctc.certify

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import Float, evaluate_float
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> evaluate_float(arm, Float(arm, rig, assist=0.4)).drift.shape
    (20, 2)
    """
    instance("law", law, Float, "Give ctc.Float.")
    tip = array("tip", tip, (3,), advice="Give a point in the frame of the last link [m].")
    random = np.random.default_rng(seed)
    dynamics = law.arm.dynamics
    poses = law.poses()[: SETTINGS.poses]
    # A hand moves joints together, in any ratio.
    directions = random.normal(size=poses.shape)
    # A direction may turn the tool about its own tip: the force is then bounded, not infinite.
    ways = np.maximum(_ways(dynamics.chain, poses, directions, tip), 1e-9)
    limp = []
    floating = []
    moved = []
    drift = []
    for arm, rig in _plants(estimate, law, random):
        # 1. The force along the way of the tool does the work of the torque.
        needed = _needed(arm, rig, poses, directions)
        helped = needed - _given(law, poses, directions)
        limp.append((needed * directions).sum(axis=1) / ways)
        floating.append((helped * directions).sum(axis=1) / ways)

        # 2. The arm when the hand lets go of it.
        # One release for each arm: a simulation takes longer than the forces at all poses.
        pose = poses[random.integers(len(poses))]
        start = np.stack([pose, speed * np.sign(random.normal(size=arm.n))])
        ways_of_joints = _released(arm, rig, law, start)
        moved.append(ways_of_joints[0])
        drift.append(ways_of_joints[1])
    return FloatVerdict(
        limp=np.array(limp),
        floating=np.array(floating),
        moved=np.array(moved),
        drift=np.array(drift),
    )


def _released(arm: Arm, rig: Rig, law: Float, start: Floats) -> Floats:
    """Way of the joints (2, n) after the release, and in the last part of it [pulses]."""
    zero = np.zeros((arm.n, 1))
    # The law ignores its reference; a simulation has one.
    here = Harmonics(period=SETTINGS.duration, offset=start[0], cosine=zero, sine=zero)
    try:
        record = simulate(arm, rig, law, here, duration=SETTINGS.duration, initial=start)
    except ValueError:  # it diverges
        return np.full((2, arm.n), np.nan)
    counts = record.counts
    late = np.searchsorted(record.t, SETTINGS.duration - SETTINGS.drift)
    return np.stack([counts[-1] - counts[0], counts[-1] - counts[late]])


def _plants(estimate: Any, law: Float, random: Any) -> Iterator[tuple[Arm, Rig]]:
    """Arms and rigs drawn from the uncertainty."""
    drive = law.rig.drive
    for _ in range(SETTINGS.arms):
        if isinstance(estimate, Identification) and estimate.fit.covariance is not None:
            fit = estimate.fit
            values = random.multivariate_normal(fit.values, fit.covariance, method="eigh")
            named = dict(zip(fit.unknown, values, strict=True))
            stated = dict(zip(law.arm.dynamics.names, law.arm.f, strict=True))
            f = [named.get(name, value) for name, value in stated.items()]
            yield law.arm.dynamics.arm(np.array(f)), law.rig.filled(named)
            continue
        # All of f by one factor: that is a weight which is wrong, and an arm that exists.
        scale = 1 + SETTINGS.gravity * random.normal()
        shares = np.maximum(1 + SETTINGS.friction * random.normal(size=law.arm.n), 0.0)
        named = {f"drive.coulomb[{i}]": drive.coulomb[i] * shares[i] for i in range(law.arm.n)}
        yield law.arm.dynamics.arm(law.arm.f * scale), law.rig.filled(named)


def _needed(arm: Arm, rig: Rig, poses: Floats, directions: Floats) -> Floats:
    """Torque (P, n) of a slow motion along the directions [N m]: gravity and Coulomb friction."""
    return _gravity(arm, poses) + rig.drive.joint_coulomb(np.zeros(arm.n)) * np.sign(directions)


def _given(law: Float, poses: Floats, directions: Floats) -> Floats:
    """The part of it (P, n) that the law gives, whose observer sees the motion."""
    friction = law.assist * law.rig.drive.joint_coulomb(np.zeros(law.arm.n))
    return _gravity(law.arm, poses) + friction * np.sign(directions)


def _gravity(arm: Arm, poses: Floats) -> Floats:
    return np.array([arm.dynamics.gravity(pose, arm.f).full().ravel() for pose in poses])


def _ways(chain: Chain, poses: Floats, directions: Floats, tip: Floats) -> Floats:
    """Way (P,) of the tool [m] per unit of the directions, by a central difference."""
    positions = joint_positions(chain, tip)
    forward, backward = (
        np.array([positions(pose).full()[:, -1] for pose in poses + move])
        for move in (_MOVE * directions, -_MOVE * directions)
    )
    return np.linalg.norm(forward - backward, axis=1) / (2 * _MOVE)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
