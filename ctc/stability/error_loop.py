"""Loop transfer function of each joint under a sampled controller, linearised, with sampling, delay and observer.

The loop of a joint is opened where its encoder is read, all other loops stay closed: input are the counts that the
controller reads, output is minus the position, in pulses, so that the sensitivity function is 1 / (1 + L). How the
loops are linearised: `plant.analysis.sampled_loops`.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.verdict.on_gears import arm_of
from identification import Identification
from plant import Arm, Law, Rig
from plant.analysis.sampled_loops import SampledLoops
from plant.parts.arguments import instance, known_options

if TYPE_CHECKING:
    from control import StateSpace


Matrix = NDArray[np.float64]


@known_options
def error_loop(
    arm: Arm | Identification | None, rig: Rig, law: Law, *, joint: int = 0, pose: ArrayLike | None = None
) -> "StateSpace":
    """Loop transfer function L of one joint, the loops of the others closed.

    Parameters
    ----------
    arm : Arm, Identification or None
        What is controlled; None for the law's own, as if f were known.
    rig : Rig
    law : Law
        With a period, such as `ComputedTorque`.
    joint : int
        Counted from 0.
    pose : (n,) array_like, optional
        q at rest [rad]; zeros by default.

    Returns
    -------
    control.StateSpace
        Discrete; from the counts that the law reads to minus the position, both in pulses.

    Raises
    ------
    ValueError
        A law without a period, a joint that is not there, an arm that the law cannot hold at the pose.

    See Also
    --------
    ctc.margins, plant.linearise

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, error_loop
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> loop = error_loop(arm, rig, ComputedTorque(arm, rig, bandwidth=60), joint=0)
    >>> loop.ninputs, loop.noutputs, loop.dt
    (1, 1, 0.0007)
    """
    import control

    loops = SampledLoops(controlled(arm, law), rig, law, pose)
    if not isinstance(joint, (int, np.integer)) or not 0 <= joint < rig.n:
        raise ValueError(f"joint must be a whole number from 0 to {rig.n - 1}; got {joint!r}. Joints count from 0.")
    A, b, c = opened(*loops.matrices(), joint)
    name = f"loop of {controlled(arm, law).dynamics.chain.joint_labels[joint]}"
    ends = {"inputs": [f"pulses[{joint}]"], "outputs": [f"position[{joint}]"]}
    return control.StateSpace(A, b, -c, 0, loops.period, name=name, **ends)


def controlled(arm: Arm | Identification | None, law: Law) -> Arm:
    """The arm itself, that of an identification, or of None that of the law, which is one."""
    instance("law", law, Law, "Give a law, such as ComputedTorque(arm, rig).")
    return arm_of(getattr(law, "arm", None) if arm is None else arm, ", or None for the law's own")


def opened(A: Matrix, B: Matrix, C: Matrix, joint: int) -> tuple[Matrix, Matrix, Matrix]:
    """Matrices of one open loop, the others closed: A (m, m), b (m, 1), c (1, m)."""
    others = [i for i in range(len(C)) if i != joint]
    return A + B[:, others] @ C[others], B[:, [joint]], C[[joint]]
