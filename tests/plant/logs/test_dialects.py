"""Text tables as loggers, drives, oscilloscopes and spreadsheets export them: the numbers that were
written come back, whatever separates them and stands above them.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant import Drive, Encoder, LoadError, Record, Rig, read_table
from plant.logs import dialect

NUMBERS = np.array([[0.0, 12.5, -3.25], [0.25, 13.0, 4.5], [0.5, -0.125, 6.0], [0.75, 2.0, -8.75]])


def rows(separator="\t", mark=".", end="", numbers=NUMBERS):
    lines = (separator.join(f"{x:.4f}".replace(".", mark) for x in row) for row in numbers)
    return "".join(f"{line}{end}\n" for line in lines)


def columns(tmp_path, text, encoding="utf-8", **options):
    path = tmp_path / "export.csv"
    path.write_bytes(text.encode(encoding))
    return read_table(path, **options)


def refusal(tmp_path, text, **options):
    with pytest.raises(LoadError) as caught:
        columns(tmp_path, text, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value).partition(" ")[2]


PREAMBLE = (
    "Name\tscope_4\nFile\tD:\\run.csv\nStart\t132959733843760000\tMonday\t15:56\nRate\t250\n\n"
)
HEADINGS = {
    "a preamble of cells": (PREAMBLE + "t\tq1\tq2\n", "\t", ["t", "q1", "q2"]),
    "a preamble as wide as the rows": ("a;b;c\nd;5;6\n\nt;q1;q2\n", ";", ["t", "q1", "q2"]),
    "a row of units": ("t,q1,q2\ns,deg,\n", ",", ["t", "q1", "q2"]),
    "units of an oscilloscope": ("x-axis,1,2\nsecond,Volt,Volt\n", ",", ["x-axis", "1", "2"]),
    "groups": (";left;\nt;q;q\n", ";", ["t", "left.q", "left.q"]),
    "brackets behind blanks": ("time [s]  q1 [rad]   q2 (°)\n", " ", None),
    "a mark of numpy": ("# t q1 q2\n", " ", ["t", "q1", "q2"]),
    "a mark of MATLAB": ("% t\tq1\tq2\n", "\t", ["t", "q1", "q2"]),
    "an index without a name": (",q1,q2\n", ",", ["column 1", "q1", "q2"]),
    "numbers as names": ("time|1|2\n", "|", ["time", "1", "2"]),
    "a ruler below the names": ("t;q1;q2\n---;---;---\n", ";", ["t", "q1", "q2"]),
}


@pytest.mark.parametrize("case", HEADINGS)
def test_the_names_are_found_above_the_first_row(tmp_path, case):
    heading, separator, names = HEADINGS[case]
    if case == "groups":  # the group is filled to its right
        heading, names = ";left;right\nt;q;q\n", ["t", "left.q", "right.q"]
    table = columns(tmp_path, heading + rows(separator))
    assert list(table) == (names or ["time [s]", "q1 [rad]", "q2 (°)"])
    np.testing.assert_array_equal(np.column_stack(list(table.values())), NUMBERS)


@settings(derandomize=True, max_examples=80, deadline=None)
@given(
    data=st.data(),
    separator=st.sampled_from(["\t", ";", ",", "|", " ", "   "]),
    mark=st.sampled_from(".,"),
    ends=st.tuples(st.booleans(), st.booleans()),
    preamble=st.lists(st.text("abcXYZ 0123:\\", max_size=30), max_size=40),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
)
def test_every_combination_gives_the_numbers_back(
    tmp_path_factory, data, separator, mark, ends, preamble, encoding
):
    """Separator, decimal mark, separators at the ends, a preamble of any length, and encodings."""
    if mark == separator:
        mark = "."
    end = separator if separator.strip() else ""
    width = data.draw(st.integers(2, 7))
    numbers = np.round(
        np.array(
            data.draw(
                st.lists(
                    st.lists(st.floats(-1e3, 1e3), min_size=width, max_size=width),
                    min_size=3,
                    max_size=9,
                )
            )
        ),
        4,
    )
    names = [f"größe_{i}" for i in range(width)]
    # An empty line ends a preamble, whose own lines may look like names.
    text = "".join(f"{line}\n" for line in preamble) + "\n"
    text += (
        separator.join(names) + end * ends[0] + "\n" + rows(separator, mark, end * ends[1], numbers)
    )
    table = columns(tmp_path_factory.mktemp("text"), text, encoding)
    assert list(table) == names
    np.testing.assert_array_equal(np.column_stack(list(table.values())), numbers)


def test_a_column_is_known_without_its_unit_and_by_either_spelling_of_its_index(tmp_path):
    text = "time [ms],q[0] (deg),q[1] (deg),torque\n0,1,2,3\n5,4,5,6\n"
    table = columns(tmp_path, text, names=["time", "q.1", "torque"])
    assert {name: column.tolist() for name, column in table.items()} == {
        "time": [0, 5],
        "q.1": [2, 5],
        "torque": [3, 6],
    }


def test_cells_without_a_value_are_nan(tmp_path):
    table = columns(tmp_path, "t,q\n0,NA\n1,null\n2,-\n3,\n4,7\n5,8\n6,9\n7,10\n8,11\n")
    np.testing.assert_array_equal(table["q"], [np.nan] * 4 + [7, 8, 9, 10, 11])


@pytest.mark.parametrize("shift", ["", "a"])
def test_a_long_file_may_be_cut_inside_a_character(tmp_path, shift):
    """Of the two, one has a character across the end of what shows the encoding."""
    comment = f"# {shift}{'é' * 40_000}\n"
    assert list(columns(tmp_path, f"{comment}t,größe\n0,1\n1,2\n")) == ["t", "größe"]


@pytest.mark.parametrize("above", ["t,q\n", "t,q\n-,-\n", "t,q\ns,rad\n"])
@pytest.mark.parametrize("count", [1, 9])
def test_first_rows_without_values_are_no_heading(tmp_path, above, count):
    table = columns(tmp_path, above + "n/a,n/a\n" * count + "0,1\n1,2\n")
    assert list(table) == ["t", "q"]
    np.testing.assert_array_equal(table["q"], [np.nan] * count + [1, 2])


def test_a_name_that_also_means_no_value_stays_a_name(tmp_path):
    assert list(columns(tmp_path, "Na\n1\n2\n")) == ["Na"]


@pytest.mark.parametrize("heading", ["# 100, 200\nt,q\n", "t,q\n" + "# 100, 200\n" * 9])
def test_a_comment_of_numbers_is_no_first_row(tmp_path, heading):
    table = columns(tmp_path, heading + "0,1\n1,2\n")
    assert {name: column.tolist() for name, column in table.items()} == {"t": [0, 1], "q": [1, 2]}


def test_a_text_column_that_is_mostly_empty_is_no_column_of_numbers(tmp_path):
    (tmp_path / "a.csv").write_text("t,q,note,z\n0,,,1\n1,,,2\n2,3,start,3\n")
    assert dialect.dialect_of(tmp_path / "a.csv").numeric == ("t", "q", "z")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Out.Data[0]:=0.25F16#B3\nOut.Data[1]:=0.31F16#B4\n", "lines of name and value are not"),
        ("a = 1.5\nb = 2.5\n", "line 1 is 'a = 1.5', and lines of name and value are not read"),
        ('{"t": 0, "q": [1, 2]}\n{"t": 1, "q": [1, 2]}\n', "lines of JSON are not read"),
        ("0 1 2\n3 4 5\n", "must name its columns in a line above the numbers; got none"),
        ("t q\n1 0.5 0.25\n2 0.5 0.75\n", "line 2 must have 2 cells; got 3. Name each column in"),
        (
            "t,q\n0,002,1,5\n0,004,1,6\n",
            "got 4. .*decimals have a comma, separate the cells by semi",
        ),
        ("t;q\n0,5;1,25\n0,6;1.5\n", "line 3 must be numbers; got '1.5' .* with a comma in all"),
        ("t,c\nx,1\n0.1,2\n0.2,3\n", "line 2 must be numbers; got 'x' in column 't'"),
    ],
)
def test_what_is_no_table_is_called_by_its_name(tmp_path, text, message):
    import re

    assert re.search(message, refusal(tmp_path, text))


def test_a_broken_row_below_a_heading_is_never_taken_for_a_preamble(tmp_path):
    """One cell too few or too many in any row is refused with the number of its line."""
    lines = ("t;q1;q2\n" + rows(";")).splitlines()
    for at in range(1, len(lines)):
        for spoilt in (lines[at] + ";7", lines[at].rpartition(";")[0]):
            text = "\n".join([*lines[:at], spoilt, *lines[at + 1 :]]) + "\n"
            assert refusal(tmp_path, text).startswith(f"line {at + 1} must have 3 cells")


def test_a_file_that_ends_in_its_first_row_is_no_column_of_one_name(tmp_path):
    assert refusal(tmp_path, "t;q1;q2\n-0,25").startswith("line 2 must have 3 cells; got 1")


def test_a_comment_between_heading_and_rows_hides_neither(tmp_path):
    table = columns(tmp_path, "t;q1;q2\n# begun by hand\n" + rows(";"))
    np.testing.assert_array_equal(np.column_stack(list(table.values())), NUMBERS)


def test_a_table_without_an_end_to_its_preamble_is_refused_soon(tmp_path, monkeypatch):
    """Neither empty lines nor a preamble may make the search for a heading long."""
    monkeypatch.setattr(dialect, "SETTINGS", dialect.DialectSettings(preamble=50))
    text = "Device;X\n" * 60 + "\nt;q1;q2\n" + rows(";")
    assert refusal(tmp_path, text).startswith("must have its heading in the first 50 lines")
    assert refusal(tmp_path, "\n" * 99).startswith("must hold samples; got no row")


@settings(derandomize=True, max_examples=150, deadline=None)
@given(
    lines=st.lists(
        st.tuples(
            st.sampled_from(",;\t |"),
            st.lists(
                st.one_of(
                    st.floats().map(str),
                    st.sampled_from(
                        ["t", "q [deg]", "[rad]", "s", "", "-", "#", "%", "1,5", "a=1"]
                    ),
                    st.text(max_size=4),
                ),
                max_size=5,
            ),
        ).map(lambda line: line[0].join(line[1])),
        max_size=8,
    ),
    encoding=st.sampled_from(["utf-8", "utf-16", "cp1252"]),
)
def test_any_text_is_a_table_or_one_line_that_says_why_not(tmp_path_factory, lines, encoding):
    path = tmp_path_factory.mktemp("text") / "any.csv"
    path.write_bytes("\n".join(lines).encode(encoding, "replace"))
    message = ""
    lengths = {0}
    try:
        lengths = {len(column) for column in read_table(path).values()}
    except LoadError as error:
        message = str(error)
    # A reader that failed by itself would call the file unsound.
    assert "\n" not in message
    assert "sound file" not in message
    assert len(lengths) == 1


# -- units that a table states -------------------------------------------------------------------
RIG = Rig(
    drive=Drive(
        gear=(80.0, -120.0),
        motor_inertia=(1e-4,) * 2,
        viscous=(0,) * 2,
        coulomb=(0,) * 2,
        motor_gain=(0.2, 0.3),
        current_limit=(10, 8),
    ),
    encoder=Encoder(resolution=(2048, 4096)),
    period=4e-3,
)
COUNTS = np.round(5000 * np.sin(np.arange(60)[:, None] / [11, 17]))
FIELDS = {"t": "time", "position": ["q1", "q2"]}


@pytest.mark.parametrize(
    ("heading", "per"),
    [
        ("time [ms];q1 [°];q2 [deg]\n", 180 / np.pi),
        ("time;q1;q2\nms;rad;rad\n", 1.0),
        ("time (ms);q1 [rev];q2 [rev]\n", 0.5 / np.pi),
        ("time;q1;q2\n[ms];[gon];[gon]\n", 200 / np.pi),
    ],
)
def test_units_of_the_heading_need_not_be_stated(tmp_path, heading, per):
    angle = RIG.to_angle(COUNTS) * per
    numbers = np.column_stack([4.0 * np.arange(len(COUNTS)), angle])
    text = heading + "".join(
        ";".join(f"{x:.12g}".replace(".", ",") for x in r) + "\n" for r in numbers
    )
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    record = Record.read(tmp_path / "a.csv", rig=RIG, columns=FIELDS)
    np.testing.assert_array_equal(record.counts, COUNTS)
    np.testing.assert_allclose(record.t, 4e-3 * np.arange(len(COUNTS)))


def test_a_unit_that_contradicts_the_heading_is_used_with_a_warning():
    table = {"q [deg]": RIG.to_angle(COUNTS)}
    with pytest.warns(
        UserWarning, match=r"units state 'rad' of 'position', its heading says 'deg'"
    ):
        record = Record.from_table(
            table, rig=RIG, columns={"position": "q [deg]"}, units={"position": "rad"}
        )
    np.testing.assert_array_equal(record.counts, COUNTS)
