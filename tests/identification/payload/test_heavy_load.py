"""A load of 150 kg on a heavy arm, from logged torques that are gravity for the most part, of
drives that drift.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest

from identification import IdentificationWarning, find_load, fit_torque
from plant import (
    PD,
    Body,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    Link,
    LoggedTorque,
    Rig,
    simulate,
)

LINKS = (Link(name="1"), Link(name="2", alpha=-np.pi / 2, a=0.35), Link(name="3", a=1.15))
BODIES = (
    Body(mass=600, com=(0.1, 0, 0), inertia=(20, 0, 0, 20, 0, 60)),
    Body(mass=350, com=(0.5, 0, 0.05), inertia=(8, 0, 0, 45, 0, 45)),
    Body(mass=280, com=(0.35, -0.1, 0), inertia=(8, 0, 0, 50, 0, 50)),
)
LOAD = Body(mass=150, com=(1.45, 0.05, 0.1), inertia=(6, 0, 0, 6, 0, 6))
DRIVE = Drive(
    gear=(220, -230, 210),
    motor_inertia=(5e-3,) * 3,
    viscous=(8e-3, 9e-3, 7e-3),
    coulomb=(2.2, 2.6, 1.8),
    motor_gain=(1, 1, 1),
    current_limit=(100,) * 3,
)
RIG = Rig(drive=DRIVE, encoder=Encoder(resolution=(4096,) * 3), period=4e-3)
LAW = PD(gain=(0.02,) * 3, derivative=(0.0015,) * 3, filter=150.0, period=4e-3)
DYNAMICS = Dynamics.from_chain(Chain(links=LINKS))
EMPTY = DYNAMICS.f(
    [
        dataclasses.replace(b, rotor=r)
        for b, r in zip(BODIES, DRIVE.reflected_inertia(), strict=True)
    ]
)
UNKNOWN = (
    *DYNAMICS.names,
    *(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(3)),
)


@cache
def log(seed, mass):
    """Torques with 15 N m of noise, of drives with up to 10 % more or less friction than stated,
    their law unstated.
    """
    random = np.random.default_rng([seed, int(mass)])
    f = EMPTY + (DYNAMICS.load_matrix() @ LOAD.standard_parameters if mass else 0.0)
    drive = dataclasses.replace(
        DRIVE,
        **{
            kind: getattr(DRIVE, kind) * random.uniform(0.9, 1.1, 3)
            for kind in ("viscous", "coulomb")
        },
    )
    path = Harmonics(period=10.0, offset=(0, -0.9, 0.7), cosine=random.normal(0, 0.13, (3, 4)),
                     sine=random.normal(0, 0.13, (3, 4)))  # fmt: skip
    record = simulate(
        DYNAMICS.arm(f), dataclasses.replace(RIG, drive=drive), LAW, path, duration=10.0
    )
    torque = record.torque + 15 * random.normal(size=record.torque.shape)
    return dataclasses.replace(
        record, rig=RIG, torque=torque, true_q=None, true_qd=None, law=LoggedTorque()
    )


@cache
def empty_arm():
    return fit_torque(DYNAMICS, [log(i, 0) for i in range(3)], unknown=UNKNOWN, band=16.0)


def loaded():
    return [log(10 + i, 150) for i in range(3)]


def load(records, arm=None, **options):
    return find_load(
        empty_arm() if arm is None else arm, records, LOAD.com, inertia=LOAD.inertia, **options
    )


@cache
def known_load():
    return load(loaded())


@pytest.mark.slow
def test_the_interval_holds_the_mass_and_counts_what_is_uncertain_of_the_arm():
    found, exact = known_load(), load(loaded(), DYNAMICS.arm(EMPTY))
    for each in (found, exact):
        assert abs(each.mass - 150) < 1.96 * each.std
        assert each.std < 3
    assert found.std > exact.std
    assert found.freedom == DYNAMICS.p - 1
    doubtful = dataclasses.replace(empty_arm(), relative_error=0.5)
    with pytest.warns(
        IdentificationWarning,
        match=r"(?s)find_load: identified with .*50% of the torque is not explained",
    ):
        load(loaded()[0], doubtful)


@pytest.mark.slow
def test_neither_order_nor_an_irrelevant_guess_changes_it():
    found, backwards = known_load(), load(loaded()[::-1])
    ranged = load(loaded(), mass=(20.0, 900.0))
    assert backwards.mass == pytest.approx(found.mass, abs=0.01 * found.std)
    assert backwards.std == pytest.approx(found.std, rel=0.01)
    np.testing.assert_allclose(backwards.runs, found.runs[::-1])
    assert ranged.mass == pytest.approx(found.mass, abs=0.01 * found.std)
    # offsets are expected within the Coulomb level
    for factors, share in (((3.0, 1.0), 0.01), ((1.0, 1 / 3), 0.2)):
        drive = dataclasses.replace(
            DRIVE, viscous=factors[0] * DRIVE.viscous, coulomb=factors[1] * DRIVE.coulomb
        )
        guessed = load(
            [
                dataclasses.replace(each, rig=dataclasses.replace(RIG, drive=drive))
                for each in loaded()
            ]
        )
        assert guessed.mass == pytest.approx(found.mass, abs=share * found.std)
        assert guessed.std == pytest.approx(found.std, rel=0.1)


@pytest.mark.slow
def test_a_log_without_a_law_replays_its_torque():
    """Which was measured at the samples: as `fit_torque` takes it."""
    record = dataclasses.replace(loaded()[0], law=None)
    held = dataclasses.replace(
        record, torque=(record.torque + np.vstack([record.torque[:1], record.torque[:-1]])) / 2
    )
    found, known = load(held), load(loaded()[0])
    assert found.mass == pytest.approx(known.mass, abs=0.5 * known.std)


@pytest.mark.slow
def test_what_is_known_of_the_arm_has_no_variance_and_counts_in_the_torque():
    """Residuals are those of the same torque, so that most of it may be known."""
    free = empty_arm()
    known = dict(zip(DYNAMICS.names, EMPTY, strict=True))
    some = {name: known[name] for name in DYNAMICS.names[1:]}
    rest = tuple(name for name in UNKNOWN if name not in some)
    fit = fit_torque(DYNAMICS, [log(i, 0) for i in range(3)], unknown=rest, known=some, band=16.0)
    assert fit.relative_error == pytest.approx(free.relative_error, rel=0.05)
    assert free.relative_error < 0.02
    found = load(loaded(), fit)
    assert abs(found.mass - 150) < 1.96 * found.std
    assert found.std < known_load().std
