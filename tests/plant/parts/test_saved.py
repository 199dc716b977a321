"""Files of parts: every bit there and back, and one line for every file that cannot be read."""

import dataclasses
import json
import os
import re
from collections import OrderedDict, defaultdict
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from plant import (
    Arm,
    Law,
    P,
    Part,
    Record,
    Resumed,
    Rig,
    StatelessLaw,
    number,
    part,
    puma560,
    simulate,
    structure,
)
from plant.checkup import Rival
from plant.parts import (
    PARTS,
    files,
    fingerprint,
    from_plain,
    kept,
    kinds,
    parsed,
    to_plain,
    written,
)

ARM, RIG, LAW, PATH = puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference()


@part
class Own(StatelessLaw):
    """A law of a user's own."""

    gain: np.ndarray = number(("n",))

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return rig.drive.joint_torque(self.gain * (setpoint.pulses - pulses)), state


@pytest.fixture
def path(tmp_path):
    return tmp_path / "thing.json"


def through_text(value):
    return from_plain(parsed("".join(written(to_plain(value))).encode()))


@pytest.mark.parametrize(
    "thing", [ARM, RIG, LAW, PATH, ARM.dynamics], ids=lambda thing: type(thing).__name__
)
def test_a_part_comes_back_equal_and_is_written_again_in_the_same_bytes(path, thing):
    thing.save(path)
    again = type(thing).load(path)
    assert again == thing
    assert Part.load(path) == thing
    first = path.read_bytes()
    again.save(path)
    assert path.read_bytes() == first
    assert os.listdir(path.parent) == [path.name]


def test_what_was_loaded_gives_the_same_bits(path):
    made = simulate(ARM, RIG, LAW, PATH, duration=0.05)
    loaded = []
    for thing, kind in ((ARM, Arm), (RIG, Rig), (LAW, Law)):
        thing.save(path)
        loaded.append(kind.load(path))
    assert simulate(*loaded, PATH, duration=0.05) == made


@settings(derandomize=True, max_examples=60, deadline=None)
@given(
    arrays.arrays(
        st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_]),
        arrays.array_shapes(min_dims=0, max_dims=3, min_side=0),
    )
)
def test_no_bit_of_an_array_is_lost(array):
    again = through_text(array)
    assert (again.dtype, again.shape) == (array.dtype, array.shape)
    nan = np.isnan(array) if array.dtype.kind == "f" else np.zeros(array.shape, bool)
    assert again[~nan].tobytes() == array[~nan].tobytes()
    assert np.isnan(again[nan]).all()


def test_the_containers_of_a_result_keep_their_types():
    value = {0.5: (1, [2.0, -np.inf]), "a": np.float64(np.nan), 3: None, "b": (), "c": True}
    again = through_text(value)
    assert repr(again) == repr(value)
    assert type(again["a"]) is np.float64
    assert np.signbit(through_text((-np.nan, -0.0))).all()


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ({(0, 1): 1.0}, r"keys of a dictionary .*; got \(0, 1\)"),
        ({None: 1.0}, "keys of a dictionary .*; got None"),
        ({np.int64(1): 1.0}, "keys of a dictionary .*; got np.int64"),
        (OrderedDict(a=1), "class of a dictionary .*; got 'OrderedDict'"),
        (defaultdict(int, a=1), "class of a dictionary .*; got 'defaultdict'"),
        (np.ma.array([1.0, 2.0], mask=[0, 1]), "class of an array .*; got 'MaskedArray'"),
    ],
)
def test_what_would_not_come_back_is_refused_before_it_is_written(value, said):
    with pytest.raises(ValueError, match=said):
        to_plain(value)
    # A comparison reads nothing back.
    assert to_plain(value, compared=True)


def test_an_array_on_a_disk_is_written_like_one_in_memory(tmp_path):
    there = np.memmap(tmp_path / "numbers", dtype=float, mode="w+", shape=(2,))
    assert to_plain(there) == to_plain(np.zeros(2))


def test_a_number_beyond_float32_is_not_read_as_infinity():
    for huge in (1e300, -1e300):
        with pytest.raises(ValueError, match="float32 must hold numbers within its range"):
            from_plain({"array": [1.0, huge], "dtype": "float32", "shape": [2]})
    assert np.isinf(from_plain({"scalar": np.inf, "dtype": "float32"}))


def test_an_older_file_gets_every_default_that_its_class_has(monkeypatch):
    monkeypatch.setattr(kinds, "_RESULTS", {**kinds._RESULTS})

    @kept
    @dataclasses.dataclass(frozen=True)
    class Older:
        __module__ = "plant.tests"  # classes of a user are refused
        values: tuple
        further: dict = dataclasses.field(default_factory=dict)

    plain = to_plain(Older((1.0,), {"a": 1}))
    del plain["further"]
    assert from_plain(plain) == Older((1.0,), {})
    rival = Rival(name="sign", joints=(0,), size=1.0, log_odds=2.0, measurement="torque")
    plain = to_plain(rival)
    del plain["measurement"]
    assert from_plain(plain) == rival._replace(measurement="")
    del plain["size"]
    with pytest.raises(ValueError, match="Rival must have the field 'size'"):
        from_plain(plain)


def test_no_class_that_a_file_names_has_a_field_called_kind(monkeypatch, tmp_path):
    """A part may have one; no file takes it, since it would come back as another class."""
    monkeypatch.setattr(kinds, "_RESULTS", {**kinds._RESULTS})
    monkeypatch.setattr(kinds, "PARTS", {**PARTS})
    with pytest.raises(ValueError, match="Trial in a file must have no field 'kind'"):
        kept(NamedTuple("Trial", [("kind", str)]))

    @part
    class Tagged(P):
        kind: str = structure(str, default="plant.P")

    record = simulate(ARM, RIG, LAW, PATH, duration=0.1)
    tagged = dataclasses.replace(record, law=Tagged(gain=LAW.gain))
    assert tagged.law == Tagged(gain=LAW.gain)
    with pytest.raises(ValueError, match="Tagged in a file must have no field 'kind'"):
        tagged.to_csv(tmp_path / "log.csv")
    assert not (tmp_path / "log.csv").exists()


def test_the_text_is_json_for_any_reader_and_a_row_of_numbers_is_a_line(path):
    RIG.save(path)
    strict = json.loads(path.read_text(), parse_constant=lambda name: pytest.fail(name))
    assert strict["content"]["drive"]["gear"] == RIG.drive.gear.tolist()
    assert re.search(r'\n   "gear": \[[-0-9., ]+\],\n', path.read_text())
    assert strict["provenance"]["versions"]["numpy"] == np.__version__


def test_a_part_of_the_user_s_own_is_refused_before_anything_is_written(path):
    own = Own(gain=(1.0,))
    for thing in (own, Resumed(law=own, state=())):
        with pytest.raises(
            ValueError, match=r"cannot be saved: .* Own is a class of .*, whose equations"
        ):
            thing.save(path)
    assert not path.exists()


def test_fingerprints_tell_settings_and_the_text_of_own_classes_apart():
    assert fingerprint(P(gain=(1.0,))) != fingerprint(P(gain=(np.nextafter(1.0, 2),)))
    assert "rig.drive.joint_torque(self.gain" in to_plain(Own(gain=(1.0,)), compared=True)["source"]
    record = simulate(ARM, RIG, LAW, PATH, duration=0.01)
    assert fingerprint(dataclasses.replace(record, name="another file")) == fingerprint(record)
    assert isinstance(record, Record)


# -- refusals ------------------------------------------------------------------------------------
def edited(path, change):
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def refused(path, kind=Rig):
    with pytest.raises(ValueError, match=re.escape(str(path))) as error:
        kind.load(path)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 400
    return str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(format=2), "must be of format 1; got 2. Use version '0.1.0' or later."),
        (
            lambda d: d.update(format=0),
            "must be of format 1; got 0. Save it again with this version.",
        ),
        (lambda d: d.update(format=True), "must be of format 1; got True."),
        (lambda d: d.pop("onepulse"), "must be a file of this library"),
        (lambda d: d.update(extra=1), "a key must be one of .*; got 'extra'"),
        (lambda d: d.pop("provenance"), "must have the key 'provenance'"),
        (lambda d: d.update(kind="plant.P"), "must hold a Rig; it holds a 'plant.P'. Use P.load."),
        (lambda d: d.update(kind="os.system"), "kind must be a known one"),
        (lambda d: d.update(kind="ctc.Magic"), "Please import ctc first."),
        (lambda d: d["content"].update(kind="plant.P"), "must hold what its head says"),
        (
            lambda d: d["content"].update(perod=1.0),
            "an option of Rig .*'perod'.*Did you mean 'period'",
        ),
        (lambda d: d["content"].pop("period"), "missing a required argument: 'period'"),
        (lambda d: d["content"]["drive"].update(gear=[1.0]), "shape"),
        (lambda d: d["content"].update(period=None), "period"),
        (
            lambda d: d["content"].update(period={"array": [1.0], "dtype": "object", "shape": [1]}),
            "dtype",
        ),
        (
            lambda d: d["content"].update(
                period={"array": [1.0], "dtype": "float64", "shape": [2]}
            ),
            "got 1 of .2.",
        ),
        (
            lambda d: d["content"].update(
                period={"array": ["1"], "dtype": "float64", "shape": [1]}
            ),
            "hold numbers",
        ),
        (
            lambda d: d["content"].update(period={"array": [300], "dtype": "uint8", "shape": [1]}),
            "range",
        ),
        (lambda d: d["content"].update(period={"dict": [[[1], 2]]}), "must be a kind, array"),
    ],
)
def test_a_wrong_file_is_one_line(path, change, message):
    RIG.save(path)
    edited(path, change)
    assert re.search(message, refused(path))


def test_a_truncated_file_is_one_line_wherever_it_is_cut(path):
    RIG.save(path)
    whole = path.read_bytes()
    for end in [*range(0, len(whole) - 2, 97), len(whole) - 2]:
        path.write_bytes(whole[:end])
        assert "it ends too early" in refused(path) or end


def test_other_texts_are_refused_in_one_line(path, tmp_path):
    for text, message in (
        (b"[" * 100_000, "nested too deep"),
        (b'{"a": NaN}', "no NaN"),
        (b'{"a": 1, "a": 2}', "'a' comes twice"),
        (b'{"a": {"float": "1"}}', "must have numbers"),
        (b"\xff\xfe", "UTF-8"),
        (b"[1]", "a file of this library"),
        (b'{"onepulse": ' + b"9" * 5000 + b"}", "digits"),
    ):
        path.write_bytes(text)
        assert message in refused(path)
    assert "there is none" in refused(tmp_path / "none.json")
    assert "got a folder, a pipe or a device" in refused(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    assert "got a folder, a pipe or a device" in refused(tmp_path / "pipe")


def test_a_file_beyond_the_limit_is_not_read(path):
    with open(path, "wb") as file:
        file.truncate(1 << 40)
    assert "must have at most 1024 MiB; got 1048576" in refused(path)


# -- written whole -------------------------------------------------------------------------------
def test_a_write_that_fails_leaves_what_was_there(path, monkeypatch):
    RIG.save(path)
    before = path.read_bytes()

    def full(_):
        raise OSError(28, "No space left on device")

    for moment in ("fsync", "replace"):
        with monkeypatch.context() as patched:
            patched.setattr(files.os, moment, lambda *_: full(_))
            with pytest.raises(OSError, match="No space"):
                ARM.save(path)
        assert path.read_bytes() == before
        assert os.listdir(path.parent) == [path.name]


def test_a_file_keeps_its_permissions(path):
    RIG.save(path)
    path.chmod(0o600)
    RIG.save(path)
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_name_may_be_as_long_in_bytes_as_the_file_system_allows(path):
    name = path.with_name("\u6e2c" * 80)
    RIG.save(name)
    assert Rig.load(name) == RIG


def test_a_path_of_bytes_is_refused():
    with os.scandir(os.fsencode(os.path.dirname(__file__))) as entries:
        entry = next(entries)
    with pytest.raises(ValueError, match="folder must be a path; got <DirEntry"):
        files.path_of("folder", entry)


def test_a_link_is_followed_and_a_device_is_left_alone(path, tmp_path):
    (tmp_path / "link.json").symlink_to(path)
    RIG.save(tmp_path / "link.json")
    assert Rig.load(path) == RIG
    assert (tmp_path / "link.json").is_symlink()
    with pytest.raises(ValueError, match="it is a folder, a pipe or a device"):
        RIG.save(os.devnull)


def test_a_file_that_is_there_is_refused_where_it_may_not_be_replaced(path):
    """As the other functions that write; `save` itself replaces it."""
    rig = puma560.rig()
    rig.save(path, overwrite=False)
    before = path.read_bytes()
    with pytest.raises(ValueError, match="target must be a new file"):
        puma560.p_law().save(path, overwrite=False)
    assert path.read_bytes() == before
    puma560.p_law().save(path, overwrite=True)
    assert Law.load(path) == puma560.p_law()
