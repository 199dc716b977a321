"""A law at work in a control script: the same equations as in the simulator, one sample at a time."""

from __future__ import annotations

import numpy as np

from plant.check import array, instance
from plant.kernel import MapKernel
from plant.rig import Rig

__all__ = ["Running"]

FAR = 1e5
"""Angle [rad] up to which the kernels' sines are exact to rounding."""


class Running:
    """A running controller; made by `Law.start`.

    Parameters
    ----------
    law : Law
    rig : Rig
    pulses : (n,) array_like
        Encoder counts now.

    Attributes
    ----------
    pulses : (n,) numpy.ndarray
        Counts of the last call.
    torque : (n,) numpy.ndarray
        Joint torque of the last call [N m].
    state : numpy.ndarray
        State of the law.
    """

    def __init__(self, law, rig, pulses):
        block = law.block(instance("rig", rig, Rig, "Pass found.rig."))
        self.n, self.rig, self.period = rig.n, rig, block.period or rig.period
        self.pulses = self._counts(pulses)
        self.torque, self.state = np.zeros(self.n), block.initial.copy()
        self._kernel = MapKernel(block.step)
        s, n = len(self.state), self.n
        self._x = np.zeros((s + 6 * n + 1 + len(block.values), 1))
        self._x[s + 6 * n] = self.period
        self._x[s + 6 * n + 1 :, 0] = block.values

    def step(self, pulses, q_r, qd_r, qdd_r):
        """Torque to be applied until the next call.

        Parameters
        ----------
        pulses : (n,) array_like
            Encoder counts, whole numbers, read now; to be called once per period.
        q_r, qd_r, qdd_r : (n,) array_like
            Reference for now, joint side [rad, rad/s, rad/s^2].

        Returns
        -------
        (n,) numpy.ndarray
            Joint torque after the amplifier's limit [N m]; ``rig.drive.current(torque)`` is what to command.

        Raises
        ------
        ValueError
            Wrong shapes, NaN, or counts that are not whole. Nothing has changed then.
        """
        pulses = self._counts(pulses)
        motion = [
            array(name, value, (self.n,), advice="Give one value per joint [SI].")
            for name, value in (("q_r", q_r), ("qd_r", qd_r), ("qdd_r", qdd_r))
        ]
        if np.abs(motion[0]).max() > FAR:
            raise ValueError(f"q_r must be below {FAR:g} rad; got {motion[0]}. Take whole turns off.")
        s, n, x = len(self.state), self.n, self._x
        x[:s, 0] = self.state
        x[s : s + 6 * n, 0] = np.concatenate([*motion, self.rig.pulses(motion[0]), pulses, self.torque])
        y = self._kernel(x)[:, 0]
        if not np.isfinite(y).all():
            raise ValueError(f"the law must give finite torques; got {y[:n]} at pulses {pulses}. Check its numbers.")
        self.pulses, self.torque, self.state = pulses, self.rig.drive.limited(y[:n]), y[n:]
        return self.torque.copy()

    def _counts(self, pulses):
        pulses = array("pulses", pulses, (self.n,), advice="Give the encoder count of each joint.")
        if (pulses != np.trunc(pulses)).any():
            raise ValueError(f"pulses must be whole encoder counts; got {pulses}. Give counts, not angles.")
        return pulses
