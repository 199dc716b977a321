"""The band of several logs: what differs between them does not hide that a wide one biases."""

import numpy as np
import pytest

from identification.equation_error import System, choose_band

ROWS, BANDS, PERIOD = 2000, (10.0, 14.0, 20.0, 28.0, 40.0, 57.0, 80.0), 1e-3


def systems(band, apart):
    """Two logs of one joint, friction off by `apart` in each; from 40 Hz on the inertia comes
    out too small.
    """
    found = []
    for sign in (-1, 1):
        random = np.random.default_rng(2 + sign)
        columns = np.column_stack([random.normal(size=ROWS), np.sign(np.sin(np.arange(ROWS) / 40))])
        made = columns @ (1.0 - 0.1 * (band >= 40), 2.0 * (1 + sign * apart))
        torque = made + 0.1 * random.normal(size=ROWS)
        found.append(
            System(
                regressor=columns[:, None],
                torque=torque[:, None],
                used=np.ones((ROWS, 1), bool),
                sample=np.arange(ROWS),
                period=PERIOD,
                speed=np.ones((ROWS, 1)),
            )
        )
    return found


@pytest.mark.parametrize("apart", [0.0, 0.3])
def test_logs_whose_friction_differs_take_no_wider_band_than_each_alone(apart):
    seconds = np.full(2, ROWS * PERIOD)
    alone = choose_band(BANDS, lambda band: systems(band, apart)[:1], seconds[:1], None)[0]
    together = choose_band(BANDS, lambda band: systems(band, apart), seconds, None)[0]
    assert alone == together == 28
