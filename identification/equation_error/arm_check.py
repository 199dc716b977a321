"""Check whether a real arm can have the fitted parameters.

The inertia matrix D(q) must be positive, and no joint may have less inertia than its rotor.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant import Dynamics, Rig
from plant.machine import rotors_alone, shaft_inertias
from plant.parts import Floats


@dataclass(frozen=True, kw_only=True)
class ArmCheckSettings:
    """Limits beyond which the check doubts the parameters. They were chosen by hand.

    Parameters
    ----------
    deviations : float
        Each check allows an inertia an error of this many standard deviations.
    below : float
        The check reports a joint if its inertia is below that of its rotor by more than this share
        of the rotor's inertia, besides the standard deviations.
    rough : float
        This value replaces `below` if the covariance does not cover the errors of the method.
    differing : float
        The check reports an identified rotor if it differs from the stated one by more than this
        share of the stated inertia, besides the standard deviations. The share allows for parts of
        the gear that turn with the rotor, which are seldom stated.
    logged, beyond : int
        D is tested at no more than `logged` poses of the log, and at `beyond` random poses.
    """

    deviations: float = 4.0
    below: float = 0.05
    rough: float = 0.2
    differing: float = 0.2
    logged: int = 60
    beyond: int = 240


SETTINGS = ArmCheckSettings()


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedArm:
    """Parameters `f` (p,) of an arm, with their covariance (p, p).

    The covariance is zero for each parameter that was not fitted. `q` (N, n) holds the poses of
    the log, and `fitted` holds the names of the fitted parameters. `rough` is true if the
    covariance does not cover the errors of the method.
    """

    dynamics: Dynamics
    rig: Rig
    f: Floats
    covariance: Floats
    q: Floats
    fitted: Sequence[str]
    rough: bool

    def doubts(self) -> Iterator[str]:
        """A line where D(q) is not positive, or else one for each rotor that is contradicted."""
        negative = self._negative()
        if negative:
            yield negative
        else:
            yield from self.of_rotors()

    def _negative(self) -> str:
        """Return a message if D is not positive at its worst pose, or else an empty string.

        The test adds `SETTINGS.deviations` standard deviations to the least eigenvalue.
        """
        q, direction, energy = self._worst(self.f)
        # Energy is linear in f.
        row = np.array(
            [
                direction @ self.dynamics.D(q, unit).full() @ direction
                for unit in np.eye(len(self.f))
            ]
        )
        if energy + SETTINGS.deviations * _deviation(row @ self.covariance @ row) > 0:
            return ""
        pose = np.array2string(q, precision=2, separator=", ")
        reason = "Check units (rad, joint side N m), signs and the order of the joints"
        if self._worst(-self.f)[2] > 0:
            reason = (
                "The torques have the other sign, that of what a joint feels: they must be what its"
                " drive gives. Change the sign of the torque"
            )
        return (
            f"no arm has these f: D(q) is negative at q = {pose}, {energy:.3g} along its smallest"
            f" axis. {reason}."
        )

    def _worst(self, f):
        """Pose (n,) of the least eigenvalue of D, its axis (n,), and its value."""
        random = np.random.default_rng(0)
        logged = self.q[:: -(-len(self.q) // SETTINGS.logged)]
        anywhere = random.uniform(-np.pi, np.pi, (SETTINGS.beyond, self.q.shape[1]))
        # A slide has no full turn to test: it keeps its first position in the log.
        slides = [link.prismatic for link in self.dynamics.chain.links]
        anywhere[:, slides] = self.q[:1, slides]
        poses = np.concatenate([logged, anywhere])
        matrices = np.array([self.dynamics.D(q, f).full() for q in poses])
        values, axes = np.linalg.eigh(matrices)
        worst = values[:, 0].argmin()
        return poses[worst], axes[worst, :, 0], values[worst, 0]

    def of_rotors(self) -> Iterator[str]:
        """A line for each joint whose stated rotor the inertias contradict.

        D at the shafts of the motors is at least diag(Jm k^2), whatever the links are: the rotor
        turns with its joint. Where a base parameter is the inertia of one rotor and nothing else,
        a fitted value of this parameter must be close to the stated inertia.
        """
        # At the pose in which the log begins; each inertia is linear in f.
        rows = shaft_inertias(self.dynamics, self.rig, self.q[0])
        inertia = self.f @ rows
        std = _deviation(np.einsum("ki,kl,li->i", rows, self.covariance, rows))
        rotors = self.rig.drive.reflected_inertia()
        alone = {} if self.rough else rotors_alone(self.dynamics)
        below = SETTINGS.rough if self.rough else SETTINGS.below
        unit_of_torque = ", the unit of the torque" if self.rough else ""
        units = self.dynamics.chain.joint_units
        for i, label in enumerate(self.dynamics.chain.joint_labels):
            unit = units[i].inertia
            stated = f"Jm k^2 = {rotors[i]:.3g} {unit}"
            k = alone.get(i, -1)
            if inertia[i] + SETTINGS.deviations * std[i] + below * rotors[i] < rotors[i]:
                yield (
                    f"the inertia of {label}, {inertia[i]:.3g} {unit}, is below that of its rotor"
                    f" as stated, {stated}: check motor_inertia{unit_of_torque} and gear."
                )
            elif k >= 0 and self.dynamics.names[k] in self.fitted:
                limit = SETTINGS.deviations * _deviation(self.covariance[k, k])
                limit += SETTINGS.differing * rotors[i]
                if abs(self.f[k] - rotors[i]) > limit > 0:  # 0: no deviation, no stated rotor
                    yield (
                        f"the rotor of {label} is not as stated: {self.dynamics.names[k]} is"
                        f" {self.f[k]:.3g} {unit}, {stated}. The law has what was found; what is"
                        " said of elastic joints has what is stated. Check motor_inertia and gear."
                    )


def _deviation(variance: Any) -> Any:
    """Standard deviation; zero of a variance that rounding has made negative."""
    return np.sqrt(np.maximum(variance, 0.0))
