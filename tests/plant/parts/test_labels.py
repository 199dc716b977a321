"""The one name of a joint, whatever the robot calls it."""

import pytest

from plant.parts.labels import joint_label, joint_labels


@pytest.mark.parametrize(
    ("names", "joint", "label"),
    [
        ((), 0, "joint q[0]"),
        (("2", "3"), 0, "joint 2 (q[0])"),
        (("base", "elbow_joint"), 1, "elbow_joint (q[1])"),
        (("base", "elbow_joint"), 0, "joint base (q[0])"),
        (("Joint_A1",), 0, "Joint_A1 (q[0])"),  # says itself that it is one
    ],
)
def test_label(names, joint, label):
    assert joint_label(names, joint) == label
    assert joint_labels(names, len(names) or 1)[joint] == label


def test_labels_tell_joints_apart():
    assert joint_labels((), 3) == ["joint q[0]", "joint q[1]", "joint q[2]"]
    assert len(set(joint_labels(("a", "a"), 2))) == 2
