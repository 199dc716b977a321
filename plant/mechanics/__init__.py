"""Rigid-body dynamics of serial chains: from links and bodies to D, h, C and the regressor Y.

Read `placement`, `link`, `body`, `chain` (with `coupling`: the geometry), `newton_euler` (the
torque), `lumping` and `base_parameters` (the parameters f), `dynamics` and `arm`. Model files:
`xml_file` (elements and their bytes), `urdf_file`, `mjcf_file`, and `model_tree` (the chain in
them). `symmetric_inverse` is a tool.
"""
