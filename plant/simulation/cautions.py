"""Warnings before a simulation: missing rotors, an unstable current lag, gears too stiff."""

import math
from dataclasses import replace

import numpy as np

from plant.laws import Law
from plant.machine import FOLLOWED, Rig, reduced
from plant.mechanics import Arm
from plant.parts import Floats, joint_label, warn
from plant.simulation.jacobians import jacobians


def warn_of_stiff_gears(arm: Arm, rig: Rig, pose: Floats, steps_per_sample: int) -> None:
    """Warn of gears whose vibration, motor against link, has its frequency wrong by over 1 %."""
    drive = rig.drive
    if drive.elasticity is None:
        return
    # D of a chain with rotors contains them; the links are the remainder.
    motors = drive.reflected_inertia()
    links = np.diag(drive.coupling.shaft_inertia(arm.D(pose))) - motors
    h = rig.period / steps_per_sample
    # Squared angular frequencies; where motor or link has no inertia, they do not vibrate.
    vibrates = (motors > 0) & (links > 0)
    inertia = reduced(*np.where(vibrates, (motors, links), 1.0))
    squared = np.where(vibrates, drive.elasticity.stiffness / inertia, 0.0)
    joint = int(np.argmax(squared))
    if h * h * squared[joint] <= FOLLOWED:
        return
    hz = math.sqrt(squared[joint]) / (2 * math.pi)
    resolved_hz = math.sqrt(FOLLOWED / (h * h)) / (2 * math.pi)
    steps = math.ceil(steps_per_sample * hz / resolved_hz)
    # More than a hundred steps per sample make a simulation too slow to be advised.
    advice = f"Take steps_per_sample={steps}, or leave" if steps <= 100 else "Leave"
    warn(
        f"the gear of {arm.dynamics.chain.joint_labels[joint]} vibrates at {hz:.4g} Hz, motor"
        f" against link; sub-steps of {1e3 * h:.3g} ms follow {resolved_hz:.4g} Hz to 1 %. {advice}"
        " elasticity out: such a gear is as good as rigid."
    )


def warn_of_missing_rotors(arm: Arm, rig: Rig, q: Floats) -> None:
    """Warn of an arm whose bodies have no rotors, under a drive that has them, at pose q (n,).

    The inertia matrix holds the rotors (f1 and f7 of the paper hold Jm k^2); a drive does not add
    them. Without them an arm is lighter than its motors, and its loop faster than any real one.
    """
    chain = arm.dynamics.chain
    rotors = rig.drive.reflected_inertia()
    if not chain.bodies or chain.n != rig.n or any(body.rotor for body in chain.bodies):
        return
    # An identified f has the rotors in it, whatever the bodies state.
    stated = arm.dynamics.f(chain.bodies)
    if not np.allclose(arm.f, stated, rtol=1e-9, atol=1e-12 * np.abs(stated).max(initial=0.0)):
        return  # identified, or with rotors that the bodies do not show
    share = rotors / np.maximum(np.diag(arm.D(q)), 1e-300)
    # A rotor below a tenth of its joint's inertia hardly changes the loop.
    if share.max() > 0.1:
        joint = int(share.argmax())
        label = joint_label([link.name for link in chain.links], joint)
        warn(
            f"the bodies of the arm have no rotors, and the drive has {rotors[joint]:.3g} kg m^2 at"
            f" {label}, {share[joint]:.2g} of the inertia there. Make the dynamics of"
            " chain.with_rotors(drive)."
        )


def warn_of_unstable_lag(arm: Arm, rig: Rig, law: Law, pose: Floats) -> None:
    """Warn of a fast law whose loop, linearised at a pose, the currents' lag makes unstable."""
    if rig.drive.current_lag is None or law.has_memory(rig.n):
        return
    growing = _growing(arm, rig, law, pose)
    prompt = replace(rig, drive=replace(rig.drive, current_lag=None))
    # A loop that is unstable without lag, too, has another cause.
    if growing is None or _growing(arm, prompt, law, pose) is not None:
        return
    lag = rig.drive.current_lag.time
    name = type(law).__name__
    warn(
        f"with a current_lag of {lag:g} s the loop of {name} is unstable: linearised at the start"
        f" it oscillates at {abs(growing.imag) / (2 * math.pi):.3g} Hz with the time constant"
        f" {1 / growing.real:.2g} s; without lag it is stable. Lower the gains, or take a law with"
        " damping."
    )


def _growing(arm, rig, law, pose):
    """The pole [1/s] that grows fastest; None if none grows, or if the law holds no pose."""
    try:
        poles = np.linalg.eigvals(jacobians(arm, rig, law, pose)[0])
    except np.linalg.LinAlgError:  # a torque that does not depend on the counts
        return None
    fastest = complex(poles[np.argmax(poles.real)])
    # A growth below a millionth of the largest pole may be rounding.
    return fastest if fastest.real > 1e-6 * abs(poles).max() else None
