"""Certificates of a set of motions, on the same Monte Carlo samples."""

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

from ctc.certification.certificate import Certificate
from ctc.certification.certified import Certified
from ctc.certification.statement import shown_set, verdict_of_set
from identification.results import Seen
from plant import Reference
from plant.motion import of_motion
from plant.parts import Piece, frozen, kept, known_options
from plant.simulation import Runs


@kept
@frozen
class Certificates(Certified, Mapping[str, Certificate]):
    """Probability of exceeding a pulse limit in a set of motions: name -> `Certificate`. Print it.

    Every sample makes every motion; `failures`, `probability`, `upper` and `sensitivities` count
    samples that exceed the limit in any motion. `Certificate.load` reads its files, too.

    `law`, `plants`, `within`, `confidence`, `threads`, `seconds`, `versions`: as of `Certificate`.
    `motions`: reference, runs, settings and `seen` of each certificate. `rare`: failures in any of
    the motions.
    """

    _read_by: ClassVar[tuple[type, ...]] = (Certificate,)

    motions: dict[str, tuple[Reference, Runs, dict[str, Any], Seen | None]]

    @functools.cached_property
    def _certificates(self) -> dict[str, Certificate]:
        common = {field.name: getattr(self, field.name) for field in dataclasses.fields(Certified)}
        common["rare"] = None  # it is a probability of the whole set
        return {
            name: Certificate(reference=path, runs=runs, settings=settings, seen=seen, **common)
            for name, (path, runs, settings, seen) in self.motions.items()
        }

    def __getitem__(self, name: str) -> Certificate:
        return of_motion(self._certificates, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.motions)

    def __len__(self) -> int:
        return len(self.motions)

    # A sample of the set is its runs in all motions: the largest errors, the sum of violations.
    @functools.cached_property
    def runs(self) -> Runs:  # type: ignore[override]  # follows from the motions
        """All motions of each sample as one."""
        return Runs.joined([certificate.runs for certificate in self.values()])

    @property
    def settings(self) -> dict[str, Any]:  # type: ignore[override]  # follows from the motions
        """``steps_per_sample``, and the largest ``after``."""
        latest = max(certificate.settings["after"] for certificate in self.values())
        return self[self.worst].settings | {"after": latest}

    @property
    def worst(self) -> str:
        """Name of the motion with the most failures; among equals, with the largest error."""
        # Where no sample fails, the largest error before rounding is still the worst.
        return max(self, key=lambda name: (self[name].failures, self[name].runs.unrounded.max()))

    @property
    def seen(self) -> Seen | None:
        """`Certificate.seen` of the worst motion."""
        return self[self.worst].seen

    @property
    def friction_known(self) -> float | None:
        """`Certificate.friction_known` of the worst motion."""
        return self[self.worst].friction_known

    @property
    def holds(self) -> bool:
        """Whether the certificates of all motions hold, and failures are as `rare` as required."""
        rare_enough = self.rare is None or self.rare.met
        return rare_enough and all(certificate.holds for certificate in self.values())

    @property
    def lowest_resonance(self) -> float | None:
        """Locked-rotor resonance [Hz] above which the arm keeps the limit in all motions.

        The arm is the nominal one.
        """
        # All motions are on the same gears, so none or all of them have a number.
        numbers = [certificate.lowest_resonance for certificate in self.values()]
        return max((hz for hz in numbers if hz is not None), default=None)

    @property
    def verdict(self) -> str:
        """Failures and bound over all motions, and the motion with the most failures."""
        return verdict_of_set(self)

    @known_options
    def from_hold(self, *, samples: int | None = None) -> "Certificates":
        """`Certificate.from_hold` of every motion."""
        held = {name: certificate.from_hold(samples=samples) for name, certificate in self.items()}
        motions = {
            name: (certificate.reference, certificate.runs, certificate.settings, certificate.seen)
            for name, certificate in held.items()
        }
        return dataclasses.replace(self, plants=held[self.worst].plants, motions=motions, rare=None)

    def _shown(self) -> Iterator[Piece]:
        return shown_set(self)
