"""Chains and rigs of the package's robot files, and a planar chain of any length."""

import functools

import numpy as np

from plant import Body, Chain, Link, read_robot

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


def planar(n, *, length=0.4, mass=2.0, rotor=0.05):
    """A chain of n equal thin rods in a vertical plane, q = 0 level; length [m], mass [kg], rotor [kg m^2] of each."""
    links = [Link(name="1", alpha=np.pi / 2)] + [Link(name=str(i + 1), a=length) for i in range(1, n)]
    about = mass * length**2 / 12
    rod = Body(mass=mass, com=(length / 2, 0, 0), inertia=(0, 0, 0, about, 0, about), rotor=rotor)
    return Chain(links=tuple(links), bodies=(rod,) * n)
