"""Write the data sets beside this file with LeRobot's own library: 0.3.3 makes version 2.1, 0.4.4
version 3.0.

    python make.py FOLDER

Each of two episodes (30 and 40 frames) is a motion of two joints; the commands are 0.001 rad ahead.
"""

import sys

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset


def angles(N, episode):
    t = np.arange(N) / 500
    return np.column_stack([0.8 * np.sin(2 * t + episode), 0.5 * np.cos(3 * t)]).astype(np.float32)


if __name__ == "__main__":
    pair = {"dtype": "float32", "shape": (2,), "names": ["shoulder.pos", "elbow.pos"]}
    features = {"observation.state": pair, "action": pair}
    data = LeRobotDataset.create(
        "two/joints", fps=500, root=sys.argv[1], features=features, use_videos=False
    )
    for episode in range(2):
        for q in angles(30 + 10 * episode, episode):
            frame = {"observation.state": q, "action": q + np.float32(0.001)}
            try:
                data.add_frame(frame | {"task": "move"})
            except (TypeError, ValueError):  # 0.3.3
                data.add_frame(frame, task="move")
        data.save_episode()
    if hasattr(data, "finalize"):
        data.finalize()
