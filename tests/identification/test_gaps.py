"""Logs with cells that are empty and rows that are missing: no cause for another f, nor for a
refusal.
"""

import dataclasses

import numpy as np
import pytest

from identification import identify
from identification.equation_error import unexcited
from identification.results import of_statements
from plant import Record, puma560, simulate

ARM, RIG, LAW = puma560.literature_arm(1.5), puma560.rig(), puma560.p_law((0.1, 0.08))
UNITS = {"t": "s", "position": "rad", "reference_position": "rad"}
COLUMNS = {"t": "t", "position": ["q1", "q2"], "reference_position": ["asked1", "asked2"]}


def table():
    """Positions of whole counts, and a reference that knows more than they do."""
    log = simulate(ARM, RIG, LAW, puma560.reference(), steps_per_sample=16)
    q, asked = RIG.cell_centre(log.counts), log.reference(log.t).q
    return {"t": log.t, "q1": q[:, 0], "q2": q[:, 1], "asked1": asked[:, 0], "asked2": asked[:, 1]}


def read(columns, rig=RIG):
    return Record.from_table(columns, rig=rig, law=LAW, columns=COLUMNS, units=UNITS)


def found_in(columns):
    return identify(ARM.dynamics, read(columns), method="prediction_error", progress=False)


@pytest.fixture(scope="module")
def whole():
    return found_in(table())


def without(rows, *names):
    columns = {name: value.copy() for name, value in table().items()}
    for name in names:
        columns[name][rows] = np.nan
    return columns


@pytest.mark.parametrize(
    "columns",
    [
        without([2000], "q1"),
        pytest.param(without([2000], "asked2"), marks=pytest.mark.slow),
        pytest.param(without(slice(100, 150), "q1", "q2"), marks=pytest.mark.slow),
        without(slice(3000, 3050), "q1", "q2", "asked1", "asked2"),
        pytest.param(
            {name: np.delete(value, slice(1000, 1080)) for name, value in table().items()},
            marks=pytest.mark.slow,
        ),
    ],
    ids=["a position", "a reference", "50 positions", "50 of all", "80 rows"],
)
def test_what_is_missing_moves_nothing(whole, columns):
    """Within half a standard deviation of the whole log, whose reference is still known between
    its counts.
    """
    assert read(columns).reference is not None
    found = found_in(columns)
    assert (np.abs(found.f - whole.f) < 0.5 * whole.fit.std).all()
    assert found.warnings == whole.warnings == []


def test_a_period_that_is_no_arms_is_named():
    columns, slow = table(), dataclasses.replace(RIG, period=1.0)
    with pytest.raises(
        ValueError, match=r"sampled every 1 s it does not. State rig\.period in seconds"
    ):
        identify(ARM.dynamics, read({**columns, "t": columns["t"] / 7e-4}, slow), progress=False)
    with pytest.raises(
        ValueError, match=r"rig\.period must be in seconds, such as 0\.001; it is 1 s"
    ):
        read(columns, slow)


def in_step():
    """A log whose joints move in step; and with counts of zero and no weight in a hundred rows."""
    path = puma560.reference()
    one = np.array(path.cosine)[[0, 0]], np.array(path.sine)[[0, 0]]
    path = dataclasses.replace(path, cosine=one[0], sine=one[1], offset=(0.3, 0.3))
    log = simulate(ARM, RIG, LAW, path)
    gap = np.zeros(len(log), bool)
    gap[2000:2100] = True
    lost = np.column_stack([gap, np.zeros(len(log), bool)])
    errors = np.where(lost, log.reference_pulses, log.error_pulses)
    return log, dataclasses.replace(log, error_pulses=errors, valid=np.where(gap, 0.0, 1.0))


def test_what_stands_in_rows_without_weight_is_no_motion():
    log, gaps = in_step()
    (message,) = unexcited(ARM.dynamics, [log])
    assert unexcited(ARM.dynamics, [gaps]) == [message]
    # Friction that no motor of the arm would overcome at the speed of the jumps.
    drive = dataclasses.replace(RIG.drive, viscous=2 * RIG.drive.viscous)
    rig = dataclasses.replace(RIG, drive=drive)
    assert list(of_statements(rig, [gaps], ARM.dynamics.chain)) == []
