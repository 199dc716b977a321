"""What is proved is named, and only what one mistake explains is repaired: no right number moves."""

import importlib.util
import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from plant import check_model

_SPEC = importlib.util.spec_from_file_location(
    "strangers_models", Path(__file__).parents[2] / "benchmarks" / "strangers_models.py"
)
strangers_models = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(strangers_models)

KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def text_of(values):
    return " ".join(repr(float(value)) for value in np.atleast_1d(values))


def body(random, size=1.0):
    """Mass, centre and inertia (3, 3) of a cloud of points, of some 0.2 m."""
    points = size * random.normal(size=(30, 3)) * random.uniform(0.03, 0.12, 3)
    mass = random.uniform(0.5, 4) * size**3
    com = points.mean(axis=0) + size * random.uniform(0.02, 0.1, 3)
    spread = mass * np.cov(points.T, bias=True)
    return mass, com, np.trace(spread) * np.eye(3) - spread


def mirrored(made, motion):
    mass, com, inertia = made
    return mass, motion @ com, motion @ inertia @ motion.T


def written(path, links, joints=(), more="", shapes=None):
    """Links name -> (mass, com, inertia); joints (parent, child, xyz), revolute ones."""
    text = '<robot name="r">\n'
    for name, made in links.items():
        text += f'<link name="{name}">'
        if made is not None:
            mass, com, inertia = made
            six = " ".join(
                f'{key}="{text_of(value)}"'
                for key, value in zip(KEYS, np.asarray(inertia)[np.triu_indices(3)], strict=True)
            )
            text += (
                f'<inertial><origin xyz="{text_of(com)}"/><mass value="{text_of(mass)}"/>'
                f"<inertia {six}/></inertial>"
            )
        text += (shapes or {}).get(name, "") + "</link>\n"
    for parent, child, xyz in joints:
        text += (
            f'<joint name="to_{child}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{text_of(xyz)}"/><axis xyz="0 0 1"/></joint>\n'
        )
    path.write_text(text + more + "</robot>")
    return path


def row(names, length=0.3):
    """Joints of links in a row."""
    return [(parent, child, (length, 0, 0)) for parent, child in itertools.pairwise(names)]


def arm(random, n=5):
    links = {"base": None} | {f"link{i}": body(random) for i in range(n)}
    return links, row(list(links))


def findings(path):
    return {finding.joint or finding.link: finding for finding in check_model(path).findings}


def steiner(mass, com):
    return mass * (com @ com * np.eye(3) - np.outer(com, com))


@pytest.mark.parametrize("seed", range(3))
def test_a_parallel_axis_term_taken_off_twice_is_no_sign(tmp_path, seed):
    """The common mistake of all links that no body can be is named; which number is wrong is open."""
    random = np.random.default_rng(seed)
    links, joints = arm(random)
    for name in ("link0", "link2", "link4"):
        mass, com, inertia = links[name]
        com = com * 0.2 / np.linalg.norm(com) + np.array([0.2, 0, 0])
        links[name] = mass, com, inertia - steiner(mass, com)
    named = findings(written(tmp_path / "arm.urdf", links, joints))
    assert sorted(named) == ["link0", "link2", "link4"]
    for finding in named.values():
        assert finding.repair is None
        assert "parallel-axis term" in finding.mistake


def test_signs_turned_in_four_links_are_repaired(tmp_path):
    random = np.random.default_rng(4)
    links, joints = arm(random)
    sound = dict(links)
    for i in range(4):
        mass, com, inertia = links[f"link{i}"]
        signs = np.ones((3, 3)) - 2 * np.diag([1.0, 1.0, 0.0])
        links[f"link{i}"] = mass, com, inertia * signs
    named = findings(written(tmp_path / "arm.urdf", links, joints))
    assert sorted(named) == [f"link{i}" for i in range(4)]
    for name, finding in named.items():
        np.testing.assert_allclose(
            finding.repair.inertia, sound[name][2][np.triu_indices(3)], rtol=1e-12
        )


BOX = '<collision><geometry><box size="{}"/></geometry></collision>'


@pytest.mark.parametrize("moment", [1.0, 100.0, 0.1])
def test_a_placeholder_is_a_finding_of_its_own(tmp_path, moment):
    """Of a link with a box, and of one without a shape; nothing says what the inertia is."""
    random = np.random.default_rng(5)
    links, joints = arm(random)
    for name in ("link1", "link3"):
        links[name] = *links[name][:2], moment * np.eye(3)
    shapes = {"link1": BOX.format("0.08 0.05 0.3")}
    named = findings(written(tmp_path / "arm.urdf", links, joints, shapes=shapes))
    assert sorted(named) == ["link1", "link3"]
    assert all(f"placeholder for the inertia ({moment:.3g}" in f.mistake for f in named.values())
    assert all(finding.repair is None for finding in named.values())


def test_one_inertia_for_all_links_is_a_placeholder(tmp_path):
    random = np.random.default_rng(6)
    links, joints = arm(random)
    inertia = links["link0"][2]
    links = {name: made and (*made[:2], inertia) for name, made in links.items()}
    named = findings(written(tmp_path / "arm.urdf", links, joints))
    assert len(named) == 5
    assert all("the same in all 5 links" in finding.mistake for finding in named.values())


IN_Y = (np.diag([1.0, -1.0, 1.0]),)


def two_sides(random, motions=IN_Y):
    """Two arms of two links, of which the right one is the left one after motions."""
    links, joints = {"torso": body(random, 2)}, []
    for side, sign in (("left", 1), ("right", -1)):
        names = [f"{side}_upper", f"{side}_lower"]
        for i, name in enumerate(names):
            left = links.get(name.replace("right", "left")) or body(random)
            motion = motions[i % len(motions)]
            links[name] = left if side == "left" else mirrored(left, motion)
        joints += [("torso", names[0], (0, 0.2 * sign, 0.3)), (*names, (0, 0.05 * sign, 0.3))]
    return links, joints


@pytest.mark.parametrize("factor", [1e6, 1e9])
def test_the_same_mistake_on_both_sides_is_named_on_both(tmp_path, factor):
    links, joints = two_sides(np.random.default_rng(7))
    for side in ("left", "right"):
        mass, com, inertia = links[f"{side}_lower"]
        links[f"{side}_lower"] = mass, com, factor * inertia
    named = findings(written(tmp_path / "arms.urdf", links, joints))
    assert sorted(named) == ["left_lower", "right_lower"]
    kinds = {finding.mistake for finding in named.values()}
    assert len(kinds) == 1


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("dust", [0.0, 3e-20])
def test_a_missing_inertia_is_that_of_the_other_side_where_the_centre_says(tmp_path, axis, dust):
    """The centre of mass states in which plane the link is mirrored; it stays, and so does the
    mass, to the byte.
    """
    random = np.random.default_rng(8 + axis)
    plane = np.diag([1.0 - 2 * (i == axis) for i in range(3)])
    links, joints = two_sides(random, (np.diag([1.0, -1.0, 1.0]), plane))
    sound = links["right_lower"]
    links["right_lower"] = *sound[:2], dust * random.normal(size=(3, 3)).round() * np.eye(3)
    path = written(tmp_path / "arms.urdf", links, joints)
    check = check_model(path)
    (finding,) = check.findings
    assert (finding.link, finding.mistake) == ("right_lower", "no inertia")
    np.testing.assert_allclose(finding.repair.inertia, sound[2][np.triu_indices(3)], rtol=1e-12)
    check.write(tmp_path / "repaired.urdf")
    strip = re.compile(r"<inertia [^>]*>")
    assert strip.sub("", (tmp_path / "repaired.urdf").read_text()) == strip.sub(
        "", path.read_text()
    )


def test_no_inertia_is_taken_from_a_side_that_states_another_link(tmp_path):
    links, joints = two_sides(np.random.default_rng(11))
    mass, com, _ = links["right_lower"]
    for other in ((1.2 * mass, com), (mass, com + np.array([0.05, 0, 0]))):
        links["right_lower"] = *other, np.zeros((3, 3))
        (finding,) = check_model(written(tmp_path / "arms.urdf", links, joints)).findings
        assert finding.repair is None


def test_products_too_small_to_tell_keep_their_signs(tmp_path):
    """Negative moments: the signs of all entries, or of the moments alone, leave one body."""
    random = np.random.default_rng(13)
    links = {name: body(random) for name in ("base", "one", "two", "three")}
    mass, com, inertia = links["two"]
    products = 1e-5 * np.where(np.eye(3, dtype=bool), 0.0, inertia)
    links["two"] = mass, com, products - np.diag(np.diag(inertia))
    joints = [
        ("base", "one", (0, 0, 0.3)),
        ("one", "two", (0, 0, 0.3)),
        ("two", "three", (0.3, 0, 0)),
    ]
    (finding,) = check_model(written(tmp_path / "arm.urdf", links, joints)).findings
    expected = products + np.diag(np.diag(inertia))
    np.testing.assert_array_equal(finding.repair.inertia, expected[np.triu_indices(3)])


def test_no_inertia_is_taken_from_a_side_that_lacks_the_products(tmp_path):
    """The other side states zeros where every other link has products: some were left out there."""
    links, joints = two_sides(np.random.default_rng(12))
    mass, com, inertia = links["right_lower"]
    links["right_lower"] = mass, com, np.zeros((3, 3))
    (finding,) = check_model(written(tmp_path / "arms.urdf", links, joints)).findings
    assert finding.repair is not None
    links["left_lower"] = *links["left_lower"][:2], np.diag(np.diag(inertia))
    (finding,) = check_model(written(tmp_path / "arms.urdf", links, joints)).findings
    assert (finding.link, finding.mistake) == ("right_lower", "no inertia")
    assert finding.repair is None


@pytest.mark.parametrize("signs", [(-1, -1, 1), (-1, 1, -1), (1, -1, -1), (-1, -1, -1), (1, 1, 1)])
def test_a_finger_may_be_its_twin_turned_by_half_a_turn(tmp_path, signs):
    random = np.random.default_rng(12)
    finger = body(random, 0.3)
    links = {"base": body(random), "palm": body(random), "left_finger": finger}
    links["right_finger"] = mirrored(finger, np.diag(np.array(signs, float)))
    joints = [("base", "palm", (0, 0, 0.3)), ("palm", "left_finger", (0, 0.03, 0.1))]
    joints += [("palm", "right_finger", (0, -0.03, 0.1))]
    assert check_model(written(tmp_path / "hand.urdf", links, joints)).ok


def test_exchanged_axes_that_one_joint_leaves_open_give_no_repair(tmp_path):
    """The joint of one palm is along x, that of the other along y: eight motions fit."""
    random = np.random.default_rng(5)
    palm, tip = body(random), body(random, 0.5)
    links = {"torso": body(random, 2), "left_palm": palm, "right_palm": None}
    links |= {"left_tip": tip, "right_tip": mirrored(tip, *IN_Y)}
    joints = [("torso", "left_palm", (0, 0.2, 0.3)), ("torso", "right_palm", (0, -0.2, 0.3))]
    joints += [("left_palm", "left_tip", (0.1, 0, 0)), ("right_palm", "right_tip", (0, 0.1, 0))]
    (finding,) = check_model(written(tmp_path / "arms.urdf", links, joints)).findings
    assert (finding.link, finding.mistake) == ("right_palm", "no inertial")
    assert finding.repair is None


def test_the_order_of_joints_in_the_file_is_no_evidence(tmp_path):
    """Of a palm with a thumb and a finger that stand as if mirrored."""
    random = np.random.default_rng(5)
    palm, tip = body(random), body(random, 0.3)
    links = {"torso": body(random, 2), "left_palm": palm, "right_palm": None}
    joints = [
        ("torso", f"{side}_palm", (0, y, 0.3)) for side, y in (("left", 0.2), ("right", -0.2))
    ]
    for side, sign in (("left", 1), ("right", -1)):
        for name, y in (("thumb", 0.04), ("finger", -0.04)):
            links[f"{side}_{name}"] = mirrored(tip, np.diag([1, sign, 1]))
            joints.append((f"{side}_palm", f"{side}_{name}", (0.02, sign * y, 0.1)))
    for order in (joints, [*joints[:4], *joints[:3:-1]]):
        (finding,) = check_model(written(tmp_path / "arms.urdf", links, order)).findings
        np.testing.assert_allclose(finding.repair.com, mirrored(palm, *IN_Y)[1], rtol=1e-12)


def test_a_side_may_stand_in_a_name_after_a_word_that_holds_it(tmp_path):
    """A link without an inertial is no frame if there is one on the other side."""
    links, joints = two_sides(np.random.default_rng(8))
    links["right_lower"] = None
    links = {f"upright_{name}": made for name, made in links.items()}
    joints = [(f"upright_{parent}", f"upright_{child}", xyz) for parent, child, xyz in joints]
    (finding,) = check_model(written(tmp_path / "arms.urdf", links, joints)).findings
    assert (finding.link, finding.mistake) == ("upright_right_lower", "no inertial")


CYLINDER = '<collision><geometry><cylinder radius="{}" length="0.3"/></geometry></collision>'


@pytest.mark.parametrize("form", [BOX.format("-0.3 -0.3 0.3"), CYLINDER.format(-0.3)])
def test_a_shape_of_negative_size_says_nothing(tmp_path, form):
    links, joints = arm(np.random.default_rng(3))
    shapes = {"link2": form}
    assert check_model(written(tmp_path / "arm.urdf", links, joints, shapes=shapes)).ok


def test_a_rod_whose_least_moment_is_zero_is_a_body(tmp_path):
    """As much rounded as one whose least moment is hardly above zero; more is a slip."""
    links, joints = arm(np.random.default_rng(3))
    mass, com, _ = links["link2"]
    for least in (0.0, 1e-9):
        links["link2"] = mass, com, np.diag([least, 0.01, 0.010005])
        assert check_model(written(tmp_path / "arm.urdf", links, joints)).ok
        links["link2"] = mass, com, np.diag([least, 0.01, 0.0102])
        (finding,) = check_model(written(tmp_path / "arm.urdf", links, joints)).findings
        assert "misses the triangle inequality by 2 %" in finding.mistake


def test_two_candidates_leave_no_repair(tmp_path):
    """A scale of 100 between g and kg mm^2: the inertia of neither is far better in an arm without
    shapes.
    """
    random = np.random.default_rng(13)
    links, joints = arm(random)
    mass, com, inertia = links["link2"]
    links["link2"] = mass, com, 3e4 * inertia
    (finding,) = check_model(written(tmp_path / "arm.urdf", links, joints)).findings
    assert (finding.link, finding.repair) == ("link2", None)


def test_degrees_and_millimetres_of_joints(tmp_path):
    links, joints = arm(np.random.default_rng(14))
    path = written(tmp_path / "arm.urdf", links, joints)
    sound = path.read_text()
    assert check_model(path).ok
    limit = '<limit lower="{}" upper="{}" effort="1" velocity="1"/></joint>'
    for joint, wrong, said in (
        ("to_link2", {"</joint>": limit.format(-135, 150)}, r"degrees for radians \(limits\)"),
        (
            "to_link1",
            {'xyz="0.3 0.0 0.0"/>': 'xyz="0.3 0 0" rpy="0 -90 0"/>'},
            r"degrees for radians \(rpy",
        ),
        ("to_link3", {'xyz="0.3 0.0 0.0"': 'xyz="300 0 0"'}, r"millimetres for metres \(xyz"),
    ):
        head, tail = sound.split(f'<joint name="{joint}"')
        for old, new in wrong.items():
            tail = tail.replace(old, new, 1)
        path.write_text(f'{head}<joint name="{joint}"{tail}')
        (finding,) = check_model(path).findings
        assert finding.joint == joint
        assert re.search(said, finding.mistake)
        assert joint in str(finding)
    for right in ((-6.28, 6.28), (-12.5, 12.5), (-1000, 1000), (-1e16, 1e16)):
        path.write_text(sound.replace("</joint>", limit.format(*right)))
        assert check_model(path).ok


def test_the_mass_of_the_robot_on_one_link(tmp_path):
    links, joints = arm(np.random.default_rng(15), n=8)
    total = sum(made[0] for made in links.values() if made)
    links["link6"] = total, *links["link6"][1:]
    (finding,) = check_model(written(tmp_path / "arm.urdf", links, joints)).findings
    assert (finding.link, finding.repair) == ("link6", None)
    assert "mass of the whole robot" in finding.mistake


def test_what_hardly_weighs_does_no_harm(tmp_path):
    """Frames that a simulator wants to have a mass."""
    links, joints = arm(np.random.default_rng(16))
    links["tip"] = 1e-4, np.zeros(3), 1e-7 * np.eye(3)
    links["flange"] = 1e-5, np.zeros(3), np.zeros((3, 3))
    joints += [("link4", "tip", (0.1, 0, 0)), ("tip", "flange", (0, 0, 0))]
    assert check_model(written(tmp_path / "arm.urdf", links, joints)).ok


def test_a_slip_and_what_is_no_number_are_named(tmp_path):
    links, joints = arm(np.random.default_rng(17))
    mass, com, inertia = links["link1"]
    moments, axes = np.linalg.eigh(inertia)
    moments[2] = 1.04 * (moments[0] + moments[1])
    links["link1"] = mass, com, axes @ np.diag(moments) @ axes.T
    path = written(tmp_path / "arm.urdf", links, joints)
    mass = text_of(links["link3"][0])
    path.write_text(path.read_text().replace(f'value="{mass}"', 'value="1,7"'))
    named = findings(path)
    assert sorted(named) == ["link1", "link3"]
    assert "misses the triangle inequality by 3.8 %" in named["link1"].mistake
    assert "mass" in named["link3"].mistake or "value" in named["link3"].mistake
    assert all(finding.repair is None for finding in named.values())


def test_the_numbers_of_a_macro_are_checked(tmp_path):
    pytest.importorskip("xacrodoc")
    links, joints = arm(np.random.default_rng(18))
    path = written(tmp_path / "arm.urdf", links, joints)
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    head += '<xacro:property name="m" value="-2.0"/>'
    mass = text_of(links["link3"][0])
    text = path.read_text().replace('<robot name="r">', head).replace(f'"{mass}"', '"${m}"')
    path.write_text(text)
    check = check_model(path)
    assert [finding.link for finding in check.findings] == ["link3"]
    with pytest.raises(ValueError, match=r"is xacro\. Expand it first"):
        check.write(tmp_path / "repaired.urdf")


def test_models_of_strangers_are_read_or_refused_with_the_right_word():
    """46 variants with other numbers than the benchmark's."""
    pytest.importorskip("mujoco")
    pytest.importorskip("xacrodoc")
    wrong = {name: said for name, said in strangers_models.variants(seed=71).items() if said}
    assert not wrong
