"""Model files and robot files: checked and repaired, edited in place, read and written.

Reading order: `check` (`check_model`) with `hypotheses` (inertials without each mistake; shapes,
other sides), `agreement` (the evidence for one of them) and `joints_stated` (degrees, millimetres);
`edits` (new inertials in a URDF or MJCF file, all other bytes as they were); `robot_file`
(`read_robot`, `write_robot`) with `tables` (parts as tables, TOML text), `arm_table` (the table
[arm]) and `new_robot` (a file to complete).
"""

from plant.models.agreement import CheckedLink, Links, cost_of, zero
from plant.models.check import ModelCheck, ModelFinding
from plant.models.edits import (
    mjcf_inertial,
    mjcf_joint,
    mjcf_motors,
    mjcf_text,
    urdf_friction,
    urdf_inertial,
)
from plant.models.hypotheses import Inertial
from plant.models.new_robot import MISSING, new_dh_file, new_robot_file
from plant.models.robot_file import FOLDER
from plant.models.tables import toml_lines, unit_of

__all__ = [
    "FOLDER",
    "MISSING",
    "CheckedLink",
    "Inertial",
    "Links",
    "ModelCheck",
    "ModelFinding",
    "cost_of",
    "mjcf_inertial",
    "mjcf_joint",
    "mjcf_motors",
    "mjcf_text",
    "new_dh_file",
    "new_robot_file",
    "toml_lines",
    "unit_of",
    "urdf_friction",
    "urdf_inertial",
    "zero",
]
