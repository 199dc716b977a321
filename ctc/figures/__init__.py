"""Figures of records and results, in one style: errors, torques, phase; loops over frequency.

Read `errors` and `loops`; colours, and how a figure is asked for, are in `plant.parts.figures`.
"""

from ctc.figures.errors import (
    draw_band,
    plot_comparison,
    plot_evaluation,
    plot_motions,
    plot_phase,
    plot_record,
)
from ctc.figures.loops import plot_margins, plot_sweep

__all__ = [
    "draw_band",
    "plot_comparison",
    "plot_evaluation",
    "plot_margins",
    "plot_motions",
    "plot_phase",
    "plot_record",
    "plot_sweep",
]
