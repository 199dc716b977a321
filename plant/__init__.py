"""The plant: a geared arm, its drives and encoders, control laws, and the simulator of them.

An experiment: Arm + Rig + Law + Reference -> Record. The rooms, each above all that it imports:

=============== ====================================================================================
`models`        URDF, MJCF and robot files: read, checked, repaired, edited in place, written
`robots`        the paper's two links
`ros2`          a control law as a controller of ros2_control
`fmu`           a law or an arm as an FMU
`analysis`      the loop linearised, python-control, P gains
`simulation`    the closed loop as one symbolic step, its kernels, `simulate` and `replay`
`logs`          `Record`, and the readers of files
`checkup`       does a log agree with its rig and its law? `Record.check` -> `Checkup`
`laws`          what a control law has to give; P, PD, PID, cascade, laws that repeat a log
`realtime`      a law at work: `Guards`, safe stop, the compiled step (`Running`), its C
`motion`        references, the fastest path, what a motion demands, and what it excites
`machine`       friction, drive, encoder, transport delay, jitter, springs; together the `Rig`
`mechanics`     links and bodies -> one torque; `Dynamics` (D, h, C, Y read off it) and `Arm`
`compiler`      a casadi Function as machine code or C; knows nothing of arms
`parts`         descriptions with named numbers; checks of arguments
=============== ====================================================================================

All that is public is exported here; `docs/architecture.md` shows the house in one picture.
"""

from importlib.util import find_spec
from pathlib import Path

from plant.analysis.control_systems import to_control
from plant.analysis.linearise import linearise, modes
from plant.analysis.p_gains import cascade_gains, p_gains
from plant.checkup.hypothesis import Hypothesis
from plant.fmu.export import to_fmu
from plant.laws.law import Law, StatelessLaw, state_of
from plant.laws.mit_drive import MitDrive
from plant.laws.pid import PD, PID, Cascade, P
from plant.laws.position_servo import PositionServo
from plant.laws.replayed import LoggedCurrent, LoggedTorque
from plant.laws.resumed import Resumed
from plant.logs.contents import LogContents
from plant.logs.logfile import LoadError, read_table
from plant.logs.record import Record
from plant.logs.several import read_records
from plant.machine.drive import Drive
from plant.machine.drive_effects import FrictionDrift, TorqueRipple
from plant.machine.elasticity import Elasticity
from plant.machine.encoder import Encoder, Phase, QuadratureError
from plant.machine.friction import FrictionCurve, Presliding
from plant.machine.known_torque import CosineTorque, Counterbalance, JointSpring, KnownTorque
from plant.machine.rig import Jitter, Rig, Transport
from plant.mechanics.arm import Arm
from plant.mechanics.body import Body
from plant.mechanics.chain import Chain
from plant.mechanics.coupling import Coupling
from plant.mechanics.dynamics import Dynamics
from plant.mechanics.link import Limits, Link
from plant.mechanics.lumping import Lumping
from plant.mechanics.placement import Placement
from plant.models.check import check_model
from plant.models.robot_file import Robot, read_robot, write_robot
from plant.motion.everyday import everyday_motions
from plant.motion.fastest import fastest
from plant.motion.link_reference import LinkReference
from plant.motion.reference import Reference
from plant.motion.smooth import Harmonics, PointToPoint, Spline
from plant.motion.table import Held, Table
from plant.motion.visibility import visibility
from plant.parts.part import Part, number, part, structure
from plant.parts.vector import Fields, per_joint, scalars
from plant.realtime.first_motion import FirstMotion
from plant.realtime.guards import Guards
from plant.robots import puma560
from plant.ros2.export import to_ros2_control
from plant.simulation.followed_path import write_replay
from plant.simulation.simulator import replay, simulate
from plant.simulation.stepped_arm import SteppedArm
from plant.version import __version__ as __version__

_home = Path(__file__).resolve().parent.parent
for _name in ("identification", "ctc"):  # other distributions called `plant` and `ctc` exist
    _spec = find_spec(_name)
    _found = Path(_spec.origin).resolve().parent.parent if _spec and _spec.origin else None
    if _found != _home:
        raise ImportError(
            f"package {_name!r} must be beside {_home / 'plant'}; it would be imported from"
            f" {_found / _name if _found else 'nowhere'}. Uninstall the other distribution, or put"
            f" {_home} first."
        )

__all__ = [
    "PD",
    "PID",
    "Arm",
    "Body",
    "Cascade",
    "Chain",
    "CosineTorque",
    "Counterbalance",
    "Coupling",
    "Drive",
    "Dynamics",
    "Elasticity",
    "Encoder",
    "Fields",
    "FirstMotion",
    "FrictionCurve",
    "FrictionDrift",
    "Guards",
    "Harmonics",
    "Held",
    "Hypothesis",
    "Jitter",
    "JointSpring",
    "KnownTorque",
    "Law",
    "Limits",
    "Link",
    "LinkReference",
    "LoadError",
    "LogContents",
    "LoggedCurrent",
    "LoggedTorque",
    "Lumping",
    "MitDrive",
    "P",
    "Part",
    "Phase",
    "Placement",
    "PointToPoint",
    "PositionServo",
    "Presliding",
    "QuadratureError",
    "Record",
    "Reference",
    "Resumed",
    "Rig",
    "Robot",
    "Spline",
    "StatelessLaw",
    "SteppedArm",
    "Table",
    "TorqueRipple",
    "Transport",
    "cascade_gains",
    "check_model",
    "everyday_motions",
    "fastest",
    "linearise",
    "modes",
    "number",
    "p_gains",
    "part",
    "per_joint",
    "puma560",
    "read_records",
    "read_robot",
    "read_table",
    "replay",
    "scalars",
    "simulate",
    "state_of",
    "structure",
    "to_control",
    "to_fmu",
    "to_ros2_control",
    "visibility",
    "write_replay",
    "write_robot",
]
