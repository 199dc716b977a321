"""The one name of a joint in messages, tables and figures: the robot's own, with its place in q beside it."""

from collections.abc import Sequence


def joint_label(names: Sequence[str], joint: int) -> str:
    """Label of a joint by its place from 0: ``joint 2 (q[0])``, ``elbow_joint (q[2])``; ``joint q[0]`` if unnamed.

    See Also
    --------
    plant.joint_labels

    Examples
    --------
    >>> from plant import joint_label
    >>> joint_label(("shoulder", "elbow"), 1)
    'joint elbow (q[1])'
    """
    if not names:
        return f"joint q[{joint}]"
    return f"{'' if 'joint' in names[joint].lower() else 'joint '}{names[joint]} (q[{joint}])"


def joint_labels(names: Sequence[str], n: int) -> list[str]:
    """Labels of all n joints.

    See Also
    --------
    plant.joint_label

    Examples
    --------
    >>> from plant import joint_labels
    >>> joint_labels((), 2)
    ['joint q[0]', 'joint q[1]']
    """
    return [joint_label(names, joint) for joint in range(n)]
