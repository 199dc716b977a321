"""A joint has one label wherever it is named: by the law's arm, else by the drive's names, else
by its place in q.
"""

import dataclasses

import numpy as np
import packaged_arms
import pytest
from closed_loops import SampledP

from ctc import ComputedTorque
from plant import Dynamics, Harmonics, P, Record, simulate
from plant.simulation import DivergenceError

NAMES = tuple(
    f"{name}_joint"
    for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)
LABELS = [f"{name} (q[{i}])" for i, name in enumerate(NAMES)]
WHOLE = packaged_arms.puma560_rig()
BARE = dataclasses.replace(WHOLE, drive=dataclasses.replace(WHOLE.drive, joints=()))
RIG = dataclasses.replace(BARE, drive=dataclasses.replace(BARE.drive, joints=NAMES))
CHAIN = packaged_arms.puma560()
CHAIN = dataclasses.replace(
    CHAIN,
    links=tuple(
        dataclasses.replace(link, name=name) for link, name in zip(CHAIN.links, NAMES, strict=True)
    ),
)
SWINGS = Harmonics(
    period=4.0, offset=(0.0,) * 6, cosine=((0.2,),) * 6, sine=np.linspace(0.1, 0.6, 6)[:, None]
)
LAW = P(gain=(0.01,) * 6)


@pytest.fixture(scope="module")
def arm():
    dynamics = Dynamics.from_chain(CHAIN)
    return dynamics.arm(dynamics.f())


def record(rig, law=None):
    """Counts on the reference; the second joint's stand still for 0.5 s, the third's jump."""
    t = np.arange(4000) * rig.period
    commanded = rig.counts(SWINGS(t).q)
    counts = commanded.copy()
    counts[1000:1700, 1] = counts[1000, 1]
    counts[2000:, 2] += 5000
    return Record(
        t=t, reference_pulses=commanded, error_pulses=commanded - counts, rig=rig, law=law
    )


@pytest.mark.parametrize(
    ("rig", "labels"),
    [(RIG, LABELS), (BARE, [f"joint q[{i}]" for i in range(6)])],
    ids=["named", "without names"],
)
def test_the_table_of_a_checkup(rig, labels):
    text = str(record(rig).check()).splitlines()
    begin = next(i for i, line in enumerate(text) if line.startswith("check "))
    lines = text[begin : next(i for i, line in enumerate(text) if i > begin and ":" in line)]
    at = [lines[0].index(title) for title in ("check", "joint", "measured", "verdict")]
    for line in lines:
        cells = [line[begin:end] for begin, end in zip(at, [*at[1:], None], strict=True)]
        # each begins at its column
        assert all(cell == "" or cell[0] != " " for cell in map(str.rstrip, cells)), line
        assert all(cell.endswith("  ") for cell in cells[:3] if len(cell.rstrip()) and cells[3]), (
            line
        )
        assert cells[1].rstrip() in ("joint", "-", "all", *labels) or not any(
            cells[:2][0].split()
        ), line
        assert len(line) <= 80
    assert any(
        line.startswith("stuck encoder") and labels[1] in line and "wrong" in line for line in lines
    )
    assert any(line.startswith("jumps") and labels[2] in line and "wrong" in line for line in lines)


def test_the_law_s_arm_names_the_joints_before_the_drive(arm):
    law = ComputedTorque(arm, BARE)
    assert law.joint_labels(BARE) == LABELS
    assert LAW.joint_labels(RIG) == LABELS
    assert LAW.joint_labels(BARE) == BARE.joint_labels
    assert record(BARE, law).check().joint_labels == tuple(LABELS)


def test_a_guard():
    controller = LAW.start(RIG, np.zeros(6))
    rest = np.zeros(6)
    for counts in (rest, rest, 20000 * np.eye(6)[4]):
        controller.step(counts, rest, rest, rest)
    assert controller.status.startswith(
        f"running; bridged a jump of 20000 pulses of {LABELS[4]} at call 3"
    )


def test_messages_of_logs_and_exports(tmp_path):
    q = np.zeros((9, 6))
    q[:, 3] = np.linspace(0, 90, 9)
    with pytest.raises(ValueError, match=r"spans 14\.3 turns of wrist_1_joint \(q\[3\]\)"):
        Record.from_table({"q": q}, rig=RIG, columns={"position": "q"}, units={"position": "rad"})
    limited = dataclasses.replace(
        RIG, drive=dataclasses.replace(RIG.drive, current_limit=(1.0,) * 5 + (40.0,))
    )
    with pytest.raises(ValueError, match=r"40 A at wrist_3_joint \(q\[5\]\); it ends at 32\.767 A"):
        LAW.to_c(tmp_path, limited, output="dac", counts_per_ampere=(1000,) * 6)


def test_a_divergence(arm):
    stiff = SampledP(gain=(0.01, 0.01, 5.0, 0.01, 0.01, 0.01), period=BARE.period)
    with pytest.raises(
        DivergenceError, match=r"s, (shoulder|elbow|wrist)_\w*joint \(q\[\d\]\) first\. "
    ):
        simulate(arm, BARE, stiff, SWINGS, duration=0.5)
