"""Arm, rig and law as python-control systems, connected by the names of their signals.

Every signal has one component per joint, ``q[0]``, ``q[1]``, ...; all are joint side but the
pulses, SI. The drives are with the arm, where their friction and their limit act; python-control
follows a signal through each system once only.

A sampled law needs a sampled arm, since python-control connects no continuous system with a
discrete one. The continuous arm is the limit of the simulator's sub-step for a short step, with
regularised friction, for an ODE solver; the sampled one makes as many of those sub-steps as
`simulate` does, with its set-valued friction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, cast

import casadi as ca
import numpy as np

from plant.laws.law import Law, Setpoint, StatelessLaw, Step
from plant.logs.record import Record
from plant.machine.rig import Rig, punctual_rig
from plant.mechanics.arm import Arm
from plant.mechanics.symmetric_inverse import inverse
from plant.parts import Fields, instance, known_options, part, per_joint, structure
from plant.simulation.closed_loop import ClosedLoop

if TYPE_CHECKING:
    import control


# Columns that become outputs, where a record has them.
_LOGGED = "error_pulses", "torque", "current", "injected", "true_q", "true_qd"


@part
class _Held(StatelessLaw):
    """Holds the torque, so that a loop has only arm and drives."""

    period: float = structure(float)

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        return torque, state


@known_options
def to_control(
    system: Arm | Law | Rig | Record,
    rig: Rig | None = None,
    *,
    sampled: bool = False,
    steps_per_sample: int = 4,
) -> control.NonlinearIOSystem | control.TimeResponseData:
    """An arm, a law or a rig as a python-control system, for `control.interconnect`.

    That function joins systems by the names of their signals.

    Parameters
    ----------
    system : Arm, Law, Rig or Record
    rig : Rig, optional
        Needed by a law. Of an arm: its drives limit the torque, and their friction acts on the
        joints; without it, neither does.
    sampled : bool
        Of an arm, one sample of the simulator: torque held over the rig's period, friction
        set-valued. Otherwise a continuous system, friction regularised.
    steps_per_sample : int
        Sub-steps of a sampled arm, as in `simulate`.

    Returns
    -------
    control.NonlinearIOSystem, or control.TimeResponseData
        Arm: outputs ``q[i]``, ``qd[i]``, which are its states too. Without a rig, inputs ``tau[i]``
        [N m]; with it, inputs ``asked[i]`` and outputs ``tau[i]``, after the amplifier's limit. A
        sampled arm has also the states ``impulse[i]`` of its friction (0 at the start). Law: inputs
        ``q_r[i]``, ``qd_r[i]``, ``qdd_r[i]``, ``pulses[i]``, outputs ``asked[i]``, before the
        limit. With a period it is discrete; its states are ``law[i]``, at first
        ``law.block(rig).initial``, and the torque applied last, ``torque[i]``. Without one it is
        continuous, or of any time if it has no state. Rig: inputs ``q[i]`` [rad], outputs
        ``pulses[i]``. A solver of differential equations wants an encoder with ``smooth=True``.
        Record, for python-control's plots: inputs ``reference_pulses[i]``, outputs
        ``error_pulses[i]`` and the other logged columns.

    Raises
    ------
    ValueError
        A sampled arm or a law without a rig, a rig that does not fit, a law without a period whose
        equations do not hold for dt = 0.

    See Also
    --------
    plant.linearise

    Examples
    --------
    >>> from plant import puma560, to_control
    >>> system = to_control(puma560.arm(), puma560.rig())
    >>> system.nstates, system.ninputs
    (4, 2)
    """
    if isinstance(system, Arm):
        return _arm_system(system, rig, sampled, steps_per_sample)
    # The period of a law is part of it, and a rig has no time at all.
    if sampled:
        raise ValueError(
            f"sampled is for arms; got a {type(system).__name__}, whose time is its own. Leave it"
            " out."
        )
    if isinstance(system, Law):
        return _law_system(system, rig)
    if isinstance(system, Record):
        return _time_response(system)
    return _rig_system(instance("system", system, Rig, "Pass an Arm, a Law, a Rig or a Record."))


def _arm_system(
    arm: Arm, rig: Rig | None, sampled: bool, steps_per_sample: int
) -> control.NonlinearIOSystem:
    """Joint torques in, joint motion out."""
    n = arm.n
    torque = ca.SX.sym("torque", arm.n)
    h = ca.SX.sym("h")
    if rig is None:
        if sampled:
            raise ValueError(
                "rig must be given for a sampled arm; got None. Period and friction are the rig's."
            )
        q = ca.SX.sym("q", n)
        qd = ca.SX.sym("qd", n)
        state = ca.vertcat(q, qd)
        # Without a rig there is neither friction nor a limit: the rigid-body equation alone.
        qdd = inverse(arm.dynamics.D(q, arm.f)).solve(torque - arm.dynamics.h(q, qd, arm.f))
        return _system(
            "arm", state, {"tau": torque}, ca.vertcat(qd, qdd), {"q": q, "qd": qd}, 0, ("q", "qd")
        )
    instance("rig", rig, Rig, "Pass the rig that drives the arm.")
    # Presliding friction is a spring, in continuous time as well.
    presliding = rig.drive.presliding
    # Bristles of no length are infinitely stiff, which a solver of differential equations is not.
    if not sampled and presliding is not None and not (presliding.distance > 0).all():
        raise ValueError(
            "distance of a continuous arm's presliding must be positive; got"
            f" {presliding.distance}. Leave presliding out, or take sampled=True."
        )
    # The simulator's own step, with a law that only holds the torque.
    _Held(period=rig.period).block(rig).require_torque("to_control")
    loop = ClosedLoop(
        dynamics=arm.dynamics,
        rig=punctual_rig(rig),
        law=_Held(period=rig.period),
        steps_per_sample=steps_per_sample,
        smooth=not sampled,
    )
    # Regularised friction has no impulse that it remembers.
    names = ("q", "qd", *(("impulse",) if sampled else ()), *loop.drive_states)
    fields = Fields(**{name: per_joint() for name in names})
    symbols = ca.SX.sym("state", fields.length(n))
    state = fields.read(symbols, n)
    # Within the system of the arm: a limit between two systems would be a loop of its own.
    tau = rig.drive.limited(torque)
    following = loop.state_with(torque=tau, **state._asdict())
    for _ in range(steps_per_sample if sampled else 1):
        following = loop.substep(following, loop.time_with(h=h), loop.number_values(arm.f))[0]
    values = loop.read_state(following)._asdict()
    following = fields.write(n, **{name: values[name] for name in names})
    # The rate of a continuous arm is the derivative of a sub-step by its length, at length zero.
    if not sampled:
        following = ca.jacobian(following, h)
    following = ca.substitute(following, h, loop.h if sampled else 0)
    # Outputs are those of the present state; only `following` is one step ahead.
    outputs = {"q": state.q, "qd": state.qd, "tau": tau}
    if loop.elastic:
        # The encoders decide which side of the gears the law sees.
        outputs |= {"q": loop.encoded(state), "link": state.link, "link_speed": state.link_speed}
    # python-control has 0 for continuous time, and None for a system of any time.
    period = rig.period if sampled else 0
    return _system("arm", symbols, {"asked": torque}, following, outputs, period, names)


def _rig_system(rig: Rig) -> control.NonlinearIOSystem:
    """The encoders, without state; the drives are in the system of the arm."""
    q = ca.SX.sym("q", rig.n)
    none = ca.SX(0, 1)
    # python-control takes a system without state; its derivative is empty as well.
    return _system("rig", none, {"q": q}, none, {"pulses": rig.true_counts(q)}, None, ())


def _law_system(law: Law, rig: Rig | None) -> control.NonlinearIOSystem:
    """Reference and pulses in, joint torque out."""
    rig = cast(Rig, instance("rig", rig, Rig, "Pass the rig that the law drives."))
    block = law.block(rig)
    block.require_torque("to_control")
    n = rig.n
    q, qd, qdd, pulses = (ca.SX.sym(name, n) for name in ("q_r", "qd_r", "qdd_r", "pulses"))
    state = ca.SX.sym("law", len(block.initial))
    torque = ca.SX.sym("torque", n)
    dt = ca.SX.sym("dt")
    command, following = block.step(
        state, q, qd, qdd, rig.counts(q), pulses, torque, dt, block.values
    )
    inputs = {"q_r": q, "qd_r": qd, "qdd_r": qdd, "pulses": pulses}
    names = _labels("law", len(block.initial))
    if block.period is not None:
        # The torque applied last is a state of the discrete system.
        following = ca.vertcat(following, rig.drive.limited(command))
        command, following = ca.substitute([command, following], [dt], [ca.SX(block.period)])
        names += _labels("torque", n)
        state = ca.vertcat(state, torque)
        return _system("law", state, inputs, following, {"asked": command}, block.period, names)
    # In continuous time a step has no length.
    command = ca.substitute(command, dt, 0)
    if ca.depends_on(command, torque):
        raise ValueError(
            "a law without a period must not depend on the torque applied last;"
            f" {type(law).__name__} does, and there is no last torque in continuous time. Give it a"
            " period."
        )
    # The rate of its state is the derivative of a step by its length, at length zero.
    following = ca.substitute(following, torque, rig.drive.limited(command))
    rate = ca.substitute(ca.jacobian(following, dt), dt, 0)
    at_start = ca.Function("rate", [state, *inputs.values()], [command, rate])
    # Tried once at the start, since a division by dt shows in numbers only.
    results = at_start(block.initial, *[np.zeros(n)] * 4)
    if not all(np.isfinite(result.full()).all() for result in results):
        raise ValueError(
            "a law without a period must have equations that hold for dt = 0; those of"
            f" {type(law).__name__} do not. Give it a period."
        )
    return _system("law", state, inputs, rate, {"asked": command}, 0 if names else None, names)


def _time_response(record: Record) -> control.TimeResponseData:
    """A record as control.TimeResponseData."""
    import control

    columns = [(name, getattr(record, name)) for name in _LOGGED]
    # Columns that the record does not have are left out.
    columns = [(name, values) for name, values in columns if values is not None]
    outputs = [label for name, _ in columns for label in _labels(name, record.n)]
    return control.TimeResponseData(
        record.t,
        np.hstack([values for _, values in columns]).T,
        inputs=record.reference_pulses.T,
        issiso=False,
        output_labels=outputs,
        input_labels=_labels("reference_pulses", record.n),
        title=repr(record),
        sysname="record",
    )


def _system(
    name: str,
    state: ca.SX,
    inputs: Mapping[str, ca.SX],
    following: ca.SX,
    outputs: Mapping[str, ca.SX],
    dt: float | None,
    states: Sequence[str],
) -> control.NonlinearIOSystem:
    """A NonlinearIOSystem of casadi expressions.

    `following` is the derivative of the state, or in discrete time the state one sample later.
    """
    import control

    # Each signal has one component per joint, so any input tells their number.
    n = next(iter(inputs.values())).shape[0]
    u = ca.vertcat(*inputs.values())
    # Common subexpressions once: the inertia matrix is in all accelerations.
    y = ca.Function("outputs", [state, u], ca.cse([ca.densify(ca.vertcat(*outputs.values()))]))
    f = ca.Function("following", [state, u], ca.cse([ca.densify(following)]))
    if len(states) != state.shape[0]:
        states = [label for state_name in states for label in _labels(state_name, n)]
    return control.NonlinearIOSystem(
        (lambda t, x, u, params: f(x, u).full().ravel()) if states else None,
        lambda t, x, u, params: y(x, u).full().ravel(),
        inputs=[label for input_name in inputs for label in _labels(input_name, n)],
        outputs=[label for output_name in outputs for label in _labels(output_name, n)],
        states=list(states) or None,
        dt=dt,
        name=name,
    )


def _labels(name: str, n: int) -> list[str]:
    return [f"{name}[{i}]" for i in range(n)]
