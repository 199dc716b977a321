"""Signals that the checks of a log share."""

import pytest

from plant import puma560, simulate
from plant.checkup.signals import Signals


@pytest.mark.parametrize("duration", [0.1, 0.35, 0.5])
def test_the_even_grid_keeps_the_last_sample(duration):
    law = puma560.p_law()
    record = simulate(puma560.arm(), puma560.rig(), law, puma560.reference(), duration=duration)
    assert len(Signals(record).clear) == len(record)
