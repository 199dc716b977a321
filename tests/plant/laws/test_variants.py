"""PID and cascade as the difference equations of their docstrings, in every variant, by hand."""

import dataclasses
import itertools

import numpy as np
import pytest

from plant import PD, PID, Cascade, Drive, Encoder, Rig
from plant.laws import ANTI_WINDUP, INTEGRATION

T = 1e-3
LIMIT = 3.0
RIG = Rig(
    drive=Drive(
        gear=(-30.0,),
        motor_inertia=(0.0,),
        viscous=(0.0,),
        coulomb=(0.0,),
        motor_gain=(0.5,),
        current_limit=(2 * LIMIT,),
    ),
    encoder=Encoder(resolution=(1000.0,)),
    period=T,
)
GAIN, RATE, RESET, POLE, POSITION = 0.02, 3e-4, 0.9, 500.0, 25.0
VARIANTS = list(itertools.product(INTEGRATION, ANTI_WINDUP))


def signals():
    """Reference and counts (K,) that drive the torque to its limit and back."""
    k = np.arange(600)
    reference = np.trunc(400 * np.sin(0.02 * k))
    return reference, np.trunc(380 * np.sin(0.02 * k - 0.3) + 30 * np.sin(0.2 * k))


def torques_of(law, rig=RIG):
    """Motor torque (K,) of the law's step after the limit."""
    block = law.block(rig)
    reference, counts = signals()
    state, torque = block.initial, np.zeros(1)
    zero = np.zeros(1)
    torques = []
    for r, c in zip(reference, counts, strict=True):
        asked, state = block.step(state, zero, zero, zero, r, c, torque, T, block.values)
        torque = rig.drive.limited(np.array(asked).ravel())
        torques.append(float(rig.drive.motor_torque(torque)[0]))
    return np.array(torques)


def by_hand(kind, integration, anti_windup, derivative_of="error"):
    """The same from the equations."""
    reference, counts = signals()
    errors = reference - counts
    smoothed = integral = command = applied = before = 0.0
    torques = []
    for k, (c, e) in enumerate(zip(counts, errors, strict=True)):
        signal = c if kind == "Cascade" else (e if derivative_of == "error" else -c)
        smoothed = signal if k == 0 else smoothed
        change = (1 - np.exp(-POLE * T)) * (signal - smoothed)
        smoothed += change
        rate = change / T
        driving = POSITION * e - rate if kind == "Cascade" else e
        slope = RESET * driving
        mean = (slope + before) / 2 if integration == "tustin" else slope
        before = slope
        cut = applied - command
        limited = abs(cut) > 1e-9
        acting = integral
        if not (anti_windup == "clamping" and limited and mean * cut <= 0):
            integral += T * mean
        if anti_windup == "back-calculation":
            ratio = RESET / (RATE if kind == "Cascade" else GAIN)
            integral += min(T * ratio, 1.0) * cut
        if anti_windup == "limit":
            integral = min(max(integral, -LIMIT), LIMIT)
        acting = acting if integration == "forward" else integral
        command = acting + (RATE * driving if kind == "Cascade" else GAIN * e + RATE * rate)
        applied = min(max(command, -LIMIT), LIMIT)
        torques.append(applied)
    return np.array(torques)


@pytest.mark.parametrize(("integration", "anti_windup"), VARIANTS)
def test_a_law_is_its_difference_equation(integration, anti_windup):
    options = {"integration": integration, "anti_windup": anti_windup, "filter": POLE, "period": T}
    cascade = Cascade(position=(POSITION,), speed=(RATE,), integral=(RESET,), **options)
    pid = PID(gain=(GAIN,), derivative=(RATE,), integral=(RESET,), **options)
    for law in (cascade, pid):
        torques = torques_of(law)
        assert (np.abs(torques) == LIMIT).mean() > 0.05
        expected = by_hand(type(law).__name__, integration, anti_windup)
        np.testing.assert_allclose(torques, expected, atol=1e-9)


def test_clamping_integrates_where_an_amplifier_rounds_the_torque():
    step = LIMIT / 100
    stepped = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, torque_step=step))
    law = PID(
        gain=(GAIN,),
        derivative=(RATE,),
        integral=(RESET,),
        filter=POLE,
        period=T,
        anti_windup="clamping",
    )
    # It leaves the limit up to a sample later, and its integral is rounded nowhere.
    np.testing.assert_allclose(torques_of(law, stepped), torques_of(law), atol=3 * step)


def test_variants_give_different_torques():
    torques = {variant: by_hand("Cascade", *variant) for variant in VARIANTS}
    for one, other in itertools.combinations(VARIANTS, 2):
        assert np.abs(torques[one] - torques[other]).max() > 1e-4, (one, other)


def test_derivative_of_counts():
    law = PD(gain=(GAIN,), derivative=(RATE,), filter=POLE, period=T, derivative_of="counts")
    reference, counts = signals()
    change = np.zeros(len(counts))
    smoothed = -counts[0]
    for k, c in enumerate(counts):
        change[k] = (1 - np.exp(-POLE * T)) * (-c - smoothed)
        smoothed += change[k]
    expected = np.clip(GAIN * (reference - counts) + RATE * change / T, -LIMIT, LIMIT)
    np.testing.assert_allclose(torques_of(law), expected, atol=1e-9)


def test_gains_in_the_units_of_drives():
    """Kv 0.03 A/rpm, 0.5 N m/A: 0.1432 N m s/rad of the motor; Kp 1.2 m/min/mm is 20 1/s."""
    law = Cascade.from_drive(
        RIG, Kp=1.2, Kv=0.03, Tn=0.01, position_unit="mm/min/um", speed_unit="A/rpm", filter=POLE
    )
    np.testing.assert_allclose(law.position, 20.0)
    # One rad/s of the motor is 1000 / 2 pi pulses per second.
    np.testing.assert_allclose(law.speed * 1000 / (2 * np.pi), 0.03 * 0.5 * 60 / (2 * np.pi))
    np.testing.assert_allclose(law.speed / law.integral, 0.01)
    same = Cascade.from_drive(RIG, Kp=20, Kv=0.03 * 0.5 * 30 / np.pi, Tn=np.inf, filter=POLE)
    np.testing.assert_allclose(same.speed, law.speed)
    assert not same.integral.any()


@pytest.mark.parametrize("name", ["integration", "anti_windup"])
def test_a_variant_must_be_known(name):
    with pytest.raises(ValueError, match=name):
        Cascade(position=(1,), speed=(1,), integral=(1,), filter=POLE, **{name: "euler"})
