"""Event-accurate motion of an arm with set-valued Coulomb friction: the reference for the plant's time stepping.

    D(q) qdd + h(q, qd) + B qd + s = torque(t, q, qd),    s_i = C_i sign(qd_i) if qd_i != 0, else |s_i| <= C_i

Each joint is stuck (mode 0: qd = 0, and s is whatever holds it) or slides (mode +1 or -1). Between two changes of mode
the motion is smooth and DOP853 integrates it nearly to rounding; a change is an event, located by root finding: a
sliding joint comes to rest, or a stuck one needs more than C. At rest the next modes are those that agree with the
motion they cause; their accelerations are unique, since they minimise a strictly convex function
(1/2 qdd' D qdd - drive' qdd + the sum of C_i |qdd_i| over the joints at rest).
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

# Friction a stuck joint may need, in units of C. The excess over 1 lets a joint break away with an
# acceleration that is surely in its direction (rounding is 1e-16 of the torques); it delays the
# break-away by 1e-10 C / (dtau/dt).
_HOLDS = 1 + 1e-10
# margins this small, relative to the piece's largest, are events at the same instant as the one
# found
_AT_ONCE = 1e-13


class Event(NamedTuple):
    """A change of one joint's mode.

    Attributes
    ----------
    t : float
        Time [s].
    joint : int
        Index of the joint, from 0.
    kind : str
        "stick", or the direction of the motion that begins: "slip+" (qd > 0), "slip-". A joint that
        turns round without a pause has a slip event only.
    """

    t: float
    joint: int
    kind: str


def simulate_events(D, h, C, B, torque, t_end, q0, qd0, t_eval, *, tolerance=1e-12, max_step=None):
    """Integrate an arm with Coulomb friction from event to event.

    Parameters
    ----------
    D : callable
        D(q) -> inertia matrix (n, n), motor inertias included [kg m^2].
    h : callable
        h(q, qd) -> Coriolis, centrifugal and gravity torques (n,) [N m].
    C : (n,) array_like
        Coulomb friction levels, joint side [N m].
    B : (n,) array_like
        Viscous friction, joint side [N m s/rad].
    torque : callable
        torque(t, q, qd) -> joint torques (n,) [N m], continuous; the step control finds kinks.
    t_end : float
        End of the motion [s]; it starts at 0.
    q0, qd0 : (n,) array_like
        Initial positions [rad] and velocities [rad/s]; a velocity of exactly 0 may stick.
    t_eval : (N,) array_like
        Times in [0, t_end] at which q is wanted [s].
    tolerance : float
        Relative tolerance per step; the absolute one is a hundredth of it.
    max_step : float, optional
        Longest step [s], t_end / 1000 if not given. Events are seen at the ends of steps, so a
        torque that exceeds C and falls back within one step is missed.

    Returns
    -------
    q : (N, n) ndarray
        Positions at t_eval [rad].
    events : list of Event
        Changes of mode in order of time; the modes at t = 0 are none.

    Raises
    ------
    RuntimeError
        If a step ended in a state that contradicts its modes (an event was missed), or events pile
        up at one instant.
    """
    C, B, t_eval = np.asarray(C, float), np.asarray(B, float), np.asarray(t_eval, float)
    n, joints = len(C), range(len(C))

    def motion(t, q, qd, modes):
        """Accelerations and friction torques s, each (n,), while the joints are in these modes."""
        slides = modes != 0
        inertia, friction, qdd = D(q), C * modes, np.zeros(n)
        drive = torque(t, q, qd) - h(q, qd) - B * qd
        qdd[slides] = np.linalg.solve(inertia[np.ix_(slides, slides)], (drive - friction)[slides])
        return qdd, np.where(slides, friction, drive - inertia @ qdd)

    def consistent(t, q, qd, choices):
        """Of the choices of modes, one that agrees with the motion it causes; where several do,
        the most stuck one.
        """
        for choice in sorted(product(*choices), key=np.count_nonzero):
            modes = np.array(choice)
            qdd, friction = motion(t, q, qd, modes)
            starts = (qd == 0) & (modes != 0)
            if (abs(friction) <= C * _HOLDS).all() and (modes * qdd > 0)[starts].all():
                return modes
        raise RuntimeError(
            f"no modes agree with q = {q}, qd = {qd} at t = {t}. Is D positive definite there?"
        )

    def rate(t, state, modes):
        return np.concatenate([state[n:], motion(t, state[:n], state[n:], modes)[0]])

    def margin(t, state, modes, joint):
        """Positive while the joint's mode lasts: its speed, or the friction that is left."""
        if modes[joint]:
            return modes[joint] * state[n + joint]
        return C[joint] * _HOLDS - abs(motion(t, state[:n], state[n:], modes)[1][joint])

    def event_of(joint):
        def event(t, state, modes):
            return margin(t, state, modes, joint)

        event.terminal, event.direction = True, -1
        return event

    q, qd, t = np.array(q0, float), np.array(qd0, float), 0.0
    modes = consistent(t, q, qd, [(0, 1, -1) if v == 0 else (int(np.sign(v)),) for v in qd])
    positions, events, at_once = np.tile(q, (len(t_eval), 1)), [], 0
    while True:
        piece = solve_ivp(
            rate,
            (t, t_end),
            np.concatenate([q, qd]),
            method="DOP853",
            dense_output=True,
            events=[event_of(joint) for joint in joints],
            args=(modes,),
            rtol=tolerance,
            atol=tolerance / 100,
            max_step=t_end / 1000 if max_step is None else max_step,
        )
        if piece.status < 0:
            raise RuntimeError(f"integration stopped at t = {piece.t[-1]}: {piece.message}")
        margins = np.array(
            [
                [margin(*point, modes, j) for j in joints]
                for point in zip(piece.t, piece.y.T, strict=True)
            ]
        )
        scale = np.where(modes == 0, C, abs(margins).max(axis=0))
        if (margins[1:-1] < -1e-7 * scale).any():
            raise RuntimeError(
                f"modes {modes} contradicted between t = {t} and {piece.t[-1]}. Use a shorter"
                " max_step."
            )
        inside = (t_eval > t) & (t_eval <= piece.t[-1])
        if inside.any():
            positions[inside] = piece.sol(t_eval[inside])[:n].T
        at_once = at_once + 1 if piece.t[-1] - t < 1e-13 * t_end else 0
        if at_once > 4 * n:
            raise RuntimeError(f"more than {4 * n} events at t = {t}; modes {modes} do not settle.")
        t, q, qd = piece.t[-1], piece.y[:n, -1].copy(), piece.y[n:, -1].copy()
        if piece.status == 0:
            return positions, events

        found = np.array([len(times) > 0 for times in piece.t_events]) | (
            margins[-1] <= _AT_ONCE * scale
        )
        rests, breaks = found & (modes != 0), found & (modes == 0)
        needed = motion(t, q, qd, modes)[1]
        qd[rests] = 0.0
        choices = [(0, 1, -1) if v == 0 else (int(np.sign(v)),) for v in qd]
        for joint in np.flatnonzero(breaks):
            choices[joint] = (int(np.sign(needed[joint])),)
        previous, modes = modes, consistent(t, q, qd, choices)
        for joint in np.flatnonzero(modes != previous):
            events.append(
                Event(
                    float(t), int(joint), {0: "stick", 1: "slip+", -1: "slip-"}[int(modes[joint])]
                )
            )


class GearedJoint(NamedTuple):
    """One horizontal geared joint that lifts a link under P control and sticks at every reversal of
    a slow reference.

    tau = stiffness (q_r - q), q_r(t) = amplitude (1 - cos(2 pi t / period)); the encoder is not
    quantised. The link's z axis is horizontal and x points along it, level at q = 0 and upwards for
    q > 0: gravity torque m g r cos q.

    Attributes
    ----------
    mass : float
        Link [kg].
    radius : float
        Distance of the centre of mass from the axis [m].
    inertia : float
        All inertia about the axis: link about the joint, and motor times gear ratio squared [kg
        m^2].
    coulomb, viscous : float
        Friction, joint side [N m] and [N m s/rad].
    stiffness : float
        Position gain, joint side [N m/rad].
    amplitude : float
        Of the reference [rad].
    period : float
        Of the reference [s].
    """

    mass: float = 3.0
    radius: float = 0.15
    inertia: float = 0.8
    coulomb: float = 6.0
    viscous: float = 0.3
    stiffness: float = 1500.0
    amplitude: float = 0.05
    period: float = 2.0

    def reference(self, t):
        """Reference position [rad] at the time t [s]."""
        return self.amplitude * (1 - np.cos(2 * np.pi * t / self.period))

    def equations(self):
        """D, h, C, B and torque as keyword arguments of `simulate_events`."""
        moment = self.mass * 9.81 * self.radius
        return {
            "D": lambda q: np.array([[self.inertia]]),
            "h": lambda q, qd: moment * np.cos(q),
            "C": (self.coulomb,),
            "B": (self.viscous,),
            "torque": lambda t, q, qd: self.stiffness * (self.reference(t) - q),
        }
