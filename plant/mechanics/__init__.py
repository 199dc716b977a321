"""Rigid-body dynamics of serial chains: from links and bodies to D, h, C and the regressor Y.

Read `placement`, `link`, `body`, `chain` (with `coupling`: the geometry), `newton_euler` (the
torque), `lumping` and `base_parameters` (the parameters f), `dynamics` and `arm`. Model files:
`xml_file` (elements and their bytes), `urdf_file`, `mjcf_file`, and `model_tree` (the chain in
them). `symmetric_inverse` is a tool.
"""

from plant.mechanics.arm import Arm
from plant.mechanics.base_parameters import base_lumping, independent_columns
from plant.mechanics.body import (
    Body,
    from_pseudo_inertia,
    inertia_matrix,
    prior_changes,
    prior_factor,
    pseudo_inertia,
    symmetric_basis,
)
from plant.mechanics.chain import Chain
from plant.mechanics.coupling import Coupling
from plant.mechanics.dynamics import Dynamics
from plant.mechanics.link import Limits, Link
from plant.mechanics.lumping import LOAD, STANDARD, Lumping, parameter_name, standard_parameters
from plant.mechanics.mjcf_file import FULL, holds, read_mjcf
from plant.mechanics.model_tree import (
    HERE,
    MOVING,
    SLIP,
    ModelFile,
    ModelJoint,
    deferred,
    fixed_to,
    links_of_chain,
)
from plant.mechanics.newton_euler import joint_positions, lumped_torque
from plant.mechanics.placement import Placement, axis_frame, righted, turn
from plant.mechanics.symmetric_inverse import Inverse, eliminated, inverse, row_by_row
from plant.mechanics.urdf_file import INERTIA, expanded, is_xacro, origin_of, read_urdf
from plant.mechanics.xml_file import ORIENTATIONS, Edit, Element, numbers_of, parsed, spliced

__all__ = [
    "FULL",
    "HERE",
    "INERTIA",
    "LOAD",
    "MOVING",
    "ORIENTATIONS",
    "SLIP",
    "STANDARD",
    "Arm",
    "Body",
    "Chain",
    "Coupling",
    "Dynamics",
    "Edit",
    "Element",
    "Inverse",
    "Limits",
    "Link",
    "Lumping",
    "ModelFile",
    "ModelJoint",
    "Placement",
    "axis_frame",
    "base_lumping",
    "deferred",
    "eliminated",
    "expanded",
    "fixed_to",
    "from_pseudo_inertia",
    "holds",
    "independent_columns",
    "inertia_matrix",
    "inverse",
    "is_xacro",
    "joint_positions",
    "links_of_chain",
    "lumped_torque",
    "numbers_of",
    "origin_of",
    "parameter_name",
    "parsed",
    "prior_changes",
    "prior_factor",
    "pseudo_inertia",
    "read_mjcf",
    "read_urdf",
    "righted",
    "row_by_row",
    "spliced",
    "standard_parameters",
    "symmetric_basis",
    "turn",
]
