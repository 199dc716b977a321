"""Records: through a file and back without loss, plain files, and every refusal in one line."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from plant import Elasticity, MitDrive, P, Record, Table, puma560

RIG, LAW, PATH = puma560.rig(), puma560.p_law(), puma560.reference()
FIELDS = (
    "t",
    "reference_pulses",
    "error_pulses",
    "torque",
    "current",
    "initial",
    "link_counts",
    "true_q",
    "true_qd",
)
finite = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def records(draw):
    """Any record: with and without each optional field; every finite double in every column."""
    N = draw(st.integers(1, 5))
    t = np.sort(draw(arrays(float, N, elements=finite, unique=True)))
    values = {"t": t}
    for name in FIELDS[1:]:
        needed = name in ("reference_pulses", "error_pulses")
        if needed or draw(st.booleans()):
            values[name] = draw(
                arrays(float, (2, 2) if name == "initial" else (N, 2), elements=finite)
            )
    law = draw(st.sampled_from([None, LAW, P(gain=(1 / 3, 1e-300))]))
    return Record(**values, rig=RIG, law=law, reference=draw(st.sampled_from([None, PATH])))


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return tmp_path_factory.mktemp("records") / "record.csv"


def same(a, b):
    assert (a.rig, a.law, a.reference) == (b.rig, b.law, b.reference)
    for name in FIELDS:
        x, y = getattr(a, name), getattr(b, name)
        assert (x is None) == (y is None), name
        if x is not None:
            assert x.shape == y.shape
            assert x.tobytes() == y.tobytes(), name  # every bit, the sign of zero included


@settings(derandomize=True, max_examples=60, deadline=None)
@given(record=records())
def test_file_gives_back_every_bit(file, record):
    record.to_csv(file)
    same(Record.from_csv(file), record)


def test_law_rig_and_reference_handed_in_take_the_place_of_those_in_the_file(file):
    Record(t=[0.0], reference_pulses=[[0, 0]], error_pulses=[[0, 0]], rig=RIG, law=LAW).to_csv(file)
    law = P(gain=(1.0, 2.0))
    record = Record.from_csv(file, law=law, reference=PATH)
    assert (record.law, record.reference, record.rig) == (law, PATH, RIG)


def test_header_is_one_comment_line_and_names_carry_units(file):
    some_record().to_csv(file)
    lines = file.read_text().splitlines()
    assert lines[0].startswith('# {"onepulse": 1')
    pulses = "reference_1 [pulses],reference_2 [pulses],error_1 [pulses],error_2 [pulses]"
    assert lines[1] == f"t [s],{pulses},torque_1 [N m],torque_2 [N m]"
    assert len(lines) == 2 + 3


GEARS = Elasticity(stiffness=(500.0, 500.0), damping=(1.0, 1.0))
ONE_LINK = dataclasses.replace(
    RIG,
    drive=dataclasses.replace(RIG.drive, elasticity=GEARS),
    encoder=dataclasses.replace(RIG.encoder, side=("both", "motor")),
)
DRIVEN = dataclasses.replace(RIG, inner=MitDrive(kp=1, kd=1))


def some_record(**changes):
    values = {
        "t": [0.0, 1.0, 2.0],
        "reference_pulses": np.ones((3, 2)),
        "error_pulses": np.arange(6).reshape(3, 2),
        "torque": np.ones((3, 2)),
        "rig": RIG,
        "law": LAW,
    }
    return Record(**values | changes)


@pytest.mark.parametrize(
    "heading",
    ["", "t,r1,r2,e1,e2\n", "# from my robot\nt;a,b,c,d,e\n", "# {not json\n", "# [1]\n\n"],
)
def test_plain_file_needs_a_rig_and_takes_any_heading(file, heading):
    file.write_text(heading + "0,1,2,3,4\n0.1, 5,6,7,8\n")
    record = Record.from_csv(file, rig=RIG, law=LAW)
    np.testing.assert_array_equal(record.reference_pulses, [[1, 2], [5, 6]])
    np.testing.assert_array_equal(record.error_pulses, [[3, 4], [7, 8]])
    assert record.reference is None
    assert (record.law, len(record), record.n) == (LAW, 2, 2)


def test_record_is_frozen_and_says_what_it_is():
    record = some_record()
    with pytest.raises(ValueError, match="read-only"):
        record.error_pulses[0] = 1
    with pytest.raises(AttributeError):
        record.t = 1
    assert repr(record) == "Record(3 samples of 2 joints, 2.000 s, under P)"
    assert "an unknown law" in repr(some_record(law=None))


def test_without_a_reference_the_errors_are_minus_the_counts():
    record = some_record(reference_pulses=None, error_pulses=[[0, -5], [-1, 2], [-3, 4]])
    np.testing.assert_array_equal(record.counts, [[0, 5], [1, -2], [3, -4]])
    np.testing.assert_array_equal(record.valid, 1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"t": [0.0, 1.0, 1.0]}, r"t must increase; got 1.0 after 1.0 at index 2"),
        ({"t": [0.0, 2.0, 1.0]}, r"t must increase; got 1.0 after 2.0 at index 2"),
        ({"t": [0.0, np.nan, 1.0]}, r"t must be finite; got nan at index 1"),
        ({"t": [[0.0, 1.0, 2.0]]}, r"t must have shape \(N,\); got shape \(1, 3\)"),
        (
            {"error_pulses": [[0, 0], [0, np.nan], [0, 0]]},
            r"error_pulses must be finite; got nan at index \(1, 1\)",
        ),
        (
            {"error_pulses": np.zeros((2, 3))},
            r"error_pulses must have shape \(3, 2\); got shape \(2, 3\)",
        ),
        ({"error_pulses": None}, r"error_pulses must have shape \(3, 2\); got None"),
        ({"valid": np.ones(2)}, r"valid must have shape \(3,\); got shape \(2,\)"),
        ({"valid": [1, 2, 0]}, r"valid must be 0 to 1; got 2 at index 1"),
        ({"torque": np.zeros((3, 1))}, r"torque must have shape \(3, 2\); got shape \(3, 1\)"),
        ({"true_q": np.full((3, 2), np.inf)}, r"true_q must be finite; got inf at index \(0, 0\)"),
        ({"initial": np.zeros((2, 3))}, r"initial must have shape \(2, 2\); got shape \(2, 3\)"),
        ({"rig": RIG.drive}, r"rig of a record must be a Rig; got Drive"),
        ({"law": "P"}, r"law of a record must be a Law; got 'P'"),
        ({"reference": np.zeros(3)}, r"reference of a record must be a Reference"),
        ({"reference": Table(times=(0, 1), points=np.zeros((2, 3)))}, r"reference .* 2 joints.* 3"),
        ({"law": P(gain=(1, 1, 1))}, r"law\.gain must have 2 joints; got 3"),
        ({"law": MitDrive(kp=(1, 2, 3), kd=1)}, r"law\.kp must have 2 joints; got 3"),
        ({"law": MitDrive(kp=2, kd=1), "rig": DRIVEN}, r"law .* inner loop .* two that differ"),
        ({"link_counts": np.full((3, 2), (1, np.inf)), "rig": ONE_LINK}, r"finite; got inf .*0, 1"),
        ({"link_counts": np.full((3, 2), np.inf)}, r"link_counts must be finite; got inf"),
        ({"notes": {"g": np.array([1.0, 2.0])}}, r"note 'g' must be a finite number"),
        ({"notes": {"g": ""}}, r"notes must be text or numbers by name"),
        ({"columns": {"torque": 3}}, r"columns .* names; got 3 for 'torque'"),
        ({"columns": {"torque": ("a", 3)}}, r"columns .* names; got .* for 'torque'"),
    ],
)
def test_bad_record_is_refused_with_its_place(changes, message):
    with pytest.raises(ValueError, match=message) as error:
        some_record(**changes)
    assert "\n" not in str(error.value)


def test_a_law_below_the_record_is_not_kept_twice():
    assert some_record(law=MitDrive(kp=1, kd=1), rig=DRIVEN).rig == RIG
    with pytest.raises(ValueError, match=r"inner\.kp must have 2 joints; got 3"):
        dataclasses.replace(RIG, inner=MitDrive(kp=(1, 2, 3), kd=1))


@pytest.mark.parametrize("end", ["abc", None, np.nan, [1.0, 2.0]])
def test_the_end_of_a_cut_is_a_time(end):
    with pytest.raises(ValueError, match="end must be a finite number; got"):
        some_record().cut(0, end)
    assert len(some_record().cut(0, np.inf)) == 3


def test_columns_of_a_record_are_its_own():
    columns = {"link_position": ["la", "lb"], "torque": "u"}
    record = some_record(columns=columns)
    columns["torque"] = "other"
    columns["link_position"].append("lc")
    assert record.column("link_counts", 1) == "column 'lb' (link_position)"
    assert "'u'" in record.column("torque", 0)
    with pytest.raises(ValueError, match="joint must be one of 0, 1; got 7"):
        record.column("reference", 7)


GOOD = "0,1,2,3,4\n0.1,5,6,7,8\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"must hold samples; got no row of numbers"),
        ("t,a,b,c,d\n", r"must hold samples"),
        (GOOD + "0.2,1,2,3\n", r"line 3 must have 5 cells; got 4"),
        (GOOD + "0.2,1,2,3,4,5\n", r"line 3 must have 5 cells; got 6"),
        ("t,a,b,c,d\n0,1,2,3\n", r"line 2 must have 5 cells; got 4"),
        (
            GOOD + "0.2,1,2,x,4\n",
            (
                r"line 3 must be numbers; got 'x' in column 4\. Correct it; of a log, map .* with"
                r" columns="
            ),
        ),
        (GOOD + "0.2,1,2,,4\n", r"line 3 must be numbers"),
        (
            "t,a,b,c,d\n" + GOOD + "0.2,1,2,RUN,4\n",
            r"line 4 must be numbers; got 'RUN' in column 'c'",
        ),
        (GOOD + "0.2,1,2,nan,4\n", r"line 3 must have finite numbers; got nan in column 4\. Cut"),
        (GOOD + "0.05,1,2,3,4\n", r"t must increase; got 0.05 after 0.1 at index 2"),
        ("0,1,2\n", r"must hold t, 2 reference and 2 error columns; got 3 columns"),
        (
            "0,0.1,0.2\n1,2,3\n1,2,3\n4,5,6\n4,5,6\n",
            r"must hold t, 2 reference and 2 error columns; got 3 columns",
        ),
        (
            "t [s],reference_1 [pulses],speed_1 [rad/s],a [b],c [d]\n" + GOOD,
            r"unknown column 'speed_1 \[rad/s\]'",
        ),
        (
            "t [s],reference_1 [pulses],reference_2 [pulses],error_1 [pulses],error_1 [pulses]\n"
            + GOOD,
            r"error_",
        ),
        (
            "t [ms],error_1 [pulses],error_2 [pulses]\n0,1,2\n1,3,4\n",
            r"must have time as column 1, 't \[s\]'; got 't \[ms\]'",
        ),
        (
            "reference_1 [pulses],error_1 [pulses],error_2 [pulses]\n0,1,2\n1,3,4\n",
            r"must have time as column 1, 't \[s\]'; got 'reference_1 \[pulses\]'",
        ),
        (
            "t,link1_ref,link2_ref,e1,e2\n0,1,2,3,4\n0.1,nan,6,7,8\n",
            r"line 3 must have finite numbers; got nan in column 'link1_ref'",
        ),
        (
            "# by hand\n\n" + GOOD + "0.2,1.5,2,3,4\n",
            r"line 5 must hold whole .* 1\.5 in column 2\.",
        ),
        ("t,a,b,c,d\n" + GOOD + "0.2,1.5,2,3,4\n", r"line 4 must hold whole .* 1\.5 in column 'a'"),
        ('# {"onepulse": 2}\n' + GOOD, r"line 1 must be version 1; got 2\. Use a newer library"),
    ],
)
def test_bad_file_is_refused_in_one_line(file, text, message):
    file.write_text(text)
    with pytest.raises(ValueError, match=message) as error:
        Record.from_csv(file, rig=RIG)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda line: "", "does not name its rig; a plain file needs one"),
        (lambda line: line[: len(line) // 2], "does not name its rig|header"),
        (lambda line: "# " + "[" * 100_000, "does not name its rig|header"),
        (lambda line: '# {"rig": ' + "[" * 900 + "]" * 900 + "}", "rig"),
        (
            lambda line: line.replace("plant.P", "ctc.Magic"),
            r"got 'ctc\.Magic'\. Please import ctc first",
        ),
        (lambda line: line.replace("plant.Rig", "plant.Wig"), r"got 'plant\.Wig'"),
        (
            lambda line: line.replace('"period": 0.0007', '"period": -1'),
            "period must be a positive number",
        ),
        (lambda line: line.replace('"period"', '"perid"'), "Did you mean 'period'"),
        (lambda line: line.replace('"gear": [107.8, -53.7]', '"gear": [107.8]'), "must have shape"),
        (
            lambda line: '# {"rig": {"kind": "plant.P", "gain": [1, 2]}}',
            "rig of a record must be a Rig",
        ),
        (lambda line: '# {"rig": {"kind": {}}}', r"got \{\}\. Please check the file"),
        (lambda line: '# {"rig": 7}', "rig of a record must be a Rig"),
    ],
    ids=[
        "missing",
        "truncated",
        "huge",
        "nested",
        "ctc",
        "kind",
        "period",
        "field",
        "shape",
        "not a rig",
        "no kind",
        "number",
    ],
)
def test_bad_header_is_refused_in_one_line(file, spoil, message):
    some_record().to_csv(file)
    first, rest = file.read_text().split("\n", 1)
    file.write_text(spoil(first) + "\n" + rest)
    with pytest.raises(ValueError, match=message) as error:
        Record.from_csv(file)
    assert "\n" not in str(error.value)


def test_a_comment_above_the_header_does_not_hide_it(file):
    record = some_record(notes={"robot": "cell_7"})
    record.to_csv(file)
    text = file.read_text()
    for comment in ('# {"operator": "me"}\n', '# {"rig": 7}\n', "# {}\n", "# by hand\n"):
        file.write_text(comment + text + comment)
        again = Record.from_csv(file)
        same(again, record)
        assert again.notes == record.notes


def test_a_file_that_was_saved_again_with_the_mark_of_utf8_is_the_library_s_own(file):
    record = some_record()
    record.to_csv(file)
    file.write_text(file.read_text(), encoding="utf-8-sig")
    same(Record.read(file), record)


def test_what_cannot_be_written_leaves_the_old_file(file):
    """`Record` refuses such notes; its dictionary may have changed since."""
    record = some_record(notes={"robot": "cell_7"})
    record.to_csv(file)
    before = file.read_bytes()
    record.notes["operator"] = object()
    with pytest.raises(TypeError):
        record.to_csv(file)
    assert file.read_bytes() == before


def test_a_row_without_a_number_may_be_marked_or_mapped(file):
    """The advice of each refusal leads to a record: weights beside named columns, a mapping of
    others.
    """
    named = "t [s],error_1 [pulses],error_2 [pulses]{}\n0,1,2{}\n0.1,{},2{}\n0.2,1,2{}\n"
    file.write_text(named.format("", "", "nan", "", ""))
    with pytest.raises(ValueError, match=r"line 3 must .*mark the row invalid.*'valid \[1\]'"):
        Record.from_csv(file, rig=RIG)
    file.write_text(named.format(",valid [1]", ",1", "0", ",0", ",1"))
    np.testing.assert_array_equal(Record.from_csv(file, rig=RIG).valid, [1, 0, 1])
    file.write_text("t,r1,r2,e1,e2\n0,1,2,3,4\n0.0007,nan,6,7,8\n0.0014,1,2,3,4\n")
    with pytest.raises(ValueError, match=r"line 3 must .*map them with columns=") as error:
        Record.from_csv(file, rig=RIG)
    assert "valid [1]" not in str(error.value)
    columns = {"t": "t", "error_pulses": ["e1", "e2"], "reference_pulses": ["r1", "r2"]}
    record = Record.from_csv(file, rig=RIG, columns=columns, units={"t": "s"})
    np.testing.assert_array_equal(record.valid, [1, 0, 1])


def test_binary_file_is_a_value_error(file):
    file.write_bytes(b"\xff\xfe\x00\x80" * 20)
    with pytest.raises(ValueError):  # noqa: PT011 - UnicodeDecodeError, Python's own words
        Record.from_csv(file, rig=RIG)
