"""Robustness reserves of a certificate: lowest bandwidth and longest sampling period at which it holds.

The same plants are run again. The sampling period is that of rig and controller together: the controller is designed
for it (its observer and its limits know of it), it is not the old one called late.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any

from ctc.certification.cells import clopper_pearson
from ctc.certification.plants import Plants
from plant import Law, Rig
from plant.parts.arguments import real
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table

_BANDWIDTHS = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
_PERIODS = (1.5, 2.0, 3.0, 4.0, 6.0, 8.0)


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
        Lowest bandwidth at which it still holds [rad/s], of those tested from above; None for a controller without.
    period : float or None
        Longest sampling period at which it still holds [s], of those tested from below; None for a controller without.
    tried : list of (str, float, int)
        Everything that was run: ``bandwidth`` or ``period``, its value, and how many exceed the limit.
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
        rows = [(kind, f"{value * units[kind][0]:.4g} {units[kind][1]}", f"{left}") for kind, value, left in tried]
        yield Table(("tested", "", "violations"), rows)


def reserves(certificate: Any, samples: int = 400, allowed: float = 0.0) -> Reserves:
    """Lowest bandwidth and longest sampling period at which at most a share `allowed` of the plants exceeds the limit.

    Parameters
    ----------
    certificate : Certificate
    samples : int
        How many of its plants are run at each setting.
    allowed : float
        Share of them that may exceed the limit.

    Returns
    -------
    Reserves

    Raises
    ------
    ValueError
        More plants than there are, a share that is none.
    """
    law, plants = certificate.law, certificate.plants
    if isinstance(samples, bool) or not isinstance(samples, int) or not 1 <= samples <= len(plants):
        raise ValueError(f"samples must be a whole number from 1 to {len(plants)}; got {samples!r}. Sample more.")
    if not 0 <= real("allowed", allowed, "Give a share, such as 0.") < 1:
        raise ValueError(f"allowed must be from 0 to below 1; got {allowed}. Give a share.")
    options = {name: certificate.settings[name] for name in ("steps_per_sample", "duration", "after")}
    plants, tried = plants.first(samples), []

    def left(kind: str, value: float, law: Law, plants: Plants) -> bool:
        population = plants.under(law, certificate.reference, within=certificate.within, **options)
        count = int((population.run(certificate.threads).outside > 0).sum())
        tried.append((kind, value, count))
        return count <= allowed * samples

    rig = plants.rig
    bandwidth, period = getattr(law, "bandwidth", None), rig.period if law.period else None
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
        samples=samples, allowed=float(allowed), holds=holds, bandwidth=bandwidth if holds else None,
        period=period if holds else None, tried=tried,
    )  # fmt: skip


def _slower(law: Any, factor: float) -> Any:
    """The same design of a law, or the rig, for a period that is longer by a factor."""
    changes = {}
    for name, value in ((field.name, getattr(law, field.name)) for field in dataclasses.fields(law)):
        if isinstance(value, (Rig, Law)):
            changes[name] = _slower(value, factor)
        elif name == "period" and value:
            changes[name] = value * factor
    return dataclasses.replace(law, **changes)
