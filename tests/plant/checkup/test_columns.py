"""A turned sign is named with the column that is turned: by what torque, law and reference say
of each other.
"""

import dataclasses

import numpy as np
import pytest

from identification import identify
from plant import PID, Drive, Encoder, Harmonics, P, Record, Rig, Spline, puma560, simulate

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
        record,
        reference_pulses=columns["reference"],
        error_pulses=columns["reference"] - columns["counts"],
        torque=columns["torque"],
        reference=None,
    )


def cause(record):
    """Name and joints of the first cause, and its remedy."""
    first = record.check().causes[0]
    return first.name, first.joints, first.remedy


TURNED = {
    "torque": "column 'u{}' (torque)",
    "counts": "column 'c{}' (counts)",
    "reference": "column 'r{}' (reference_pulses)",
}


@pytest.mark.parametrize(
    ("what", "joint"),
    [
        ("torque", 1),
        ("counts", 0),
        ("reference", 1),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (("torque", 0), ("counts", 1), ("reference", 0))
        ),
    ],
)
def test_the_turned_column_is_named(record, what, joint):
    name, joints, remedy = cause(turned(record, what, joint))
    assert (name, joints) == (f"turned {what}", (joint,))
    assert TURNED[what].format(joint + 1) in remedy


def test_an_error_of_the_other_sign_is_named(record):
    error = dataclasses.replace(
        record, error_pulses=-record.error_pulses, columns={"error_pulses": ("e1", "e2")}
    )
    name, joints, remedy = cause(error)
    assert (name, joints) == ("turned error of all joints", ())
    assert "column 'e1' (error_pulses)" in remedy


@pytest.fixture(scope="module", params=["P", pytest.param("PID", marks=pytest.mark.slow)])
def table(request):
    """The motion of a heavily geared arm under a law, as a file has it, and the law."""
    p = puma560.p_law()
    law = (
        p
        if request.param == "P"
        else PID(gain=p.gain, integral=p.gain, derivative=0.002 * p.gain, filter=1500.0)
    )
    made = simulate(puma560.arm(), RIG, law, puma560.reference(), duration=3.65)
    columns = {
        "p": RIG.cell_centre(made.counts),
        "r": made.reference(made.t).q,
        "c": made.counts,
        "i": made.current,
    }
    return {"t": made.t, **columns}, law


def read(table, measured="p", rig=RIG, turned=()):
    columns, law = dict(table[0]), table[1]
    for name in turned:
        columns[name] = columns[name] * (1, -1)
    fields = {"p": "position", "c": "counts", "r": "reference_position", "i": "current"}
    split = {
        f"{name}{k + 1}": columns[name][:, k] for name in (measured, "r", "i") for k in range(2)
    }
    mapped = {"t": "t"} | {fields[name]: [f"{name}1", f"{name}2"] for name in (measured, "r", "i")}
    units = {"t": "s", "reference_position": "rad", "current": "A"} | (
        {"position": "rad"} if measured == "p" else {}
    )
    return Record.from_table(
        {"t": columns["t"], **split}, rig=rig, law=law, columns=mapped, units=units
    )


@pytest.mark.parametrize("spoiled", [("i",), pytest.param(("p", "r"), marks=pytest.mark.slow)])
def test_a_current_of_the_other_sign_is_turned_back(table, spoiled):
    """A motion that is turned as a whole is that of a motor with the other sign of its current."""
    record = read(table, turned=spoiled)
    checkup = record.check()
    (cause,) = checkup.causes
    assert (cause.name, cause.joints) == ("turned torque", (1,))
    assert "column 'i2' (current)" in cause.remedy
    assert [rival.name for rival in cause.rivals] == ["turned counts and reference"]
    np.testing.assert_array_equal(checkup.corrected.current, record.current * (1, -1))


def test_positions_of_the_other_sign_are_turned_back(table):
    checkup = read(table, turned="p").check()
    (cause,) = checkup.causes
    assert (cause.name, cause.joints) == ("turned counts", (1,))
    assert "column 'p2' (position)" in cause.remedy
    np.testing.assert_array_equal(checkup.corrected.counts, table[0]["c"])


def test_a_gear_that_was_stated_with_the_wrong_sign_is_turned(table):
    gear = RIG.drive.gear * (1, -1)
    record = read(
        table, "c", rig=dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, gear=gear))
    )
    checkup = record.check()
    (cause,) = checkup.causes
    assert (cause.name, cause.joints) == ("turned gear", (1,))
    np.testing.assert_array_equal(checkup.corrected.rig.drive.gear, RIG.drive.gear)
    np.testing.assert_array_equal(checkup.corrected.current, record.current)
    if isinstance(table[1], P):  # saturates when it is replayed on that rig
        with pytest.raises(
            ValueError,
            match=r"^The gear of joint .*Change the sign of the gear.* As it is, a log must be",
        ):
            identify(puma560.dynamics(), record, progress=False)


@pytest.mark.filterwarnings("ignore:.*not in whole pulses")
@pytest.mark.parametrize("ratio", [110 / 120, pytest.param(1.15, marks=pytest.mark.slow)])
def test_a_gear_that_is_not_the_logged_positions_own_is_told_by_their_step(table, ratio):
    rig = dataclasses.replace(
        RIG, drive=dataclasses.replace(RIG.drive, gear=RIG.drive.gear * (1, ratio))
    )
    first, *others = read(table, rig=rig).check().problems
    assert (first.check, first.joint, first.value) == (
        "quantisation step",
        1,
        pytest.approx(ratio, rel=1e-4),
    )
    assert f"appears to be {1 / ratio:.4g} times as stated" in first.advice
    assert not [f for f in others if f.check == "quantisation step"]


@pytest.mark.filterwarnings("ignore:.*not in whole pulses")
@pytest.mark.parametrize(
    "made",
    ["filtered", *(pytest.param(made, marks=pytest.mark.slow) for made in ("decimals", "degrees"))],
)
def test_positions_that_were_filtered_or_rounded_accuse_no_gear(table, made):
    p, unit = table[0]["p"], np.pi / 180
    some = {
        "filtered": np.column_stack([np.convolve(x, np.full(5, 0.2), mode="same") for x in p.T]),
        "decimals": np.round(p, 4),
        "degrees": np.round(p / unit, 2) * unit,
    }
    record = read(({**table[0], "p": some[made]}, table[1]))
    assert not [f for f in record.check().problems if "gear times resolution" in f.advice]


def test_without_a_law_or_torque_both_columns_that_may_be_turned_are_named(record):
    lawless = dataclasses.replace(turned(record, "torque", 1), law=None)
    assert cause(lawless)[:2] == ("turned torque", (1,))
    open_loop = dataclasses.replace(
        lawless, reference_pulses=np.zeros_like(record.counts), error_pulses=-record.counts
    )
    name, joints, remedy = cause(open_loop)
    assert (name, joints) == ("turned torque", (1,))
    assert all(word in remedy for word in ("'u2'", "counts", "gear"))
    silent = dataclasses.replace(turned(record, "counts", 0), torque=None, current=None, law=None)
    first = silent.check().causes[0]
    names = {first.name, *(rival.name for rival in first.rivals)}
    assert names == {"turned counts", "turned reference"}
    assert first.joints == (0,)


def test_counts_of_a_smooth_encoder_are_accepted():
    """By the running controller, which gives the torque of the simulation to the last bit, and
    by the readers.
    """
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
    np.testing.assert_array_equal(
        again.counts, record.reference_pulses - (record.reference_pulses - record.counts)
    )


def test_without_a_torque_no_joint_is_turned_as_a_whole():
    """Corners of a spline feign it: a joint whose columns are all turned moves as well."""
    times = tuple(0.75 * k for k in range(7))
    points = ((0, 0), (0.6, -0.5), (-0.3, 0.7), (0.8, 0.9), (-0.7, 0.1), (0.2, -0.8), (0.9, 0.3))
    drive = Drive(
        gear=(101.0, -61.0),
        motor_inertia=(1.8e-4, 2.2e-4),
        viscous=(9e-4, 1.1e-3),
        coulomb=(0.10, 0.13),
        motor_gain=(0.21, 0.25),
        current_limit=(14.0, 11.0),
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=(4096, 2000)), period=1e-3)
    path = Spline(times=times, points=points)
    made = simulate(puma560.arm(), rig, P(gain=(0.05, 0.09)), path)
    counts_alone = dataclasses.replace(made, torque=None, current=None, reference=None)
    assert counts_alone.check().causes == ()
