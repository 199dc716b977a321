"""Float: the arm carries its own weight, and a hand that moves it feels part of its friction.

The law has no reference. It needs the speed that the hand gives the arm. Counts of a slow joint
give it badly: their difference is zero, and then a pulse per sample. The cell observer corrects its
speed only by what lies outside the counted cell, and lets it leak, so that the assistance ends with
the motion. Assistance beyond friction would drive the arm by itself; the law refuses it.
"""

from typing import Any

import casadi as ca
import numpy as np

from ctc.laws.model_law import ModelLaw
from identification import Identification
from plant import Fields, Rig, number, part, per_joint, scalars, structure
from plant.laws import Setpoint, Step
from plant.machine import Frame
from plant.parts import Floats, Settings, signs, warn


@part
class FloatSettings(Settings):
    """Numbers of the observer of `Float`, and of the bound on its assistance.

    Parameters
    ----------
    assist : float
        Share of friction that the law takes over by default, where the bound allows it.
    observer : float
        Bandwidth of the observer of speed [rad/s]. tests/benchmarks/floating.py chose it: 60 rad/s
        cost the hand on an SO-101 1.12 N, 100 rad/s 1.06 N.
    taper : float
        Share of `Float.speed` within which the assistance ends; chosen by hand.
    cells : float
        Cells of the encoder within `Float.leak` that are a motion of the hand: at this speed some
        three quarters of the assistance act. Chosen by hand.
    gravity, friction : float
        Relative uncertainty of gravity and of friction that no log has identified. 5 % is what a
        data sheet or a CAD model leaves open; state less of an arm that was weighed.
    deviations : float
        Standard deviations of identified gravity and friction that the bound covers.
    poses : int
        Poses, drawn within the limits of the joints, at which gravity is evaluated.

    See Also
    --------
    ctc.Float

    Examples
    --------
    >>> from ctc import FloatSettings
    >>> FloatSettings(observer=40.0).observer
    40.0
    """

    assist: float = 0.7
    observer: float = 100.0
    taper: float = 0.2
    cells: float = 2.0
    gravity: float = 0.05
    friction: float = 0.3
    deviations: float = 2.0
    poses: int = 200


SETTINGS = FloatSettings()


@part
class Float(ModelLaw):
    """tau = g-hat(q) + assist (coulomb tanh(w / w0) + viscous w): a hand moves the arm freely.

    Once per sample: q and the speed w are those of an observer that is corrected by what lies
    outside the counted cell. The reference is ignored; pass the counted position where one is asked
    for. Goals and frames lie beside the motion that the observer sees, so that the inner loop does
    not hold the hand back.

    Parameters
    ----------
    arm : Arm or Identification
        The identified arm; an identification gives its rig, and how well gravity and friction are
        known.
    rig : Rig, optional
        The identified rig: its friction is assisted.
    assist : float, optional
        Share of friction that the law takes over, 0 to 1. By default `FloatSettings.assist`, or
        less where the arm could drive itself: a warning then names the joint.
    leak : float
        Time constant with which the speed leaks [s]: without new counts the assistance ends.
    speed : float
        Speed of a joint above which the law brakes instead of assisting [rad/s, or m/s].
    settings : FloatSettings, optional
        Numbers that seldom need a change.

    Raises
    ------
    ValueError
        As `ModelLaw`; a stated assistance beyond (1 - dg / F) / (1 + s) of a joint, with its
        friction F, the deviation dg of its gravity torque and the relative deviation s of its
        friction: the arm could drive itself. With dg beyond F a released joint falls, and no
        assistance is accepted.

    See Also
    --------
    ctc.ComputedTorque, ctc.PDGravity

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import Float
    >>> Float(puma560.arm(), puma560.rig(), assist=0.4).assist
    0.4
    """

    assist: float = number((), default=None)
    leak: float = number((), default=0.15)
    speed: float = number((), default=3.0)
    settings: FloatSettings = structure(FloatSettings, default=SETTINGS)

    fields = Fields(position=per_joint(), speed=per_joint(), begun=scalars())

    def __post_init__(self) -> None:
        knowledge = self.arm if isinstance(self.arm, Identification) else None
        super().__post_init__()
        signs(self, positive=("leak", "speed"))
        # Left out, it follows from what is known of friction and gravity, below.
        if self.assist is not None:
            signs(self, not_negative=("assist",))
        friction, gravity, relative = self._uncertainty(knowledge)
        bound = (1 - gravity / np.maximum(friction, 1e-12)) / (1 + relative)
        # A joint without dry friction has none to be assisted.
        largest = np.where(friction > 0, bound, 1.0)
        joint = int(np.argmin(largest))
        label = self.arm.dynamics.chain.joint_labels[joint]
        unit = self.arm.dynamics.chain.effort_units[joint]
        if largest[joint] <= 0:
            raise ValueError(
                f"gravity of {label} must be known within its dry friction, {friction[joint]:.2g}"
                f" {unit}, so that it rests when released; got {gravity[joint]:.2g} {unit}."
                " Identify it with its tool, or state FloatSettings(gravity=)."
            )
        if self.assist is None:
            # Rounded down, so that a user may state the number that the warning names.
            allowed = np.floor(100 * largest[joint]) / 100
            assist = min(self.settings.assist, float(allowed))
            object.__setattr__(self, "assist", assist)
            if assist < self.settings.assist:
                warn(
                    f"Float takes over {assist:g} of the friction, not {self.settings.assist:g}:"
                    f" with more, {label} could drive itself, since its friction is known to"
                    f" {relative[joint]:.0%} and its gravity to {gravity[joint]:.2g} {unit}."
                    f" Identify {label} better, or state assist."
                )
        if self.assist > largest[joint]:
            raise ValueError(
                f"assist must be at most {largest[joint]:.2g}, so that {label} cannot drive itself"
                " with the gravity and friction that are left open;"
                f" got {self.assist:g}. Lower it, or identify {label} better."
            )

    def _uncertainty(self, identification: Any) -> tuple[Floats, Floats, Floats]:
        """Dry friction (n,), deviation of gravity (n,) [N m], relative deviation of friction."""
        n = self.arm.n
        friction = np.array(self.rig.drive.joint_coulomb(np.zeros(n)))
        relative = np.full(n, self.settings.friction)
        fit = None if identification is None else identification.fit
        if fit is None or fit.covariance is None:
            # The weight is wrong as a whole: the share of the largest torque that it causes.
            gravity = self.arm.dynamics.gravity
            torques = np.array([gravity(pose, self.arm.f).full()[:, 0] for pose in self.poses()])
            return friction, self.settings.gravity * np.abs(torques).max(axis=0), relative
        for i in range(n):
            name = f"drive.coulomb[{i}]"
            if name in fit.unknown and self.rig.drive.coulomb[i] > 0:
                deviation = fit.std[fit.unknown.index(name)]
                relative[i] = self.settings.deviations * deviation / self.rig.drive.coulomb[i]
        return friction, self.settings.deviations * self._gravity_deviation(fit), relative

    def _gravity_deviation(self, fit: Any) -> Floats:
        """Largest standard deviation (n,) of the gravity torque over the poses [N m]."""
        dynamics = self.arm.dynamics
        q = ca.SX.sym("q", self.arm.n)
        f = ca.SX.sym("f", len(self.arm.f))
        # Gravity is linear in f.
        regressor = ca.Function("regressor", [q], [ca.jacobian(dynamics.gravity(q, f), f)])
        known = [name in fit.unknown for name in dynamics.names]
        places = [fit.unknown.index(name) for name in dynamics.names if name in fit.unknown]
        covariance = fit.covariance[np.ix_(places, places)]
        variances = []
        for pose in self.poses():
            Y = np.array(regressor(pose))[:, known]
            variances.append(np.einsum("ij,jk,ik->i", Y, covariance, Y))
        return np.sqrt(np.maximum(np.max(variances, axis=0), 0.0))

    def poses(self) -> Floats:
        """Poses (P, n) drawn within the limits of the joints, or a turn where there are none."""
        chain = self.arm.dynamics.chain
        low = np.full(self.arm.n, -np.pi)
        high = np.full(self.arm.n, np.pi)
        if chain.limits is not None:
            low = np.maximum(low, chain.limits.lower)
            high = np.minimum(high, chain.limits.upper)
        # A fixed seed: the same law accepts the same assistance.
        return np.random.default_rng(0).uniform(low, high, (self.settings.poses, self.arm.n))

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """One sample: cell of the count -> q and speed -> gravity and assistance."""
        n = self.arm.n
        before = self.fields.read(state, n)
        centre = rig.cell_centre(pulses)

        # 1. Predict. The speed leaks: a joint that gives no counts is at rest.
        decay = ca.exp(-dt / self.leak)
        speed = before.speed * decay
        predicted = ca.if_else(before.begun > 0, before.position + dt * speed, centre)

        # 2. Correct by what lies outside the counted cell.
        half_cell = ca.fabs(ca.diag(self.rig.to_angle(ca.SX.eye(n)))) / 2
        deviation = centre - predicted
        outside = deviation - ca.fmax(ca.fmin(deviation, half_cell), -half_cell)
        pole = ca.exp(-self.settings.observer * dt)
        position = predicted + (1 - pole**2) * outside
        speed = speed + (1 - pole) ** 2 * outside / dt
        # In a steady motion the leaking speed stays behind by this factor.
        steady = speed * (decay + (1 - decay) * (1 + pole) / (1 - pole))

        # 3. Assist up to the largest speed, and brake above it.
        begins = 2 * self.settings.cells * half_cell / self.leak
        excess = ca.fmax(ca.fabs(steady) - self.speed, 0)
        share = ca.fmax(1 - excess / (self.settings.taper * self.speed), 0)
        viscous = self.rig.drive.joint_viscous(steady)
        coulomb = self.rig.drive.joint_coulomb(steady) * ca.tanh(steady / begins)
        friction = coulomb + viscous * steady
        brake = viscous * ca.sign(steady) * excess
        acting = self.assist * share * friction - brake

        # 4. Gravity, at the place that the observer knows better than the count.
        gravity = self.arm.dynamics.gravity(position, self.arm.f) - self.rig.spring_torque(position)
        following = self.fields.write(n, position=position, speed=speed, begun=1)
        torque = gravity + self.rig.drive.coupling.joint_torque(acting)
        return torque + self._beside(rig, setpoint, position, steady), following

    def _beside(self, rig: Rig, setpoint: Setpoint, q: ca.SX, qd: ca.SX) -> ca.SX:
        """Torque (n, 1) by which a goal or frame lies beside this motion, not the reference."""
        known = self.rig_of_frames(rig)
        if rig.inner is None or known.inner is None:
            return ca.SX.zeros(rig.n)
        # It holds for a period, which begins late where frames are late: the middle of that time.
        late = 0 if known.transport is None else known.transport.delay
        middle = rig.period / 2 + late
        own = q + middle * qd
        frame = Frame(rig.position_in_pulses(own) - rig.encoder.centre, qd, ca.SX.zeros(rig.n))
        reference = setpoint.q + middle * setpoint.qd + middle**2 / 2 * setpoint.qdd
        return known.inner.added(rig, reference, setpoint.qd + middle * setpoint.qdd, frame)

    def model_parts(self, q: ca.SX, qd: ca.SX, qdd: ca.SX) -> dict[str, ca.SX]:
        """Gravity alone: a firmware that adds friction would not know the assistance."""
        return {"gravity": self.arm.dynamics.gravity(q, self.arm.f)}
