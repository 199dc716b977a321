"""Logs in every format: what was written is what is read, and a file that is not one is refused
in one line.
"""

import importlib.util
import json
import re
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from spoilt_files import (
    COLUMNS,
    FORMATS,
    RIG,
    UNITS,
    WarmChildren,
    log,
    opaque,
    read,
    refused,
    write,
)

from plant import LoadError, Record, puma560, read_table
from plant.logs import isolation, logfile

SUFFIX = {"csv": "csv", "npz": "npz", "mat": "mat", "hdf5": "h5", "parquet": "parquet"}


@pytest.mark.parametrize("compress", [True, False])
@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_gives_back_what_was_written(tmp_path, kind, compress):
    """Counts, torques and times to the last bit: text is written with repr, the others are
    binary.
    """
    columns, path = log(), tmp_path / f"log.{SUFFIX[kind]}"
    columns["ok"][7] = False
    write(kind, path, columns, compress)
    record = read(kind, path)
    np.testing.assert_array_equal(record.t, columns["time"])
    np.testing.assert_array_equal(record.counts, np.column_stack([columns["c1"], columns["c2"]]))
    np.testing.assert_array_equal(record.torque, np.column_stack([columns["u1"], columns["u2"]]))
    np.testing.assert_array_equal(record.valid, columns["ok"])
    np.testing.assert_array_equal(record.reference_pulses, 0)
    table = read_table(path)
    assert set(table) == set(columns)
    for name, column in columns.items():
        np.testing.assert_array_equal(table[name], column)


def test_groups_structures_and_archives_are_one_prefix_away(tmp_path):
    columns = log()
    np.savez(
        tmp_path / "a.npz",
        **{f"run_07/{name}": column for name, column in columns.items()},
        note="by hand",
    )
    scipy.io.savemat(tmp_path / "a.mat", {"run": {"number": 7, "deep": columns}, "note": "by hand"})
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["note"] = "by hand"
        for name, column in columns.items():
            file[f"run/07/{name}"] = column
    for name, prefix in (("a.npz", "run_07/"), ("a.mat", "run.deep."), ("a.h5", "run/07/")):
        record = Record.read(tmp_path / name, rig=RIG, columns=COLUMNS, units=UNITS, prefix=prefix)
        np.testing.assert_array_equal(
            record.counts, np.column_stack([columns["c1"], columns["c2"]])
        )
        assert set(read_table(tmp_path / name, prefix=prefix)) == set(columns)


@pytest.mark.parametrize("objects", [False, True])
def test_structures_of_matlab_with_all_that_is_no_column(tmp_path, objects):
    """Text, cells, structures without fields or elements beside the columns; and an object,
    which scipy cannot list.
    """
    columns, path = log(20), tmp_path / "a.mat"
    runs = np.zeros((1, 2), dtype=[("c1", object), ("note", object)])
    runs[0, 0], runs[0, 1] = (columns["c1"], "first"), (columns["c2"], {})
    empty = np.zeros((0, 0), dtype=[("c1", object)])
    inside = columns | {
        "note": "by hand",
        "none": {},
        "empty": empty,
        "cells": np.array([[1, "a"]], object),
        "runs": runs,
    }
    scipy.io.savemat(path, {"run": inside})
    if objects:
        path.write_bytes(path.read_bytes() + opaque("made"))
        with pytest.raises(TypeError):
            scipy.io.whosmat(path)
        assert "run" in scipy.io.loadmat(path)
    with WarmChildren():
        record = Record.read(path, rig=RIG, columns=COLUMNS, units=UNITS, prefix="run.")
        np.testing.assert_array_equal(
            record.counts, np.column_stack([columns["c1"], columns["c2"]])
        )
        second = read_table(path, names=["run.runs[1].c1"])["run.runs[1].c1"]
        np.testing.assert_array_equal(second, columns["c2"])
        refused(
            lambda: read_table(path, names=["run.c3"]),
            r"column 'run\.c3' must be there; got .* Did you mean 'run\.c",
        )


def test_a_csv_may_have_semicolons_tabs_quotes_and_empty_cells(tmp_path):
    path = tmp_path / "log.csv"
    for separator in ",;\t":
        rows = ['"time [s]"#"c1"#"c2"', "0#1#2", "0.1##-4", "0.2#3#nan"]
        path.write_text("# by hand\n" + "\n".join(rows).replace("#", separator) + "\n")
        np.testing.assert_array_equal(read_table(path)["c1"], [1, np.nan, 3])
        np.testing.assert_array_equal(read_table(path)["c2"], [2, -4, np.nan])
        assert list(read_table(path, names=["time [s]"])) == ["time [s]"]


def test_blocks_of_columns_and_other_byte_orders(tmp_path):
    q = np.arange(12).reshape(6, 2).astype(">i2")
    np.savez(tmp_path / "a.npz", q=np.asfortranarray(q))
    scipy.io.savemat(tmp_path / "a.mat", {"q": q})
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["q"] = q
    for name in ("a.npz", "a.mat", "a.h5"):
        table = read_table(tmp_path / name)
        assert table["q"].dtype == np.int64
        np.testing.assert_array_equal(table["q"], q)


def test_arrays_that_matlab_wrote_as_hdf5_have_their_axes_in_order(tmp_path):
    """As -v7.3 does it: (N, n) is stored as (n, N), with an attribute that names the class."""
    q = np.arange(12.0).reshape(6, 2)
    with h5py.File(tmp_path / "a.h5", "w", userblock_size=512) as file:
        file["q"] = q.T
        file["t"] = np.arange(6.0)[None, :]
        for name in "qt":
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    table = read_table(tmp_path / "a.h5")
    np.testing.assert_array_equal(table["q"], q)
    np.testing.assert_array_equal(table["t"], np.arange(6.0)[:, None])


def test_missing_cells_of_parquet_are_nan(tmp_path):
    pq.write_table(pa.table({"c": pa.array([1, None, 3], pa.int32())}), tmp_path / "a.parquet")
    np.testing.assert_array_equal(read_table(tmp_path / "a.parquet")["c"], [1, np.nan, 3])


def test_weights_and_every_column_survive_the_library_s_own_file(tmp_path):
    columns = log(20)
    columns["ok"] = np.linspace(0, 1, 20)
    record = Record.from_table(columns, rig=RIG, columns=COLUMNS, units=UNITS, law=puma560.p_law())
    record.to_csv(tmp_path / "own.csv")
    again = Record.from_csv(tmp_path / "own.csv")
    for name in ("t", "error_pulses", "torque", "valid"):
        assert getattr(again, name).tobytes() == getattr(record, name).tobytes()
    assert (again.rig, again.law) == (record.rig, record.law)


# -- refusals ------------------------------------------------------------------------------------
def test_what_is_no_file_is_a_load_error(tmp_path):
    for kind in FORMATS:
        refused(
            lambda kind=kind: read(kind, tmp_path / "none"),
            "none must be a file; there is none. Check the path",
        )
        refused(
            lambda kind=kind: read(kind, tmp_path),
            "must be a file; got a folder, a pipe or a device",
        )
    refused(lambda: Record.from_csv(tmp_path / "none"), "must be a file; there is none")
    refused(lambda: read_table(tmp_path / "log.docx"), r"must end in one of \.csv, .*got '\.docx'")
    refused(lambda: read_table("a\0.npz"), "null")


def test_what_is_no_text_is_refused_with_its_path(tmp_path):
    path = tmp_path / "wide.csv"
    path.write_bytes("time,c1,c2\n0,1,2\n".encode("utf-16")[2:] + b"\xff")
    refused(lambda: read("csv", path), r"wide\.csv must ")
    path.write_bytes(b"time,c1,c2\n0,1,2\n" + bytes(9) + b"\xff\xfe\n")
    expected = r"wide\.csv must be text in UTF-8; got byte 0xff\. Save it as CSV in UTF-8"
    refused(lambda: Record.from_csv(path, rig=RIG), expected)
    refused(lambda: read("csv", path), expected)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must hold samples; got no row"),
        ("0,1,2\n", "must name its columns in a line above the numbers"),
        ("time,c1,c1\n0,1,2\n", "has column 'c1' twice"),
        ("time,c1,c2\n0,1\n", "line 2 must have 3 cells; got 2"),
        (
            "time,c1,c2\n0,1,1;5\n",
            "line 2 must be numbers; got '1;5' in column 'c2'. Correct it, leave the cell empty",
        ),
        (
            "time,c1,c2\n0,1,2,3,4\n",
            "line 2 must have 3 cells; got 5. Name each column in line 1. If decimals have a comma, sep",
        ),
        (
            "time;c1;c2\n0.25;1;1\n0.5;2;2\n0,75;2;2\n",
            "line 4 must be numbers; got '0,75' in column 'time'. Write decimals with a point in all",
        ),
        (
            "time,c1,c2\nwide,tall,\n0,1,1\n0,1,1\n",
            "column 'time' must be there; got 3 others: 'wide'",
        ),
        (
            "time,c1,c2\n0,1,1\nx,y,z\n",
            "line 3 must be numbers; got 'x' in column 'time'. Correct it",
        ),
        (
            "time,c1,c2\n0,1,2.50\n0.1,1,-0.28\n0.2,1,-0",
            "line 4 must be complete; got '-0' without a line end",
        ),
        (
            "time,c1,C2\n0,1,1\n",
            r"column 'c2' must be there; got 3 others: 'time', 'c1', 'C2'\. Did you mean 'c1'\?",
        ),
        ("time,c1,c2\n" + "1" * (1 << 20), "line 2 must be shorter than 1048576 characters"),
    ],
)
def test_bad_csv_is_refused_with_its_line(tmp_path, text, message):
    path = tmp_path / "log.csv"
    path.write_text(text)
    columns = {"t": "time", "counts": ["c1", "c2"]}
    refused(
        lambda: Record.from_csv(path, rig=RIG, columns=columns, units={"t": "s"}),
        r"log\.csv ",
        message,
    )


MODES = (
    'stamp;mode;time;c1;note;c2\n2026-01-01T00:00:00Z;RUN;0;1;;2\n2026-01-01T00:00:01Z;0,5;0.1;3;"a;'
    ' b";4\n'
)


def test_text_in_a_csv_matters_only_in_a_column_that_is_read(tmp_path):
    """Stamps, modes, decimal commas and quoted separators elsewhere; so does a name that comes
    twice.
    """
    path = tmp_path / "log.csv"
    for text in (MODES, MODES.replace("mode", "stamp"), MODES.replace("note", "stamp")):
        path.write_text(text)
        table = read_table(path, names=["c2", "time"])
        assert set(table) == {"c2", "time"}
        np.testing.assert_array_equal(table["time"], [0, 0.1])
        np.testing.assert_array_equal(table["c2"], [2, 4])
        record = Record.from_csv(path, rig=RIG, columns={"counts": ["c1", "c2"]})
        np.testing.assert_array_equal(record.counts, [[1, 2], [3, 4]])
    path.write_text(MODES)
    assert set(read_table(path, prefix="c")) == {"1", "2"}
    np.testing.assert_array_equal(read_table(path, names=["stamp"])["stamp"], [0, 1])
    refused(
        lambda: read_table(path),
        "line 2 must be numbers; got 'RUN' in column 'mode'",
    )
    refused(
        lambda: read_table(path, names=["mode"]),
        "line 2 must be numbers; got 'RUN' in column 'mode'",
    )
    refused(lambda: read_table(path, names=["d"]), "column 'd' must be there; got 6 others")


@pytest.mark.parametrize("end", ["2.5", "3", "3\n", "-12.25\n", "7"])
def test_a_whole_last_line_without_an_end_is_read(tmp_path, end):
    """Only fewer decimals than in all lines before tell that it was cut."""
    (tmp_path / "log.csv").write_text("t,c\n0,2.5\n1,0.75\n2," + end)
    (tmp_path / "whole.csv").write_text("t,c\n0,200\n1,75\n2," + end)
    assert read_table(tmp_path / "whole.csv")["c"][-1] == float(end)
    if end in ("3", "7"):
        refused(lambda: read_table(tmp_path / "log.csv"), "line 4 must be complete")
    else:
        assert read_table(tmp_path / "log.csv")["c"][-1] == float(end)


def test_a_cut_cell_that_nobody_reads_does_not_matter(tmp_path):
    (tmp_path / "log.csv").write_text("t,c,x\n0,2,1.25\n1,0,1.50\n2,5,1")
    np.testing.assert_array_equal(read_table(tmp_path / "log.csv", names=["c"])["c"], [2, 0, 5])
    refused(lambda: read_table(tmp_path / "log.csv"), "line 4 must be complete; got '1'")


def test_only_real_numbers_are_read(tmp_path):
    """Text and complex numbers in a column that is read; elsewhere they do not matter."""
    c, s = np.array([1, 2j]), np.array(["a", "b"])
    np.savez(tmp_path / "a.npz", t=np.arange(2), c=c, s=s)
    scipy.io.savemat(tmp_path / "a.mat", {"t": np.arange(2), "c": c, "s": s})
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"], file["c"], file["s"] = np.arange(2), c, ["a", "b"]
    pq.write_table(pa.table({"t": np.arange(2), "s": s}), tmp_path / "a.parquet")
    with WarmChildren():
        for name, columns in (("a.npz", "cs"), ("a.mat", "cs"), ("a.h5", "cs"), ("a.parquet", "s")):
            for column in columns:
                refused(
                    lambda name=name, column=column: read_table(tmp_path / name, names=[column]),
                    f"must hold real numbers; got .* in column '{column}'",
                )
            np.testing.assert_array_equal(read_table(tmp_path / name, names=["t"])["t"], [0, 1])


def test_a_missing_extra_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(isolation, "find_spec", lambda name: None)
    for kind, library in (("hdf5", "h5py"), ("parquet", "pyarrow")):
        write(kind, tmp_path / "log", log())
        refused(
            lambda kind=kind: read(kind, tmp_path / "log"),
            rf"needs {library}.*pip install 'onepulse\[{kind}\]'",
        )
    assert importlib.util.find_spec("h5py")


def test_hdf5_that_points_into_another_file_is_refused(tmp_path):
    (tmp_path / "secret").write_bytes(np.arange(8.0).tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("t", (8,), float, external=[(str(tmp_path / "secret"), 0, 64)])
    refused(
        lambda: read_table(tmp_path / "a.h5"),
        "must hold its own data; column 't' points into another file",
    )


def test_links_to_another_file_are_refused_and_never_followed(tmp_path):
    """Of a column and of a group that holds one; a link that is not wanted does not matter."""
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["run/t"] = np.arange(8.0)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = h5py.ExternalLink("other.h5", "run/t")
        file["deep/run"] = h5py.ExternalLink("other.h5", "run")
        file["c"] = np.arange(3)
    with WarmChildren():
        for names, link in ((["t"], "t"), (["deep/run/t"], "deep/run"), (None, "t")):
            refused(
                lambda names=names: read_table(tmp_path / "a.h5", names=names),
                f"'{link}' is a link to another",
            )
        np.testing.assert_array_equal(read_table(tmp_path / "a.h5", names=["c"])["c"], [0, 1, 2])


def test_a_column_that_is_not_there_is_answered_by_those_that_are(tmp_path):
    """Fields of a structure by their whole names; and an empty file has none."""
    scipy.io.savemat(
        tmp_path / "a.mat", {"run": {"time": [0, 1], "deep": {"c": [1, 2]}}, "x": [1, 2]}
    )
    h5py.File(tmp_path / "a.h5", "w").close()
    with WarmChildren():
        expected = (
            r"column 'time' must be there; got 3 others: 'x', 'run\.time', 'run\.deep\.c'\. Did you"
            r" mean 'run"
        )
        refused(lambda: read_table(tmp_path / "a.mat", names=["time"]), expected)
        refused(
            lambda: read_table(tmp_path / "a.h5", names=["t"]),
            r"column 't' must be there; got none\. Correct",
        )


def test_checksums_of_parquet_pages_are_compared(tmp_path):
    """One bit of plain data, which without a checksum would read as another number."""
    path = tmp_path / "a.parquet"
    options = {"use_dictionary": False, "compression": "none", "write_page_checksum": True}
    pq.write_table(pa.table({"c": np.arange(100.0)}), path, **options)
    sound = path.read_bytes()
    at = sound.index(np.arange(40.0, 60.0).tobytes())
    path.write_bytes(sound[:at] + b"\x01" + sound[at + 1 :])
    refused(
        lambda: read_table(path),
        "must be a sound file; reading it gave .*could not verify page integrity",
    )


def test_wrong_calls_are_refused_before_the_file_is_opened():
    for call, message in (
        (lambda: Record.read("log.npz", columns=COLUMNS), "rig must be of type Rig"),
        (
            lambda: Record.read("log.npz", rig=RIG, columns=COLUMNS, unit=UNITS),
            "Did you mean 'units'",
        ),
        (lambda: Record.read("log.mat", rig=RIG, columns=["t"]), "columns must be of type dict"),
        (
            lambda: Record.read("log.mat", rig=RIG.drive, columns=COLUMNS, units=UNITS),
            "rig must be of type Rig",
        ),
        (lambda: Record.from_csv("log.csv", rig=RIG, units=UNITS), "Pass columns= as well"),
        (lambda: read_table("log.csv", names="ab"), "names must be a list .* got 'ab'"),
        (lambda: read_table("log.csv", names=[]), r"names must be a list .* got \[\]"),
        (lambda: read_table("log.csv", names=["a", 1]), "names must be a list"),
        (lambda: read_table("log.csv", names=3), "names must be a list"),
        (lambda: read_table(None), "path must be a path; got None"),
        (lambda: read_table("log.csv", prefix=None), "prefix must be of type str"),
    ):
        with pytest.raises(ValueError, match=message) as refusal:
            call()
        assert not isinstance(refusal.value, LoadError)


def test_a_refusal_has_the_path_as_it_is_and_one_line(tmp_path):
    path = tmp_path / "two  blanks.npz"
    path.write_bytes(b"no archive")
    with pytest.raises(LoadError, match=re.escape(str(path))) as refusal:
        read_table(path)
    assert "\n" not in str(refusal.value)


def test_an_empty_column_is_refused_for_its_samples(tmp_path):
    np.savez(tmp_path / "a.npz", t=[])
    refused(lambda: read_table(tmp_path / "a.npz"), "'t' has no samples")


def test_a_clock_has_its_prefix_once(tmp_path, monkeypatch):
    """Also where the file is read once more, to refuse what there is in place of numbers."""
    (tmp_path / "a.mcap").write_bytes(b"0")
    clocks = []

    def reader(*_, clock, **__):
        clocks.append(clock)
        return ["/run/t"], {}

    monkeypatch.setattr(logfile, "read_isolated", reader)
    with pytest.raises(LoadError):
        logfile.read_file("mcap", tmp_path / "a.mcap", None, "/run", numbers_only=True, clock="/t")
    assert clocks == ["/run/t", "/run/t"]


@pytest.mark.parametrize(
    "given", [{"units": UNITS}, {"prefix": "run."}, {"torque_delay": 1}, {"episode": 3}]
)
def test_what_serves_a_mapping_alone_is_refused_of_an_own_file(tmp_path, given):
    path = tmp_path / "own.csv"
    Record.from_table(log(20), rig=RIG, columns=COLUMNS, units=UNITS, law=puma560.p_law()).to_csv(
        path
    )
    assert len(Record.read(path)) == 20
    (name,) = given
    with pytest.raises(ValueError, match=name):
        Record.read(path, **given)


@pytest.mark.parametrize(
    "given", [{"units": UNITS}, {"wrap": (1.0, 1.0)}, {"held": True}, {"torque_delay": 1}]
)
def test_what_serves_a_mapping_alone_is_refused_where_contents_are_shown(tmp_path, given):
    path = tmp_path / "log.npz"
    np.savez(path, **log(20))
    (name,) = given
    with pytest.raises(ValueError, match=name):
        Record.read(path, **given)


def test_limits_reach_the_child(tmp_path, monkeypatch):
    """What the child is told: its own time, memory and the size of the columns."""
    seen = {}
    run = isolation.run
    monkeypatch.setattr(
        isolation,
        "run",
        lambda command, **options: (
            seen.update(order=json.loads(command[-1]), timeout=options["timeout"])
            or run(command, **options)
        ),
    )
    write("hdf5", tmp_path / "log.h5", log())
    read_table(tmp_path / "log.h5")
    assert seen["timeout"] < 5
    assert seen["order"]["seconds"] <= 5
    assert seen["order"]["memory"] == 2 << 30
    assert seen["order"]["bytes"] == 256 << 20


# -- the page ------------------------------------------------------------------------------------
def test_the_page_on_your_own_log_is_true(tmp_path, monkeypatch, capsys):
    """Its code runs as it stands, in an empty folder, and prints what it says it prints."""
    page = (Path(__file__).parents[3] / "docs" / "guides" / "logs.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    code = "\n".join(re.findall(r"```{code-cell}\n(?::tags.*?\n)?(.*?)```", page, re.DOTALL))
    exec(code, {})  # noqa: S102 - our own page
    printed = capsys.readouterr().out.splitlines()
    said = re.findall(r"^# (.*)$", code, re.MULTILINE)
    assert printed[: len(said)] == said
    assert len(printed) == len(said) + 1
    assert printed[-1].startswith("log.mat must be ")
