"""Old names of this package: they work for one release, say so, and go together with this file."""

from __future__ import annotations

from ctc.certification.certificate import Certificate
from plant.parts.deprecation import install

__all__: list[str] = []

install(Certificate, hurts="sensitivities", margins="reserves")
