"""Linear analysis: the loop linearised and its modes, P gains, systems of python-control.

Reading order: `linearise` -> `p_gains`; `control_systems`.
"""

from plant.analysis.sampled_loops import SampledLoops, held

__all__ = ["SampledLoops", "held"]
