"""Spoilt and hostile files: a record or one LoadError, in a process that lives on. 500 of each:
corrupt_files.py.
"""

import io
import struct
import sys
import zipfile
import zlib

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from spoilt_files import FORMATS, RIG, WarmChildren, log, read, spoil, write

from plant import LoadError, Record, puma560, read_table
from plant.logs import isolation
from plant.logs.formats import mat as mat_format

MUTATIONS = 50


@pytest.fixture(scope="module")
def server():
    with WarmChildren() as children:
        isolation.run = children.cold
        yield children


@pytest.fixture
def children(server, monkeypatch):
    monkeypatch.setattr(isolation, "run", server)


def attempt(call):
    """Whether there is a record; if not, one line says why not."""
    try:
        record = call()
    except LoadError as error:
        said = str(error)
    else:
        assert np.isfinite(record.error_pulses).all()
        assert (np.diff(record.t) > 0).all()
        return True
    assert "\n" not in said
    assert len(said) < 500
    return False


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", FORMATS)
def test_spoilt_files(tmp_path, children, kind):
    path, rng = tmp_path / f"log.{kind}", np.random.default_rng(7)
    read_some = 0
    for i in range(MUTATIONS):
        if i in (0, MUTATIONS // 2):
            write(kind, path, log(), compress=i == 0)
            assert attempt(lambda: read(kind, path))
            sound = path.read_bytes()
        path.write_bytes(spoil(sound, rng))
        read_some += attempt(lambda: read(kind, path))
    assert read_some < MUTATIONS


@pytest.mark.filterwarnings("ignore")
def test_spoilt_files_of_the_library(tmp_path):
    path, rng = tmp_path / "own.csv", np.random.default_rng(8)
    columns, N = log(30), 30
    Record(t=columns["time"], error_pulses=np.ones((N, 2)), rig=RIG, law=puma560.p_law()).to_csv(
        path
    )
    sound = path.read_bytes()
    for _ in range(4 * MUTATIONS):
        path.write_bytes(spoil(sound, rng))
        attempt(lambda: Record.from_csv(path))


@pytest.mark.parametrize("kind", ["mat", "hdf5", "parquet"])
def test_spoilt_files_in_children_of_their_own(tmp_path, kind):
    """As users read them: nothing imported before, nothing forked."""
    path, rng = tmp_path / "log", np.random.default_rng(9)
    write(kind, path, log())
    sound = path.read_bytes()
    for _ in range(2):
        path.write_bytes(spoil(sound, rng))
        attempt(lambda: read(kind, path))


# -- the child -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("body", "message"),
    [
        (
            "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)",
            "its reader ended with SIGSEGV",
        ),
        ("import os; os._exit(9)", "its reader ended with status 9"),
        ("import time; time.sleep(60)", "must be read within 1 s"),
    ],
)
def test_a_child_that_dies_or_hangs_is_one_load_error(tmp_path, monkeypatch, body, message):
    (tmp_path / "child.py").write_text(body)
    write("mat", tmp_path / "log.mat", log())
    monkeypatch.setattr(isolation.child, "__file__", str(tmp_path / "child.py"))
    monkeypatch.setattr(isolation, "LIMITS", isolation.ReadingLimits(seconds=1))
    with pytest.raises(LoadError, match=message):
        read_table(tmp_path / "log.mat")


@pytest.mark.skipif(sys.platform != "linux", reason="RLIMIT_AS binds on Linux")
def test_memory_of_the_child_is_capped(tmp_path, monkeypatch):
    """In an address space of 350 MiB there is room for the libraries and 8 kB, but not for 240
    MiB more.
    """
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("large", (30 << 20,), float, fillvalue=1.0, chunks=(1 << 20,))
        file["small"] = np.ones(1000)
    monkeypatch.setattr(isolation, "LIMITS", isolation.ReadingLimits(memory=350 << 20))
    assert len(read_table(tmp_path / "a.h5", names=["small"])["small"]) == 1000
    with pytest.raises(LoadError, match=r"Memory|ended with|allocate|memory"):
        read_table(tmp_path / "a.h5")


# -- files that expand ---------------------------------------------------------------------------
def bomb(path, declared=None, size=300):
    """An archive with `size` MiB of zeros in a few hundred kB; its directory may say otherwise."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "<f8", "fortran_order": False, "shape": (size << 17,)}
    )
    archive = zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
    with archive, archive.open("time.npy", "w") as file:
        file.write(head.getvalue())
        for _ in range(size):
            file.write(bytes(1 << 20))
    if declared is not None:
        data, old = path.read_bytes(), len(head.getvalue()) + (size << 20)
        path.write_bytes(data.replace(struct.pack("<I", old), struct.pack("<I", declared)))


def test_a_zip_bomb_is_refused_by_its_declared_size(tmp_path, monkeypatch):
    path = tmp_path / "bomb.npz"
    bomb(path)
    assert path.stat().st_size < 2 << 20
    monkeypatch.setattr(zipfile.ZipFile, "open", lambda *_: pytest.fail("a member was opened"))
    with pytest.raises(LoadError, match="must hold at most 256 MiB; it declares 300"):
        read_table(path)


def test_a_zip_bomb_that_lies_about_its_size_expands_no_further_than_that(tmp_path):
    path = tmp_path / "bomb.npz"
    bomb(path, declared=1000, size=8)
    with pytest.raises(LoadError, match=r"CRC|bytes"):
        read_table(path)


def test_an_array_that_lies_about_its_shape_is_refused(tmp_path):
    path = tmp_path / "huge.npz"
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "<f8", "fortran_order": False, "shape": (10**15,)}
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("time.npy", head.getvalue() + bytes(80))
    with pytest.raises(
        LoadError,
        match=r"must hold \(1000000000000000,\) of float64 in column 'time'; got 80 bytes",
    ):
        read_table(path)


class Hostile:
    def __reduce__(self):
        return print, ("opened",)


def test_pickles_are_never_opened(tmp_path, capsys):
    np.savez(tmp_path / "a.npz", time=np.array([Hostile()], dtype=object))
    with pytest.raises(LoadError, match="must hold real numbers; got object in column 'time'"):
        read_table(tmp_path / "a.npz")
    assert capsys.readouterr().out == ""


def mat(declared, zeros):
    """A MAT file of one compressed element that declares so many bytes and expands to those
    zeros [MiB].
    """
    squeeze = zlib.compressobj(1)
    parts = [squeeze.compress(struct.pack("<II", 14, declared))]
    parts += [squeeze.compress(bytes(1 << 20)) for _ in range(zeros)]
    element = b"".join([*parts, squeeze.flush()])
    return b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(element)) + element


@pytest.mark.parametrize(
    ("declared", "zeros", "message"),
    [
        (300 << 20, 300, "must hold at most 256 MiB; it declares 300"),
        (4_000_000_000, 0, "must hold at most 256 MiB; it declares 3814"),
        (1000, 50, "declares an element of 1008 bytes; it expands beyond them"),
    ],
)
def test_a_mat_bomb_is_refused(tmp_path, children, declared, zeros, message):
    (tmp_path / "bomb.mat").write_bytes(mat(declared, zeros))
    with pytest.raises(LoadError, match=message):
        read_table(tmp_path / "bomb.mat")


def test_a_mat_bomb_of_declared_size_is_not_expanded(tmp_path, monkeypatch):
    path = tmp_path / "bomb.mat"
    path.write_bytes(mat(300 << 20, 300))
    monkeypatch.setattr(mat_format, "_expanded", lambda *_: pytest.fail("it was expanded"))
    with pytest.raises(ValueError, match="it declares 300"):
        mat_format._require_bounded(path, 256 << 20)


def test_hdf5_and_parquet_bombs_are_refused_by_their_declared_size(tmp_path, children):
    with h5py.File(tmp_path / "bomb.h5", "w") as file:
        file.create_dataset("time", (1 << 40,), float, chunks=(1 << 16,))
    assert (tmp_path / "bomb.h5").stat().st_size < 1 << 20
    pq.write_table(
        pa.table({"time": pa.array(np.zeros(40_000_000, np.int8))}), tmp_path / "bomb.parquet"
    )
    assert (tmp_path / "bomb.parquet").stat().st_size < 1 << 20
    for name, size in (("bomb.h5", 8 << 20), ("bomb.parquet", 305)):
        with pytest.raises(LoadError, match=f"must hold at most 256 MiB; it declares {size}"):
            read_table(tmp_path / name)


def test_a_file_beyond_the_limit_is_not_opened(tmp_path):
    for kind in ("csv", "npz", "mat", "h5", "parquet"):
        path = tmp_path / f"large.{kind}"
        with open(path, "wb") as file:
            file.truncate(1 << 40)
        with pytest.raises(LoadError, match=r"at most 256 MiB; got 1048576 MiB"):
            read_table(path)
