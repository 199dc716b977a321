"""A simulated arm for a control script: counts out, torque in, one sample at a time; what it
carries may change.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant.laws.replayed import LoggedTorque
from plant.machine.rig import Rig
from plant.mechanics.arm import Arm
from plant.mechanics.body import Body
from plant.parts.arguments import array, instance, known_options
from plant.parts.fields import Floats
from plant.simulation.closed_loop import ClosedLoop, bounded
from plant.simulation.logged_run import DivergenceError
from plant.simulation.loop_kernel import loop_kernel


def stepped_loop(arm: Arm, rig: Rig, steps_per_sample: int, sweeps: int) -> ClosedLoop:
    """The loop of an arm whose torque comes from outside."""
    instance("arm", arm, Arm, "The order is arm, rig, q.")
    instance("rig", rig, Rig, "The order is arm, rig, q.")
    if rig.transport is not None or rig.jitter is not None:
        raise ValueError(
            "rig must be without transport and jitter here; got one. Delay the script's own calls."
        )
    law = LoggedTorque()
    return ClosedLoop(
        dynamics=arm.dynamics, rig=rig, law=law, steps_per_sample=steps_per_sample, sweeps=sweeps
    )


@known_options
class SteppedArm:
    """The arm of `simulate`, sample by sample, for a controller that `Law.start` gave.

    Parameters
    ----------
    arm : Arm
    rig : Rig
    q, qd : (n,) array_like
        Position [rad] and velocity [rad/s] at the start; by default at rest.
    steps_per_sample, sweeps : int
        As for `simulate`.

    Attributes
    ----------
    q, qd : (n,) numpy.ndarray
        The true position [rad] and velocity [rad/s] of the joints.

    Raises
    ------
    ValueError
        Bad input; a rig with a transport delay or jitter, which belong to the controller's side of
        a script.

    See Also
    --------
    plant.simulate

    Examples
    --------
    >>> from plant import SteppedArm, puma560
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> robot = SteppedArm(arm, rig, (0, 0))
    >>> for _ in range(100):
    ...     counts = robot.step((0, 0))
    ...
    >>> print(counts)                                      # of the motors, after 70 ms without torque
    [487. 100.]
    """

    def __init__(
        self,
        arm: Arm,
        rig: Rig,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        *,
        steps_per_sample: int = 4,
        sweeps: int = 3,
    ) -> None:
        loop = stepped_loop(arm, rig, steps_per_sample, sweeps)
        self.arm = arm
        self.rig = rig
        self.n = rig.n
        q = array("q", q, (rig.n,), advice="Give the position of each joint [rad].")
        qd = (
            np.zeros(rig.n)
            if qd is None
            else array("qd", qd, (rig.n,), advice="Give the velocity of each joint.")
        )
        self._loop, self._kernel, self._f = loop, loop_kernel(loop), np.array(arm.f)
        self._numbers = loop.number_values(self._f)
        self._state = loop.initial_state(q, qd, self._numbers)
        self._logged = [loop.time_names.index(f"logged[{i}]") for i in range(self.n)]
        row = np.zeros(len(loop.time_names))
        row[-1] = loop.h
        self._step_time = np.tile(row, (steps_per_sample, 1))
        self._logs = np.empty((1, loop.n_log)), np.empty((steps_per_sample, self.n))
        self._log = self._logs[0][0]
        self._nothing: tuple[Any, ...] = row[None][:0], np.empty((1, 0)), np.empty((0, 1))

    @property
    def q(self) -> Floats:
        return self._joint("link", 0)

    @property
    def qd(self) -> Floats:
        return self._joint("link_speed", self.n)

    @property
    def pulses(self) -> Floats:
        """What the encoders count now, (n,)."""
        seen = self.q if self.rig.encoder.side == "link" else self._state[: self.n]
        return self.rig.true_counts(seen)

    def carry(self, load: Body | None, link: int | str = -1) -> None:
        """Carry this load from now on, or nothing.

        Parameters
        ----------
        load : Body or None
            In the frame of the link's own body, as for `Chain.carrying`.
        link : int or str
            Place in the chain from 0, or name; by default the last.
        """
        f = self._f
        if load is not None:
            instance("load", load, Body, "Give mass and com; a point mass needs no inertia.")
            f = f + self.arm.dynamics.load_matrix(link) @ load.standard_parameters
        self._numbers[: len(f)] = f

    def step(self, torque: ArrayLike) -> Floats:
        """Apply a joint torque for one sample of the rig.

        Parameters
        ----------
        torque : (n,) array_like
            Held from now to the next sample [N m]; the amplifier's limit is kept.

        Returns
        -------
        pulses : (n,) numpy.ndarray
            What the encoders count then.

        Raises
        ------
        DivergenceError
            A motion that does not stay bounded.
        """
        self._step_time[:, self._logged] = array(
            "torque", torque, (self.n,), advice="Give one per joint [N m]."
        )
        tables = self._kernel.prepared(
            (self._nothing[0], self._step_time[:1], *[self._step_time, self._nothing[1]]),
            logged=True,
        )
        final, _ = self._kernel.run(
            tables, self._state[:, None], np.empty((0, 1)), self._numbers, self._logs
        )
        self._state = final[:, 0]
        if not (self._state[-1] > 0 and bounded(self._state[: 2 * self.n])):
            raise DivergenceError(
                "the arm must stay bounded; it does not under this torque. Lower the gains."
            )
        return self.pulses

    def _joint(self, name: str, otherwise: int) -> Floats:
        loop = self._loop
        start = loop.state_names.index(f"{name}[0]") if name in loop.giving else otherwise
        return self._state[start : start + self.n].copy()
