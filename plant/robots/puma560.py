"""The paper's example: links 2 and 3 of a PUMA 560, with drives, encoders, law and trajectory.

Frames: axis 2 is horizontal, and positive q2 lowers the arm. All numbers come from the
paper (section 3, 4 and appendix, corrected where the print is wrong) or, where said, from the
literature on this robot.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant.laws import P
from plant.machine import Drive, Encoder, Rig
from plant.mechanics import Arm, Body, Chain, Dynamics, Link, Lumping
from plant.motion import Harmonics

# distance of axes 2 and 3 [m]; the paper's a3, called a2 in the tables of modified DH parameters
LINK_LENGTH = 0.4318

# f1..f9 that the paper identified (4.2) [kg m^2: f1-f4, f7; kg m: f5, f6, f8, f9].
PUBLISHED = np.array([1.68, 1.39, -0.29, -1.4, -0.08, -1.94, 6.67, 0.06, 10.2])
PUBLISHED.setflags(write=False)

# Variation of f1..f9 over the paper's series of identifications (4.2), as a fraction.
PUBLISHED_ALTERATION = np.array([0.10, 0.21, 0.80, 0.30, 0.16, 0.14, 0.11, 0.40, 0.03])
PUBLISHED_ALTERATION.setflags(write=False)

# Ranges of f1..f9 printed in 3.6. Those of f2 and f7 do not follow from the inputs
# (`identification.planning.ranges` derives [0, 1.27] and [1.25, 18.76]); the published f3 and f4
# lie outside theirs.
PRINTED_RANGES = (
    (0.28, 4.07),
    (0.0, 2.33),
    (-0.2, 0.2),
    (-1.25, 0.0),
    (-0.4, 0.4),
    (-2.5, 0.0),
    (2.23, 17.95),
    (-1.75, 1.75),
    (-2.7, 11.25),
)


def equation_3(link2: Any, link3: Any, a3: Any) -> dict[str, Any]:
    """f1..f9 by name from physical parameters of links 2 and 3, and the length a3 [m] of link 2.

    A link has attributes m [kg], x, y [m], Izz about the centre of mass and J = Jm k^2 [kg m^2]:
    numbers, casadi symbols or intervals.

    Source: paper eq. (3), with Jm3 in f1 and Jm2 in f7 (printed the other way round).
    """
    inertia3 = link3.Izz + link3.m * link3.x**2 + link3.m * link3.y**2
    return {
        "f1": link3.J + inertia3,
        "f2": inertia3,
        "f3": link3.m * link3.x * a3,
        "f4": link3.m * link3.y * a3,
        "f5": link3.m * link3.x,
        "f6": link3.m * link3.y,
        "f7": (
            link2.J
            + link2.Izz
            + link2.m * link2.x**2
            + link2.m * link2.y**2
            + link3.m * a3**2
            + inertia3
        ),
        "f8": link2.m * link2.y,
        "f9": link2.m * link2.x + link3.m * a3,
    }


def dynamics() -> Dynamics:
    """Equations (1)-(2) of links 2 and 3 with f1..f9 open, and their printed search ranges."""
    links = (
        Link(name="2", alpha=-np.pi / 2, a=0.0, d=0.0),
        Link(name="3", alpha=0.0, a=LINK_LENGTH, d=0.0),
    )
    # The paper's parameters, so that results can be compared with its numbers.
    lumping = Lumping.from_equation(
        lambda link2, link3: equation_3(link2, link3, LINK_LENGTH),
        links=2,
        inertial=("f1", "f2", "f3", "f4", "f7"),
        gravitational=("f5", "f6", "f8", "f9"),
    )
    return Dynamics(chain=Chain(links=links), lumping=lumping, ranges=PRINTED_RANGES)


def arm() -> Arm:
    """The arm with the published f."""
    return dynamics().arm(PUBLISHED)


def literature_arm(
    tool_mass: float = 0.0, tool_position: tuple[float, float] = (0.0, -0.55)
) -> Arm:
    """A physical PUMA 560 (links 2 and 3, the wrist lumped into link 3), with a point mass as tool.

    `tool_mass` is in kg, `tool_position` x, y in frame 3 [m].

    Source: Armstrong, Khatib and Burdick (1986); Corke and Armstrong-Helouvry (1994).
    """

    def body(mass: float, x: float, y: float, izz: float = 0.0, rotor: float = 0.0) -> Body:
        return Body(mass=mass, com=(x, y, 0.0), inertia=(0, 0, 0, 0, 0, izz), rotor=rotor)

    # The f of the paper contains the rotors' reflected inertia.
    rotor2, rotor3 = rig().drive.reflected_inertia()
    link2 = body(17.4, 0.068, 0.006, 0.539, rotor2)
    link3 = body(4.8, 0.0, -0.070, 0.086, rotor3)
    # Masses and centres of the three wrist links, in frame 3.
    for wrist in ((0.82, -0.0203, -0.414), (0.34, -0.0203, -0.4331), (0.09, -0.0203, -0.465)):
        link3 = link3.joined(body(*wrist))
    # Without a tool the bodies stay exactly those of the sources.
    if tool_mass:
        link3 = link3.joined(body(tool_mass, *tool_position))
    model = dynamics()
    return model.arm(model.f((link2, link3)))


def rig() -> Rig:
    """Drives and encoders of joints 2 and 3.

    Source: paper appendix (gears, friction, encoders; its second "Kfr-stat2" is motor 3's), 4.1
    (0.7 ms, 12 A amplifiers); motor inertia 2e-4 kg m^2 and motor gains 0.228 and 0.238 N m/A from
    Corke and Armstrong-Helouvry (1994).
    """
    # Per motor, on the motor's side of the gear; joint 3 turns against its motor.
    drive = Drive(
        gear=(107.8, -53.7),
        motor_inertia=(2e-4, 2e-4),
        viscous=(0.817e-3, 1.38e-3),
        coulomb=(0.124, 0.146),
        motor_gain=(0.228, 0.238),
        current_limit=(12.0, 12.0),
    )
    return Rig(drive=drive, encoder=Encoder(resolution=(800, 1000), rounding="fix"), period=0.7e-3)


def p_law(gain: ArrayLike = (0.20, 0.15)) -> P:
    """The P controller of the experiment: motor torque per pulse of error [N m].

    The paper prints neither P nor K_i. With (0.20, 0.15) the tracking errors stay within about +-10
    pulses, as in Figs. 6-7, and oscillate at 23-27 Hz, near the 27-32 Hz that the paper saw; with
    (0.1, 0.08) they reach 14-18.
    """
    return P(gain=gain)


def reference(period: float = 3.65) -> Harmonics:
    """The test trajectory, `period` seconds long. Source: paper eq. (6)."""
    quarter = np.pi / 4
    cosine = np.diag([quarter, -quarter])
    return Harmonics(
        period=period, offset=(-quarter, quarter), cosine=cosine, sine=np.zeros((2, 2))
    )
