"""Robustness reserves: a certificate's samples at lower bandwidths and longer periods.

`held` runs the samples from a hold: each starts with its disturbance torque already learnt.

The lowest bandwidth and the longest period at which the certificate holds are its reserves. The rig
and the controller share the sampling period: for a longer one the controller, its observer and its
limits are designed again; the old controller is not merely called less often.
"""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from ctc.certification.certified import clopper_pearson
from ctc.certification.plants import Plants
from ctc.laws import ModelLaw
from plant import Law, Resumed, Rig
from plant.parts import TORQUE_ERROR, Piece, Shown, Table, Verdict, frozen, frozen_settings, real


@frozen_settings
class ReserveSettings:
    """Steps of the search for reserves, all chosen by hand.

    Parameters
    ----------
    bandwidths : tuple of float
        Tested bandwidths as shares of the designed one, in falling order.
    periods : tuple of float
        Tested sampling periods as multiples of the designed one, in rising order.
    rest : float
        Speed [pulses/s] up to which the start of a path counts as rest, in `held`.
    """

    bandwidths: tuple[float, ...] = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
    periods: tuple[float, ...] = (1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
    rest: float = 1.0


SETTINGS = ReserveSettings()


@frozen
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
        Lowest tested bandwidth at which it still holds [rad/s]; None if it has no bandwidth, or if
        `holds` is False.
    period : float or None
        Longest tested sampling period at which it still holds [s]; None if it has no period, or if
        `holds` is False.
    tried : list of (str, float, int)
        All runs: ``bandwidth`` or ``period``, its value, and how many plants exceed the limit.
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
        return f"holds {' and '.join(filter(None, (down, up))) or 'as it is'}"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(f"It {self._short()}.", self.holds)
        allowed = _count(self.allowed, self.samples)
        # A two-sided interval of 90 % has the one-sided upper bound of 95 %.
        upper = clopper_pearson(allowed, self.samples, 0.9)[1]
        exceed = f"at most {allowed} of {self.samples} plants may exceed the limit"
        yield f"allowed: {exceed} (95 % confidence: below {upper:.2%} of all)"
        rows = []
        for kind, value, failures in sorted(self.tried, key=lambda row: row[0]):
            text = f"{value:.4g} rad/s" if kind == "bandwidth" else f"{value * 1e3:.4g} ms"
            rows.append((kind, text, f"{failures}"))
        yield Table(("tested", "", "violations"), rows)


def reserves(certificate: Any, samples: int | None, allowed: float = 0.0) -> Reserves:
    """See `Certificate.reserves`."""
    law = certificate.law
    plants = certificate.plants.first(samples)
    # A failed run is listed too: its violations show how far it is from holding.
    tried = list[tuple[str, float, int]]()
    if not 0 <= real("allowed", allowed, "Give a share, such as 0.") < 1:
        raise ValueError(f"allowed must be from 0 to below 1; got {allowed}. Give a share.")

    def holds(kind: str, value: float, law: Law, plants: Plants) -> bool:
        failures = int((certificate.run(plants, law).outside > 0).sum())
        tried.append((kind, value, failures))
        return failures <= _count(allowed, len(plants))

    rig = plants.rig
    # A law may have no bandwidth, such as P, or no period, if it is continuous.
    bandwidth = getattr(law, "bandwidth", None)
    period = rig.period if law.period else None
    # 1. As designed: a controller that fails here has no reserves.
    kind = "bandwidth" if bandwidth else "period"
    as_designed = holds(kind, bandwidth or rig.period, law, plants)
    # 2. Ever lower bandwidths, then 3. ever longer periods, each until one fails.
    for share in SETTINGS.bandwidths if as_designed and bandwidth else ():
        lower = law.bandwidth * share
        # The first that fails ends it: lower ones may hold again, but are no reserve.
        if not holds("bandwidth", lower, dataclasses.replace(law, bandwidth=lower), plants):
            break
        bandwidth = lower
    for factor in SETTINGS.periods if as_designed and period else ():
        # Plant and controller are called at the same, longer period.
        slow = dataclasses.replace(plants, rig=dataclasses.replace(rig, period=rig.period * factor))
        if not holds("period", slow.rig.period, _slower(law, factor), slow):
            break
        period = slow.rig.period
    return Reserves(
        samples=len(plants),
        allowed=float(allowed),
        holds=as_designed,
        bandwidth=bandwidth if as_designed else None,
        period=period if as_designed else None,
        tried=tried,
    )


def _count(share: float, samples: int) -> int:
    """Plants that a share of them allows."""
    # 0.29 of 100 is 28.999999999999996 in floating point.
    return math.floor(share * samples * (1 + 1e-12))


def _slower(law: Any, factor: float) -> Any:
    """The same design of a law, or the rig, for a period that is longer by a factor."""
    changes = {}
    for field in dataclasses.fields(law):
        name = field.name
        value = getattr(law, name)
        # A law may hold a rig and another law, each with the period.
        if isinstance(value, (Rig, Law)):
            changes[name] = _slower(value, factor)
        elif name == "period" and value:
            changes[name] = value * factor
    return dataclasses.replace(law, **changes)


def held(certificate: Any, samples: int | None) -> Any:
    """The certificate of the first samples, each from a hold.

    Each sample starts with a disturbance torque: the gravity that the model lacks, plus a share of
    each joint's Coulomb friction. The shares are drawn uniformly from -1 to 1.
    """
    law = certificate.law
    path = certificate.reference
    plants = certificate.plants.first(samples)
    arm = plants.arm
    drive = plants.rig.drive
    errors = law.fields.places(arm.n, TORQUE_ERROR) if isinstance(law, ModelLaw) else ()
    if not errors:
        name = type(law).__name__
        raise ValueError(
            f"the controller must learn a disturbance torque; {name} does not. Use ComputedTorque."
        )
    # A path that begins in motion cannot begin with a hold.
    motion = path(np.zeros(1))
    still = np.zeros(arm.n)
    if np.abs(plants.rig.position_in_pulses(motion.qd[0])).max() > SETTINGS.rest:
        raise ValueError(
            f"the path must begin at rest; this one begins with {motion.qd[0]} rad/s. Take another."
        )
    # A stream of its own, so that the samples stay those of the certificate.
    shares = np.random.default_rng((plants.seed, 3)).uniform(-1, 1, (len(plants), arm.n))
    # At rest the regressor is that of gravity alone.
    weight = np.asarray(arm.dynamics.Y(motion.q[0], still, still))
    # In a hold static friction balances any torque up to the Coulomb level, of either sign.
    friction = [drive.coupling.joint_torque(row) for row in shares * drive.joint_coulomb()]
    lacking = (plants.f - law.arm.f) @ weight.T + friction
    # The disturbance torque is part of the law's state, from which the runs resume. The derived
    # numbers with the names ``law.state[i]`` give each sample its own.
    begun = dataclasses.replace(
        plants,
        derived_names=(*plants.derived_names, *(f"law.state[{i}]" for i in errors[0])),
        derived=np.hstack([plants.derived, lacking]),
    )
    runs = certificate.run(begun, Resumed(law=law, state=law.initial_state(arm.n)))
    settings = certificate.settings | {"held": True}
    return dataclasses.replace(certificate, plants=plants, runs=runs, settings=settings, rare=None)
