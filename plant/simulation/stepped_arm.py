"""A simulated arm for a control script, one sample at a time: torque in, counts out, any load."""

import numpy as np
from numpy.typing import ArrayLike

from plant.laws import LoggedTorque
from plant.machine import Rig
from plant.mechanics import Arm, Body
from plant.parts import Floats, array, instance, known_options
from plant.simulation.closed_loop import ClosedLoop
from plant.simulation.logged_run import DivergenceError
from plant.simulation.loop_kernel import loop_kernel


def stepped_loop(arm: Arm, rig: Rig, steps_per_sample: int, sweeps: int) -> ClosedLoop:
    """The loop of an arm whose torque comes from outside."""
    instance("arm", arm, Arm, "The order is arm, rig, q.")
    instance("rig", rig, Rig, "The order is arm, rig, q.")
    if rig.transport is not None or rig.jitter is not None:
        raise ValueError(
            "rig must be without transport and jitter here; got one of them. Delay the calls of"
            " step in the script."
        )
    # A law that repeats a logged torque: the script writes it, sample by sample.
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
    q : (n,) array_like
        Position at the start [rad].
    qd : (n,) array_like, optional
        Velocity at the start [rad/s]; by default zero.
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
    >>> print(counts)  # of the motors, after 70 ms without torque
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
        # 1. The loop and its kernel, for one individual with its log.
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
        self._loop = loop
        self._kernel = loop_kernel(loop)
        # A copy: the arm is frozen, while its load may change from sample to sample.
        self._f = np.array(arm.f)
        self._numbers = loop.number_values(self._f)
        self._state = loop.initial_state(q, qd, self._numbers)
        # The torque is held over a sample, so that its sub-steps have the same inputs.
        self._step_time = np.tile(loop.time_with(), (steps_per_sample, 1))
        self._torque = list(loop.time_fields.at(self.n)["logged"])
        # A state of places in place of values: what is read from it is where each quantity stands.
        places = loop.read_state(np.arange(len(self._state)))
        self._q, self._qd = loop.joint_motion(places)
        self._encoded = loop.encoded(places)
        # Rows of the log and of the sub-steps: the kernel writes them, and nobody reads them here.
        self._logs = np.empty((1, loop.n_log)), np.empty((steps_per_sample, self.n))

    @property
    def q(self) -> Floats:
        return self._state[self._q]

    @property
    def qd(self) -> Floats:
        return self._state[self._qd]

    @property
    def pulses(self) -> Floats:
        """Counts (n,) of the encoders now."""
        return self.rig.true_counts(self._state[self._encoded])

    def carry(self, load: Body | None, link: int | str = -1) -> None:
        """Carry this load from now on, or none.

        Parameters
        ----------
        load : Body or None
            In the frame of the link's own body, as for `Chain.carrying`.
        link : int or str
            Place in the chain from 0, or name; by default the last.
        """
        # A load adds its standard parameters to those of its link; f is linear in them.
        f = self._f
        if load is not None:
            instance("load", load, Body, "Give mass and com; a point mass needs no inertia.")
            # From the bare arm each time, so that loads replace each other and do not add up.
            f = f + self.arm.dynamics.load_matrix(link) @ load.standard_parameters
        self._numbers[: len(f)] = f

    def step(self, torque: ArrayLike) -> Floats:
        """Apply a joint torque for one sample of the rig.

        Parameters
        ----------
        torque : (n,) array_like
            Held from now to the next sample [N m]; the amplifier limits it.

        Returns
        -------
        pulses : (n,) numpy.ndarray
            Counts of the encoders at the next sample.

        Raises
        ------
        DivergenceError
            A motion that does not stay bounded.
        """
        # The torque stands in the column of a logged one. A law that repeats a log has no steps
        # and no data, so these two tables are empty.
        self._step_time[:, self._torque] = array(
            "torque", torque, (self.n,), advice="Give one per joint [N m]."
        )
        law_time = self._step_time[:0]
        sample_time = self._step_time[:1]
        tables = self._kernel.prepared(
            (law_time, sample_time, self._step_time, np.empty((1, 0))), logged=True
        )
        final, _ = self._kernel.run(
            tables, self._state[:, None], np.empty((0, 1)), self._numbers, self._logs
        )
        # Before the check: after a divergence `q` shows where it went.
        self._state = final[:, 0]
        if not self._loop.sound(self._state):
            raise DivergenceError(
                "the arm must stay bounded; it does not under this torque. Lower the gains."
            )
        return self.pulses
