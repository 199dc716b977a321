"""Checkpoints: what is finished is not made again, what is of other inputs is refused, and no
write loses anything.
"""

import dataclasses
import json
import os
import re
import threading

import numpy as np
import pytest

from plant import P, puma560, simulate
from plant.parts import Checkpoint, files
from plant.parts import checkpoint as module


@pytest.fixture
def path(tmp_path):
    return tmp_path / "work.json"


class Counted:
    """A stage that counts how often it is made."""

    def __init__(self, value):
        self.value, self.made = value, 0

    def __call__(self, *_):
        self.made += 1
        return self.value


VALUES = {
    "array": np.array([[0.1, -0.0], [np.inf, 1e-300]]),
    "none": None,
    "pair": (puma560.rig(), [1, 2.5]),
}


def test_a_finished_stage_is_taken_from_the_file_bit_for_bit(path):
    for _ in range(2):
        stages = {name: Counted(value) for name, value in VALUES.items()}
        with Checkpoint(path, "work") as kept:
            got = {name: kept.stage(name, stage) for name, stage in stages.items()}
        assert got["array"].tobytes() == VALUES["array"].tobytes()
        assert got["none"] is None
        assert got["pair"] == VALUES["pair"]
    assert [stage.made for stage in stages.values()] == [0, 0, 0]


def test_without_a_path_everything_is_made_and_nothing_written(path, monkeypatch):
    monkeypatch.setattr(module, "write_whole", lambda *_: pytest.fail("written"))
    stage = Counted(3)
    with Checkpoint(None, "work").bind(lambda: pytest.fail("asked for")) as kept:
        assert [kept.part("a").stage("x", stage) for _ in range(2)] == [3, 3]
        assert kept.remembered("f", stage) is stage
    assert stage.made == 2


def test_what_was_finished_before_an_interrupt_is_kept(path):
    def work():
        with Checkpoint(path, "work") as kept:
            for i in range(5):
                kept.stage(f"stage {i}", Counted(i))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert list(json.loads(path.read_text())["stages"]) == [f"stage {i}" for i in range(5)]


def test_parts_have_stages_of_their_own(path):
    with Checkpoint(path, "work") as kept:
        assert [kept.part(name).stage("x", Counted(name)) for name in "ab"] == ["a", "b"]
        assert kept.part("a").part("a").stage("x", Counted(3)) == 3
        assert Checkpoint(kept.part("b"), "within").stage("x", Counted(4)) == "b"


def test_a_remembered_function_is_known_by_its_argument(path):
    with Checkpoint(path, "work") as kept:
        squared = kept.remembered("squared", np.square)
        np.testing.assert_array_equal(squared(np.array([1.0, 2.0])), [1, 4])
    with Checkpoint(path, "work") as kept:
        other = kept.remembered("squared", lambda x: x + 100)
        np.testing.assert_array_equal(other(np.array([1.0, 2.0])), [1, 4])
        np.testing.assert_array_equal(other(np.array([[1.0, 2.0]])), [[101, 102]])
        np.testing.assert_array_equal(other(np.array([1.0, np.nextafter(2, 3)])), [101, 102])


def test_threads_finish_stages_side_by_side(path):
    with Checkpoint(path, "work") as kept:
        threads = [threading.Thread(target=kept.stage, args=(f"{i}", Counted(i))) for i in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert sorted(json.loads(path.read_text())["stages"].values()) == list(range(8))


# -- refusals ------------------------------------------------------------------------------------
def refused(path, call):
    with pytest.raises(ValueError, match=re.escape(f"checkpoint {path}")) as error:
        call()
    assert "\n" not in str(error.value)
    return str(error.value)


def test_other_inputs_are_refused_by_name(path):
    inputs = {"log": puma560.rig(), "seed": 3, "settings": (1.0, np.ones(3))}
    Checkpoint(path, "work").bind(lambda: inputs)
    Checkpoint(path, "work").bind(lambda: inputs)
    others = {
        "seed": 4,
        "log": P(gain=(1.0,)),
        "settings": (1.0, np.array([1, 1, np.nextafter(1, 2)])),
    }
    for name, other in others.items():
        changed = inputs | {name: other}
        said = refused(path, lambda changed=changed: Checkpoint(path, "work").bind(lambda: changed))
        assert f"must be of the same {name}; it was made with another" in said


def test_another_work_version_or_processor_is_refused(path, monkeypatch):
    Checkpoint(path, "work")
    assert "must be of the work 'other'; got 'work'" in refused(
        path, lambda: Checkpoint(path, "other")
    )
    with monkeypatch.context() as patched:
        patched.setattr(module, "get_host_cpu_name", lambda: "z80")
        assert "must be of the processor 'z80'" in refused(path, lambda: Checkpoint(path, "work"))
    monkeypatch.setattr(module, "versions", lambda: {"onepulse": "9"})
    assert "must be of the versions onepulse 9; got onepulse" in refused(
        path, lambda: Checkpoint(path, "work")
    )


def test_files_that_are_none_or_spoilt_are_refused(path, tmp_path):
    for text in (
        "",
        "{",
        "[]",
        '{"kind": "plant.Rig"}',
        '{"kind": "checkpoint", "format": 2, "stages": {}}',
    ):
        path.write_text(text)
        refused(path, lambda: Checkpoint(path, "work"))
    path.unlink()
    with Checkpoint(path, "work") as kept:
        kept.stage("x", Counted(np.ones(3)))
    path.write_text(path.read_text().replace("[1.0, 1.0, 1.0]", "[1.0, 1.5, 1.0]"))
    assert "it has been changed. Delete it, and begin anew" in refused(
        path, lambda: Checkpoint(path, "work")
    )
    refused(tmp_path, lambda: Checkpoint(tmp_path, "work"))
    refused(tmp_path / "no" / "file", lambda: Checkpoint(tmp_path / "no" / "file", "work"))


# -- disks that are full -------------------------------------------------------------------------
def test_on_a_full_disk_the_work_goes_on_and_what_was_there_stays(path, monkeypatch):
    with Checkpoint(path, "work") as kept:
        kept.stage("first", Counted(1))
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    said = "cannot be written .No space left on device.; the work goes on"
    with monkeypatch.context() as patched:
        patched.setattr(files.os, "fsync", full)
        with pytest.warns(UserWarning, match=said) as warned, Checkpoint(path, "work") as kept:
            assert [kept.stage(name, Counted(name)) for name in ("first", "second", "x")] == [
                1,
                "second",
                "x",
            ]
        assert len(warned) == 1
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == [path.name]
    with Checkpoint(path, "work") as kept:
        assert kept.stage("first", Counted(2)) == 1


def test_remains_of_killed_processes_go_and_fresh_ones_stay(path):
    Checkpoint(path, "work")
    old, fresh, other = (
        path.with_name(name)
        for name in (f".work.json.{'0' * 16}", f".work.json.{'1' * 16}", ".work.json.x")
    )
    for left in (old, fresh, other):
        left.write_text("")
    os.utime(old, (0, 0))
    os.utime(other, (0, 0))
    Checkpoint(path, "work")
    assert (old.exists(), fresh.exists(), other.exists()) == (False, True, True)


def test_writes_take_a_bounded_share_of_the_time(path, monkeypatch):
    written, now = [], [0.0]

    def slow(*_):
        written.append(now[0])
        now[0] += 1.0

    with Checkpoint(path, "work") as kept:
        monkeypatch.setattr(module, "write_whole", slow)
        monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
        for i in range(100):
            now[0] += 0.5
            kept.stage(f"{i}", Counted(i))
    assert np.diff(written[:-1]).min() >= 20
    assert len(written) >= 3


def test_inputs_of_records_do_not_hang_on_the_file_s_name(path):
    record = simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.01
    )
    with Checkpoint(path, "work") as kept:
        kept.bind(lambda: {"log": record})
        kept.stage("one", Counted(1))
    again, made = Checkpoint(path, "work"), Counted(2)
    again.bind(lambda: {"log": dataclasses.replace(record, name="moved.csv")})
    assert again.stage("one", made) == 1  # the file's own, not made again
    assert made.made == 0
    with pytest.raises(ValueError, match="inputs"):
        Checkpoint(path, "work").bind(
            lambda: {"log": dataclasses.replace(record, error_pulses=-record.error_pulses)}
        )


def test_the_log_says_which_stages_ended(caplog):
    with caplog.at_level("INFO", logger="onepulse"), Checkpoint(None, "work") as kept:
        assert kept.part("one").stage("fit", lambda: 3) == 3
    (said,) = caplog.records
    assert said.name == "onepulse.work"
    assert said.getMessage().startswith("one, fit: 0.")
