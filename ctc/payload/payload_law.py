"""A control law whose model carries a load, and a monitor of changes of that load.

It is the part of the payload estimator that runs in the loop. Like every law, it is written once in
casadi: kernels simulate it, a controller runs it, and C code is exported from it. The load is part
of the state: ten other numbers in ``wanted`` replace the load in the model at the next step. The
torque then jumps only by the term that `PayloadLaw` states.
"""

import copy
import dataclasses
import functools
from typing import Any, NamedTuple

import casadi as ca

from ctc.laws import ModelLaw, correct, predict, triple_pole
from plant import Law, Rig, state_of
from plant.laws import Block, Setpoint, Step
from plant.mechanics import LOAD, inverse
from plant.parts import (
    MODEL_ERROR,
    MODEL_TORQUE,
    TORQUE_ERROR,
    Fields,
    Nested,
    Vector,
    number,
    part,
    per_joint,
    scalars,
    signs,
    structure,
)

# Added to the squared torque of 1 kg, in units of the noise: no division by zero at a pose at which
# a load takes no torque.
_TINY = 1e-12


class _Swap(NamedTuple):
    """The models before and after a possible swap of the load at this sample.

    `swapped`: whether the load is swapped. `inertia`, `inertia_before` (n, n): what the feedback
    uses after and before the swap. `torque`, `torque_before` (n, 1): what the model needs along the
    reference after and before the swap [N m].
    """

    swapped: ca.SX
    inertia: ca.SX
    inertia_before: ca.SX
    torque: ca.SX
    torque_before: ca.SX

    def acceleration(self, old: ca.SX) -> ca.SX:
        """An unexplained acceleration `old` (n, 1), re-based if the load is swapped.

        The new one solves ``inertia @ new = inertia_before @ old + torque_before - torque``.
        """
        moment = self.inertia_before @ old + self.torque_before - self.torque
        return ca.if_else(self.swapped, inverse(self.inertia).solve(moment), old)

    @property
    def gained(self) -> ca.SX:
        """Torque (n, 1) that the model gains [N m]."""
        return ca.if_else(self.swapped, self.torque - self.torque_before, 0)


@part
class PayloadLaw(Law):
    """A law whose arm carries a load that can be swapped, and a monitor of changes of the load.

    The state (`fields`) holds the state of the law, the ten standard parameters of the load in the
    model (`load`), those of the load that the next step shall use (`wanted`), and the numbers of
    the monitor (`observer`, `slow`, `change`).

    A swap keeps the sum of the model's torque m along the reference and the disturbance torque D x.
    D is the inertia of the feedback, and x an acceleration in the law's state that the model did
    not explain. It is re-based by D' x' = D x + m - m', where a prime marks the load after the
    swap. The commanded torque then changes by (D' - D) times the feedback of the tracking error,
    and by nothing else.

    For rigid gears (``stiffened=True``), the law has the model that carries the load, so that its
    bandwidth stays the same. For elastic gears (``stiffened=False``), the feedback keeps the
    inertia of the empty arm: above the resonance the motor does not feel the load, and a higher
    gain would make the loop unstable. The torque that the load needs is then fed forward beside the
    law, and a swap re-bases the law's state by the torques alone.

    The monitor (`change`) subtracts from the disturbance torque its own slow part, and weighs the
    difference by the torque of 1 kg of load. Its unit is the standard deviation that it has under
    `noise`, and it is positive where the load grows. After a swap, the disturbance and its slow
    part begin at zero, as if the new model were right: a wrong new load then shows as a change.

    `law`: a law that holds an arm. `start_with` (10,): standard parameters of the load at the start
    (`Body.standard_parameters`). `per_kg` (10,): of 1 kg where loads are expected. `noise` (n,):
    standard deviation of the disturbance torque's changes without a change of the load [N m].
    `stiffened`: whether the feedback, too, has the inertia of the load. `observer`: triple pole of
    the observer [rad/s]. `memory`: time constant of the slow part [s].
    """

    law: ModelLaw = structure(ModelLaw)
    start_with: Nested = structure(default=(0.0,) * len(LOAD))
    per_kg: Vector = number((len(LOAD),))
    noise: Vector = number(("n",))
    stiffened: bool = structure(bool, default=True)
    observer: float = number((), default=60.0)
    memory: float = number((), default=0.05)

    def __post_init__(self) -> None:
        super().__post_init__()
        # Counts and torque are collected once per period, so that an analogue law has no samples to
        # give.
        if not self.law.period:
            raise ValueError(
                f"law must have a period; {type(self.law).__name__} has none. Use a sampled law."
            )
        if not self.stiffened and getattr(self.law, "delay", False):
            raise ValueError(
                "stiffened must be True for a law with a delay; got False. Its coming torque is"
                " fixed."
            )
        signs(self, positive=("noise", "observer", "memory"))
        # A tuple of plain numbers, so that laws can be compared and hashed.
        object.__setattr__(self, "start_with", tuple(float(x) for x in self.start_with))

    @property
    def arm(self) -> Any:
        """The law's, without a load."""
        return self.law.arm

    @property
    def rig(self) -> Rig:
        """The law's."""
        return self.law.rig

    @property
    def period(self) -> float | None:  # type: ignore[override]  # declared, and here the law's
        """The law's [s]."""
        return self.law.period

    @functools.cached_property
    def fields(self) -> Fields:
        """The law's state; the load in the model, and the wanted one; observer, slow part, change.

        Of the observer: tracking error, its rate, and the disturbance as an acceleration; `slow` is
        the disturbance's slow part [N m].
        """
        # Both loads start equal: no swap takes place at the first sample.
        load = scalars(len(LOAD), start=self.start_with)
        return Fields(
            law=state_of(self.law),
            load=load,
            wanted=load,
            observer=Fields(error=per_joint(), rate=per_joint(), disturbance=per_joint()),
            slow=per_joint(),
            change=scalars(),
        )

    def places(self, n: int) -> dict[str, range]:
        """Places of each field in the state, by name."""
        return self.fields.at(n)

    def sliding(self) -> Law:
        """The law's own."""
        return dataclasses.replace(self, law=self.law.sliding())  # type: ignore[arg-type]  # of the same kind

    def block(self, rig: Rig) -> Block:
        self.law.block(rig)  # refuses a rig that is not the law's
        return super().block(rig)

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """One sample: swap -> law with the model that carries the load -> disturbance -> change."""
        n = rig.n
        stored = self.fields.read(state, n)
        dynamics = self.arm.dynamics
        f = self.arm.f
        q, qd, qdd = setpoint[:3]
        # Parameters f are linear in the standard parameters of the load.
        load_matrix = ca.DM(dynamics.load_matrix())

        # 1. The models with the load before and the load now, along the reference.
        f_before = f + load_matrix @ stored.load
        f_now = f + load_matrix @ stored.wanted
        D_before = dynamics.D(q, f_before)
        D_now = dynamics.D(q, f_now)
        needed_before = D_before @ qdd + dynamics.h(q, qd, f_before)
        needed = D_now @ qdd + dynamics.h(q, qd, f_now)
        swapped = ca.sum1(ca.fabs(stored.wanted - stored.load)) > 0
        # On elastic gears the feedback keeps the inertia of the empty arm, see the class. The two
        # inertias of the swap are then equal, and only the torques re-base the state.
        empty = dynamics.D(q, f)
        inertias = (D_now, D_before) if self.stiffened else (empty, empty)
        swap = _Swap(swapped, *inertias, needed, needed_before)

        # 2. The law, its memory re-based to the new model.
        memory = self._rebased(stored.law, n, swap)
        if self.stiffened:
            law = _with_f(self.law, f_now)
            beside = ca.SX.zeros(n)
            acted = torque
        else:
            # The law alone must observe the motion of an empty arm: the load's share of the torque
            # is taken from the torque that acted, and added to the commanded one.
            law = self.law
            beside = needed - empty @ qdd - dynamics.h(q, qd, f)
            # The torque that acted contains the share of the load before. A law with errors of
            # torque has them re-based to the load now: then the share of the load now is
            # subtracted, else that of the load before.
            errors = self.law.fields.places(n, TORQUE_ERROR)
            acted = torque - (beside if errors else beside + needed_before - needed)
        commanded, memory = law.equations(rig, memory, setpoint, pulses, acted, dt)
        commanded = commanded + beside

        # 3. Observe the disturbance, which begins anew at a swap.
        e, rate, disturbance = stored.observer
        # This observer is separate from the law's, so that every law, with or without an observer,
        # is monitored in the same way.
        friction = self.rig.drive.friction(qd)
        reference_torque = needed - self.rig.spring_torque(q) + friction
        v = inverse(D_now).solve(torque - reference_torque)
        predicted = predict(e, rate, ca.if_else(swapped, 0, disturbance), v, dt)
        innovation = q - rig.cell_centre(pulses) - predicted[0]
        gains = triple_pole(self.observer, dt)
        error, rate, disturbance = correct(*predicted, innovation, gains, dt)

        # 4. The disturbance torque without its slow part, weighed by the torque of 1 kg of load.
        # Friction that differs from the model is a disturbance too, but it keeps its sign between
        # reversals: the slow part absorbs it. The weight projects the rest on the torque of a load,
        # in units of each joint's noise.
        lacking = D_now @ disturbance
        slow = ca.if_else(swapped, 0, stored.slow)
        slow = slow + (1 - ca.exp(-dt / self.memory)) * (lacking - slow)
        one = load_matrix @ self.per_kg
        weight = (dynamics.D(q, one) @ qdd + dynamics.h(q, qd, one)) / self.noise
        size = ca.sqrt(ca.dot(weight, weight) + _TINY)
        change = ca.dot(weight, (lacking - slow) / self.noise) / size
        following = self.fields.write(
            n,
            law=memory,
            load=stored.wanted,
            wanted=stored.wanted,
            observer={"error": error, "rate": rate, "disturbance": disturbance},
            slow=slow,
            change=change,
        )
        return commanded, following

    def _rebased(self, memory: ca.SX, n: int, swap: _Swap) -> ca.SX:
        """The law's memory after a swap, so that the torque does not jump with the model."""
        fields = self.law.fields
        # The roles in the law's state mark the numbers that depend on the model. `_Swap` re-bases
        # accelerations that the model did not explain. Errors of torque lose the torque that the
        # model gains; torques of the model gain it, if the law's model carries the load.
        memory = fields.changed(memory, n, MODEL_ERROR, swap.acceleration)
        memory = fields.changed(memory, n, TORQUE_ERROR, lambda old: old + -1 * swap.gained)
        if self.stiffened:
            memory = fields.changed(memory, n, MODEL_TORQUE, lambda old: old + swap.gained)
        return memory


def _with_f(law: Any, f: ca.SX) -> Any:
    """The same law with other parameters of its arm, in an equation."""
    # The arm is frozen, and checks f as numbers: a copy takes the symbols without that check.
    arm = copy.copy(law.arm)
    object.__setattr__(arm, "f", f)
    # Not `dataclasses.replace`, which would check symbols as if they were numbers.
    changed = object.__new__(type(law))
    for field in dataclasses.fields(law):
        value = arm if field.name == "arm" else getattr(law, field.name)
        object.__setattr__(changed, field.name, value)
    return changed
