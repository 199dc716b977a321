"""Joints at rest, and torques that were injected beside the law's."""

import dataclasses

import numpy as np
import pytest
from random_rigs import drawn

from ctc import ComputedTorque
from plant import (
    PD,
    PID,
    Body,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    Link,
    P,
    Rig,
    puma560,
    simulate,
)
from plant.checkup import TABLE, Experiment

ARM, RIG = puma560.arm(), puma560.rig()
GAIN = puma560.p_law().gain
LAW = PID(gain=GAIN, derivative=4e-3 * GAIN, integral=5 * GAIN, filter=2000.0, period=RIG.period)
ONE_MOVES = Harmonics(
    period=2.0, offset=(-0.8, 0.8), cosine=((0.3, 0.1), (0, 0)), sine=((0.2, -0.1), (0, 0))
)


def injected(t):
    waves = np.outer(t, 2 * np.pi * np.array((1.3, 1.9)))
    return (40, 20) * np.sin(waves)


def row(name, joints):
    """The row of the table that asks for one mistake of these joints."""
    return next(row for row in TABLE if row.name == name and joints in row.scope(2))


def names(record):
    return [cause.name for cause in record.check().causes]


def test_what_was_injected_is_no_part_of_the_law_s_torque():
    record = simulate(ARM, RIG, LAW, puma560.reference(), duration=2.0, injected=injected)
    gains = {name: 1e3 * getattr(LAW, name) for name in ("gain", "derivative", "integral")}
    wrong = dataclasses.replace(record, law=dataclasses.replace(LAW, **gains))
    assert names(wrong) == ["unit of gains"]
    still = np.zeros(2)
    gravity = np.array([ARM.inverse(q, still, still) for q in RIG.cell_centre(record.counts)])
    lacking = dataclasses.replace(record, torque=record.torque - gravity, current=None)
    assert names(lacking) == ["torque without gravity"]


def test_what_was_injected_is_no_part_of_a_gain_s_torque():
    case = drawn(17, torque=True)
    rig, law, path = case.record.rig, case.record.law, case.record.reference
    half = np.abs(case.record.torque).max(axis=0) / 2
    record = simulate(
        case.dynamics.arm(case.truth),
        rig,
        law,
        path,
        duration=2.0,
        injected=lambda t: np.outer(np.sin(2 * np.pi * 2.7 * t), half),
    )
    stated = dataclasses.replace(law, gain=10 * np.array(law.gain))
    wrong = dataclasses.replace(record, law=stated, torque=None, current=None)
    ((size, odds),) = row("gain alone", (0,)).evidence(Experiment(wrong), (0,))
    assert size == pytest.approx(10, rel=0.02)
    assert odds > 50


@pytest.mark.filterwarnings("error")
def test_a_joint_whose_law_commands_nothing_hides_no_rate_of_another():
    links = tuple(
        Link(name=name, alpha=alpha, a=0.0, d=0.0, prismatic=True)
        for name, alpha in (("x", 0.0), ("y", np.pi / 2))
    )
    bodies = tuple(Body(mass=mass, com=(0, 0, 0), inertia=(0, 0, 0, 0, 0, 0.01)) for mass in (4, 2))
    drive = Drive(
        gear=(600.0, -600.0),
        motor_inertia=5e-5 * np.ones(2),
        viscous=2e-4 * np.ones(2),
        coulomb=0.02 * np.ones(2),
        motor_gain=0.1 * np.ones(2),
        current_limit=20 * np.ones(2),
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=4000), period=1e-3)
    chain = Chain(links=links, bodies=bodies, gravity=(0, 0, 0)).with_rotors(drive)
    dynamics = Dynamics.from_chain(chain)
    gain = np.array((4e-4, 4e-4))
    law = PD(gain=gain, derivative=0.015 * gain, filter=800.0, period=1e-3)
    path = Harmonics(
        period=2.0, offset=(0, 0.1), cosine=((0.05, 0.02), (0, 0)), sine=((0.03, -0.01), (0, 0))
    )
    record = simulate(dynamics.arm(dynamics.f()), rig, law, path, duration=3.0)
    cause, *_ = dataclasses.replace(record, law=P(gain=gain), reference=None).check().causes
    assert cause.name == "rate of the error"
    assert cause.size == pytest.approx(0.015, rel=0.05)


def test_a_reference_at_rest_has_no_lag():
    record = simulate(ARM, RIG, ComputedTorque(ARM, RIG), ONE_MOVES, duration=2.0)
    checkup = dataclasses.replace(record, torque=None, current=None).check()
    delays = [finding for finding in checkup.findings if finding.check == "delay"]
    assert [finding.value is None for finding in delays] == [False, True]


def test_friction_of_the_one_joint_that_moves_is_no_delay():
    record = simulate(ARM, RIG, LAW, ONE_MOVES, duration=1.5)
    guess = dataclasses.replace(RIG.drive, viscous=0.3 * RIG.drive.viscous)
    rig = dataclasses.replace(RIG, drive=guess)
    assert names(dataclasses.replace(record, rig=rig, torque=None, current=None)) == []


def test_a_reference_at_rest_hides_no_delay_of_all():
    record = simulate(ARM, RIG, puma560.p_law(), ONE_MOVES, duration=1.5)
    rows = np.clip(np.arange(len(record)) - 10, 0, None)
    pulses = record.reference_pulses[rows]
    late = dataclasses.replace(
        record, reference=None, reference_pulses=pulses, error_pulses=pulses - record.counts
    )
    experiment = Experiment(late)
    together, second = (row("late references", joints) for joints in ((), (1,)))
    assert 10 in together.suggested(experiment, ())
    assert second.suggested(experiment, (1,)) == ()
