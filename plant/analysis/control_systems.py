"""Arm, rig and law as python-control systems, connected by the names of their signals.

Every signal has one component per joint, ``q[0]``, ``q[1]``, .... The signals of the systems are
joint-side and in SI units, except the encoder pulses. The drives are part of the arm's system:
their friction and their limit act there, and python-control follows a signal through each system
only once.

A sampled law needs a sampled arm, since python-control connects no continuous system with a
discrete one. The continuous arm is for an ODE solver: its derivative is the limit of the
simulator's sub-step as the length of the step goes to zero, with regularised friction. The sampled
arm makes `steps_per_sample` of the simulator's sub-steps, with its set-valued friction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, cast

import casadi as ca
import numpy as np

from plant.laws import Law, Setpoint, StatelessLaw, Step
from plant.logs import Record
from plant.machine import Rig, punctual_rig
from plant.mechanics import Arm, inverse
from plant.parts import Fields, instance, known_options, part, per_joint, structure
from plant.simulation import ClosedLoop

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
    """An arm, a law or a rig as a python-control system, or a record as a time response.

    The function `control.interconnect` joins the systems by the names of their signals.

    Parameters
    ----------
    system : Arm, Law, Rig or Record
    rig : Rig, optional
        A law and a sampled arm need it. The drives of an arm's rig limit the torque and add their
        friction; an arm without a rig has neither limit nor friction.
    sampled : bool
        If true, the arm is discrete: the torque is held over the rig's period, and friction is
        set-valued. Otherwise it is continuous, and friction is regularised. For arms only.
    steps_per_sample : int
        Sub-steps of a sampled arm, as in `simulate`.

    Returns
    -------
    control.NonlinearIOSystem, or control.TimeResponseData
        Arm: without a rig, inputs ``tau[i]`` [N m]; with one, inputs ``asked[i]``, and outputs
        ``tau[i]`` after the amplifier's limit. The outputs ``q[i]`` and ``qd[i]`` are states, too.
        If the gears are elastic, the output ``q[i]`` is the position that the encoders measure, and
        ``link[i]`` and ``link_speed[i]`` are further outputs and states. A sampled arm also has the
        states ``impulse[i]`` of its friction (0 at the start).
        Law: inputs ``q_r[i]``, ``qd_r[i]``, ``qdd_r[i]``, ``pulses[i]``; outputs ``asked[i]``,
        before the limit. A law with a period is discrete and has the states ``law[i]`` and
        ``torque[i]``, the torque applied last. A law without a period is continuous, or of any time
        if it has no state. The system does not store the initial ``law[i]``: pass
        ``law.block(rig).initial`` to the simulation.
        Rig: inputs ``q[i]`` [rad], outputs ``pulses[i]``. A solver of differential equations needs
        an encoder with ``smooth=True``.
        Record, for python-control's plots: inputs ``reference_pulses[i]``, outputs
        ``error_pulses[i]`` and the other logged columns.

    Raises
    ------
    ValueError
        A law or a sampled arm has no rig; a rig or a record has one beside it; the rig does not
        fit; `sampled` is true for a system that is no arm; a continuous arm has a presliding
        distance that is not positive; a law without a period depends on the torque applied last,
        or has equations that do not hold for dt = 0.

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
    if rig is not None:
        raise ValueError(
            f"rig is for arms and laws; got a {type(system).__name__} beside it. Leave it out."
        )
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
            "arm",
            state,
            {"tau": torque},
            ca.vertcat(qd, qdd),
            {"q": q, "qd": qd},
            0,
            [*_labels("q", n), *_labels("qd", n)],
        )
    instance("rig", rig, Rig, "Pass the rig that drives the arm.")
    # Presliding friction is a spring, in continuous time as well.
    presliding = rig.drive.presliding
    # Bristles of zero length are infinitely stiff: no solver of differential equations takes them.
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
    # The system of the arm contains the limit, so that no separate system of it adds a loop.
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
    labels = [label for name in names for label in _labels(name, n)]
    return _system("arm", symbols, {"asked": torque}, following, outputs, period, labels)


def _rig_system(rig: Rig) -> control.NonlinearIOSystem:
    """The encoders, without state; the drives are in the system of the arm."""
    q = ca.SX.sym("q", rig.n)
    none = ca.SX(0, 1)
    # The encoders have no state, so the state and its derivative are both empty.
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
    # A step of no length changes no state; one that does, such as of the last pulses, has no rate.
    jump = ca.substitute(following, dt, 0) - state
    at_start = ca.Function("rate", [state, *inputs.values()], [command, rate, jump])
    # Tried at the start, at rest and in motion, since a division by dt shows in numbers only.
    for motion in (np.zeros(n), np.ones(n)):
        results = at_start(block.initial, *[motion] * 4)
        torque_at_start, rate_at_start, jump_at_start = (result.full() for result in results)
        finite = np.isfinite(torque_at_start).all() and np.isfinite(rate_at_start).all()
        if not finite or jump_at_start.any():
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
    # `cse` computes common subexpressions once, such as the inertia matrix of all accelerations.
    y = ca.Function("outputs", [state, u], ca.cse([ca.densify(ca.vertcat(*outputs.values()))]))
    f = ca.Function("following", [state, u], ca.cse([ca.densify(following)]))
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
