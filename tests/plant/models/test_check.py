"""The doctor: mistakes of every kind are found and undone, sound files are left alone, and only repairs are written."""

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest
from model_texts import urdf

from plant import Chain, check_model
from plant.models.robot_file import FOLDER

_SPEC = importlib.util.spec_from_file_location(
    "broken_models", Path(__file__).parents[2] / "benchmarks" / "broken_models.py"
)
broken_models = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(broken_models)


def test_every_mistake_of_a_robot_with_two_sides_is_undone():
    """The other side tells what is right; the benchmark has 50."""
    good, alarms, failed = broken_models.study(count=9, seed=3)
    assert (good, alarms) == (9, 0), failed


def test_alone_no_sound_file_is_blamed():
    assert broken_models.study(count=9, seed=4, pairs=False)[1] == 0


def test_sound_files_of_ours(tmp_path):
    assert check_model(FOLDER / "ur5e.urdf").ok
    for seed in range(5):  # without shapes
        path = tmp_path / f"{seed}.urdf"
        path.write_text(urdf(seed))
        assert check_model(path).ok


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda t: t.replace('mass value="8.058"', 'mass value="8058"'), r"grams for kilograms \(mass\)"),
        (lambda t: t.replace('xyz="-0.2125 0 0.11336"/>', 'xyz="-212.5 0 113.36"/>'), r"millimetres for metres"),
        (lambda t: t.replace('iyy="0.143231"', 'iyy="-0.143231"'), "a negative moment of inertia"),
        (lambda t: t.replace('ixx="0.014504" ixy="0" ixz="0" iyy="0.143231" iyz="0" izz="0.143231"',
                             'ixx="14504" ixy="0" ixz="0" iyy="143231" iyz="0" izz="143231"'), r"kg mm\^2 for kg m\^2"),
    ],
)  # fmt: skip
def test_a_link_alone_that_is_impossible_in_its_shape(tmp_path, wrong, said):
    """Then the repaired file is the sound one to the last digit of its numbers, and to the byte elsewhere."""
    sound = (FOLDER / "ur5e.urdf").read_text()
    path = tmp_path / "broken.urdf"
    path.write_text(wrong(sound))
    assert path.read_text() != sound
    check = check_model(path)
    assert [finding.link for finding in check.findings] == ["upper_arm"]
    assert re.search(said, str(check))
    check.write(tmp_path / "repaired.urdf")
    got, expected = Chain.from_urdf(tmp_path / "repaired.urdf"), Chain.from_urdf(FOLDER / "ur5e.urdf")
    np.testing.assert_allclose(got.bodies[1].number_values(), expected.bodies[1].number_values(), rtol=1e-9, atol=1e-12)
    strip = re.compile(r"<inertial>.*?</inertial>", re.DOTALL)
    assert strip.sub("", (tmp_path / "repaired.urdf").read_text()) == strip.sub("", sound)
    with pytest.raises(ValueError, match="target must be a new file"):
        check.write(path)


def test_an_impossible_inertia_without_evidence_has_no_repair(tmp_path):
    path = tmp_path / "r.urdf"
    path.write_text(
        '<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="5"/></inertial></link>'
        '<joint name="j" type="revolute"><parent link="a"/><child link="b"/></joint></robot>'
    )
    (finding,) = check_model(path).findings
    assert finding.repair is None
    assert "an inertia that no body has; no repair is certain" in str(finding)
