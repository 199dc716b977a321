"""A turned sign is named with the column that is turned: by what torque, law and reference say of each other."""

import dataclasses

import numpy as np
import pytest

from plant import Harmonics, Record, puma560, simulate

RIG = puma560.rig()
COLUMNS = {"counts": ("c1", "c2"), "torque": ("u1", "u2"), "reference_pulses": ("r1", "r2")}


@pytest.fixture(scope="module")
def record():
    made = simulate(puma560.arm(), RIG, puma560.p_law(), puma560.reference(), duration=3.65)
    return dataclasses.replace(made, columns=COLUMNS)


def turned(record, what, joint):
    """One column of the file with the other sign; the errors are its reference less its counts."""
    columns = {
        "counts": record.counts.copy(),
        "reference": record.reference_pulses.copy(),
        "torque": record.torque.copy(),
    }
    columns[what][:, joint] *= -1
    return dataclasses.replace(
        record, reference_pulses=columns["reference"], error_pulses=columns["reference"] - columns["counts"],
        torque=columns["torque"], reference=None,
    )  # fmt: skip


def advice(record, check, joint):
    return next(f.advice for f in record.check().findings if f.check == check and f.joint == joint and not f.ok)


@pytest.mark.parametrize("joint", [0, 1])
def test_the_turned_column_is_named(record, joint):
    k = joint + 1
    said = advice(turned(record, "torque", joint), "drive sign", joint)
    assert f"change the sign of column 'u{k}' (torque)." in said
    said = advice(turned(record, "counts", joint), "gear sign", joint)
    assert f"against the torque: change the sign of column 'c{k}' (counts), or of the gear." in said
    said = advice(turned(record, "reference", joint), "gear sign", joint)
    assert f"along with the torque: change the sign of column 'r{k}' (reference_pulses)." in said
    error = dataclasses.replace(record, error_pulses=-record.error_pulses, columns={"error_pulses": ("e1", "e2")})
    assert f"change the sign of column 'e{k}' (error_pulses) (reference minus counted)." in advice(
        error, "drive sign", joint
    )


def test_without_a_law_or_torque_both_columns_that_may_be_turned_are_named(record):
    lawless = dataclasses.replace(turned(record, "torque", 1), law=None)
    assert "backwards, and drives against friction's sign: change the sign of column 'u2' (torque)." in advice(
        lawless, "drive sign", 1
    )
    open_loop = dataclasses.replace(lawless, reference_pulses=np.zeros_like(record.counts), error_pulses=-record.counts)
    said = advice(open_loop, "drive sign", 1)
    assert "change the sign of column 'u2' (torque), column 'c2' (counts) or gear" in said
    silent = dataclasses.replace(turned(record, "counts", 0), torque=None, current=None, law=None)
    assert "change the sign of the gear, or of column 'c1' (counts)." in advice(silent, "gear sign", 0)


def test_without_names_of_columns_the_fields_are_named(record):
    plain = dataclasses.replace(turned(record, "torque", 0), columns=None)
    assert "change the sign of the torque." in advice(plain, "drive sign", 0)


def test_counts_of_a_smooth_encoder_are_accepted():
    """By the running controller, which gives the torque of the simulation to the last bit, and by the readers."""
    smooth = dataclasses.replace(RIG, encoder=dataclasses.replace(RIG.encoder, smooth=True))
    path = Harmonics(period=3.65, offset=(0, 0.5), cosine=((0.4,), (0.3,)), sine=np.zeros((2, 1)))
    record = simulate(puma560.arm(), smooth, puma560.p_law(), path, duration=0.1)
    assert (record.counts != np.round(record.counts)).any()
    running, motion = puma560.p_law().start(smooth, record.counts[0]), path(record.t)
    torque = [running.step(*row) for row in zip(record.counts, *motion, strict=True)]
    np.testing.assert_array_equal(torque, record.torque)
    assert np.isfinite(running.step((np.nan, 0), *(row[-1] for row in motion))).all()
    assert running.bridged == 1
    with pytest.raises(ValueError, match="pulses must be whole encoder counts"):
        puma560.p_law().start(RIG, record.counts[5])
    table = {"c": record.counts, "r": record.reference_pulses}
    again = Record.from_table(table, rig=smooth, columns={"counts": "c", "reference_pulses": "r"})
    np.testing.assert_array_equal(again.counts, record.reference_pulses - (record.reference_pulses - record.counts))
