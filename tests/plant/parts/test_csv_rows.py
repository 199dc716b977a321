"""Rows of numbers in a text file."""

import numpy as np
import pytest

from plant.parts import read_rows


def test_rows_of_one_width_are_read_with_their_heading(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,a\n0.0,1\n0.1,2\n")
    names, rows = read_rows(path)
    assert names == ["t", "a"]
    np.testing.assert_array_equal(rows, [[0.0, 1.0], [0.1, 2.0]])


@pytest.mark.parametrize("row", ["0.1", "0.1,2,3"])
def test_a_row_of_another_width_is_refused_with_its_line(tmp_path, row):
    path = tmp_path / "log.csv"
    path.write_text(f"t,a\n0.0,1\n{row}\n")
    with pytest.raises(ValueError, match="line 3"):
        read_rows(path)
