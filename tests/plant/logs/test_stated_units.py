"""Units with a constant: per mille of a rated torque, ampere with a torque constant, positions as a
share of a joint's range; and what is said of a unit that needs one.
"""

import dataclasses
import warnings

import numpy as np
import pytest

from plant import Drive, Encoder, Record, Rig

GEAR = np.array([64.0, -25.0, 90.0])
RIG = Rig(
    drive=Drive(
        gear=GEAR,
        motor_inertia=(1e-4,) * 3,
        viscous=(0,) * 3,
        coulomb=(0,) * 3,
        motor_gain=(0.2, 0.3, 0.1),
        current_limit=(10, 8, 9),
    ),
    encoder=Encoder(resolution=(4096, 2000, 1024)),
    period=1e-3,
)
N = 300
PHASE = np.arange(N)[:, None] / [23, 41, 37]
COUNTS = np.round(4000 * np.sin(PHASE))
Q = RIG.to_angle(COUNTS)
TORQUE = 5 * np.cos(PHASE)


def record(value, unit, field="torque", **columns):
    table = {"c": COUNTS, "x": value} | columns
    mapping = {"counts": "c", field: "x"} if field in ("torque", "current") else {field: "x"}
    return Record.from_table(table, rig=RIG, columns=mapping, units={field: unit})


@pytest.mark.parametrize(
    ("word", "turn"),
    [
        ("turns", 1), ("rev", 1), ("Revolutions", 1), ("gon", 400), ("gradians", 400),
        ("mrad", 2000 * np.pi), ("milliradians", 2000 * np.pi), ("°", 360), ("degrees", 360),
    ],
)  # fmt: skip
def test_any_unit_of_angle_gives_the_counts(word, turn):
    for field, angle in (("position", Q), ("motor_position", Q * GEAR)):
        found = record(angle * turn / (2 * np.pi), word, field)
        np.testing.assert_array_equal(found.counts, COUNTS)


@pytest.mark.parametrize("stated", ["rad", "deg", "gon", "mrad"])
@pytest.mark.parametrize(("true", "turn"), [("turns", 1), ("gon", 400), ("deg", 360)])
def test_angles_in_another_unit_than_stated_are_refused_with_theirs(stated, true, turn):
    if stated != true:
        with pytest.raises(ValueError, match=f"in '{stated}'.*'{true}'"):
            record(Q * turn / (2 * np.pi), stated, "position")


def test_a_span_that_fits_several_units_names_them_all():
    """Positions on no grid: 5.1 turns read as degrees or as gradians are both a joint's."""
    with pytest.raises(ValueError, match=r"'deg' or 'gon' or 'mrad' would fit"):
        record(1.37 * np.degrees(Q), "rad", "position")


RATED = np.array([1.5, 2.25, 0.75])


@pytest.mark.parametrize(
    ("unit", "logged", "field"),
    [
        ({"per mille of motor N m": RATED}, 1000 * TORQUE / GEAR / RATED, "torque"),
        ({"per cent of N m": 40.0}, 100 * TORQUE / 40.0, "torque"),
        ({"N m per A": RATED}, TORQUE / RATED, "torque"),
        ({"motor N m per mA": 2e-4}, TORQUE / GEAR / 2e-4, "torque"),
        ({"N m per unit": -0.01}, -100 * TORQUE, "torque"),
        ({"N m per mA per turn": 0.5}, 2 * TORQUE, "torque"),
        ({"per mille of A": RATED}, 1000 * TORQUE / RATED, "current"),
    ],
)
def test_torques_and_currents_with_their_constant(unit, logged, field):
    found = record(logged, unit, field)
    np.testing.assert_allclose(getattr(found, field), TORQUE, rtol=1e-13)


def test_normalised_positions_with_the_ranges_of_their_joints():
    """As LeRobot stores them, in single precision: -100 and 100 are the ends of the range."""
    ranges = np.array([[-5000, 4500], [-4100, 4900], [6000, -4700]])  # the last one turned round
    share = 200 * (COUNTS - ranges[:, 0]) / (ranges[:, 1] - ranges[:, 0]) - 100
    found = record(share.astype("f4"), {"-100 to 100 of pulses": ranges}, "position")
    np.testing.assert_array_equal(found.counts, COUNTS)
    angles = RIG.to_angle(ranges.T).T
    found = record((share + 100) / 200, {"0 to 1 of rad": angles}, "position")
    np.testing.assert_array_equal(found.counts, COUNTS)


def test_steps_that_differ_in_normalised_positions_are_called_so():
    """A slow motion shows them; the same motion in degrees, on the rig's pulses, is no such."""
    counts = np.round(900 * np.sin(np.arange(2000)[:, None] / [410, 370, 450]))
    ranges = np.array([[-1000, 1500], [-1300, 950], [-1700, 1600]])
    share = 200 * (counts - ranges[:, 0]) / (ranges[:, 1] - ranges[:, 0]) - 100
    table = {"x": share, "deg": np.degrees(RIG.to_angle(counts))}
    degrees = {"rig": RIG, "units": {"position": "deg"}}
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        Record.from_table(table, columns={"position": "x"}, **degrees)
        Record.from_table(table, columns={"position": "deg"}, **degrees)
    texts = [str(note.message) for note in noted if "normalised" in str(note.message)]
    assert len(texts) == 1
    assert '{"-100 to 100 of pulses": ranges of the joints}' in texts[0]
    with pytest.raises(ValueError, match=r"Normalised positions need their ranges: .*-100 to 100"):
        Record.from_table(table, rig=RIG, columns={"position": "x"}, units={"position": "rad"})


def test_a_check_names_the_ranges_where_steps_of_joints_differ():
    """Servos without a gear, whose ranges make steps of about one pulse; then one wrong gear."""
    drive = dataclasses.replace(RIG.drive, gear=(1.0,) * 3)
    rig = dataclasses.replace(RIG, drive=drive, encoder=Encoder(resolution=(4096,) * 3))
    counts = np.round(900 * np.sin(np.arange(2000)[:, None] / [410, 370, 450]))
    ranges = np.array([[-1000, 1500], [-1300, 1100], [-1700, 1600]])
    share = 200 * (counts - ranges[:, 0]) / (ranges[:, 1] - ranges[:, 0]) - 100
    table = {"share": share, "scaled": np.degrees(rig.to_angle(1.3371 * counts))}
    advices = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for column in table:
            record = Record.from_table(
                table, columns={"position": column}, rig=rig, units={"position": "deg"}
            )
            problems = record.check().problems
            advices[column] = [f.advice for f in problems if f.check == "quantisation step"]
    assert [len(texts) for texts in advices.values()] == [3, 3]
    assert all("-100 to 100" in text for text in advices["share"])
    assert not any("-100 to 100" in text for text in advices["scaled"])


@pytest.mark.parametrize(
    ("unit", "field", "message"),
    [
        ("per mille", "torque", 'must state the rated torque; got none. Give {"per mille of motor'),
        ("%", "current", 'the rated current; got none. Give {"per cent of A": rated}'),
        ("A", "torque", "must be one of torque, or have a torque constant; got 'A'. Map"),
        (
            "normalised",
            "position",
            'the ranges of the joints; got none. Give {"-100 to 100 of deg"',
        ),
        ("grad", "position", "must be 'deg' or 'gon'; got 'grad', which is used for both"),
        ("furlong", "position", "got 'furlong'. Convert the column, or give {\"rad per furlong\""),
        ("rpm", "position", "must be one of 'rad', .*got 'rpm'"),
        ({"per mille of motor N m": (1, 2)}, "torque", "must be one number, or one per joint; got"),
        ({"per mille of A": 2.0}, "torque", "unit of 'torque' must be one of .*got 'A'"),
        ({"N m per A": np.nan}, "torque", "must be one number, or one per joint; got nan"),
        ({"N m per A": 0}, "torque", "must not be zero; got 0"),
        ({"per mille of N m": "ten"}, "torque", "must be one number, or one per joint; got 'ten'"),
        ({}, "torque", "must be one word with its constants; got 0"),
        ({"rated": 3}, "torque", "must say what its constants mean; got 'rated'"),
        ({"-100 to 100 of deg": (5, 5)}, "position", "must have two ends; got"),
        ({"-100 to 100 of deg": (5, 6, 7)}, "position", "a pair .least, most. per joint"),
        (
            {"100 to -100 of deg": (5, 6)},
            "position",
            "unit of .* must rise; got '100 to -100 of deg'",
        ),
        ({"0 to 1 of rad": np.ones((3, 2))}, "position", "must have two ends; got"),
        ({"N m per A": np.ones((3, 2))}, "torque", "must be one number, or one per joint; got"),
        ([{"N m per A": 2.0}, "N m", "N m"], "torque", "must be a word.*got {'N m per A': 2.0}"),
        (np.array(["N m"] * 3), "torque", "must be a word"),
        (5, "torque", "must be a word.*got 5"),
    ],
)
def test_a_unit_without_what_it_needs_is_refused(unit, field, message):
    with pytest.raises(ValueError, match=message) as caught:
        record(TORQUE, unit, field)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("unit", "field"),
    [
        ("mN m", "torque"),
        ("kN m", "torque"),
        ("N mm", "torque"),
        ("urad", "position"),
        ("mdeg", "position"),
        ({"N mm per A": 3.0}, "torque"),
    ],
)
def test_another_multiple_of_a_unit_is_no_misspelling(unit, field):
    """Advice to state the unit itself would lose the factor without a word."""
    with pytest.raises(ValueError, match="must be one of") as caught:
        record(TORQUE, unit, field)
    assert "Did you mean" not in str(caught.value)


@pytest.mark.parametrize("unit", [{"s per tick": 0.5}, {"ms per tick": [500]}])
def test_times_with_their_constant(unit):
    table = {"time": 2e-3 * np.arange(N) + 7, "c": COUNTS}
    columns = {"t": "time", "counts": "c"}
    found = Record.from_table(table, rig=RIG, columns=columns, units={"t": unit})
    np.testing.assert_allclose(found.t, 1e-3 * np.arange(N), rtol=1e-12)


@pytest.mark.parametrize(
    ("stated", "heading", "warns"),
    [
        (["rad"] * 3, "rad", False),
        ({"rad per rad": 1.0}, "rad", False),
        (["rad"] * 3, "deg", True),
    ],
)
def test_a_unit_is_compared_with_its_heading_by_its_meaning(stated, heading, warns):
    names = [f"q{i} [{heading}]" for i in range(3)]
    table = dict(zip(names, Q.T, strict=True))
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        Record.from_table(table, rig=RIG, columns={"position": names}, units={"position": stated})
    said = [str(note.message) for note in noted if "heading" in str(note.message)]
    assert ["state 'rad'" in text for text in said] == [True] * warns


def test_headings_of_two_units_beside_a_joint_without_a_second_encoder():
    table = {"c": COUNTS, "a [deg]": np.degrees(Q[:, 0]), "b [rad]": Q[:, 2]}
    columns = {"counts": "c", "link_position": ["a [deg]", None, "b [rad]"]}
    found = Record.from_table(table, rig=RIG, columns=columns)
    np.testing.assert_allclose(found.link_counts[:, [0, 2]], COUNTS[:, [0, 2]], atol=1e-8)
    assert np.isnan(found.link_counts[:, 1]).all()


@pytest.mark.parametrize(
    ("field", "heading", "unit", "logged", "noted"),
    [
        ("temperature", "", None, 25.0, 25.0),
        ("temperature", " [°C]", None, 25.0, 25.0),
        ("temperature", " [K]", None, 298.15, 25.0),
        ("temperature", "", "K", 298.15, 25.0),
        ("temperature", "", {"degC per V": 10.0}, 2.5, 25.0),
        ("time", "", None, 1.7e9, 1.7e9),
        ("time", " [ms]", None, 1.7e12, 1.7e9),
        ("time", "", "ns", 1.7e18, 1.7e9),
    ],
)
def test_notes_are_in_their_unit(field, heading, unit, logged, noted):
    """Celsius and Unix seconds, unless the heading or the units say something else."""
    table = {"c": COUNTS, f"x{heading}": np.full(N, logged)}
    columns = {"counts": "c", field: f"x{heading}"}
    units = {} if unit is None else {field: unit}
    found = Record.from_table(table, rig=RIG, columns=columns, units=units)
    assert found.notes[field] == pytest.approx(noted, rel=1e-12)


@pytest.mark.parametrize("heading", ["mrad", "deg", "A"])
def test_counts_under_a_heading_of_another_unit_are_refused(heading):
    names = [f"q{i} [{heading}]" for i in range(3)]
    table = dict(zip(names, COUNTS.T, strict=True))
    with pytest.raises(
        ValueError, match=f"unit of 'counts' must be one of 'pulses'; got '{heading}'"
    ):
        Record.from_table(table, rig=RIG, columns={"counts": names})
    # Who states the unit knows more than the heading.
    with pytest.warns(UserWarning, match="its heading says"):
        Record.from_table(table, rig=RIG, columns={"counts": names}, units={"counts": "pulses"})


@pytest.mark.parametrize("heading", ["inc", "1", "-", "axis"])
def test_a_heading_of_counts_may_have_no_unit(heading):
    names = [f"q{i} [{heading}]" for i in range(3)]
    table = dict(zip(names, COUNTS.T, strict=True))
    found = Record.from_table(table, rig=RIG, columns={"counts": names})
    np.testing.assert_array_equal(found.counts, COUNTS)
