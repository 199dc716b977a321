"""A law that adds a torque, learnt along one path, to the torque of an inner law."""

import dataclasses
import functools
import operator
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ctc.learning.settings import SETTINGS
from plant import Law, Reference, Rig, state_of
from plant.laws import Block, Setpoint, Step
from plant.parts import Fields, Floats, Vector, array, number, part, per_joint, scalars, structure
from plant.realtime import Running


@part
class LearntTorque(Law):
    """tau = tau of a law + sum over k of a_k cos(k pi t / T), learnt by `learn` along one path.

    T is the duration of the path, and t is the time since the law began. After T, the learnt
    torque keeps its value at T.

    Parameters
    ----------
    law : Law
        Any controller.
    rig, reference : Rig, Reference
        Rig on which, and path along which, `learn` repeated the motion.
    terms : (K n,) array_like
        a_0 of all joints [N m], then a_1 of all joints, ...
    start_distance : float
        Distance [pulses] from the start of the path within which `start` accepts an arm.

    Raises
    ------
    ValueError
        If the law replays or is itself a `LearntTorque`, or if the number of terms is zero or no
        multiple of the number of joints. `block` refuses a rig with another period, gear, motor
        gain or resolution; `require_reference` refuses another path.

    See Also
    --------
    ctc.learn

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import LearntTorque
    >>> p, rig, path = puma560.p_law(), puma560.rig(), puma560.reference()
    >>> law = LearntTorque(law=p, rig=rig, reference=path, terms=(1.0, 0.5))
    >>> law.torque([0.0, 1.0])
    array([[1. , 0.5],
           [1. , 0.5]])
    """

    law: Law = structure(Law)
    rig: Rig = structure(Rig)
    reference: Reference = structure(Reference)
    terms: Vector = number(("m",))
    start_distance: float = structure(float, default=SETTINGS.start_distance)

    def __post_init__(self) -> None:
        super().__post_init__()
        # The inner law must be a controller. To learn further, `learn` adds to the terms of this
        # law instead of nesting it in another.
        if self.law.replays or isinstance(self.law, LearntTorque):
            raise ValueError(
                f"law must be a controller; got {type(self.law).__name__}. Give its inner law."
            )
        if not len(self.terms) or len(self.terms) % self.rig.n:
            raise ValueError(
                f"terms must be as many for each of {self.rig.n} joints; got {len(self.terms)} in"
                " all. Add zeros."
            )

    @property
    def period(self) -> float | None:  # type: ignore[override]  # Law declares an attribute
        """Period of the inner law [s]; None if the inner law is not sampled."""
        return self.law.period

    @property
    def arm(self) -> Any:
        """Arm of the inner law; None of a law without a model."""
        return getattr(self.law, "arm", None)

    def torque(self, t: ArrayLike) -> Floats:
        """Learnt torque (N, n) at times t (N,) [s]."""
        a = np.reshape(self.terms, (-1, self.rig.n))
        end = self.reference.duration
        share = np.clip(np.asarray(t, float), 0, end) / end
        return np.cos(np.pi * np.outer(share, np.arange(len(a)))) @ a

    @functools.cached_property
    def fields(self) -> Fields:
        """State of the inner law, torque added last [N m], time [s], 1 once the law has begun."""
        return Fields(law=state_of(self.law), added=per_joint(), time=scalars(), begun=scalars())

    def sliding(self) -> Law:
        """This law, with an inner law that compensates no dry friction."""
        return dataclasses.replace(self, law=self.law.sliding())

    def require_reference(self, reference: Reference) -> None:
        """Refuse another path."""
        if reference != self.reference:
            raise ValueError(
                "reference must be the path along which it was learnt; got another"
                f" {type(reference).__name__}. Learn along it, or use the arm and rig that learn"
                " corrected."
            )

    def block(self, rig: Rig) -> Block:
        """This law as a symbolic step for the rig on which it was learnt."""
        self._require_rig(rig)
        self.law.block(rig)  # refuses a rig that is not the law's
        return super().block(rig)

    def _require_rig(self, rig: Rig) -> None:
        """Refuse another rig than that on which the torque was learnt."""
        # These numbers convert counts, currents and time. Friction and the other parameters may be
        # identified again without loss of the learnt torque.
        for name, path in (
            ("period", "period"),
            ("gear", "drive.gear"),
            ("motor gain", "drive.motor_gain"),
            ("resolution", "encoder.resolution"),
        ):
            value_of = operator.attrgetter(path)
            expected = value_of(self.rig)
            value = value_of(rig)
            same_shape = np.shape(expected) == np.shape(value)
            if not (same_shape and np.allclose(value, expected, rtol=1e-9, atol=0)):
                raise ValueError(
                    f"rig must be that on which the torque was learnt, {name} {expected};"
                    f" got {value}. Learn on this one."
                )

    def start(self, rig: Rig, pulses: ArrayLike, **options: Any) -> Running:
        """As `Law.start`, for an arm that stands where the path begins.

        Raises
        ------
        ValueError
            If the rig is another one, if the inner law refuses it or the pulses, or if the arm
            stands elsewhere.
        """
        # The rig comes first: counts of another one lie elsewhere, wherever its arm stands.
        self._require_rig(rig)
        # The learnt torque belongs to times along the path: from another position it would push the
        # arm off the path at once.
        begins = self.rig.counts(self.reference([0.0]).q[0])
        advice = "Give the encoder count of each joint."
        counts = array("pulses", pulses, (self.rig.n,), advice=advice)
        if (np.abs(counts - begins) > self.start_distance).any():
            raise ValueError(
                f"pulses must be where the learnt path begins, {begins}; got {counts}. Move the arm"
                " there."
            )
        getattr(self.law, "require_stable", lambda *_: None)(rig, pulses)
        return super().start(rig, pulses, **options)

    def friction_in(self, state: Floats) -> Floats:
        """Friction that the inner law has learnt, in this state."""
        return self.law.friction_in(self.fields.read(state, self.rig.n).law)

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Torque of the inner law plus the learnt torque, which the inner law never observes."""
        n = rig.n
        stored = self.fields.read(state, n)
        end = self.reference.duration
        # `begun` is 0 at the first sample, so that the time starts at zero there whatever dt is.
        time = stored.begun * (stored.time + dt)

        # cos(k x) by Chebyshev's recursion, cos((k + 1) x) = 2 cos(x) cos(k x) - cos((k - 1) x):
        # one cosine in the controller, however many terms.
        cosine = ca.cos(ca.pi / end * ca.fmin(time, end))
        previous = cosine
        term = ca.SX(1)
        added = ca.SX.zeros(n)
        for amplitude in ca.vertsplit(self.terms, n):
            added += amplitude * term
            following = 2 * cosine * term - previous
            previous = term
            term = following
        # The observer of the inner law compares torque with motion. If its input contained the
        # learnt torque, the observer would estimate the missing torque again and cancel what was
        # learnt.
        inner_torque = torque - stored.added
        commanded, memory = self.law.equations(rig, stored.law, setpoint, pulses, inner_torque, dt)
        return commanded + added, self.fields.write(n, law=memory, added=added, time=time, begun=1)
