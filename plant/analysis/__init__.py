"""Linear analysis: the loop linearised and its modes, P gains, systems of python-control.

Reading order: `linearise` -> `p_gains`; `control_systems`.
"""
