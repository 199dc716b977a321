"""Arms to start from: the whole PUMA 560, a planar chain of any length, and geometry and gears of the Staubli TX40."""

import numpy as np

from plant.machine.drive import Drive
from plant.machine.encoder import Encoder
from plant.machine.friction import FrictionCurve
from plant.machine.rig import Rig
from plant.mechanics.body import Body
from plant.mechanics.chain import Chain
from plant.mechanics.coupling import Coupling
from plant.mechanics.link import Link

_QUARTER_TURN = np.pi / 2


def puma560() -> Chain:
    """All six joints of the PUMA 560, with bodies.

    Standard Denavit-Hartenberg rows; at q = 0 the upper arm is level and the forearm hangs from it at a right angle.
    Rotor inertias are in the bodies, reflected through the gears of `puma560_rig`. Of link 1 only Iyy is known, the one
    parameter of it that is identifiable, so its mass is zero.

    Source: P. Corke and B. Armstrong-Helouvry, A search for consensus among model parameters reported for the PUMA 560
    robot, IEEE International Conference on Robotics and Automation 1994.
    """
    rows = (
        {"alpha": _QUARTER_TURN, "a": 0.0, "d": 0.0},
        {"alpha": 0.0, "a": 0.4318, "d": 0.0},
        {"alpha": -_QUARTER_TURN, "a": 0.0203, "d": 0.15005},
        {"alpha": _QUARTER_TURN, "a": 0.0, "d": 0.4318},
        {"alpha": -_QUARTER_TURN, "a": 0.0, "d": 0.0},
        {"alpha": 0.0, "a": 0.0, "d": 0.0},
    )
    known = (  # mass, centre of mass, Ixx Iyy Izz about it
        (0.0, (0.0, 0.0, 0.0), (0.0, 0.35, 0.0)),
        (17.4, (-0.3638, 0.006, 0.2275), (0.13, 0.524, 0.539)),
        (4.8, (-0.0203, -0.0141, 0.070), (0.066, 0.086, 0.0125)),
        (0.82, (0.0, 0.019, 0.0), (1.8e-3, 1.3e-3, 1.8e-3)),
        (0.34, (0.0, 0.0, 0.0), (0.3e-3, 0.4e-3, 0.3e-3)),
        (0.09, (0.0, 0.0, 0.032), (0.15e-3, 0.15e-3, 0.04e-3)),
    )
    rotors = puma560_rig().drive.reflected_inertia()
    bodies = tuple(
        Body(mass=mass, com=com, inertia=(x, 0, 0, y, 0, z), rotor=float(rotor))
        for (mass, com, (x, y, z)), rotor in zip(known, rotors, strict=True)
    )
    return Chain.standard(rows, bodies=bodies)


def puma560_rig() -> Rig:
    """Its drives and encoders: gears, motor inertia, friction (Coulomb: mean of both directions) and counts.

    The amplifiers' limits are not in the source and infinite here; the coupling of the wrist's motors is left out.

    Source: as for `puma560`.
    """
    drive = Drive(
        gear=(-62.6111, 107.815, -53.7063, 76.0364, 71.923, 76.686),
        motor_inertia=(200e-6, 200e-6, 200e-6, 33e-6, 33e-6, 33e-6),
        viscous=(1.48e-3, 0.817e-3, 1.38e-3, 71.2e-6, 82.6e-6, 36.7e-6),
        coulomb=(0.415, 0.0985, 0.1185, 14.05e-3, 11.88e-3, 7.23e-3),
        motor_gain=(0.223, 0.226, 0.240, 0.069, 0.072, 0.066),
        current_limit=(np.inf,) * 6,
        joints=tuple("123456"),
    )
    return Rig(drive=drive, encoder=Encoder(resolution=(1000, 800, 1000, 1000, 1000, 500)), period=0.7e-3)


def planar(n: int, *, length: float = 0.4, mass: float = 2.0, rotor: float = 0.05) -> Chain:
    """A chain of n equal links in a vertical plane, q = 0 level.

    Parameters
    ----------
    n : int
    length, mass : float
        Of each link, a thin rod [m], [kg].
    rotor : float
        Rotor inertia reflected to each joint [kg m^2].
    """
    links = [Link(name="1", alpha=_QUARTER_TURN)] + [Link(name=str(i + 1), a=length) for i in range(1, n)]
    about = mass * length**2 / 12
    rod = Body(mass=mass, com=(length / 2, 0, 0), inertia=(0, 0, 0, about, 0, about), rotor=rotor)
    return Chain(links=tuple(links), bodies=(rod,) * n)


def tx40() -> Chain:
    """Geometry of the Staubli TX40, modified Denavit-Hartenberg rows, base flange down; without bodies.

    Motor 6 moves with joint 5 as well. Frame 6 is turned by half a turn about its axis, which gives the first moments
    and products of inertia of link 6 the signs of the published ones.

    Source: example staubli_TX40 of figaroh-plus (Apache-2.0), commit c3b5172.
    """
    rows = (
        (0.0, 0.0, 0.320, 0.0),
        (-_QUARTER_TURN, 0.0, 0.0, 0.0),
        (0.0, 0.225, 0.035, 0.0),
        (_QUARTER_TURN, 0.0, 0.225, 0.0),
        (-_QUARTER_TURN, 0.0, 0.0, 0.0),
        (_QUARTER_TURN, 0.0, 0.0, np.pi),
    )
    links = tuple(
        Link(name=str(i), alpha=alpha, a=a, d=d, theta=theta) for i, (alpha, a, d, theta) in enumerate(rows, 1)
    )
    return Chain(links=links, coupling=_TX40_WRIST)


_TX40_WRIST = Coupling(matrix=np.eye(6) + np.eye(6)[5][:, None] * np.eye(6)[4])


def tx40_rig(period: float = 0.2e-3) -> Rig:
    """Its gears, motor = R q, without friction, motor inertia or limits, which are to be identified.

    The published log holds motor angles, so a pulse of this rig is one radian of the motor, not quantised.

    Source: as for `tx40`.
    """
    drive = Drive(
        gear=(32, 32, 45, -48, 45, 32), motor_inertia=(0,) * 6, viscous=(0,) * 6, coulomb=(0,) * 6,
        motor_gain=(1,) * 6, current_limit=(np.inf,) * 6, coupling=_TX40_WRIST,
        curve=FrictionCurve(offset=(0,) * 6, breakaway=(0,) * 6, speed=(1,) * 6),
    )  # fmt: skip
    return Rig(drive=drive, encoder=Encoder(resolution=(2 * np.pi,) * 6, smooth=True), period=period)
