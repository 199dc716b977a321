"""Old names of this package: they work for one release, say so, and go together with this file."""

from __future__ import annotations

from identification.payload.load import Load
from identification.results.identification import Identification
from plant.parts.deprecation import install

__all__: list[str] = []

install(
    Identification,
    scatter="fit.rms_innovation",
    trouble="fit.fallback_reason",
    zeros="fit.zeros",
    correlation="fit.correlation",
    ranges="search.ranges",
    stages="search.stages",
    initial_costs="search.initial_costs",
    bands="diagnostics.bands",
    delay="diagnostics.delay",
    delay_std="diagnostics.delay_std",
    difference="diagnostics.difference",
    held_out_difference="diagnostics.held_out_difference",
)
install(Load, scatter="rms_innovation")
