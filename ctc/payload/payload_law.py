"""The stage of the payload estimator that runs in the loop: a law whose model carries a load, and
what watches it.

Written once in casadi as every law, so it is simulated by the kernels, runs in a controller, and is
exported as C. The load is state: whoever writes ten other numbers into ``wanted`` swaps the model
at the next step, bumplessly.
"""

import copy
import dataclasses
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ctc.laws.model_law import ModelLaw
from ctc.laws.observer import correct, predict, triple_pole
from plant import Law, Rig
from plant.laws.law import Block, Setpoint, Step
from plant.mechanics.lumping import LOAD
from plant.mechanics.symmetric_inverse import inverse
from plant.parts.arguments import signs
from plant.parts.fields import Nested, Vector
from plant.parts.part import number, part, structure


@part
class PayloadLaw(Law):
    """A law with a model, whose arm carries a load that can be swapped, and a watch over changes of
    it.

    The state is that of the law, then phi (10, the standard parameters of the load in the model),
    ``wanted`` (10), the observer of the disturbance (3 n), its slow part (n) [N m], and the change
    (1).

    A swap keeps the disturbance torque: what of the law's state stands for accelerations that the
    model did not explain is re-based, D' x' = D x + model - model', with the model's torque along
    the reference. The commanded torque then differs by (D' - D) times the feedback of the tracking
    error, and by nothing else.

    On rigid gears the law has the model that carries the load, so that its bandwidth stays. On
    elastic ones its feedback keeps the inertia of the empty arm, since above their resonance a load
    is not felt and a higher gain would make them swing (``stiffened=False``): what the load needs
    is fed forward beside it, and re-based likewise.

    The change is that of the disturbance torque against its own slow part, weighed by the torque of
    the load per kg: in standard deviations of what friction that is uncertain would do; positive
    where the load grows. After a swap it begins anew, from nothing that the model lacks: a swap to
    a wrong load is a change.

    `law`: that holds an arm. `start_with` (10,): standard parameters of the load at the start
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

    def places(self, n: int) -> dict[str, range]:
        """Where in the state the parts are."""
        sizes = {
            "law": len(self.law.initial_state(n)),
            "load": len(LOAD),
            "wanted": len(LOAD),
            "observer": 3 * n,
            "slow": n,
            "change": 1,
        }
        ends = np.cumsum([0, *sizes.values()]).tolist()
        return {name: range(a, b) for name, a, b in zip(sizes, ends[:-1], ends[1:], strict=True)}

    def initial_state(self, n: int) -> NDArray[np.float64]:
        """The law's, the load to start with twice, and nothing observed yet."""
        return np.concatenate(
            [self.law.initial_state(n), self.start_with, self.start_with, np.zeros(4 * n + 1)]
        )

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
        dynamics = self.arm.dynamics
        parts = {name: state[where.start : where.stop] for name, where in self.places(n).items()}
        matrix = ca.DM(dynamics.load_matrix())
        drive = self.rig.drive
        models = [self.arm.f + matrix @ parts[name] for name in ("load", "wanted")]
        inertias = [dynamics.D(setpoint.q, f) for f in models]
        q, qd, qdd = setpoint[:3]
        before, after = (
            D @ qdd + dynamics.h(q, qd, f) for D, f in zip(inertias, models, strict=True)
        )
        swapped = ca.sum1(ca.fabs(parts["wanted"] - parts["load"])) > 0
        empty = dynamics.D(setpoint.q, self.arm.f)
        from_inertia, to_inertia = inertias if self.stiffened else (empty, empty)
        rebase = inverse(to_inertia).solve

        own = ca.vertsplit(parts["law"])
        for some in self.law.model_errors(n):
            x = ca.vertcat(*(own[i] for i in some))
            new = ca.if_else(swapped, rebase(from_inertia @ x + before - after), x)
            for i, value in zip(some, ca.vertsplit(new), strict=True):
                own[i] = value
        errors = self.law.torque_errors(n)
        torques = self.law.model_torques(n) if self.stiffened else ()
        gained = ca.vertsplit(ca.if_else(swapped, after - before, 0))
        for places, sign in ((errors, -1), (torques, 1)):
            for i, value in (
                (i, value) for some in places for i, value in zip(some, gained, strict=True)
            ):
                own[i] = own[i] + sign * value
        if self.stiffened:
            law = _with_f(self.law, models[1])
            beside = ca.SX.zeros(n)
            acted = torque
        else:
            law = self.law
            beside = after - empty @ setpoint.qdd - dynamics.h(setpoint.q, setpoint.qd, self.arm.f)
            # What acted was commanded with the load before; an error of torque that is re-based
            # stands beside it.
            acted = torque - (beside if errors else beside + before - after)
        asked, following = law.equations(rig, ca.vertcat(*own), setpoint, pulses, acted, dt)
        asked = asked + beside

        e, rate, disturbance = ca.vertsplit(parts["observer"], n)
        needed = after - self.rig.spring_torque(setpoint.q) + drive.friction(setpoint.qd)
        v = inverse(inertias[1]).solve(torque - needed)
        e, rate, disturbance = predict(e, rate, ca.if_else(swapped, 0, disturbance), v, dt)
        innovation = setpoint.q - rig.cell_centre(pulses) - e
        seen = correct(e, rate, disturbance, innovation, triple_pole(self.observer, dt), dt)
        lacking = inertias[1] @ seen[2]
        slow = ca.if_else(swapped, 0, parts["slow"])
        slow = slow + (1 - ca.exp(-dt / self.memory)) * (lacking - slow)
        one = matrix @ self.per_kg
        weight = (
            dynamics.D(setpoint.q, one) @ setpoint.qdd + dynamics.h(setpoint.q, setpoint.qd, one)
        ) / self.noise
        change = ca.dot(weight, (lacking - slow) / self.noise) / ca.sqrt(
            ca.dot(weight, weight) + _TINY
        )
        return asked, ca.vertcat(following, parts["wanted"], parts["wanted"], *seen, slow, change)


_TINY = 1e-12  # beside the squared torque of 1 kg in units of the noise, where a load has none


def _with_f(law: Any, f: ca.SX) -> Any:
    """The same law with other parameters of its arm, in an equation."""
    arm = copy.copy(law.arm)
    other = object.__new__(type(law))
    object.__setattr__(arm, "f", f)
    for field in dataclasses.fields(law):
        object.__setattr__(
            other, field.name, arm if field.name == "arm" else getattr(law, field.name)
        )
    return other
