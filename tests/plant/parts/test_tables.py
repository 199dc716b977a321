"""Tables as text: aligned, no wider than 80 columns, every cell and every label in full."""

from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant.parts import LAYOUT, WIDTH, Table, by_joint, largest, significant, wrapped

NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
LABELS = [f"{name} (q[{i}])" for i, name in enumerate(NAMES)]
QUANTITIES = [
    "encoder error, peak [pulses]",
    "torque, peak [N m]",
    "torque chatter per sample [N m]",
    "at the limit",
]


def test_columns_are_as_wide_as_their_cells():
    table = Table(("", "long title"), [("longer", "1"), ("a", "22")])
    assert table.lines() == ["        long title", "longer           1", "a               22"]
    assert Table((), [("a", "1"), ("b", "22")]).lines() == ["a   1", "b  22"]
    words = Table(("", "why"), [("a", "no"), ("b", "because")], words=(1,))
    assert words.lines() == ["   why", "a  no", "b  because"]


def test_titles_wrap_before_anything_else_does_and_units_stay_whole():
    table = Table(("", *QUANTITIES), [("j" * 30, *"1234")])
    *head, row = table.lines()
    assert max(map(len, head)) <= WIDTH
    assert row.split() == ["j" * 30, *"1234"]
    assert "[N m]" in head[-1]
    assert [
        line.split() for line in Table(("", "chatter per sample [N m]"), [("a", "1")]).lines(18)[:2]
    ] == [
        ["chatter", "per"],
        ["sample", "[N", "m]"],
    ]


def test_what_is_still_too_wide_goes_below_with_its_labels():
    rows = [(label, *(f"{i}.{k}" + "0" * 9 for k in range(6))) for i, label in enumerate(LABELS)]
    lines = Table(("", *"abcdef"), rows).lines()
    blank = lines.index("")
    for half, begin in ((lines[:blank], 0), (lines[blank + 1 :], 3)):
        assert half[0].split() == list("abcdef"[begin : begin + 3])
        assert [line[:26].rstrip() for line in half[1:]] == LABELS
        assert len(set(map(len, half))) == 1
        assert half[2].split()[-3:] == list(rows[1][begin + 1 : begin + 4])


def test_words_wrap_in_their_column_the_last_first():
    table = Table(
        ("check", "joint", "why"),
        [("lag", LABELS[1], "one two three " * 6), ("x", "all", "no")],
        (1, 2),
    )
    lines = table.lines()
    assert max(map(len, lines)) <= WIDTH
    at = lines[0].index("why")
    assert " ".join(line[at:] for line in lines[1:-1]).split() == ("one two three " * 6).split()
    assert lines[1].startswith(f"lag    {LABELS[1]}  one")
    assert lines[-1].split() == ["x", "all", "no"]


def test_joints_are_columns_where_they_fit_and_rows_where_not():
    few = by_joint(["joint 2 (q[0])", "joint 3 (q[1])"], [("torque, peak [N m]", "1", "22")])
    assert few.lines() == [
        "                    joint 2 (q[0])  joint 3 (q[1])",
        "torque, peak [N m]               1              22",
    ]
    many = by_joint(LABELS, [(title, *"123456") for title in QUANTITIES])
    assert list(many.head) == ["", *QUANTITIES]
    assert [row[0] for row in many.rows] == LABELS
    assert max(map(len, many.lines())) <= WIDTH


def test_a_name_of_a_hundred_letters_wraps():
    lines = Table(("", "mass"), [("a" * 100, "1.5")]).lines()
    assert max(map(len, lines)) <= WIDTH
    assert "".join(line.split()[0] for line in lines[1:]) == "a" * 100


def test_what_cannot_be_narrower_stays_whole():
    assert Table((), [("a" * 40, "1" * 60)]).lines() == [f"{'a' * 40}  {'1' * 60}"]
    assert Table(("t" * 90,), [("a",)]).lines() == ["t" * 90, "a"]
    assert Table((), []).lines() == []


def test_words_wrap_though_their_column_and_its_label_do_not_fit():
    lines = Table(("", "note"), [("x" * LAYOUT.label, "word " * 40)], (1,)).lines(55)
    assert 55 < max(map(len, lines)) <= LAYOUT.label + 2 + LAYOUT.words


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (9.94, "9.9"),
        (9.96, "10"),
        (-9.96, "-10"),
        (0.0994, "0.099"),
        (0.0996, "0.10"),
        (99.6, "100"),
        (12345.0, "12345"),
        (0.0, "0"),
        (float("nan"), "nan"),
    ],
)
def test_a_number_that_is_rounded_up_has_no_digit_more(value, text):
    assert significant(value) == text


def test_nan_is_not_the_largest_of_numbers():
    nan = float("nan")
    assert largest([nan, 3.0, 5.0, nan], ["N"] * 4) == [2]
    assert largest([nan, nan, 1.0], ["N m", "N m", "N"]) == [0, 2]


def test_a_unit_stays_whole_and_words_that_look_like_it_do_not():
    assert wrapped("CAN motor", 6) == ["CAN", "motor"]
    assert wrapped("1 kN m, 2 N m/rad", 9) == ["1 kN m, 2", "N m/rad"]


def test_text_wraps_and_is_indented():
    assert wrapped("torque in N m", 11, "  ") == ["torque in", "  N m"]
    assert wrapped("") == [""]


text = st.text("ab c_", max_size=30)


@settings(derandomize=True, max_examples=150, deadline=None)
@given(data=st.data(), rows=st.integers(1, 3), columns=st.integers(2, 8))
def test_no_table_is_wider_than_80_and_none_loses_a_letter(data, rows, columns):
    head = data.draw(st.lists(text, min_size=columns, max_size=columns))
    body = data.draw(
        st.lists(st.lists(text, min_size=columns, max_size=columns), min_size=rows, max_size=rows)
    )
    words = tuple(data.draw(st.sets(st.integers(1, columns - 1))))
    lines = Table(head, body, words).lines()
    assert max(map(len, lines)) <= WIDTH
    letters = Counter("".join(cell for row in [head, *body] for cell in row))
    # names of rows more than once, where columns go below each other
    shown = Counter("".join(lines))
    assert all(shown[letter] >= letters[letter] for letter in "abc_")


@pytest.mark.parametrize("row", [("a",), ("a", "1", "2")])
def test_rows_of_another_length_are_refused(row):
    with pytest.raises(ValueError, match="argument"):
        Table(("", "x"), [row]).lines()
