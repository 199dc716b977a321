# ruff: noqa: S603 - the compiler
"""FMUs of a law and of an arm, validated and run by fmpy: the loop of `simulate`, and states
that are saved.
"""

import dataclasses
import io
import os
import re
import shutil
import subprocess
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ctc import ComputedTorque, PDGravity
from plant import (
    Elasticity,
    Guards,
    LoggedTorque,
    P,
    PointToPoint,
    SteppedArm,
    puma560,
    read_robot,
    simulate,
    to_fmu,
    write_replay,
)  # fmt: skip
from plant.fmu import named_joints

fmpy = pytest.importorskip("fmpy", reason="needs fmpy, of the extra test")
fmi2, fmi3 = pytest.importorskip("fmpy.fmi2"), pytest.importorskip("fmpy.fmi3")
CC = shutil.which("cc") or shutil.which("gcc")
pytestmark = pytest.mark.skipif(
    CC is None and "CI_ARM" not in os.environ, reason="needs a C compiler"
)

ARM, RIG = puma560.arm(), puma560.rig()
LAW = ComputedTorque(ARM, RIG)
STICKS = PointToPoint(start=(0.0, 0.0), goal=(0.004, 0.05), duration=0.6)
"""A move so slow that its friction holds it now and then."""


class Fmu:
    """One instance, with its variables by name."""

    def __init__(self, path, folder):
        self.about = fmpy.read_model_description(str(path))
        fmpy.extract(str(path), str(folder))
        self.at = {v.name: v.valueReference for v in self.about.modelVariables}
        second = self.about.fmiVersion == "2.0"
        kind = fmi2.FMU2Slave if second else fmi3.FMU3Slave
        self.c = kind(guid=self.about.guid, unzipDirectory=str(folder), instanceName="one",
                      modelIdentifier=self.about.coSimulation.modelIdentifier)  # fmt: skip
        self.c.instantiate()
        self.real = (
            (self.c.getReal, self.c.setReal) if second else (self.c.getFloat64, self.c.setFloat64)
        )
        self.whole = (
            (self.c.getInteger, self.c.setInteger) if second else (self.c.getInt32, self.c.setInt32)
        )
        self.state = ("FMUstate" if second else "FMUState"), second

    def names(self, quantity):
        return [
            at for name, at in self.at.items() if name.startswith((f"{quantity}.", f"{quantity}["))
        ]

    def begin(self, **start):
        for quantity, values in start.items():
            self.set(quantity, values)
        if self.state[1]:
            self.c.setupExperiment(startTime=0.0)
        self.c.enterInitializationMode()
        self.c.exitInitializationMode()
        self.time = 0.0

    def set(self, quantity, values):
        write = self.whole if quantity == "counts" else self.real
        write[1](self.names(quantity), list(values))

    def get(self, quantity):
        return np.array(
            (self.whole if quantity == "counts" else self.real)[0](self.names(quantity))
        )

    def step(self, h=RIG.period):
        self.c.doStep(self.time, h)
        self.time += h


@cache
def made(version):
    folder = Path(made.folder) / str(version)
    to_fmu(LAW, folder / "law.fmu", version=version)
    to_fmu(ARM, folder / "arm.fmu", rig=RIG, version=version)
    return folder


@pytest.fixture(autouse=True, scope="module")
def _folder(tmp_path_factory):
    made.folder = tmp_path_factory.mktemp("fmu")


def opened(version, kind, tmp_path):
    return Fmu(made(version) / f"{kind}.fmu", tmp_path / f"{kind}{version}")


def loop(law, arm, record, tmp_path):
    """Counts and torques (N, n) of a loop of both along a record's reference: law first, then
    arm with its torque.
    """
    write_replay(record, tmp_path / "record.csv")
    motion = np.loadtxt(tmp_path / "record.csv", delimiter=",", skiprows=1)[:, 2:]
    first = record.reference(np.zeros(1))
    arm.begin(q_start=first.q[0], qd_start=first.qd[0])
    law.begin(counts=arm.get("counts"), q_r=first.q[0])
    found = []
    for row in motion:
        law.set("counts", counts := arm.get("counts"))
        for name, values in zip(("q_r", "qd_r", "qdd_r"), row.reshape(3, 2), strict=True):
            law.set(name, values)
        law.step()
        found.append((counts, torque := law.get("torque")))
        arm.set("torque", torque)
        arm.step()
    return (np.array(each) for each in zip(*found, strict=True))


@pytest.mark.parametrize("version", [2, 3])
def test_fmpy_finds_nothing_wrong_and_runs_both(version, tmp_path):
    from fmpy.validation import validate_fmu

    for kind in ("law", "arm"):
        assert validate_fmu(str(made(version) / f"{kind}.fmu")) == []
    told = fmpy.simulate_fmu(str(made(version) / "arm.fmu"), stop_time=0.07, output_interval=0.0007)
    robot = SteppedArm(ARM, RIG, (0, 0))
    for _ in range(100):
        counts = robot.step((0, 0))
    assert (told["counts.joint_2"][-1], told["counts.joint_3"][-1]) == tuple(counts)
    np.testing.assert_allclose([told["q.joint_2"][-1], told["q.joint_3"][-1]], robot.q, rtol=1e-12)


@pytest.mark.parametrize(("version", "path", "duration"), [(2, puma560.reference(), 2.8), (3, STICKS, None)],
                         ids=["(6)", "sticks"])  # fmt: skip
def test_the_two_are_the_loop_of_simulate(version, path, duration, tmp_path):
    record = simulate(ARM, RIG, LAW, path, duration=duration)
    counts, torque = loop(
        opened(version, "law", tmp_path), opened(version, "arm", tmp_path), record, tmp_path
    )
    np.testing.assert_array_equal(counts, record.counts)
    running, limit = LAW.start(RIG, counts[0]), np.abs(record.torque).max()
    stepped = [running.step(*row) for row in zip(counts, *record.reference(record.t), strict=True)]
    np.testing.assert_allclose(torque, stepped, rtol=0, atol=1e-12 * limit)
    # The kernels of simulate round otherwise; friction that is learnt carries that along: a count
    # flips after 3.4 s.
    np.testing.assert_allclose(torque, record.torque, rtol=0, atol=1e-11 * limit)
    if path is STICKS:
        assert (np.abs(record.true_qd) < 1e-9).mean(axis=0).min() > 0.02  # both do stick


@pytest.mark.parametrize("version", [2, 3])
def test_a_saved_state_begins_where_it_was(version, tmp_path):
    arm = opened(version, "arm", tmp_path)
    arm.begin(q_start=(0.1, -0.2))
    arm.set("torque", (3.0, -2.0))
    for _ in range(20):
        arm.step()
    name = arm.state[0]
    get, restore, free = (getattr(arm.c, f"{verb}{name}") for verb in ("get", "set", "free"))
    kept = get()
    words = (arm.c.serializeFMUstate if version == 2 else arm.c.serializeFMUState)(kept)

    def onward():
        for _ in range(30):
            arm.step()
        return arm.get("q"), arm.get("qd"), arm.get("counts")

    first = onward()
    restore(kept)
    again = onward()
    restore((arm.c.deSerializeFMUstate if version == 2 else arm.c.deserializeFMUState)(words))
    third = onward()
    free(kept)
    for each in (again, third):
        for one, other in zip(first, each, strict=True):
            np.testing.assert_array_equal(one, other)
    with pytest.raises(Exception, match="failed with status 3"):
        (arm.c.deSerializeFMUstate if version == 2 else arm.c.deserializeFMUState)(
            b"0" * len(words)
        )


@pytest.mark.parametrize("version", [2, 3])
def test_what_it_exports_has_the_signatures_of_the_standard(version, tmp_path):
    """Compiled behind the standard's own headers, which fmpy has; and nothing else is to be seen
    from outside.
    """
    headers, folder = Path(fmpy.__file__).parent / "c-code", tmp_path / "fmu"
    fmpy.extract(str(made(version) / "law.fmu"), str(folder))
    strict = [CC, "-std=c99", "-Wall", "-Wextra", "-Werror"]
    given = [
        f"-I{headers}",
        "-include",
        f"fmi{version}Functions.h",
        "-fsyntax-only",
        f"fmi{version}.c",
    ]
    said = subprocess.run([*strict, *given], cwd=folder / "sources", capture_output=True, text=True)
    assert said.returncode == 0, said.stderr
    source = (folder / "sources" / f"fmi{version}.c").read_text()
    (folder / "sources" / "wrong.c").write_text(
        source.replace(f"fmi{version}Byte bytes[]", "float bytes[]")
    )
    said = subprocess.run(
        [*strict, *given[:-1], "wrong.c"], cwd=folder / "sources", capture_output=True, text=True
    )
    assert "conflicting types" in said.stderr
    library = next((folder / "binaries").rglob("*.so"))
    seen = subprocess.run(
        [shutil.which("nm"), "-D", "--defined-only", library], capture_output=True, text=True
    )
    assert {line.split()[-1][:4] for line in seen.stdout.splitlines()} == {f"fmi{version}"}
    wanted = {line.split()[-1] for line in seen.stdout.splitlines()}
    declared = (headers / f"fmi{version}Functions.h").read_text()
    model_exchange = {
        "fmi2EnterEventMode",
        "fmi2NewDiscreteStates",
        "fmi2EnterContinuousTimeMode",
        "fmi2SetTime",
        "fmi2CompletedIntegratorStep",
        "fmi2SetContinuousStates",
        "fmi2GetDerivatives",
        "fmi2GetEventIndicators",
        "fmi2GetContinuousStates",
        "fmi2GetNominalsOfContinuousStates",
    }
    for name in set(re.findall(rf"\bfmi{version}[A-Z]\w+(?=TYPE)", declared)) - model_exchange:
        assert name in wanted, name


def test_a_step_of_the_wrong_length_or_an_arm_that_flies_away_is_refused(tmp_path):
    law, arm = opened(2, "law", tmp_path), opened(2, "arm", tmp_path)
    law.begin()
    arm.begin()
    for each, h in (
        (law, 2 * RIG.period),
        (law, 0.0),
        (arm, 0.3 * RIG.period),
        (arm, 0.0),
        (arm, np.nan),
    ):
        with pytest.raises(Exception, match="failed with status 3"):
            each.step(h)
        each.time = 0.0
    with pytest.raises(Exception, match="failed with status 3"):
        arm.set("torque", (np.nan, 0.0))
    with pytest.raises(Exception, match="failed with status 3"):
        arm.set("q", (1.0, 0.0))  # an output
    arm.step(RIG.period / 4)  # a sub-step
    arm.c.reset()
    arm.begin(qd_start=(6e5, -6e5))
    with pytest.raises(Exception, match="failed with status 3"):
        arm.step()
    np.testing.assert_array_equal(arm.get("qd"), (6e5, -6e5))  # as before


def test_other_arms_and_controllers(tmp_path):
    """Elastic gears that carry their weight, an encoder with a phase, other f; a law without a
    period; one's guards.
    """
    drive = dataclasses.replace(
        RIG.drive, elasticity=Elasticity.from_resonance(ARM, 20.0, 0.02, drive=RIG.drive)
    )
    rig = dataclasses.replace(RIG, drive=drive)
    to_fmu(ARM, tmp_path / "elastic.fmu", rig=rig)
    fmu = Fmu(tmp_path / "elastic.fmu", tmp_path / "x")
    f = 1.1 * np.asarray(ARM.f)
    fmu.begin(q_start=(0.3, -0.4), f=f)
    robot = SteppedArm(ARM.dynamics.arm(f), rig, (0.3, -0.4))
    np.testing.assert_allclose(fmu.get("q"), robot.q, rtol=1e-13)
    for k in range(300):
        fmu.set("torque", torque := (40.0 * np.sin(k / 20), 10.0))
        fmu.step()
        counts = robot.step(torque)
        np.testing.assert_array_equal(fmu.get("counts"), counts)
    np.testing.assert_allclose(fmu.get("qd"), robot.qd, rtol=1e-9)
    running = P(gain=(0.2, 0.15)).start(RIG, (5, 0), guards=Guards(error=10), torque_limit=(30, 20))
    to_fmu(running, tmp_path / "p.fmu", version=3)
    fmu = Fmu(tmp_path / "p.fmu", tmp_path / "y")
    fmu.begin(counts=(5, 0))
    for k in range(40):
        fmu.set("counts", (5 + k, -k))
        fmu.step()
        np.testing.assert_allclose(
            fmu.get("torque"), running.step((5 + k, -k), (0, 0), (0, 0), (0, 0)), rtol=1e-12
        )
    assert running.stopped
    assert fmu.whole[0]([fmu.at["stopped"]])[0] > 0


def test_the_description_names_what_the_controller_leaves_to_others(tmp_path):
    law = PDGravity(ARM, RIG, feedback=P(gain=(0.2, 0.15)))
    running = law.start(RIG, (0, 0), guards=None, without=("gravity",))
    to_fmu(running, tmp_path / "law.fmu")
    about = fmpy.read_model_description(str(tmp_path / "law.fmu"))
    assert about.description == "PDGravity without guards"
    torques = [v.description for v in about.modelVariables if v.name.startswith("torque.")]
    assert all("without gravity" in description for description in torques)


def test_bad_input_says_what_to_do(tmp_path):
    for message, give in {
        "rig must be given, since P holds none": lambda: to_fmu(
            P(gain=(0.2, 0.1)), tmp_path / "p.fmu"
        ),
        "rig must be given with an arm": lambda: to_fmu(ARM, tmp_path / "p.fmu"),
        "rig must be of type Rig; got a value of type float. Call to_fmu": lambda: to_fmu(
            ARM, tmp_path / "p.fmu", rig=7e-4
        ),
        "version must be one of 2, 3; got 1": lambda: to_fmu(LAW, tmp_path / "p.fmu", version=1),
        "path must end in .fmu": lambda: to_fmu(LAW, tmp_path / "my law.fmu"),
        "path must be that of a file": lambda: to_fmu(LAW, 3),
        "must be a controller; LoggedTorque repeats": lambda: to_fmu(
            LoggedTorque(), tmp_path / "p.fmu", RIG
        ),
        "model must be of type Law": lambda: to_fmu(RIG, tmp_path / "p.fmu"),
        "rig must be left out": lambda: to_fmu(LAW.start(RIG, (0, 0)), tmp_path / "p.fmu", RIG),
        "encoder that counts": lambda: to_fmu(
            ARM,
            tmp_path / "p.fmu",
            dataclasses.replace(RIG, encoder=dataclasses.replace(RIG.encoder, smooth=True)),
        ),
    }.items():
        with pytest.raises(ValueError, match=re.escape(message)) as told:
            give()
        assert "\n" not in str(told.value)


def damaged():
    """An archive whose packed description is cut into by other bytes."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", "letters " * 100)
    data = bytearray(file.getvalue())
    begin = 30 + len("modelDescription.xml")  # behind the header of the entry
    data[begin : begin + 4] = b"\xff" * 4
    return bytes(data)


@pytest.mark.parametrize("content", [b"a letter", damaged()], ids=["letter", "damaged"])
def test_another_file_stays(tmp_path, content):
    (tmp_path / "mine.fmu").write_bytes(content)
    with pytest.raises(ValueError, match="must not exist, or be an earlier export"):
        to_fmu(LAW, tmp_path / "mine.fmu")
    assert (tmp_path / "mine.fmu").read_bytes() == content


def test_a_path_through_a_file_or_a_link_to_nowhere_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for folder in ("notes.txt", "notes.txt/out", "link", "link/out"):
        with pytest.raises(ValueError, match=r"(notes.txt|link) is a file. Name another"):
            to_fmu(LAW, tmp_path / folder / "law.fmu")
    assert not (tmp_path / "nowhere").exists()


def test_an_export_that_cannot_be_written_leaves_the_earlier_one(tmp_path, monkeypatch):
    def full(*_):
        raise OSError("no space left")

    path = tmp_path / "arm.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", '<fmi generationTool="onepulse 0"/>')
    earlier = path.read_bytes()
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="no space left"):
        to_fmu(ARM, path, rig=RIG)
    assert [file.name for file in tmp_path.iterdir()] == ["arm.fmu"]
    assert path.read_bytes() == earlier


def test_names_that_cannot_be_told_apart_are_refused():
    assert named_joints(["joint 2 (q[0])", "elbow_joint (q[1])", "joint q[2]"]) == [
        "joint_2",
        "elbow_joint",
        "joint_q_2",
    ]
    with pytest.raises(ValueError, match="joint names must differ"):
        named_joints(["joint a-b (q[0])", "joint a b (q[1])"])


def test_without_a_compiler_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(ValueError, match=r"needs a C compiler .* Install gcc"):
        to_fmu(ARM, tmp_path / "arm.fmu", rig=RIG)


def test_the_same_export_has_the_same_bytes(tmp_path):
    for name in "ab":
        to_fmu(ARM, tmp_path / name / "arm.fmu", rig=RIG)
    assert (tmp_path / "a" / "arm.fmu").read_bytes() == (tmp_path / "b" / "arm.fmu").read_bytes()


def test_an_arm_of_six_joints_whose_parameters_have_long_names(tmp_path):
    from fmpy.validation import validate_fmu

    robot = read_robot("ur5e")
    to_fmu(robot.arm, tmp_path / "ur5e.fmu", rig=robot.rig, version=3)
    assert validate_fmu(str(tmp_path / "ur5e.fmu")) == []
    joints = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    told = fmpy.simulate_fmu(
        str(tmp_path / "ur5e.fmu"),
        stop_time=50 * robot.rig.period,
        output_interval=robot.rig.period,
        start_values={f"q_start.joint_{joint}": 0.1 for joint in joints},
    )
    stepped = SteppedArm(robot.arm, robot.rig, np.full(6, 0.1))
    for _ in range(50):
        counts = stepped.step(np.zeros(6))
    assert [told[f"counts.joint_{joint}"][-1] for joint in joints] == list(counts)


@pytest.mark.skipif(
    shutil.which("cmake") is None and "CI_ARM" not in os.environ, reason="needs cmake"
)
def test_fmpy_builds_it_from_its_sources(tmp_path):
    from fmpy.build import build_platform_binary

    told = []
    for folder, build in ((tmp_path / "theirs", True), (tmp_path / "ours", False)):
        fmpy.extract(str(made(3) / "arm.fmu"), str(folder))
        if build:
            library = next((folder / "binaries").rglob("*.so"))
            library.unlink()
            (tmp_path / "build").mkdir()
            build_platform_binary(folder, tmp_path / "build")
        told.append(fmpy.simulate_fmu(str(folder), stop_time=0.7, output_interval=0.0007))
    assert library.exists()
    for name in told[0].dtype.names:
        np.testing.assert_allclose(told[0][name], told[1][name], rtol=1e-12, atol=1e-15)
