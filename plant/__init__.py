"""The plant: a geared arm, its drives and encoders, control laws, and the simulator that joins them.

Reading order: `links`, `body`, `placement`, `urdf` (geometry) -> `dynamics` (one torque, D, h, C and Y read off it)
with `lumping` (what f means) and `base` (which f a chain has) -> `arm` (dynamics + f) -> `drive`, `coupling`,
`friction`, `encoder`, `transport` (late torque, lost counts), `rig` -> `reference`, `scaled` (the same path at other
times; `demand`, `scaling`: how fast) ->
`law`, `laws` and `cascade` (with `velocity`, `integral`), `logged` (laws that repeat a log), `running` (a law in a
control script: `guards`, `shell`, `core`), `c` (as C) -> `loop` (the symbolic closed loop) -> `rewrite`, `translate`,
`pieces`, `elementary`, `source`, `kernel`, `compile` (the same loop as machine code) -> `clock`, `tables`,
`simulator`, `referee` (the loop by casadi), `record`, `logs` (files), `checkup` (is it what its rig says?); `linear`
(the loop linearised), `control_systems` (for python-control), `gains` (P for any arm), `inertia` (can this be an
arm?), `kinematics`, `puma560` (the paper's example) and `arms` (others).
"""

from plant import puma560
from plant.arm import Arm
from plant.base import visibility
from plant.body import Body
from plant.cascade import Cascade
from plant.coupling import Coupling
from plant.demand import shortest_duration, torque_share
from plant.drive import Drive
from plant.dynamics import Dynamics
from plant.encoder import Encoder, Phase
from plant.friction import FrictionCurve
from plant.gains import p_gains
from plant.guards import Guards
from plant.law import Block, Law, Setpoint
from plant.laws import PD, PID, P
from plant.linear import linearise
from plant.links import Chain, Link
from plant.logged import LoggedCurrent, LoggedTorque
from plant.logs.logfile import LoadError, read_table
from plant.lumping import Lumping
from plant.placement import Placement
from plant.record import Record
from plant.reference import Harmonics, Motion, PointToPoint, Reference, Spline, Table
from plant.rig import Rig
from plant.scaled import Scaled, slowed
from plant.scaling import fastest
from plant.siblings import check_siblings
from plant.simulator import DivergenceError, replay, simulate
from plant.transport import Transport

check_siblings()

__version__ = "0.1.0"

__all__ = [
    "PD",
    "PID",
    "Arm",
    "Block",
    "Body",
    "Cascade",
    "Chain",
    "Coupling",
    "DivergenceError",
    "Drive",
    "Dynamics",
    "Encoder",
    "FrictionCurve",
    "Guards",
    "Harmonics",
    "Law",
    "Link",
    "LoadError",
    "LoggedCurrent",
    "LoggedTorque",
    "Lumping",
    "Motion",
    "P",
    "Phase",
    "Placement",
    "PointToPoint",
    "Record",
    "Reference",
    "Rig",
    "Scaled",
    "Setpoint",
    "Spline",
    "Table",
    "Transport",
    "fastest",
    "linearise",
    "p_gains",
    "puma560",
    "read_table",
    "replay",
    "shortest_duration",
    "simulate",
    "slowed",
    "torque_share",
    "visibility",
]  # fmt: skip
