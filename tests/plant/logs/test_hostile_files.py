"""What readers refuse before they read: pipes, devices, what is too large, what expands; and
what is no number.
"""

import bz2
import os
import resource
import struct
import time
import zipfile
from functools import partial

import numpy as np
import pytest

from plant import Chain, LoadError, Record, Table, puma560, read_table
from plant.parts import csv_rows

RIG = puma560.rig()


def mapped(kind, path):
    """As `Record.read` does of a file of this ending."""
    return Record._read(
        kind, path, None, prefix="", rig=RIG, columns={"counts": ["a", "b"]}, units=None
    )


READERS = {
    "own CSV": lambda path: Record.from_csv(path, rig=RIG),
    "mapped CSV": lambda path: Record.from_csv(path, rig=RIG, columns={"counts": ["a", "b"]}),
    "NPZ": partial(mapped, "npz"),
    "MAT": partial(mapped, "mat"),
    "HDF5": partial(mapped, "hdf5"),
    "MCAP": partial(mapped, "mcap"),
    "URDF": Chain.from_urdf,
    "path": Table.from_csv,
}
EVERY = pytest.mark.parametrize("read", READERS.values(), ids=READERS)


@EVERY
def test_pipes_devices_and_folders_are_refused_at_once(read, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, "/dev/zero"):
        began = time.monotonic()
        with pytest.raises(ValueError, match=r"must be a file; got a folder.* device") as error:
            read(path)
        assert str(path) in str(error.value)
        assert time.monotonic() - began < 1


@EVERY
def test_what_is_too_large_is_refused_before_it_is_read(read, tmp_path):
    path = tmp_path / "large"
    with open(path, "wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(ValueError, match=r"must have at most \d+ MiB; got 1048576"):
        read(path)


def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_member_that_expands_two_million_times_is_refused_before_it_is_expanded(tmp_path, method):
    """bzip2 makes 45 bytes of 45 MB of zeros, and zipfile expands them at once, whatever size is
    declared.
    """
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("time.npy", b"\x93NUMPY\x01\x00" + bytes(1000))
    if method == zipfile.ZIP_BZIP2:
        old, bomb = bz2.compress(b"\x93NUMPY\x01\x00" + bytes(1000)), bz2.compress(bytes(200 << 20))
        data = path.read_bytes()
        assert old in data
        data = data.replace(old, bomb).replace(
            struct.pack("<I", len(old)), struct.pack("<I", len(bomb))
        )
        at = data.rfind(b"PK\5\6") + 16
        path.write_bytes(data[:at] + struct.pack("<I", data.find(b"PK\1\2")) + data[at + 4 :])
    before = peak()
    with pytest.raises(LoadError, match=r"column 'time' has ZIP method (12|14)"):
        read_table(path)
    assert peak() - before < 100


def test_a_directory_of_very_many_members_is_not_listed(tmp_path):
    path = tmp_path / "many.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for i in range(70_000):
            archive.writestr(f"{i}.npy", b"")
    with pytest.raises(
        LoadError, match="must hold at most some 32768 columns; its directory is larger"
    ):
        read_table(path)


# -- numbers -------------------------------------------------------------------------------------
@pytest.mark.parametrize("cell", ["1_000", "١٢", "１２", "1\u00a0000", "٣.5"])
def test_digits_of_other_scripts_and_underscores_are_no_numbers(tmp_path, cell):
    path = tmp_path / "log.csv"
    path.write_text(f"0,1,2,3,4\n0.0007,{cell},2,3,4\n")
    with pytest.raises(LoadError, match="line 2 must be numbers"):
        Record.from_csv(path, rig=RIG)
    path.write_text(f"t,a,b,note\n0,1,2,übung_1\n0.0007,2,{cell},x\n")
    with pytest.raises(LoadError, match=r"line 3 must be numbers; got .* in column 'b'"):
        read_table(path, names=["t", "a", "b"])
    assert read_table(path, names=["t", "a"])["a"].tolist() == [1, 2]  # the others may be anything
    path.write_text(f"0,1\n1,{cell}\n")
    with pytest.raises(ValueError, match="line 2 must be numbers"):
        Table.from_csv(path)


def test_a_table_that_takes_too_long_is_refused_in_one_line(tmp_path, monkeypatch):
    path = tmp_path / "log.csv"
    path.write_text("t,a\n" + "0,1\n" * 20_001)
    monkeypatch.setattr(csv_rows, "LIMITS", csv_rows.TextLimits(seconds=0))
    with pytest.raises(
        LoadError, match=r"must be read within 0 s; row 10000 was not. Save it as NPZ, or cut it"
    ):
        read_table(path)


# -- models --------------------------------------------------------------------------------------
def urdf(path, count, kind="fixed"):
    rows = ["<robot name='r'><link name='l0'><inertial><mass value='1'/>"]
    rows.append("<inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial></link>")
    for i in range(1, count):
        moves = "revolute" if i == 2 else kind
        mass = (
            "<inertial><mass value='1'/><inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0'"
            " izz='1'/></inertial>"
        )
        rows.append(f"<link name='l{i}'>{mass * (i == 5)}</link>")
        rows.append(
            f"<joint name='j{i}' type='{moves}'><parent link='l{i - 1}'/><child"
            f" link='l{i}'/></joint>"
        )
    path.write_text("\n".join([*rows, "</robot>"]))


def test_a_model_of_very_many_links_is_read_in_time_that_grows_with_them(tmp_path):
    """12,000 links in a row: time does not grow with their square."""
    path = tmp_path / "robot.urdf"
    urdf(path, 12_000)
    began = time.monotonic()
    assert Chain.from_urdf(path).n == 1
    assert time.monotonic() - began < 15
    path.write_text(path.read_text().replace("<parent link='l1'/>", "<parent link='l11999'/>"))
    with pytest.raises(ValueError, match="hangs on itself"):
        Chain.from_urdf(path)


def test_numbers_of_a_model_have_ascii_digits(tmp_path):
    path = tmp_path / "robot.urdf"
    urdf(path, 7)
    path.write_text(path.read_text().replace("mass value='1'", "mass value='١'"))
    with pytest.raises(ValueError, match="must have one finite number in value"):
        Chain.from_urdf(path)


def test_columns_are_what_they_were(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", t=np.arange(3.0))
    assert read_table(tmp_path / "a.npz")["t"].tolist() == [0, 1, 2]
