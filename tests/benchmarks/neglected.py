"""What the model neglects (3.3, 4.2): the current loop. By how many pulses it changes the tracking
errors.

    python tests/benchmarks/neglected.py

The same run of trajectory (6) under P, robot at 16 steps per sample, with motor torques that follow
what is asked for with a lag of first order: the closed current loop of the amplifier, whose time
constant is the inductance over the gain of its PI controller (back-EMF is a disturbance inside that
loop). And what the default identification makes of it.
"""

import casadi as ca
import numpy as np

from identification import identify
from plant import Law, number, part, puma560, simulate

WIDTH = np.diff(puma560.PRINTED_RANGES, axis=1).ravel()


@part
class LaggedP(Law):
    """P control behind an amplifier whose current follows with a lag [s]."""

    period = None

    gain: np.ndarray = number(("n",))
    lag: float = number(())

    def initial_state(self, n):
        return np.zeros(n)

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        wanted = self.gain * (setpoint.pulses - pulses)
        state = state + (1 - ca.exp(-dt / self.lag)) * (wanted - state)
        return rig.drive.joint_torque(state), state


def main():
    robot, rig, path, dynamics = (
        puma560.arm(),
        puma560.rig(),
        puma560.reference(),
        puma560.dynamics(),
    )
    print(
        "| gains | lag [ms] | change of the errors, rms of joints 2, 3 [pulses] | largest | worst"
        " error of f, default |"
    )
    print("|---|---|---|---|---|")
    for gain in ((0.1, 0.08), (0.2, 0.15)):
        p = puma560.p_law(gain)
        plain = simulate(robot, rig, p, path, steps_per_sample=16)
        for lag in (1e-6, 2e-5, 5e-5, 1e-4, 2e-4):
            made = simulate(robot, rig, LaggedP(gain=gain, lag=lag), path, steps_per_sample=16)
            change = made.error_pulses - plain.error_pulses
            log = type(made)(
                t=made.t,
                reference_pulses=made.reference_pulses,
                error_pulses=made.error_pulses,
                rig=rig,
                law=p,
                reference=path,
            )
            try:
                off = 100 * np.abs(identify(dynamics, log, progress=False).f - robot.f) / WIDTH
                said = (
                    f"{off.max():.1f} % ({dynamics.names[int(off.argmax())]}), median"
                    f" {np.median(off):.2f} %"
                )
            except ValueError as error:
                said = str(error).split(";")[0]
            rms = np.sqrt((change**2).mean(axis=0))
            print(
                f"| {gain} | {1e3 * lag:g} | {rms[0]:.2f}, {rms[1]:.2f} |"
                f" {np.abs(change).max():.0f} | {said} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
