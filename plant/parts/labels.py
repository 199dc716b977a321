"""The one name of a joint in messages, tables and figures: the robot's own, with its place in q beside it."""

from collections.abc import Sequence


def joint_label(names: Sequence[str], joint: int) -> str:
    """Label of a joint by its place from 0: ``joint 2 (q[0])``, ``elbow_joint (q[2])``; ``joint q[0]`` if unnamed."""
    if not names:
        return f"joint q[{joint}]"
    return f"{'' if 'joint' in names[joint].lower() else 'joint '}{names[joint]} (q[{joint}])"


def joint_labels(names: Sequence[str], n: int) -> list[str]:
    """Labels of all n joints."""
    return [joint_label(names, joint) for joint in range(n)]
