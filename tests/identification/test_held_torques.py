"""Whether a logged torque was held until the next sample follows from the log."""

import dataclasses
import re

import numpy as np
import pytest
from packaged_arms import elbow_of_a_ur5e

from ctc import ComputedTorque
from identification import identify
from identification.replay import Prediction
from plant import (
    PD,
    Body,
    Cascade,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    Link,
    LoggedCurrent,
    LoggedTorque,
    P,
    Record,
    Rig,
    puma560,
    simulate,
)


def repeated(law, made_by):
    """A log of the paper's arm under a controller, as one that repeats its torque or current."""
    made = simulate(puma560.arm(), puma560.rig(), made_by, puma560.reference(), duration=1.2)
    current = made.rig.drive.current(made.torque)
    return dataclasses.replace(made, law=law, current=current, true_q=None, true_qd=None)


@pytest.mark.parametrize(
    "law", [LoggedTorque(), pytest.param(LoggedCurrent(), marks=pytest.mark.slow)]
)
def test_the_torque_of_a_loop_faster_than_its_log_is_found_to_be(law):
    """P of the paper is fast hardware: held, its torques made late and wrong arms."""
    found = identify(puma560.dynamics(), repeated(law, puma560.p_law()), progress=False)
    assert found.records[0].law.held is False
    assert "delay" not in found.diagnostics.detection.names
    assert found.fit.rms_innovation < 1


def test_the_torque_of_a_sampled_controller_is_found_to_be_held():
    controller = ComputedTorque(puma560.arm(), puma560.rig())
    found = identify(puma560.dynamics(), repeated(LoggedTorque(), controller), progress=False)
    assert found.records[0].law.held is True
    assert "delay" not in found.diagnostics.detection.names


def test_what_is_stated_of_the_torque_stays():
    log = repeated(LoggedTorque(held=True), puma560.p_law())
    found = identify(puma560.dynamics(), log, progress=False, method="equation_error")
    assert found.records[0].law.held is True


@pytest.mark.parametrize("law", [LoggedTorque(held=False), LoggedCurrent(held=False)])
def test_a_torque_beside_an_interpolated_one_leaves_it_interpolated(law):
    """Held, the torque of a faster loop would be another one."""
    log = repeated(law, puma560.p_law())
    dynamics = puma560.dynamics()
    prediction = Prediction(dynamics, log, dynamics.names)
    values = np.append(puma560.arm().f, prediction.nuisances)
    alone = prediction.innovations(values)
    none = prediction.beside([np.zeros(log.counts.shape)]).innovations(values)
    np.testing.assert_allclose(none, alone, rtol=0, atol=1e-9 * np.abs(alone).max())
    some = prediction.beside([np.ones(log.counts.shape)]).innovations(values)
    assert np.abs(some - alone).max() > 0.1


def test_what_a_faster_loop_does_between_its_rows_is_no_finding():
    """It chatters between counts, while one joint creeps: rows show a part of that alone."""
    chain, rig = elbow_of_a_ur5e("fix")
    dynamics = Dynamics.from_chain(chain.with_rotors(rig.drive))
    path = Harmonics(
        period=2.7,
        offset=(0.1, -0.1),
        cosine=((0.3, 0.1), (0.03, 0.0)),
        sine=((-0.2, 0.1), (0.0, 0.03)),
    )
    law = P(gain=(0.042, 0.0153))
    made = simulate(dynamics.arm(dynamics.f()), rig, law, path, duration=2.7, steps_per_sample=64)
    log = Record(
        t=made.t, error_pulses=-made.counts, torque=made.torque, rig=rig, law=LoggedTorque()
    )
    found = identify(dynamics, log, progress=False)
    assert found.records[0].law.held is False
    assert found.fit.rms_innovation > 0.5
    assert found.doubts == []


def test_a_law_that_is_faster_than_its_log_is_not_judged_by_counts_between_rows():
    """Run along the rows it gave another torque: gears, friction and the law were in doubt."""
    rig = puma560.rig()
    law = Cascade(
        position=(60.0, 60.0),
        speed=(1e-3, 8e-4),
        integral=(0.05, 0.04),
        difference=8,
        period=rig.period / 4,
    )
    log = simulate(puma560.arm(), rig, law, puma560.reference(), duration=2.0)
    log = dataclasses.replace(log, true_q=None, true_qd=None)
    found = identify(puma560.dynamics(), log, progress=False)
    assert found.diagnostics.law_apart == (None,)
    assert found.doubts == []
    assert (np.abs(found.f - puma560.arm().f) < 5 * found.fit.std[:9]).all()


def slide_under_a_cascade():
    """Two joints and a slide under a drive at 4 kHz, logged at 1 kHz."""
    drive = Drive(
        gear=(80.0, -60.0, 2 * np.pi / 0.02),
        motor_inertia=(6e-5, 4e-5, 2e-5),
        viscous=(2e-4, 2e-4, 1e-4),
        coulomb=(0.03, 0.02, 0.01),
        motor_gain=(0.1,) * 3,
        current_limit=(20.0,) * 3,
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=(4096,) * 3), period=1e-3)
    links = Link(name="1"), Link(name="2", a=0.3), Link(name="3", a=0.25, prismatic=True)
    bodies = [
        Body(mass=mass, com=(0.1, 0, 0), inertia=(0.02, 0, 0, 0.02, 0, 0.02), rotor=rotor)
        for mass, rotor in zip((5, 3, 2), drive.reflected_inertia(), strict=True)
    ]
    dynamics = Dynamics.from_chain(Chain(links=links, bodies=bodies))
    path = Harmonics(
        period=2.0,
        offset=(0.2, 0.0, 0.0),
        cosine=((0.3, 0.1), (0.2, -0.2), (0.02, 0.01)),
        sine=((0.1, 0.2), (0.2, 0.1), (0.01, 0.02)),
    )
    law = Cascade.from_drive(
        rig, Kp=40, Kv=(0.02, 0.02, 0.01), Tn=0.02, difference=1, period=rig.period / 4
    )
    arm = dynamics.arm(dynamics.f())
    return arm, simulate(arm, rig, law, path, duration=1.0)


def faster_than_its_log():
    """A loop at 4 kHz whose model follows the log at 1 kHz all the same."""
    rig = dataclasses.replace(puma560.rig(), period=1e-3)
    law = PD(gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=2000.0, period=rig.period / 4)
    arm = puma560.arm()
    return arm, simulate(arm, rig, law, puma560.reference(), duration=1.2)


@pytest.mark.parametrize(
    ("made", "doubted"), [(slide_under_a_cascade, True), (faster_than_its_log, False)]
)
def test_counts_between_the_rows_stand_before_what_they_may_bring_about(made, doubted):
    """No torque was logged: the rotor of the slide was in doubt, which is right."""
    arm, log = made()
    bare = dataclasses.replace(log, torque=None, current=None, true_q=None, true_qd=None)
    found = identify(arm.dynamics, bare, method="prediction_error", progress=False)
    # The period of the law, and that of the rows.
    assert re.findall(r"[\d.]+ ms", found.warnings[0])[:2] == ["0.25 ms", "1 ms"]
    assert (len(found.warnings) > 1) == doubted
    # Alone it doubts nothing.
    assert found.doubts == found.warnings * doubted
    if not doubted:
        logged = identify(arm.dynamics, log, method="prediction_error", progress=False)
        assert found.warnings[0] not in logged.warnings
