"""Signals that the checks of a log share."""

from types import SimpleNamespace

import numpy as np
import pytest

from plant import puma560, simulate
from plant.checkup import Signals, hardly_asked


@pytest.mark.parametrize("duration", [0.1, 0.35, 0.5])
def test_the_even_grid_keeps_the_last_sample(duration):
    law = puma560.p_law()
    record = simulate(puma560.arm(), puma560.rig(), law, puma560.reference(), duration=duration)
    assert len(Signals(record).clear) == len(record)


def test_a_joint_that_follows_a_few_pulses_is_hardly_asked():
    """Friction lets go of it in jumps: the slope of its speeds, 0.31, is no scale of its counts."""
    phase = np.sin(np.linspace(0.0, 2 * np.pi, 400))
    reference = np.column_stack([8000 * phase, 16 * phase])
    counts = np.rint(reference) + np.array([0, 1]) * (np.arange(400) % 7 == 0)[:, None]
    record = SimpleNamespace(
        counts=counts,
        reference_pulses=reference,
        error_pulses=reference - counts,
        injected=None,
    )
    assert hardly_asked(record).tolist() == [False, True]
