"""From named columns to a record: units, wrap, missing samples, repeated times; wrong units are
named.
"""

import dataclasses
import os
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant import (
    Coupling,
    Drive,
    Encoder,
    Harmonics,
    LoadError,
    LoggedTorque,
    Record,
    Rig,
    puma560,
    read_table,
)

GEAR, RESOLUTION = np.array([60.0, -45.0]), np.array([1000.0, 2000.0])
DRIVE = Drive(
    gear=GEAR,
    motor_inertia=(1e-4,) * 2,
    viscous=(0,) * 2,
    coulomb=(0,) * 2,
    motor_gain=(0.2, 0.3),
    current_limit=(10, 8),
)
RIG = Rig(drive=DRIVE, encoder=Encoder(resolution=RESOLUTION), period=2e-3)
N = 400
T = RIG.period * np.arange(N)
COUNTS = np.round(np.column_stack([4000 * np.sin(3 * T), 3000 * np.cos(5 * T) - 500]))
ANGLE = COUNTS / RESOLUTION * 2 * np.pi / GEAR  # of the joint, typed here a second time on purpose


def record(table, columns, units=None, **changes):
    return Record.from_table(table, **{"rig": RIG, "columns": columns, "units": units} | changes)


def angles(unit, value=ANGLE, rig=RIG, **columns):
    return record({"q": value, **columns}, {"position": "q"}, {"position": unit}, rig=rig)


# -- angles into counts --------------------------------------------------------------------------
@pytest.mark.parametrize(("field", "factor"), [("position", 1.0), ("motor_position", GEAR)])
@pytest.mark.parametrize(("unit", "per"), [("rad", 1.0), ("deg", 180 / np.pi)])
def test_angles_become_the_counts_they_came_from(field, factor, unit, per):
    found = record({"q": ANGLE * factor * per}, {field: "q"}, {field: unit})
    np.testing.assert_array_equal(found.counts, COUNTS)
    np.testing.assert_array_equal(found.reference_pulses, 0)
    np.testing.assert_array_equal(found.t, T)


@settings(derandomize=True, max_examples=50, deadline=None)
@given(shift=st.floats(-3, 3))
def test_a_grid_that_is_shifted_is_still_counted_without_a_miss(shift):
    """Whatever the zero of the angle is, two neighbours on the grid are never counted as one, but
    for the cell of two pulses around zero, and no count is a pulse from where it was measured.
    """
    found = angles("rad", (COUNTS + shift) / RESOLUTION * 2 * np.pi / GEAR).counts
    assert (np.abs(found - (COUNTS + shift)) <= 1).all()
    away = np.abs(COUNTS + shift) > 1
    for j in range(2):
        keep = away[:, j] & (COUNTS[:, j] > 0)
        assert len(set((found - COUNTS)[keep, j])) == 1


def test_the_middle_of_a_cell_is_the_count_of_that_cell():
    """As the rig says it: angle() is the middle of the cell, and loading it gives the count
    back.
    """
    np.testing.assert_array_equal(angles("rad", RIG.cell_centre(COUNTS)).counts, COUNTS)


def test_five_digits_of_an_angle_are_enough_to_find_the_count():
    rounded = np.array([[float(f"{x:.5g}") for x in row] for row in ANGLE])
    np.testing.assert_array_equal(angles("rad", rounded).counts, COUNTS)


def test_coupled_joints_are_counted_on_their_motors():
    coupling = Coupling(matrix=((1, 0), (1, 1)))
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(DRIVE, coupling=coupling))
    shaft = COUNTS / RESOLUTION * 2 * np.pi / GEAR
    joint = np.column_stack([shaft[:, 0], shaft[:, 1] - shaft[:, 0]])
    np.testing.assert_array_equal(angles("rad", joint, rig=rig).counts, COUNTS)


def test_a_resolution_that_is_not_the_log_s_is_noted():
    with pytest.warns(
        UserWarning,
        match=r"not in whole pulses of rig.encoder.resolution \(smallest step 1\.31 pulses\)",
    ):
        found = angles("rad", ANGLE * np.array([1.31, 1.0]))
    np.testing.assert_array_equal(found.counts[:, 1], COUNTS[:, 1])
    np.testing.assert_array_equal(found.counts[:, 0], np.trunc(1.31 * COUNTS[:, 0]))


def test_a_resolution_with_too_few_digits_is_told_from_a_wrong_one():
    """Steps of 25/65535 rad under a rig that says 3.815e-4 rad: 0.99994 pulses, which is not "1
    pulse".
    """
    step = 25 / 65535
    encoder = Encoder(resolution=2 * np.pi / 3.815e-4 / np.abs(GEAR))
    said = r"smallest step 0\.999936 pulses: state the resolution more exactly"
    assert f"{step / 3.815e-4:.6f}" == "0.999936"
    with pytest.warns(UserWarning, match=said):
        angles("rad", COUNTS * step, rig=dataclasses.replace(RIG, encoder=encoder))


def test_a_zero_that_is_shifted_by_whole_pulses_is_told_from_a_wrong_resolution():
    """The cell of two pulses of `fix` is then not at zero, and half a pulse off the grid."""
    rig = dataclasses.replace(RIG, encoder=Encoder(resolution=RESOLUTION, rounding="fix"))
    shift = np.array([0, 13425])
    counts = np.round(40 * np.sin(9 * T))[:, None] * (1, 1)
    q = rig.cell_centre(counts) + rig.to_angle(shift)
    with pytest.warns(UserWarning, match=r"at 13425\.0 pulses: correct the zero") as noted:
        angles("rad", q, rig=rig)
    assert "resolution more exactly" not in str(noted[0].message)
    # A resolution that is off by as little as 1 %.
    with pytest.warns(UserWarning, match=r"smallest step 1\.01 pulses"):
        angles("rad", 1.01 * (q + rig.to_angle(shift)), rig=rig)


def test_warnings_point_at_the_line_that_loads(tmp_path):
    """Through every reader, whatever is wrapped around it."""
    table = {"q": ANGLE * 1.31, "t": np.repeat(T[::2], 2)}
    np.savez(tmp_path / "log.npz", **table)
    rows = np.column_stack([table["t"], table["q"]])
    np.savetxt(tmp_path / "log.csv", rows, "%.17g", ",", header="t,a,b", comments="")
    options = {"rig": RIG, "units": {"t": "s", "position": "rad"}}
    block, cells = {"t": "t", "position": "q"}, {"t": "t", "position": ["a", "b"]}
    for call in (
        lambda: Record.from_table(table, columns=block, **options),
        lambda: Record.read(tmp_path / "log.npz", columns=block, **options),
        lambda: Record.from_csv(tmp_path / "log.csv", columns=cells, **options),
    ):
        with pytest.warns(UserWarning, match="whole pulses|repeat the time") as noted:
            call()
        assert [Path(note.filename) for note in noted] == [Path(__file__)] * 2
        assert {note.lineno for note in noted} == {call.__code__.co_firstlineno}


def test_a_smooth_encoder_keeps_the_angle():
    rig = dataclasses.replace(RIG, encoder=Encoder(resolution=RESOLUTION, smooth=True))
    q = np.random.default_rng(0).normal(size=(N, 2))
    np.testing.assert_allclose(
        angles("rad", q, rig=rig).counts, q * GEAR * RESOLUTION / (2 * np.pi), rtol=1e-14
    )


# -- other fields --------------------------------------------------------------------------------
def test_torque_and_current_are_brought_to_the_joint_and_to_ampere():
    u = np.random.default_rng(0).normal(size=(N, 2)).clip(-1.5, 1.5)
    columns = {"counts": "c", "torque": "u"}
    table = {"c": COUNTS, "u": u}
    np.testing.assert_allclose(
        record(table, columns, {"torque": "motor N m"}).torque, u * GEAR, rtol=1e-15
    )
    np.testing.assert_array_equal(record(table, columns, {"torque": "N m"}).torque, u)
    columns = {"counts": "c", "current": "u"}
    np.testing.assert_array_equal(record(table, columns, {"current": "A"}).current, u)
    np.testing.assert_allclose(
        record({"c": COUNTS, "u": 1e3 * u}, columns, {"current": "mA"}).current, u, rtol=1e-15
    )


def test_the_reference_comes_as_counts_as_angles_or_as_a_reference():
    table = {"c": COUNTS, "r": COUNTS + 7, "q": (COUNTS + 7) / RESOLUTION * 2 * np.pi / GEAR}
    for columns, units in (
        ({"counts": "c", "reference_pulses": "r"}, {}),
        ({"counts": "c", "reference_position": "q"}, {"reference_position": "rad"}),
    ):
        found = record(table, columns, units)
        np.testing.assert_array_equal(found.reference_pulses, COUNTS + 7)
        np.testing.assert_array_equal(found.error_pulses, 7)
    path = Harmonics(period=1.0, offset=(0.3, -0.2), cosine=((0.1,), (0.2,)), sine=((0.0,), (0.1,)))
    found = record({"e": np.ones((N, 2))}, {"error_pulses": "e"}, reference=path)
    np.testing.assert_array_equal(found.reference_pulses, RIG.counts(path(T).q))
    np.testing.assert_array_equal(found.error_pulses, 1)
    assert found.reference == path


def test_a_second_sensor_on_the_links_is_kept_as_it_resolves():
    """Angles of the joints, in pulses of the motors' shafts, unrounded: its grid is not the
    rig's.
    """
    angle = np.linspace(0.1, 0.3, 7)[:, None] * [1, -2]
    table = {"counts": np.zeros((7, 2), int), "link": np.degrees(angle)}
    columns = {"counts": "counts", "link_position": "link"}
    record = Record.from_table(
        table,
        rig=RIG,
        columns=columns,
        units={"link_position": "deg"},
        reference=puma560.reference(),
    )
    np.testing.assert_allclose(record.link_counts, RIG.position_in_pulses(angle), rtol=1e-12)
    with pytest.raises(ValueError, match="units must state that of 'link_position'"):
        Record.from_table(table, rig=RIG, columns=columns, reference=puma560.reference())


def test_a_second_sensor_may_be_on_some_links_alone():
    """None, or a column without numbers, of the others; a motor that turns several joints needs
    all of them.
    """
    angle = np.linspace(0.1, 0.3, 7)
    table = {"counts": np.zeros((7, 2), int), "link": angle, "empty": np.full(7, np.nan)}
    units = {"link_position": "rad", "torque": "N m"}
    for names in ([None, "link"], ["empty", "link"]):
        columns, own = {"counts": "counts", "link_position": names}, {"link_position": "rad"}
        record = Record.from_table(
            table, rig=RIG, columns=columns, units=own, reference=puma560.reference()
        )
        expected = RIG.position_in_pulses(np.column_stack([angle, angle]))
        np.testing.assert_allclose(record.link_counts, expected * (np.nan, 1), rtol=1e-12)
        assert record.valid.all()
    coupled = dataclasses.replace(
        RIG, drive=dataclasses.replace(RIG.drive, coupling=Coupling(matrix=((1, 0), (1, 1))))
    )

    def mapped(rig, names, field="link_position"):
        own = {name: unit for name, unit in units.items() if name in ("counts", field)}
        columns = {"counts": "counts", field: names}
        return Record.from_table(
            table, rig=rig, columns=columns, units=own, reference=puma560.reference()
        )

    assert np.isfinite(mapped(coupled, ["link", None]).link_counts).all(axis=0).tolist() == [
        True,
        False,
    ]
    with pytest.raises(ValueError, match="link_counts must be of a joint at least"):
        mapped(coupled, [None, "link"])
    with pytest.raises(ValueError, match="'link_position' must name a column at least"):
        mapped(RIG, [None, None])
    with pytest.raises(ValueError, match="columns must be mapped by their names"):
        mapped(RIG, ["link", None], "torque")


def test_names_may_be_one_per_joint():
    found = record({"a": COUNTS[:, 0], "b": COUNTS[:, 1]}, {"counts": ["b", "a"]})
    np.testing.assert_array_equal(found.counts, COUNTS[:, ::-1])


# -- time ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("unit", "per"), [("s", 1.0), ("ms", 1e3), ("us", 1e6)])
def test_time_starts_at_zero_in_seconds(unit, per):
    stamp = np.round(T * 1e6).astype(np.int64) if unit == "us" else T * per
    found = record(
        {"t": stamp + 1_700_000 * int(per), "c": COUNTS}, {"t": "t", "counts": "c"}, {"t": unit}
    )
    np.testing.assert_allclose(found.t, T, atol=1e-9)
    assert found.t[0] == 0


def test_whole_microseconds_since_1970_lose_nothing():
    stamp = 1_700_000_000_000_000 + np.arange(N) * 2000
    found = record({"t": stamp, "c": COUNTS}, {"t": "t", "counts": "c"}, {"t": "us"})
    np.testing.assert_array_equal(found.t, np.arange(N) * 2000 / 1e6)


def test_rows_that_repeat_a_time_are_left_out_and_said():
    rows = np.sort(np.append(np.arange(N), [3, 3, 9]))
    with pytest.warns(
        UserWarning,
        match="3 rows repeat the time of the row before and are left out, from row 4 on",
    ):
        found = record({"t": T[rows], "c": COUNTS[rows]}, {"t": "t", "counts": "c"}, {"t": "s"})
    np.testing.assert_array_equal(found.counts, COUNTS)


def test_missing_cells_hold_the_row_before_and_weigh_nothing():
    c, u = COUNTS.copy(), np.ones((N, 2))
    c[0, 0], c[5:8, 1], u[20, 0] = np.nan, np.nan, np.nan
    weights = np.ones(N)
    weights[30], weights[31] = 0.25, np.nan
    found = record(
        {"c": c, "u": u, "w": weights},
        {"counts": "c", "torque": "u", "valid": "w"},
        {"torque": "N m"},
    )
    np.testing.assert_array_equal(np.flatnonzero(found.valid < 1), [0, 5, 6, 7, 20, 30, 31])
    np.testing.assert_array_equal(found.valid[[5, 30, 31]], [0, 0.25, 0])
    np.testing.assert_array_equal(found.counts[5:9, 1], COUNTS[[4, 4, 4, 8], 1])
    assert found.counts[0, 0] == COUNTS[1, 0]
    assert found.torque[20, 0] == 1


# -- wrap ----------------------------------------------------------------------------------------
@settings(derandomize=True, max_examples=60, deadline=None)
@given(
    steps=st.lists(st.integers(-2047, 2047), min_size=1, max_size=60),
    start=st.integers(0, 4095),
    low=st.sampled_from([0, -2048]),
)
def test_unwrapping_is_exact(steps, start, low):
    """Steps below half a wrap come back to the last count, whatever range the counter has."""
    truth = start + low + np.cumsum([0, *steps])
    wrapped = (truth - low) % 4096 + low
    table = {"c": np.column_stack([wrapped, wrapped.astype(float)])}
    found = record(table, {"counts": "c"}, wrap=4096).counts
    np.testing.assert_array_equal(found, np.column_stack([truth, truth]))


TURNING = np.column_stack([3000 * np.sin(3 * T) - 10, 5000 * np.cos(5 * T) - 500]).round()


@pytest.mark.parametrize("of_reference", ["both", "one"])
@pytest.mark.parametrize(
    ("measured", "reference", "unit", "wrap"),
    [
        ("counts", "reference_pulses", "pulses", 4096),
        ("position", "reference_position", "pulses", 4096.0),
        ("motor_position", "reference_motor_position", "deg", 360.0),
    ],
)
def test_a_reference_that_starts_again_as_well_is_unwrapped(
    measured, reference, unit, wrap, of_reference
):
    """Both lie about the end of the counter: at the start they are a wrap apart."""
    goal = TURNING + np.array([20, 30])
    per = 1 if unit == "pulses" else 360 / RESOLUTION
    wrapped = [x * per % wrap for x in (TURNING, goal)]
    table = {"q": wrapped[0], "r": wrapped[1] if of_reference == "both" else goal * per}
    columns, units = {measured: "q", reference: "r"}, {measured: unit, reference: unit}
    with pytest.warns(UserWarning, match=f"{reference} .* whole wraps"):
        found = record(table, columns, units, wrap=wrap)
    np.testing.assert_array_equal(found.error_pulses, goal - TURNING)


def test_a_reference_whose_steps_are_followed_is_no_wrapped_one():
    """A step of 0.9 wraps, which the counter follows."""
    counts = np.column_stack([np.linspace(0, 3700, N).round()] * 2)
    goal = np.where(T[:, None] < 0.1, 0, [3700, 3700])
    table = {"c": counts % 4096, "r": goal}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = record(table, {"counts": "c", "reference_pulses": "r"}, wrap=4096)
    np.testing.assert_array_equal(found.error_pulses, goal - counts)


def test_angles_are_unwrapped_before_they_are_counted():
    motor = COUNTS / RESOLUTION * 2 * np.pi
    for unit, wrap in (("rad", 2 * np.pi), ("deg", 360.0)):
        wrapped = np.degrees(np.angle(np.exp(1j * motor)))
        wrapped = wrapped if unit == "deg" else np.radians(wrapped)
        found = record(
            {"q": wrapped}, {"motor_position": "q"}, {"motor_position": unit}, wrap=wrap
        ).counts
        whole = (found - COUNTS)[0] / RESOLUTION
        np.testing.assert_array_equal(whole, np.round(whole))
        np.testing.assert_array_equal(found - found[0], COUNTS - COUNTS[0])


# -- refusals ------------------------------------------------------------------------------------
COLUMNS = {"t": "t", "position": "q"}
# Their difference, 60000, is more than 16 bits hold.
JUMPS = np.array([[-30000, 0], [30000, 0]], np.int16)
TABLE = {"t": T, "q": ANGLE, "u": np.full((N, 2), 20.0), "c": COUNTS, "s": np.full(N, "a")}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: angles("deg"), r"position in 'deg' must be whole pulses .* as 'position' in 'rad' they would be"),
        (lambda: angles("rad", np.degrees(4 * ANGLE)), r"spans .* turns of joint q\[0\]; at most 10\. 'deg' would fit"),
        (lambda: angles("rad", np.degrees(ANGLE)), r"must be whole pulses of the rig; .* as 'position' in 'deg' they"),
        (
            lambda: record({"q": ANGLE}, {"motor_position": "q"}, {"motor_position": "rad"}),
            r"motor_position in 'rad' must be whole pulses of the rig; they are not, as 'position' in 'rad'",
        ),
        (lambda: angles("pulses"), r"'position' must be whole pulses; got .* in row 0, joint q\[1\]. Map angles"),
        (lambda: record(TABLE, COLUMNS, {"t": "ms", "position": "rad"}), r"step of 2e-06 s; .*'s' would fit"),
        (
            lambda: record(TABLE | {"t": 1e3 * T}, COLUMNS, {"t": "s", "position": "rad"}),
            r"t in 's' has a step of 2 s; rig.period is 0.002 s. 'ms' would fit",
        ),
        (lambda: record(TABLE | {"t": 30 * T}, COLUMNS, {"t": "s", "position": "rad"}), "Give the rig the log's"),
        (
            lambda: record(TABLE, {"counts": "c", "torque": "u"}, {"torque": "motor N m"}),
            r"torque in 'motor N m' reaches 20 at joint q\[[01]\]; the amplifier drives .* 'N m' would fit",
        ),
        (
            lambda: record(TABLE | {"u": 1000 * TABLE["u"]}, {"counts": "c", "torque": "u"}, {"torque": "N m"}),
            r"torque in 'N m' reaches 20000 .*Correct the log, or the rig's limit",
        ),
        (
            lambda: record(TABLE | {"u": 100 * TABLE["u"]}, {"counts": "c", "current": "u"}, {"current": "A"}),
            r"current in 'A' reaches 2000 .* 'mA' would fit",
        ),
        (lambda: record(TABLE, COLUMNS, {"t": "s"}), r"units must state that of 'position'; got none"),
        (lambda: record(TABLE, COLUMNS, {"t": "s", "position": "grad"}), "unit of 'position' must be 'deg' or 'gon'; got 'grad'"),
        (lambda: record(TABLE, COLUMNS, {"t": "s", "postion": "rad"}), "Did you mean 'position'"),
        (lambda: record(TABLE, {"t": "t", "pos": "q"}, {"t": "s"}), "what a column is mapped to must be one of"),
        (lambda: record(TABLE, {"t": "t"}, {"t": "s"}), "columns must hold exactly one of position"),
        (lambda: record(TABLE, {"counts": "c", "error_pulses": "c"}), "columns must hold exactly one of position"),
        (lambda: record(TABLE, {"error_pulses": "c"}), "error_pulses need what was commanded"),
        (lambda: record(TABLE, {"counts": ["c", "u"]}), "'counts' must have 2 columns, one per joint; got 4"),
        (lambda: record(TABLE, {"counts": ["c", "c"]}), "columns must map each column once; got 'c' twice"),
        (
            lambda: record(TABLE, {"counts": "c", "torque": "c"}, {"torque": "N m"}),
            "columns must map each column once; got 'c' twice. Give each joint its own",
        ),
        (
            lambda: record(TABLE, {"counts": "c"}, law=LoggedTorque()),
            "LoggedTorque needs the record's torque; it has none",
        ),
        (lambda: record(TABLE, {"counts": "d"}), "column 'd' must be there; got 5 others"),
        (lambda: record(TABLE, {"counts": 3}), r"columns must be mapped by their names; got \[3\]"),
        (lambda: record({"c": 3.0}, {"counts": "c"}), r"column 'c' must be real numbers.*; got float64 \(\)"),
        (
            lambda: record({"t": [], "c": np.zeros((0, 2))}, {"t": "t", "counts": "c"}, {"t": "s"}),
            "columns must hold samples; got none",
        ),
        (
            lambda: record(TABLE | {"w": np.full(N, np.nan)}, {"counts": "c", "temperature": "w"}),
            "'temperature' must hold numbers; got NaN alone",
        ),
        (
            lambda: record({"c": JUMPS}, {"counts": "c"}, wrap=10000),
            r"wrap must be as large .* got 10000, but joint q\[0\] spans 60000",
        ),
        (lambda: record(TABLE, {"counts": ["s", "c"]}), "column 's' must be real numbers"),
        (lambda: record(TABLE | {"t": T[:-1]}, COLUMNS, {"t": "s", "position": "rad"}), "columns must have one length"),
        (lambda: record({"c": np.full((9, 2), np.nan)}, {"counts": "c"}), "must hold numbers; joint q\\[0\\] has none"),
        (lambda: record({"c": np.full((9, 2), np.inf)}, {"counts": "c"}), "must be finite, or NaN where it is missing"),
        (lambda: record(TABLE, {"counts": "c"}, wrap=4096), "wrap must be as large as what is logged; got 4096"),
        (lambda: record(TABLE, {"counts": "c"}, wrap=-1), "wrap must be a positive number"),
        (lambda: record(TABLE, {"counts": "c"}, wrap=(9, 9, 9)), "wrap must be one number, or 2"),
        (lambda: record(TABLE | {"t": np.r_[np.nan, T[1:]]}, COLUMNS, {"t": "s", "position": "rad"}), "nan in row 0"),
        (lambda: record(TABLE | {"t": T[::-1]}, COLUMNS, {"t": "s", "position": "rad"}), "t must increase"),
    ],
)  # fmt: skip
def test_wrong_units_and_mappings_are_refused_in_one_line(call, message):
    with pytest.raises(ValueError, match=message) as refusal:
        call()
    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < 400


# -- resampling ----------------------------------------------------------------------------------
def test_resampling_at_the_logged_times_changes_nothing():
    log = record(TABLE, {"t": "t", "counts": "c", "torque": "u"}, {"t": "s", "torque": "N m"})
    again = log.resampled(RIG.period)
    for name in ("t", "counts", "valid", "torque", "reference_pulses"):
        np.testing.assert_allclose(getattr(again, name), getattr(log, name), atol=1e-12)


def test_resampled_counts_are_within_half_a_pulse_of_the_line():
    """A ramp sampled with jitter is the same ramp at uniform times; half a pulse is the rounding. A
    torque is not between its samples but held: the new ones have the same integral, sample by
    sample.
    """
    rng = np.random.default_rng(0)
    t = T + np.r_[0, rng.uniform(-3e-4, 3e-4, N - 1)]
    ramp = np.column_stack([5000 * t, -300 * t])
    log = Record(t=t, error_pulses=-ramp, reference_pulses=np.zeros((N, 2)), torque=ramp, rig=RIG)
    again = log.resampled(1e-3)
    assert (np.abs(again.counts - np.outer(again.t, [5000, -300])) <= 0.5 + 1e-9).all()
    np.testing.assert_array_equal(again.counts, np.round(again.counts))
    ends = np.append(again.t, again.t[-1] + 1e-3)
    total = np.vstack([[0, 0], np.cumsum(ramp * np.diff(t, append=ends[-1])[:, None], axis=0)])
    total = np.column_stack([np.interp(ends, np.append(t, ends[-1]), column) for column in total.T])
    # eps times 1e3 samples of 1e3
    np.testing.assert_allclose(again.torque, np.diff(total, axis=0) / 1e-3, atol=1e-9)
    np.testing.assert_allclose(np.diff(again.t), 1e-3)
    assert again.rig.period == 1e-3
    assert again.t[-1] <= t[-1] < again.t[-1] + 1e-3


def test_resampled_counts_of_a_smooth_encoder_keep_their_fractions():
    smooth = dataclasses.replace(RIG, encoder=dataclasses.replace(RIG.encoder, smooth=True))
    pulses = np.column_stack([0.1 * np.arange(5), np.zeros(5)])
    log = Record(t=T[:5], reference_pulses=2 * pulses, error_pulses=pulses, rig=smooth)
    again = log.resampled(RIG.period / 2)
    np.testing.assert_allclose(again.reference_pulses[:, 0], 0.1 * np.arange(9), atol=1e-12)
    np.testing.assert_allclose(again.counts[:, 0], 0.05 * np.arange(9), atol=1e-12)


def test_resampled_gaps_and_dropped_samples_weigh_nothing():
    t = np.array([0, 1, 2, 3, 6, 7, 8, 9.0]) * 2e-3
    valid = np.array([1, 1, 1, 1, 1, 0, 1, 0.5])
    log = Record(t=t, error_pulses=np.zeros((8, 2)), valid=valid, rig=RIG)
    again = log.resampled(1e-3)
    np.testing.assert_array_equal(again.t, 1e-3 * np.arange(19))
    np.testing.assert_array_equal(
        again.valid, [1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0.5, 0.5]
    )


def test_resampled_torques_are_means_of_what_was_held():
    """By hand: two to one gives means of pairs, one to two repeats, two to three mixes; the last
    is held on.
    """
    u = np.array([[1.0, -2], [3, 0], [5, 7], [-4, 1], [2, 2]])
    log = Record(t=T[:5], error_pulses=np.zeros((5, 2)), torque=u, current=-u, rig=RIG)
    for period, expected in (
        (2 * RIG.period, [[2, -1], [0.5, 4], [2, 2]]),
        (RIG.period / 2, np.repeat(u, 2, axis=0)[:-1]),
        (1.5 * RIG.period, [[5 / 3, -4 / 3], [13 / 3, 14 / 3], [-2, 4 / 3]]),
    ):
        again = log.resampled(period)
        np.testing.assert_allclose(again.torque, expected, rtol=1e-12)
        np.testing.assert_array_equal(again.current, -again.torque)


def test_resampled_torques_go_straight_across_gaps():
    """As they are replayed there: from 1 to 7 over three intervals, whose means are 2, 4 and 6."""
    log = Record(t=RIG.period * np.array([0, 1, 4, 5]), error_pulses=np.zeros((4, 2)),
                 torque=np.array([[9, 9], [1, 7], [7, 1], [5, 5.0]]), rig=RIG)  # fmt: skip
    expected = [[9, 9], [2, 6], [4, 4], [6, 2], [7, 1], [5, 5]]
    np.testing.assert_allclose(log.resampled(RIG.period).torque, expected, rtol=1e-12)


def test_resampling_needs_a_period():
    log = record(TABLE, {"counts": "c"})
    for period in (21 * RIG.period, RIG.period / 21, 2.0):
        with pytest.raises(
            ValueError, match=r"period must be within 20 times the log's; got .* Give seconds"
        ):
            log.resampled(period)
    assert len(log.resampled(19 * RIG.period)) == -(-N // 19)
    with pytest.raises(ValueError, match="period must be a positive number; got 0"):
        log.resampled(0)
    gap = Record(t=[0, 2e-3, 4e-3, 1e6], error_pulses=np.zeros((4, 2)), rig=RIG)
    with pytest.raises(
        ValueError, match=r"period must give at most 33554432 samples; got 0\.002 s"
    ):
        gap.resampled(2e-3)


# -- real logs -----------------------------------------------------------------------------------
@pytest.mark.parametrize("design", ["A.0", "C.0", "C.1"])
def test_every_run_of_a_real_double_pendulum_is_read_to_the_last_count(design):
    """Its position has steps of 25/65535 rad, logged in the middle of them: 6 motor turns per
    joint turn.
    """
    folder = os.environ.get("CTC_DATA")
    if not folder:
        pytest.skip("CTC_DATA is not set: no real logs to read")
    path = Path(folder) / "dfki_double_pendulum" / f"sysid_{design}.npz"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    step = 25 / 65535
    drive = Drive(gear=(6, 6), motor_inertia=(6.07e-5,) * 2, viscous=(0,) * 2, coulomb=(0,) * 2,
                  motor_gain=(0.091,) * 2, current_limit=(np.inf,) * 2)  # fmt: skip
    rig = Rig(drive=drive, encoder=Encoder(resolution=(2 * np.pi / step / 6,) * 2), period=2e-3)
    columns = {
        "t": "time",
        "position": ["pos_meas1", "pos_meas2"],
        "torque": ["tau_meas1", "tau_meas2"],
    }
    units = {"t": "s", "position": "rad", "torque": "N m"}
    table = read_table(path)
    runs = sorted({name.split("/")[0] for name in table})
    assert len(runs) >= 9
    for run in runs:
        log = Record.read(path, rig=rig, columns=columns, units=units, prefix=f"{run}/")
        logged = np.column_stack([table[f"{run}/{name}"] for name in columns["position"]])
        cells = logged / step - 0.5  # the log has the middles of cells, all of them one step wide
        np.testing.assert_allclose(log.counts, cells, atol=1e-6)
        np.testing.assert_array_equal(log.t, table[f"{run}/time"])
    with pytest.raises(LoadError, match="as 'position' in 'rad' they would be"):
        Record.read(
            path, rig=rig, columns=columns, units=units | {"position": "deg"}, prefix=f"{run}/"
        )


def test_the_paper_s_rig_takes_a_log_in_degrees():
    rig = puma560.rig()
    counts = np.array([[0, 0], [100, -50], [260, -120]])
    q = np.degrees(rig.cell_centre(counts))
    found = Record.from_table(
        {"q": q}, rig=rig, columns={"position": "q"}, units={"position": "deg"}
    )
    np.testing.assert_array_equal(found.counts, counts)


# -- joints that slide ---------------------------------------------------------------------------
def test_positions_in_m_and_mm_and_forces_in_n_of_joints_that_slide():
    """By hand: counts are whole pulses of position times gear; one unit for all, or one per
    joint.
    """
    t = RIG.period * np.arange(400)
    counts = np.round(RIG.counts(np.column_stack([0.3 * np.sin(9 * t), 0.2 * np.cos(7 * t)])))
    q = RIG.cell_centre(counts)
    torque = np.column_stack([np.sin(t), np.cos(t)])
    table = {"m": q, "mm": 1e3 * q, "mixed": q * (180 / np.pi, 1e3), "u": torque}
    for name, unit in (
        ("m", "m"),
        ("mm", "mm"),
        ("mixed", ("deg", "mm")),
        ("m", ["m", "m"]),
        ("m", ("rad", "m")),
    ):
        for force in ("N", ("N m", "N"), "N m"):
            units = {"position": unit, "torque": force}
            record = Record.from_table(
                table, rig=RIG, columns={"position": name, "torque": "u"}, units=units
            )
            np.testing.assert_array_equal(record.counts, counts)
            np.testing.assert_array_equal(record.torque, torque)


@pytest.mark.parametrize(
    ("unit", "message"),
    [
        (
            "m",
            (
                r"position in 'm' (spans 6\d\d m of .*; at most 50\. 'mm' would fit|must be whole"
                r" pulses)"
            ),
        ),
        (("rad",), r"units of 'position' must be one, or 2, one per joint; got 1"),
        (
            ("rad", "pulses"),
            r"units of 'position' may differ between joints among 'rad', 'deg', .*'m', 'mm'; got",
        ),
        (
            ("rad", "inch"),
            r"one of 'rad', 'deg', .*'m', 'mm', 'pulses'; got 'inch'. Convert .*rad per inch",
        ),
    ],
)
def test_units_of_joints_that_slide_are_checked(unit, message):
    t = RIG.period * np.arange(400)
    table = {"q": 1e3 * np.column_stack([0.3 * np.sin(9 * t), 0.2 * np.cos(7 * t)])}
    with pytest.raises(ValueError, match=message):
        Record.from_table(table, rig=RIG, columns={"position": "q"}, units={"position": unit})


# -- the path that was asked for -----------------------------------------------------------------
def _asked(kind):
    """Positions that a controller was asked for, at its samples."""
    t = np.arange(800) * RIG.period
    q = puma560.reference()(t).q
    if kind == "a step":
        q = q + 0.01 * (t > 0.3)[:, None]
    if kind == "whole pulses":
        q = RIG.to_angle(RIG.counts(q))
    return t, q


@pytest.mark.parametrize(
    "kind", ["smooth", "a step", "whole pulses", "one is missing", "the first are missing"]
)
def test_positions_without_rounding_are_the_path_where_they_are_smooth(kind):
    """Counts at samples alone leave open what a P loop does between them: straight lines lag by
    half a pulse.
    """
    t, q = _asked(kind)
    counts = RIG.counts(q)
    missing = {"one is missing": [50], "the first are missing": [0, 1]}.get(kind, [])
    q[missing] = np.nan
    record = Record.from_table(
        {"t": t, "c": counts, "q": q}, rig=RIG, law=puma560.p_law(),
        columns={"t": "t", "counts": "c", "reference_position": "q"},
        units={"t": "s", "counts": "pulses", "reference_position": "rad"},
    )  # fmt: skip
    if kind in ("a step", "whole pulses"):
        assert record.reference is None
        return
    np.testing.assert_array_equal(record.reference_pulses, RIG.counts(record.reference(t).q))
    np.testing.assert_array_equal(record.reference_pulses[2:], counts[2:])
    loose = 1e3 if missing else 1.0
    between = t[3:-3] + RIG.period / 3
    truth = puma560.reference()(between)
    for got, expected, limit in zip(
        record.reference(between), truth, (1e-12, 1e-9, 1e-5), strict=True
    ):
        np.testing.assert_allclose(got, expected, rtol=0, atol=loose * limit)


def test_a_commanded_position_in_pulses_with_fractions(tmp_path):
    """The path that a controller was given, in its own units; as counts it is refused, with what
    to map it to.
    """
    t = RIG.period * np.arange(400)
    asked = 300 * np.sin(20 * t)[:, None] * (1.0, -0.7) + 0.25
    rows = np.column_stack([t, np.trunc(asked), asked])
    np.savetxt(
        tmp_path / "log.csv", rows, delimiter=",", header="t,c1,c2,r1,r2", comments="", fmt="%.17g"
    )
    columns = {"t": "t", "counts": ["c1", "c2"], "reference_position": ["r1", "r2"]}
    units = {"t": "s", "reference_position": "pulses"}
    record = Record.from_csv(
        tmp_path / "log.csv", rig=RIG, law=puma560.p_law(), columns=columns, units=units
    )
    np.testing.assert_array_equal(record.reference_pulses, np.floor(asked))
    np.testing.assert_allclose(RIG.position_in_pulses(record.reference(t).q), asked, atol=1e-9)
    counted = {"t": "t", "counts": ["c1", "c2"], "reference_pulses": ["r1", "r2"]}
    with pytest.raises(
        ValueError,
        match=r"must be whole pulses; .* Map it as 'reference_position', with its unit, 'p",
    ):
        Record.from_csv(
            tmp_path / "log.csv", rig=RIG, law=puma560.p_law(), columns=counted, units={"t": "s"}
        )


def test_columns_that_are_mapped_the_other_way_round_are_called_so():
    with pytest.raises(ValueError, match="the other way round"):
        Record.from_table(
            {"time": [0.0, 1.0], "q1": [0.0, 1.0]}, rig=RIG, columns={"time": "t", "q1": "position"}
        )


def test_a_second_sensor_that_spans_more_than_a_joint_is_refused():
    """Degrees that are stated as rad are 14 turns, of a sensor on a link as well."""
    table = {
        "counts": np.zeros((7, 2), int),
        "link": np.linspace(0, 90, 7)[:, None] * [1, 1],
    }
    with pytest.raises(ValueError, match=r"link_position .* 'deg' or"):
        Record.from_table(
            table,
            rig=RIG,
            columns={"counts": "counts", "link_position": "link"},
            units={"link_position": "rad"},
            reference=puma560.reference(),
        )


def test_a_count_that_a_float_cannot_hold_is_refused():
    counts = np.full((7, 2), 2**53 + 1)
    with pytest.raises(ValueError, match="whole pulses"):
        Record.from_table(
            {"counts": counts}, rig=RIG, columns={"counts": "counts"}, reference=puma560.reference()
        )
