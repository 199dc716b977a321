"""The table of an identification: values, intervals, what contradicts the model, what was assumed."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["summary_of"]


def summary_of(found: Any) -> str:
    """Lines about an `Identification`: each value, its deviation, the bound, its 95 % interval, its correlation."""
    names, diagnostics = found.short_names, found.diagnostics
    width = max(map(len, names))
    lines = [f"{found.method}, {len(found.records)} record(s): {found.message}"]
    if found.covariance is None:
        lines += [f"{name:<{width}} {value:12.5g}" for name, value in zip(names, found.values, strict=True)]
    else:
        try:
            bounds = np.full(len(found.values), np.nan) if found.fit.resumptions else found.bound()
        except ValueError:  # no reference, or numbers that are not separately identifiable
            bounds = np.full(len(found.values), np.nan)
        known = np.isfinite(bounds).all()
        head = f"{'value':>12} {'std':>9} {'bound' if known else '':>{9 * known}} {'95 % interval':>25}"
        lines.append(f"{'':<{width}} {head}   largest correlation")
        others = found.fit.correlation - np.eye(len(found.values))
        rows = zip(names, found.values, found.std, bounds, strict=True)
        for i, (name, value, std, bound) in enumerate(rows):
            if not std > 0:
                said = "bounded" if found.resonance is not None and found.resonance.bounds(name) else "known"
                lines.append(f"{name:<{width}} {value:12.5g} {said:>9}")
                continue
            most = int(np.argmax(np.abs(others[i])))
            interval = f"[{value - 1.96 * std:.5g}, {value + 1.96 * std:.5g}]"
            together = f"{names[most]} ({others[i, most]:+.2f})"
            least = f"{bound:9.2g}" if known else ""
            lines.append(f"{name:<{width}} {value:12.5g} {std:9.2g} {least} {interval:>25}   {together}")
    known = np.isfinite(diagnostics.difference)
    by = f"{diagnostics.difference:.2f} pulses (rms)" if known else "an unknown amount"
    lines.append(f"simulated and measured errors differ by {by}")
    if diagnostics.held_out_difference is not None:
        lines[-1] += f", in the record(s) kept aside by {diagnostics.held_out_difference:.2f}"
    lines.append(str(diagnostics.detection))
    lines += [] if found.fit.noise_covariance is None else [f"intervals count noise and {found.search.tolerances}"]
    told = found.covariance is not None and found.diagnostics.detection.assumed
    lines += str(found.assumed()).splitlines() if told else []
    lines += [] if found.resonance is None else str(found.resonance).splitlines()
    lines += [f"warning: {text}" for text in found.warnings]
    return "\n".join([*lines, *found.arm.dynamics.legend.splitlines()])
