"""The public faces are typed: strictly where they are defined, and as a user's script sees them
(mypy of all: CI).
"""

import inspect
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import ctc
import identification
import plant

ROOT = Path(__file__).resolve().parent.parent
MYPY = Path(sys.executable).with_name("mypy")
FACES = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mypy"]["overrides"][1][
    "module"
]
pytestmark = pytest.mark.skipif(not MYPY.exists(), reason="mypy is not installed")

SCRIPT = """
import numpy as np

from ctc import ComputedTorque, certify, evaluate
from identification import Identification, identify
from plant import Body, Chain, Coupling, Drive, Dynamics, Harmonics, Link, Placement, Record, fastest, part, puma560
from plant import simulate, visibility

rig, path = puma560.rig(), puma560.reference()
measured = simulate(puma560.arm(), rig, puma560.p_law(), path)
reveal_type(measured)
found = identify(puma560.dynamics(), measured, seed=1)
reveal_type(found.f)
law = ComputedTorque(found.arm, found.rig, bandwidth=150)
reveal_type(law.bandwidth)
reveal_type(ComputedTorque(found).rig)
report = evaluate(puma560.arm(), rig, law, path)
reveal_type(report.within(1))
controller = law.start(rig, [0, 0])
reveal_type(controller.step([0, 0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]))
reveal_type(rig.drive.gear)
print(certify(found, rig, law, path).probability)

drive = Drive(gear=(107.8, -53.7), motor_inertia=[2e-4, 2e-4], viscous=(0, 0), coulomb=(0.1, 0.1),
              motor_gain=np.ones(2), current_limit=(12, np.inf), coupling=Coupling(matrix=np.eye(2)))
waves = Harmonics(period=3.65, offset=(0, 1), cosine=((1.0,), (0,)), sine=np.zeros((2, 1)))
rod = Body(mass=2.0, com=(0.2, 0, 0), inertia=(0, 0, 0, 0.03, 0, 0.03))
elbow = Link(name="2", a=0.4, frame=Placement(rotation=np.eye(3)))
chain = Chain(links=(Link(name="1"), elbow), bodies=(rod, rod))
dynamics = Dynamics.from_chain(chain)
print(dynamics.D(np.zeros(2), dynamics.f()), dynamics.arm(dynamics.f()).dynamics.legend, drive.gear.shape)
logged = Record(t=np.arange(9) * 1e-3, error_pulses=np.zeros((9, 2), int), torque=0.1 * np.ones((9, 2)), rig=rig)
checkup = logged.check()
print(checkup.ok, [problem.advice for problem in checkup.problems], Record.read("log.npz", rig=rig, columns={}).t)
print(visibility(dynamics, waves), waves.torque_share(found.arm, found.rig).max(), fastest(found.arm, rig, path).n)

ComputedTorque(found.arm, found.rig, bandwith=150)  # error: call-arg
ComputedTorque(found.arm, found.rig, bandwidth="fast")  # error: arg-type
simulate(puma560.arm(), rig, law)  # error: call-arg
simulate(puma560.arm(), rig, path, law)  # error: arg-type
rig.period = 0.7e-3  # error: misc
"""


def test_mypy_is_strict_where_public_things_are_defined():
    defined = set()
    for package in (plant, identification, ctc):
        for name in package.__all__:
            thing = getattr(package, name)
            defined.add(thing.__name__ if inspect.ismodule(thing) else thing.__module__)
    assert {
        name for name in defined if name.split(".")[0] in ("plant", "identification", "ctc")
    } <= set(FACES)


def test_a_user_s_script_has_types(tmp_path):
    path = tmp_path / "script.py"
    path.write_text(SCRIPT)
    settings = tmp_path / "mypy.ini"
    settings.write_text(f"[mypy]\nstrict = true\nmypy_path = {ROOT}\nfollow_imports = silent\n")
    command = [MYPY, "--config-file", settings, path]
    # ours
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False).stdout  # noqa: S603
    revealed = re.findall(r"Revealed type is \"(.*)\"", said)
    array = "numpy.ndarray[tuple[Any, ...], numpy.dtype[numpy.float64]]"
    assert [each.replace("builtins.", "") for each in revealed] == [
        "plant.logs.record.Record", array, "float", "plant.machine.rig.Rig", "bool", array, array,
    ], said  # fmt: skip
    expected = {
        i: m[1]
        for i, line in enumerate(SCRIPT.splitlines(), 1)
        if (m := re.search(r"# error: (\S+)$", line))
    }
    errors = re.findall(r"script\.py:(\d+): error: .*\[(.*)\]", said)
    assert {int(line) for line, _ in errors} == set(expected), said
    assert all((str(line), code) in errors for line, code in expected.items()), said


def test_every_ignore_has_its_code_and_its_reason():
    for package in ("plant", "identification", "ctc"):
        for path in (ROOT / package).rglob("*.py"):
            for line in path.read_text(encoding="utf-8").splitlines():
                if "type: ignore" in line:
                    assert re.search(r"# type: ignore\[[\w, -]+\]  # \w+", line), f"{path}: {line}"
