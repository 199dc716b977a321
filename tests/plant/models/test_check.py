"""The doctor: mistakes of every kind are found and undone, sound files are left alone, and only
repairs are written.
"""

import importlib.util
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from model_texts import urdf

from plant import Chain, check_model
from plant.models import FOLDER, CheckedLink, Inertial, Links, cost_of, zero

_SPEC = importlib.util.spec_from_file_location(
    "broken_models", Path(__file__).parents[2] / "benchmarks" / "broken_models.py"
)
broken_models = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(broken_models)


def test_every_mistake_of_a_robot_with_two_sides_is_named():
    """The other side tells what is right, and its evidence which side it is; none is made worse."""
    found, repaired, wrong, alarms, failed = broken_models.study(count=18, seed=3)
    assert (found, wrong, alarms) == (18, 0, 0), failed
    assert repaired >= 12


def test_alone_no_sound_file_is_blamed():
    _, repaired, wrong, alarms, _ = broken_models.study(count=18, seed=4, pairs=False)
    assert (wrong, alarms) == (0, 0)
    assert repaired >= 4


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
        (lambda t: t.replace('iyy="0.143231"', 'iyy="1.43231"'), "a decimal point of a moment"),
    ],
)  # fmt: skip
def test_a_link_alone_that_is_impossible_in_its_shape(tmp_path, wrong, said):
    """Then the repaired file is the sound one to the last digit of its numbers, and to the byte
    elsewhere.
    """
    sound = (FOLDER / "ur5e.urdf").read_text()
    path = tmp_path / "broken.urdf"
    path.write_text(wrong(sound))
    assert path.read_text() != sound
    check = check_model(path)
    assert [finding.link for finding in check.findings] == ["upper_arm"]
    assert re.search(said, str(check))
    check.write(tmp_path / "repaired.urdf")
    got, expected = (
        Chain.from_urdf(tmp_path / "repaired.urdf"),
        Chain.from_urdf(FOLDER / "ur5e.urdf"),
    )
    np.testing.assert_allclose(
        got.bodies[1].number_values(), expected.bodies[1].number_values(), rtol=1e-9, atol=1e-12
    )
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


def test_matter_is_not_so_dense_without_a_shape_either(tmp_path):
    """A ball of its mass and second moments would have 1,000 times the density of steel."""
    path = tmp_path / "robot.urdf"
    path.write_text(
        '<robot name="r"><link name="a"><inertial><mass value="2"/><inertia ixx="0.02" ixy="0"'
        ' ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial></link><link name="b"><inertial><origin'
        ' xyz="0 0 0.1"/><mass value="300"/><inertia ixx="0.2" ixy="0" ixz="0" iyy="0.2" iyz="0"'
        ' izz="0.1"/></inertial></link><joint name="j" type="revolute"><parent link="a"/><child'
        ' link="b"/><origin xyz="0 0 1"/></joint></robot>'
    )
    check = check_model(path)
    assert [finding.link for finding in check.findings] == ["b"]
    assert "grams for kilograms" in str(check)
    np.testing.assert_allclose(check.findings[0].repair.mass, 0.3, rtol=1e-12)


@pytest.mark.parametrize("excess", [0.0, 5e-5])
def test_a_rounded_inertia_hides_no_other_proof(tmp_path, excess):
    """A plate whose moments miss the triangle inequality by the rounding of their digits."""
    path = tmp_path / "robot.urdf"
    path.write_text(
        '<robot name="r"><link name="a"/><link name="b"><inertial><mass value="300"/><inertia'
        f' ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="{0.2 + excess}"/></inertial></link>'
        '<joint name="j" type="revolute"><parent link="a"/><child link="b"/></joint></robot>'
    )
    (finding,) = check_model(path).findings
    assert finding.link == "b"
    assert excess == 0.0 or finding.mistake == "denser than any matter"


def test_a_partner_without_a_mass_is_no_evidence():
    body = Inertial(2.0, np.zeros(3), np.eye(3), np.diag([0.02, 0.02, 0.01]))
    alone = CheckedLink("a", body, None, np.empty((0, 3)))
    massless = replace(body, mass=0.0)
    beside = replace(alone, partners=[(massless, np.eye(3))])
    links = Links(a=alone)
    assert cost_of(body, beside, links) == cost_of(body, alone, links)


def test_an_inertia_of_zeros_is_zero_without_a_mass_too():
    assert zero(Inertial(0.0, np.zeros(3), np.eye(3), np.zeros((3, 3))))


def test_one_mistake_in_both_sides_is_undone_in_both(tmp_path):
    random = np.random.default_rng(2)
    links, path = broken_models.robot(random), tmp_path / "robot.urdf"
    wrong = {
        name: (*row[:3], row[3], 1e3 * row[4], 1e6 * row[5]) if name.endswith("_1") else row
        for name, row in links.items()
    }
    path.write_text(broken_models.written(wrong))
    findings = {finding.link: finding.repair for finding in check_model(path).findings}
    assert sorted(findings) == ["left_1", "right_1"]
    for name, repair in findings.items():
        np.testing.assert_allclose(repair.com, links[name][4], rtol=1e-9)


def test_a_link_without_an_inertial_is_named_beside_a_mistake_of_its_partner(tmp_path):
    """Filled boxes; the inertia of the right one is about the frame of its link."""
    path = tmp_path / "robot.urdf"
    place = '<origin xyz="0 0 0.2"/>'
    box = f'<visual>{place}<geometry><box size="0.1 0.2 0.3"/></geometry></visual>'
    about_centre = 'ixx="0.065" iyy="0.05" izz="0.025"'
    inertias = {
        "left_arm": "",
        "right_arm": 'ixx="0.305" iyy="0.29" izz="0.025"',
        "a": about_centre,
        "b": about_centre,
    }
    text = '<robot name="r"><link name="base"/>'
    for name, moments in inertias.items():
        inertia = f'<inertia {moments} ixy="0" ixz="0" iyz="0"/>'
        inertial = f'<inertial>{place}<mass value="6"/>{inertia}</inertial>' if moments else ""
        text += (
            f'<link name="{name}">{inertial}{box}</link><joint name="of_{name}" type="revolute">'
            f'<parent link="base"/><child link="{name}"/></joint>'
        )
    path.write_text(f"{text}</robot>")
    left, right = check_model(path).findings
    assert (left.link, left.mistake) == ("left_arm", "no inertial")
    assert right.link == "right_arm"
    np.testing.assert_allclose(right.repair.inertia[[0, 3, 5]], (0.065, 0.05, 0.025))
