"""The model with what its rig leaves out: each number is that of a rig which has it, and all
zero is the rigid one.
"""

import dataclasses

import numpy as np
import pytest

from identification import without_delay
from identification.replay import Extended, Prediction
from identification.results import NUMBERS
from plant import Elasticity, LoggedTorque, puma560, simulate

DYNAMICS, RIG, PATH = puma560.dynamics(), puma560.rig(), puma560.reference()
ARM = puma560.literature_arm(1.5)


@pytest.fixture(scope="module")
def record():
    return simulate(ARM, RIG, puma560.p_law((0.1, 0.08)), PATH, duration=0.7)


@pytest.fixture(scope="module")
def model(record):
    return Extended(DYNAMICS, [record], DYNAMICS.names, ARM.f, NUMBERS)


def values(model, **extra):
    """Values of all unknowns, of `extra` by place (an underscore before the joint)."""
    all_values = np.concatenate([ARM.f, model.gains, np.zeros(len(model.extra))])
    for name, value in extra.items():
        kind, _, joint = name.partition("_")
        all_values[model.place(f"{kind}[{joint}]" if joint else kind)] = value
    return all_values


def predicted(record, **changes):
    """Innovations of a prediction whose drive has what is said."""
    drive = dataclasses.replace(record.rig.drive, **changes)
    known = dataclasses.replace(record, rig=dataclasses.replace(record.rig, drive=drive))
    prediction = Prediction(DYNAMICS, known, DYNAMICS.names)
    return prediction.innovations(np.append(ARM.f, prediction.nuisances))


def gears(record, hz, backlash=None):
    pose = RIG.cell_centre(record.counts[0])
    return Elasticity.from_resonance(ARM, hz, 0.02, drive=RIG.drive, q=pose, backlash=backlash)


def test_with_nothing_left_out_it_is_the_rigid_prediction(record, model):
    np.testing.assert_allclose(model.innovations(values(model)), predicted(record), atol=1e-5)


def test_compliance_is_the_resonance_of_a_gear(record, model):
    ours = model.innovations(values(model, compliance_0=60.0**-2, compliance_1=90.0**-2))
    theirs = predicted(record, elasticity=gears(record, (60.0, 90.0)))
    np.testing.assert_allclose(ours, theirs, atol=1e-4)
    assert np.abs(ours - predicted(record)).max() > 0.05


def test_a_torque_along_the_log_is_that_of_a_record_it_was_injected_in(record, model):
    """Once more beside itself, too, and on elastic gears."""
    torque = 2.0 * np.sin(np.linspace(0, 20, len(record)))[:, None] * np.array([1.0, -0.5])
    pushed = model.pushed([torque]).pushed([torque])
    injected = dataclasses.replace(record, injected=2 * torque)
    anew = Extended(DYNAMICS, [injected], DYNAMICS.names, ARM.f, NUMBERS)
    for given in ({}, {"compliance_0": 60.0**-2}):
        ours, before = (each.innovations(values(model, **given)) for each in (pushed, model))
        np.testing.assert_array_equal(ours, anew.innovations(values(model, **given)))
        assert np.abs(ours - before).max() > 0.05


def test_backlash_lag_and_friction_are_those_of_the_drive(record, model):
    play = dict.fromkeys(("compliance_0", "compliance_1"), 250.0**-2) | {"backlash_0": 5e-4}
    theirs = predicted(record, elasticity=gears(record, 250.0, backlash=(5e-4, 0.0)))
    np.testing.assert_allclose(model.innovations(values(model, **play)), theirs, atol=1e-4)
    lagging = model.innovations(values(model, lag=1e-4))
    np.testing.assert_allclose(lagging, predicted(record, current_lag=1e-4), atol=1e-4)
    rubbing = model.innovations(values(model, viscous_0=2e-4, coulomb_1=-0.05))
    theirs = predicted(
        record,
        viscous=np.add(RIG.drive.viscous, (2e-4, 0)),
        coulomb=np.subtract(RIG.drive.coulomb, (0, 0.05)),
    )
    np.testing.assert_allclose(rubbing, theirs, atol=1e-5)


def test_what_a_gear_gives_is_added_to_what_it_gives_already(record):
    """Two springs in series: 1 / 100^2 of the rig and the rest, and its own damping stays."""
    drive = dataclasses.replace(RIG.drive, elasticity=gears(record, 100.0))
    known = dataclasses.replace(record, rig=dataclasses.replace(RIG, drive=drive))
    model = Extended(DYNAMICS, [known], DYNAMICS.names, ARM.f, NUMBERS)
    more = model.innovations(
        values(model, compliance_0=60.0**-2 - 100.0**-2, compliance_1=60.0**-2 - 100.0**-2)
    )
    soft = dataclasses.replace(gears(record, 60.0), damping=gears(record, 100.0).damping)
    np.testing.assert_allclose(more, predicted(record, elasticity=soft), atol=1e-6)


def test_late_counts_and_several_records(record, model):
    late = model.late(0.3).innovations(values(model))
    again = Extended(DYNAMICS, [without_delay(record, -0.3)], DYNAMICS.names, ARM.f, NUMBERS)
    np.testing.assert_array_equal(late, again.innovations(values(model)))
    both = Extended(DYNAMICS, [record, without_delay(record, -0.3)], DYNAMICS.names, ARM.f, NUMBERS)
    found = both.innovations(values(both))
    np.testing.assert_array_equal(found[both.rows()[0]], model.innovations(values(model)))
    np.testing.assert_array_equal(found[both.rows()[1]], late)


def test_the_least_of_friction_is_none(model):
    friction = {"viscous": RIG.drive.viscous, "coulomb": RIG.drive.coulomb}
    assert model.stated() == {
        f"{kind}[{i}]": numbers[i] for kind, numbers in friction.items() for i in range(2)
    }
    none, less = (
        model.innovations(values(model, coulomb_0=times * RIG.drive.coulomb[0]))
        for times in (-1, -2)
    )
    np.testing.assert_array_equal(none, less)


def test_without_motor_inertia_no_gear_gives(record):
    """A spring needs a mass on either side; lag and friction are there in any case."""
    drive = dataclasses.replace(RIG.drive, motor_inertia=(0.0, 2e-4))
    torques = dataclasses.replace(
        record, rig=dataclasses.replace(RIG, drive=drive), law=LoggedTorque()
    )
    model = Extended(DYNAMICS, [torques], DYNAMICS.names, ARM.f, NUMBERS)
    assert model.extra == (
        *(
            f"{kind}[{i}]"
            for kind in ("viscous", "coulomb", "offset", "gear", "motor_gain")
            for i in (0, 1)
        ),
        "lag",
    )
    assert np.isfinite(model.innovations(values(model))).all()
