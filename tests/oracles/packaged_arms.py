"""Chains and rigs of the package's robot files, and a planar chain of any length."""

import functools

import numpy as np

from plant import Body, Chain, Drive, Encoder, Link, Rig, read_robot

_robot = functools.cache(read_robot)


def puma560():
    """All six joints of the PUMA 560, with bodies."""
    return _robot("puma560").dynamics.chain


def puma560_rig():
    return _robot("puma560").rig


def tx40():
    """Geometry of the Staubli TX40 with its coupled wrist, without bodies."""
    return _robot("tx40").dynamics.chain


def tx40_rig():
    return _robot("tx40").rig


def elbow_of_a_ur5e(rounding="floor"):
    """Shoulder lift and elbow of the UR5e, without rotors; and a rig of gears of 100 and
    encoders of 4,096 counts.
    """
    model = _robot("ur5e").model
    drive = Drive(
        gear=(100, 100),
        motor_inertia=(8e-5, 2e-5),
        viscous=(5e-4, 2e-4),
        coulomb=(0.04, 0.015),
        motor_gain=(1, 1),
        current_limit=(4, 2),
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=(4096, 4096), rounding=rounding), period=1e-3)
    return Chain.from_urdf(model, [link.name for link in Chain.from_urdf(model).links[1:3]]), rig


def planar(n, *, length=0.4, mass=2.0, rotor=0.05):
    """A chain of n equal thin rods in a vertical plane, q = 0 level; length [m], mass [kg],
    rotor [kg m^2] of each.
    """
    links = [Link(name="1", alpha=np.pi / 2)] + [
        Link(name=str(i + 1), a=length) for i in range(1, n)
    ]
    about = mass * length**2 / 12
    rod = Body(mass=mass, com=(length / 2, 0, 0), inertia=(0, 0, 0, about, 0, about), rotor=rotor)
    return Chain(links=tuple(links), bodies=(rod,) * n)
