"""Forward kinematics of a chain, over the frames of its dynamics."""

import casadi as ca
from numpy.typing import ArrayLike

from plant.mechanics.chain import Chain
from plant.parts.arguments import array
from plant.parts.checked_function import CheckedFunction


def joint_positions(chain: Chain, tip: ArrayLike = (0.0, 0.0, 0.0)) -> CheckedFunction:
    """Positions of the base, the origins of the links' frames and the tip, as a function of q.

    Parameters
    ----------
    chain : Chain
    tip : (3,) array_like
        A point in the frame of the last link [m].

    Returns
    -------
    CheckedFunction
        Called with q (n,), (3, n + 2) [m] in the base frame; the frames are those of `plant.mechanics.newton_euler`.
    """
    tip = array("tip", tip, (3,), advice="Give x, y and z in the frame of the last link [m].")
    q = ca.SX.sym("q", chain.n)
    orientation, position = ca.SX.eye(3), ca.SX(3, 1)
    positions = [position]
    for i, link in enumerate(chain.links):
        rotation, origin = link.rotation(q[i])
        position = position + orientation @ origin
        orientation = orientation @ rotation
        positions.append(position)
    positions.append(position + orientation @ tip)
    return CheckedFunction(ca.Function("joints", [q], [ca.densify(ca.horzcat(*positions))], ["q"], ["positions"]))
