"""Search for the controller with the least chatter that keeps a pulse limit under uncertainty.

Read `tuning` (families of laws, ranges of their numbers, the result), `search` (populations of
tunings, and its settings), `tune`.
"""

from ctc.tuning.effort_scale import effort_scale
from ctc.tuning.inner_loops import InnerTrial
from ctc.tuning.known_gears import KnownGears, best_law, with_known_gears
from ctc.tuning.search import SearchSettings, Tunings
from ctc.tuning.tune import tune
from ctc.tuning.tuning import Trial, Tuning, families

__all__ = [
    "InnerTrial",
    "KnownGears",
    "SearchSettings",
    "Trial",
    "Tuning",
    "Tunings",
    "best_law",
    "effort_scale",
    "families",
    "tune",
    "with_known_gears",
]
