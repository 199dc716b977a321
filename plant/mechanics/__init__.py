"""Rigid-body dynamics of serial chains: from links and bodies to D, h, C and the regressor Y.

Read `placement`, `link`, `body`, `chain` (`urdf_file`, `urdf`, `coupling`: the geometry), `newton_euler` (the one
torque), `lumping` and `base_parameters` (what f is), `dynamics` and `arm`, `load` (what an
arm carries); `kinematics`, `symmetric_inverse`, `collect`
and `independent_columns` are tools.
"""

__all__: list[str] = []
