"""Default gains by other settings: `ComputedTorque.designed`."""

import dataclasses

import pytest

from ctc import ComputedTorque, DefaultGainSettings
from plant import Elasticity, puma560

ARM, RIG = puma560.arm(), puma560.rig()


def test_usual_settings_give_the_default_law():
    assert ComputedTorque.designed(ARM, RIG) == ComputedTorque(ARM, RIG)
    assert ComputedTorque.designed(ARM, RIG, bandwidth=90) == ComputedTorque(ARM, RIG, bandwidth=90)


def test_gains_come_from_the_settings():
    gains = DefaultGainSettings().arm._replace(bandwidth=80.0, dead_zone=0.1, start_time=4.0)
    law = ComputedTorque.designed(ARM, RIG, gains=DefaultGainSettings(arm=gains), learnable=0.2)
    assert (law.bandwidth, law.dead_zone, law.start_time) == (80, 0.1, 4 / 80)
    assert law.learnable == 0.2
    none = dict.fromkeys(("bandwidth", "dead_zone", "start_time", "observer_ratio", "start_boost"))
    settings = DefaultGainSettings(arm=gains)
    assert ComputedTorque.designed(ARM, RIG, gains=settings, learnable=0.2, **none) == law


def test_more_room_on_elastic_gears_is_a_lower_bandwidth():
    gears = Elasticity.from_resonance(ARM, 40, 0.02, drive=RIG.drive)
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears))
    usual = ComputedTorque.designed(ARM, rig)
    careful = DefaultGainSettings(predicted=(0.7, 1.0, 1.5), spare=3.0)
    assert ComputedTorque.designed(ARM, rig, gains=careful).bandwidth < usual.bandwidth
    with pytest.raises(ValueError, match="no bandwidth is stable"):
        ComputedTorque.designed(ARM, rig, gains=DefaultGainSettings(smallest=350, spare=5))
    # None is tried: the gears are not to blame.
    slow = dataclasses.replace(rig, period=0.07)
    for gains in ({"rig": slow}, {"rig": rig, "gains": DefaultGainSettings(smallest=1000)}):
        with pytest.raises(ValueError, match=r"above (5|1000) rad/s .* period .* allow (4.29|360)"):
            ComputedTorque.designed(ARM, **gains)


@pytest.mark.parametrize("gains", [(360.0, 0.0), (360.0, 0.0, 1.3, 4.0, 10.0), 360.0])
def test_gains_without_names_are_refused(gains):
    with pytest.raises(ValueError, match="arm of DefaultGainSettings must be of type Gains"):
        DefaultGainSettings(arm=gains)


def test_other_settings_are_refused_by_name():
    with pytest.raises(ValueError, match="gains must be of type DefaultGainSettings"):
        ComputedTorque.designed(ARM, RIG, gains={"step": 0.5})
    with pytest.raises(ValueError, match="arm of ComputedTorque must be of type Arm"):
        ComputedTorque.designed(None)
