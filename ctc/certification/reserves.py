"""The samples of a certificate run again: at lower bandwidths, longer sampling periods, and from a
hold.

The bandwidths and periods down, and up, to which it holds are its robustness reserves. The sampling
period is that of rig and controller together: the controller is designed for it (its observer and
its limits know of it), it is not the old one called late.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from ctc.certification.certified import clopper_pearson
from ctc.certification.plants import Plants
from ctc.laws.model_law import ModelLaw
from plant import Law, Resumed, Rig
from plant.parts.arguments import real
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table
from plant.parts.vector import TORQUE_ERROR

_BANDWIDTHS = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
_PERIODS = (1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
_AT_REST = 1.0  # pulses/s


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Reserves(Shown):
    """Robustness reserves of a certificate. Print them for a table.

    Attributes
    ----------
    samples : int
        Plants that were run at each setting.
    allowed : float
        Share of them that may exceed the limit.
    holds : bool
        Whether the controller as it is holds with these plants; where not, there are no reserves.
    bandwidth : float or None
        Lowest bandwidth at which it still holds [rad/s], of those tested from above; None for a
        controller without.
    period : float or None
        Longest sampling period at which it still holds [s], of those tested from below; None for a
        controller without.
    tried : list of (str, float, int)
        Everything that was run: ``bandwidth`` or ``period``, its value, and how many exceed the
        limit.
    """

    samples: int
    allowed: float
    holds: bool
    bandwidth: float | None
    period: float | None
    tried: list[tuple[str, float, int]]

    def _short(self) -> str:
        if not self.holds:
            return "does not hold as it is"
        down = "" if self.bandwidth is None else f"down to {self.bandwidth:.4g} rad/s"
        up = "" if self.period is None else f"up to {1e3 * self.period:.4g} ms"
        return f"holds {' and '.join(filter(None, (down, up)))}"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(f"It {self._short()}.", self.holds)
        most = int(self.allowed * self.samples)
        upper = clopper_pearson(most, self.samples, 0.9)[1]
        exceed = f"at most {most} of {self.samples} plants may exceed the limit"
        yield f"allowed: {exceed} (95 % confidence: below {upper:.2%} of all)"
        units = {"bandwidth": (1, "rad/s"), "period": (1e3, "ms")}
        tried = sorted(self.tried, key=lambda each: each[0])
        rows = [
            (kind, f"{value * units[kind][0]:.4g} {units[kind][1]}", f"{left}")
            for kind, value, left in tried
        ]
        yield Table(("tested", "", "violations"), rows)


def reserves(certificate: Any, samples: int | None, allowed: float = 0.0) -> Reserves:
    """See `Certificate.reserves`."""
    law, plants, tried = certificate.law, certificate.plants.first(samples), []
    if not 0 <= real("allowed", allowed, "Give a share, such as 0.") < 1:
        raise ValueError(f"allowed must be from 0 to below 1; got {allowed}. Give a share.")

    def left(kind: str, value: float, law: Law, plants: Plants) -> bool:
        count = int((certificate.run(plants, law).outside > 0).sum())
        tried.append((kind, value, count))
        return count <= allowed * len(plants)

    rig = plants.rig
    bandwidth = getattr(law, "bandwidth", None)
    period = rig.period if law.period else None
    holds = left("bandwidth" if bandwidth else "period", bandwidth or rig.period, law, plants)
    for share in _BANDWIDTHS if holds and bandwidth else ():
        lower = law.bandwidth * share
        if not left("bandwidth", lower, dataclasses.replace(law, bandwidth=lower), plants):
            break
        bandwidth = lower
    for factor in _PERIODS if holds and period else ():
        slow = dataclasses.replace(plants, rig=dataclasses.replace(rig, period=rig.period * factor))
        if not left("period", slow.rig.period, _slower(law, factor), slow):
            break
        period = slow.rig.period
    return Reserves(
        samples=len(plants),
        allowed=float(allowed),
        holds=holds,
        bandwidth=bandwidth if holds else None,
        period=period if holds else None,
        tried=tried,
    )


def _slower(law: Any, factor: float) -> Any:
    """The same design of a law, or the rig, for a period that is longer by a factor."""
    changes = {}
    for name, value in (
        (field.name, getattr(law, field.name)) for field in dataclasses.fields(law)
    ):
        if isinstance(value, (Rig, Law)):
            changes[name] = _slower(value, factor)
        elif name == "period" and value:
            changes[name] = value * factor
    return dataclasses.replace(law, **changes)


def held(certificate: Any, samples: int | None) -> Any:
    """The certificate of the first samples, each from a hold: the disturbance torque is what the
    model lacks at rest, and of Coulomb friction any share from -1 to 1, uniform, of each joint.
    """
    law, path, plants = certificate.law, certificate.reference, certificate.plants.first(samples)
    arm = plants.arm
    drive = plants.rig.drive
    errors = law.fields.places(arm.n, TORQUE_ERROR) if isinstance(law, ModelLaw) else ()
    if not errors:
        name = type(law).__name__
        raise ValueError(
            f"the controller must learn a disturbance torque; {name} does not. Use ComputedTorque."
        )
    motion = path(np.zeros(1))
    still = np.zeros(arm.n)
    if np.abs(plants.rig.position_in_pulses(motion.qd[0])).max() > _AT_REST:
        raise ValueError(
            f"the path must begin at rest; this one begins with {motion.qd[0]} rad/s. Take another."
        )
    shares = np.random.default_rng((plants.seed, 3)).uniform(-1, 1, (len(plants), arm.n))
    weight = np.asarray(arm.dynamics.Y(motion.q[0], still, still))
    friction = [drive.coupling.joint_torque(row) for row in shares * drive.joint_coulomb()]
    lacking = (plants.f - law.arm.f) @ weight.T + friction
    begun = dataclasses.replace(
        plants,
        derived_names=(*plants.derived_names, *(f"law.state[{i}]" for i in errors[0])),
        derived=np.hstack([plants.derived, lacking]),
    )
    runs = certificate.run(begun, Resumed(law=law, state=law.initial_state(arm.n)))
    settings = certificate.settings | {"held": True}
    return dataclasses.replace(certificate, plants=plants, runs=runs, settings=settings, rare=None)
