"""Arrays with their samples along either axis, elements of them, and what MATLAB makes of both."""

import re

import h5py
import numpy as np
import pytest
import scipy.io
from spoilt_files import WarmChildren, opaque, refused

from plant import Drive, Encoder, Record, Rig, read_table
from plant.logs import read_file

N, n = 240, 3
T = 8e-4 * np.arange(N)
RIG = Rig(
    drive=Drive(
        gear=(50.0, -101.0, 80.0),
        motor_inertia=(1e-4,) * n,
        viscous=(0,) * n,
        coulomb=(0,) * n,
        motor_gain=(0.2,) * n,
        current_limit=(10,) * n,
    ),
    encoder=Encoder(resolution=(4096, 1024, 2000)),
    period=8e-4,
)
COUNTS = np.round(3000 * np.sin(np.arange(N)[:, None] / [31, 47, 59]))
Q = RIG.to_angle(COUNTS)


@pytest.fixture(autouse=True)
def warm():
    with WarmChildren():
        yield


def save(path, arrays):
    if path.suffix == ".npz":
        np.savez(path, **arrays)
    elif path.suffix == ".mat":
        scipy.io.savemat(path, arrays)
    else:
        with h5py.File(path, "w") as file:
            for name, array in arrays.items():
                file[name] = array


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".h5"])
@pytest.mark.parametrize(
    ("time", "angles"),
    [(T, Q.T), (T[None], Q.T), (T[:, None], Q), (T[None], Q.T[:, None]), (T, Q[:, None])],
)
def test_samples_may_lie_along_any_axis(tmp_path, suffix, time, angles):
    path = tmp_path / f"a{suffix}"
    save(path, {"t": time, "q": angles})
    units = {"t": "s", "position": "rad"}
    for columns in (
        {"t": "t", "position": "q"},
        {"t": "t", "position": ["q[0]", "q[1]", "q[2]"]},
        {"t": "t", "position": ["q.0", "q.1", "q.2"]},
    ):
        record = Record.read(path, rig=RIG, columns=columns, units=units)
        np.testing.assert_array_equal(record.counts, COUNTS)


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".h5"])
def test_a_matrix_with_time_in_its_first_row(tmp_path, suffix):
    """As Simulink's To File writes it; the mapping names its rows."""
    path = tmp_path / f"a{suffix}"
    save(path, {"ans": np.vstack([T, Q.T])})
    record = Record.read(
        path,
        rig=RIG,
        columns={"t": "ans[0]", "position": ["ans[1]", "ans[2]", "ans[3]"]},
        units={"t": "s", "position": "rad"},
    )
    np.testing.assert_array_equal(record.counts, COUNTS)
    refused(
        lambda: read_table(path, names=["ans[4]"]),
        r"column 'ans\[4\]' must be there; got 5 others: 'ans', 'ans\[0\]'",
    )


def test_few_samples_of_many_joints_stay_as_the_vectors_say(tmp_path):
    save(tmp_path / "a.npz", {"t": T[:2], "q": Q[:2]})
    np.testing.assert_array_equal(read_table(tmp_path / "a.npz")["q"], Q[:2])


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("vectors", [("kp",), ("kp", "kd")])
def test_gains_beside_the_samples_do_not_turn_them(tmp_path, vectors, turned):
    q = Q[1:]
    arrays = {"t": T[1:], "q": q.T if turned else q} | dict.fromkeys(vectors, np.ones(n))
    save(tmp_path / "a.npz", arrays)
    np.testing.assert_array_equal(read_table(tmp_path / "a.npz")["q"], q)


def test_each_array_is_turned_by_the_vectors_of_its_own_sampling(tmp_path):
    arrays = {"t": T, "u": T, "v": T[:50], "q": Q, "w": Q[:50].T}
    save(tmp_path / "a.npz", arrays)
    table = read_table(tmp_path / "a.npz")
    np.testing.assert_array_equal(table["q"], Q)
    np.testing.assert_array_equal(table["w"], Q[:50])


# -- MATLAB 7.3 -----------------------------------------------------------------------------------
def matlab73(path, fill):
    """An HDF5 file with the header of MATLAB, and what `fill` puts into it."""
    with h5py.File(path, "w", userblock_size=512) as file:
        fill(file)
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def put(group, name, values, matlab_class="double"):
    item = group.create_dataset(name, data=np.asarray(values).T)
    item.attrs["MATLAB_class"] = np.bytes_(matlab_class)
    return item


def test_a_mat_file_is_known_by_its_content(tmp_path):
    def fill(file):
        run = file.create_group("run")
        run.attrs["MATLAB_class"] = np.bytes_("struct")
        put(run, "t", T[:, None])
        put(run, "q", Q)

    matlab73(tmp_path / "a.mat", fill)
    for time, joint in (("run/t", "run/q"), ("run.t", "run.q")):
        table = read_table(tmp_path / "a.mat", names=[time, joint, f"{joint}[2]"])
        np.testing.assert_array_equal(table[joint], Q)
        np.testing.assert_array_equal(table[f"{joint}[2]"], Q[:, 2])


def test_an_array_of_structures_is_read_through_its_references(tmp_path):
    def fill(file):
        scope, hidden = file.create_group("scope"), file.create_group("#refs#")
        put(scope, "time", T[None])
        signals = scope.create_group("signals")
        signals.attrs["MATLAB_class"] = np.bytes_("struct")
        inner = hidden.create_group("c")
        put(inner, "raw", COUNTS)
        references = [put(hidden, "a", Q).ref, inner.ref]
        signals.create_dataset("values", data=np.array([references], dtype=h5py.ref_dtype).T)

    matlab73(tmp_path / "a.mat", fill)
    for name in ("scope/signals[0]/values", "scope.signals[0].values"):
        np.testing.assert_array_equal(read_table(tmp_path / "a.mat", names=[name])[name], Q)
    table = read_table(tmp_path / "a.mat")
    assert set(table) == {
        "scope/time",
        "scope/signals[0]/values",
        "scope/signals[1]/values/raw",
    }
    np.testing.assert_array_equal(table["scope/signals[1]/values/raw"], COUNTS)


@pytest.mark.parametrize(
    ("matlab_class", "saved"),
    [
        ("timetable", r"s = table2struct\(timetable2table\(log\), 'ToScalar', true\)"),
        ("table", r"s = table2struct\(log, 'ToScalar', true\)"),
        ("timeseries", r"t = log\.Time; q = log\.Data"),
        ("Simulink.SimulationData.Dataset", r"log\{1\}\.Values\.Time"),
        ("datetime", r"seconds\(log - log\(1\)\)"),
        ("categorical", r"x = double\(log\)"),
    ],
)
def test_an_object_of_matlab_is_called_by_its_class(tmp_path, matlab_class, saved):
    def fill(file):
        item = put(file, "log", np.uint32([[3707764736, 2, 1, 1, 1, 1]]), matlab_class)
        item.attrs["MATLAB_object_decode"] = np.int32(3)
        put(file, "other", T[:, None])

    matlab73(tmp_path / "new.mat", fill)
    old = tmp_path / "old.mat"
    scipy.io.savemat(old, {"other": T})
    old.write_bytes(old.read_bytes() + opaque("log", matlab_class))
    for path in (tmp_path / "new.mat", old):
        for names in (["log"], ["log/Time"], ["log.Time"], None):
            refused(
                lambda path=path, names=names: read_table(path, names=names),
                f"'log' is an? MATLAB {re.escape(matlab_class)}",
                saved,
            )
        np.testing.assert_array_equal(read_table(path, names=["other"])["other"].ravel(), T)


# -- structures beyond the limit of elements -------------------------------------------------------
def referring(group, name, targets, **options):
    return group.create_dataset(name, data=np.array(targets, dtype=h5py.ref_dtype), **options)


def test_elements_are_counted_over_all_levels_of_references(tmp_path):
    """Structures of structures, and many references to one group; of another column the same file
    is read.
    """
    with h5py.File(tmp_path / "levels.h5", "w") as file:
        hidden = file.create_group("#refs#")
        hidden["q"] = file["t"] = T
        target = hidden["q"].ref
        for level in "abc":
            target = referring(hidden, level, [target] * 200).ref
        referring(file, "run/q", [target])
    with h5py.File(tmp_path / "group.h5", "w") as file:
        inner = file.create_group("#refs#/inner")
        for k in range(200):
            inner[f"q{k}"] = 0.0
        file["t"] = T
        referring(file, "run/q", [inner.ref] * 200)
    for name in ("levels.h5", "group.h5"):
        refused(lambda name=name: read_table(tmp_path / name), "at most 10000 elements")
        refused(
            lambda name=name: read_table(tmp_path / name, prefix="run[0]"), "at most 10000 elements"
        )
        np.testing.assert_array_equal(read_table(tmp_path / name, names=["t"])["t"], T)


def test_a_large_set_of_references_is_refused_by_its_size(tmp_path):
    """Of 8 TiB; it is neither read nor in the way of the other columns."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = T
        file.create_dataset("run/q", (1 << 40,), h5py.ref_dtype, chunks=(1 << 16,))
    refused(lambda: read_table(tmp_path / "a.h5"), "at most 10000 elements")
    np.testing.assert_array_equal(read_table(tmp_path / "a.h5", names=["t"])["t"], T)
    contents = Record.read(tmp_path / "a.h5")
    assert list(contents.roles) == ["t"]


def test_structures_that_nobody_wants_do_not_count(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        hidden = file.create_group("#refs#")
        hidden["q"] = T
        for run in ("early", "late"):
            referring(file, f"{run}/q", [hidden["q"].ref] * 5001)
    for name in ("late[5000]/q", "late[5000].q", "early[0].q"):
        np.testing.assert_array_equal(read_table(tmp_path / "a.h5", names=[name])[name], T)
    refused(lambda: read_table(tmp_path / "a.h5", names=["late[0]/q", "early[0]/q"]), "elements")


def test_one_reference_or_none_in_place_of_an_array(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = T
        file.create_dataset("run/q", data=file["t"].ref, dtype=h5py.ref_dtype)
        file.create_dataset("none/q", data=h5py.Empty(h5py.ref_dtype))
    table = read_table(tmp_path / "a.h5")
    assert set(table) == {"t", "run[0]/q"}
    np.testing.assert_array_equal(table["run[0]/q"], T)


def test_references_in_another_file_are_refused(tmp_path):
    (tmp_path / "secret").write_bytes(bytes(64))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = T
        file.create_dataset(
            "run/q", (8,), h5py.ref_dtype, external=[(str(tmp_path / "secret"), 0, 64)]
        )
    refused(lambda: read_table(tmp_path / "a.h5"), "column 'run/q' points into another file")
    np.testing.assert_array_equal(read_table(tmp_path / "a.h5", names=["t"])["t"], T)


@pytest.mark.parametrize(("name", "data"), [("log/Time", "log"), ("notes.text", "notes/text")])
def test_what_holds_no_numbers_is_left_out_under_the_name_that_is_asked(tmp_path, name, data):
    """A field of an object of MATLAB, and a point in place of a slash."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = T
        file["notes/text"] = ["by hand"]
        put(file, "log", np.uint32([[1, 2]]), "timetable")
    request = "hdf5", tmp_path / "a.h5", [name], ""
    refused(
        lambda: read_file(*request, numbers_only=True),
        f"column {name!r} must be there; got 3 others: .*{data!r}",
    )
