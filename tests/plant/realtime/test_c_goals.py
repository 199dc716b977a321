"""C of a law above position servos: whole goals, the same as the running controller's."""

import dataclasses
import shutil
import subprocess

import numpy as np
import pytest
from servos import arm, rig

from ctc import ComputedTorque
from plant import Harmonics, MitDrive, simulate, write_replay

ARM = arm()
PATH = Harmonics(period=2.0, offset=(0.3, -0.2), cosine=((0,), (0,)), sine=((0.4,), (-0.4,)))
needs_c = pytest.mark.skipif(
    shutil.which("cc") is None or shutil.which("make") is None, reason="no C compiler or no make"
)


def run(*command, folder):
    return subprocess.run(  # noqa: S603
        [str(word) for word in command], cwd=folder, capture_output=True, text=True, check=True
    )


@needs_c
def test_goals_of_the_c_are_those_of_the_running_controller(tmp_path):
    loop = rig()
    law = ComputedTorque(ARM, loop)
    record = simulate(ARM, loop, law, PATH, duration=2.0)
    law.to_c(tmp_path, loop, guards=None, output="goal")
    run("make", folder=tmp_path)
    write_replay(record, tmp_path / "record.csv")
    lines = run(tmp_path / "controller", "record.csv", folder=tmp_path).stdout.splitlines()
    goals = np.loadtxt(lines, delimiter=",").astype(int)

    running = law.start(loop, record.counts[0], guards=None)
    motion = PATH(record.t)
    expected = []
    for counts, *state in zip(record.counts, *motion, strict=True):
        running.step(counts, *state)
        expected.append(running.goal)
    np.testing.assert_array_equal(goals, expected)
    assert np.ptp(goals, axis=0).min() > 400


def test_goals_are_refused_where_nothing_takes_them(tmp_path):
    law = ComputedTorque(ARM, rig(inner=None), bandwidth=30)
    with pytest.raises(ValueError, match="this one has none"):
        law.to_c(tmp_path, guards=None, output="goal")
    frames = rig(0.002, None)
    frames = dataclasses.replace(frames, inner=MitDrive.for_arm(ARM, frames, stiffness=40))
    with pytest.raises(ValueError, match="has MitDrive"):
        ComputedTorque(ARM, frames).to_c(tmp_path, guards=None, output="goal")
    # The guarded controller commands torques; its goals are `Running.goal`.
    with pytest.raises(ValueError, match="has an inner loop"):
        ComputedTorque(ARM, rig()).to_c(tmp_path, output="goal")
    assert not list(tmp_path.iterdir())
