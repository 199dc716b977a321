"""Calls that a new user gets wrong: each is refused in one line that says what was expected,
what came, what to do.
"""

import numpy as np
import pytest

from ctc import ComputedTorque
from ctc.figures import plot_comparison
from identification import Identification, find_gears, fit_torque, identify, spread, write_model
from plant import (
    Body,
    Chain,
    Drive,
    Dynamics,
    Link,
    P,
    Record,
    Rig,
    Table,
    check_model,
    puma560,
    read_records,
    read_robot,
    read_table,
    simulate,
    write_robot,
)
from plant.parts import Checkpoint

ARM, RIG, LAW, PATH = puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference()
DYNAMICS, NOTHING = ARM.dynamics, np.empty((0, 2))


@pytest.fixture(scope="module")
def record():
    return simulate(ARM, RIG, LAW, PATH, duration=0.07)


CALLS = {
    "swapped arm and rig": (
        lambda r: simulate(RIG, ARM, LAW, PATH),
        "arm must be of type Arm; got a value of type Rig",
    ),
    "swapped law and path": (lambda r: simulate(ARM, RIG, PATH, LAW), "law must be of type Law"),
    "equations, not an arm": (
        lambda r: simulate(DYNAMICS, RIG, LAW, PATH),
        "arm must be of type Arm",
    ),
    "points, not a reference": (
        lambda r: simulate(ARM, RIG, LAW, np.zeros((9, 2))),
        "reference must be of type Reference",
    ),
    "a class, not a law": (lambda r: simulate(ARM, RIG, P, PATH), "got the class P"),
    "nothing to follow": (
        lambda r: simulate(ARM, RIG, LAW),
        "missing a required argument: 'reference'",
    ),
    "an arm, not equations": (lambda r: identify(ARM, r), "dynamics must be of type Dynamics"),
    "a name, not names": (lambda r: identify(DYNAMICS, r, unknown="f1"), r"Write \('f1',\)"),
    "part of f": (
        lambda r: identify(DYNAMICS, r, unknown=["f1"], ranges=[(0, 1)]),
        "equal ends of its range",
    ),
    "one seed": (lambda r: spread(DYNAMICS, r, seeds=5), "seeds must be two or more"),
    "a seed twice": (lambda r: spread(DYNAMICS, r, seeds=(0, 0)), "seeds must differ"),
    "seeds and a seed": (lambda r: spread(DYNAMICS, r, seeds=(0, 1), seed=3), "got seed=3"),
    "an arm, not a rig": (lambda r: LAW.start(ARM, (0, 0)), "rig must be of type Rig"),
    "swapped parts": (
        lambda r: Rig(drive=RIG.encoder, encoder=RIG.drive, period=1e-3),
        "drive of Rig must be of type Drive",
    ),
    "a name, not a lumping": (
        lambda r: Dynamics(chain=DYNAMICS.chain, lumping="standard"),
        "must be of type Lumping",
    ),
    "numbers, not bodies": (lambda r: DYNAMICS.f([1, 2]), "must be of type Body"),
    "a body too few": (
        lambda r: DYNAMICS.f([Body(mass=1, com=(0, 0, 0), inertia=(0,) * 6)]),
        "bodies must be 2",
    ),
    "negative mass": (
        lambda r: Body(mass=-1, com=(0, 0, 0), inertia=(0,) * 6),
        "mass must not be negative",
    ),
    "negative gain": (lambda r: P(gain=(-1, 1)), "gain must not be negative"),
    "no names": (lambda r: Link("1", 0, 0, 0), "too many positional arguments"),
    "half a drive": (lambda r: Drive(gear=(1,)), "missing a required argument: 'motor_inertia'"),
    "no rig": (lambda r: ComputedTorque(ARM), "rig of ComputedTorque must be of type Rig"),
    "text for a flag": (lambda r: ComputedTorque(ARM, RIG, friction="no"), "must be of type bool"),
    "no laws": (lambda r: plot_comparison({}), "got none"),
    "no samples": (
        lambda r: Record(t=[], reference_pulses=NOTHING, error_pulses=NOTHING, rig=RIG),
        "got none",
    ),
    "names, not values": (
        lambda r: fit_torque(DYNAMICS, r, known=["f3"]),
        "known must be of type Mapping; got a value of type list",
    ),
    "names, not columns": (lambda r: fit_torque(DYNAMICS, r, extra=["f3"]), "extra must be of"),
    "a number, not names": (
        lambda r: fit_torque(DYNAMICS, r, unknown=3),
        "unknown must be a sequence of names; got 3",
    ),
    "no rows": (
        lambda r: fit_torque(DYNAMICS, NOTHING, NOTHING, rig=RIG),
        "q must hold samples; got none",
    ),
    "no such joint": (lambda r: fit_torque(DYNAMICS, r, joints=7), "a joint must be one of"),
    "no records": (
        lambda r: find_gears(ARM, None),
        "records must be at least one Record; got NoneType",
    ),
    "letters, not counts": (
        lambda r: RIG.cell_centre([1.5, "a"]),
        r"counts must be numbers of shape \(2,\)",
    ),
    "a count too many": (
        lambda r: RIG.cell_centre([[1, 2, 3]]),
        r"counts must have shape \(1, 2\); got shape \(1, 3\)",
    ),
    "an unknown angle": (lambda r: RIG.counts([np.nan, 1]), "q must be finite; got nan at index 0"),
    "an argument too many": (lambda r: r.check(3), "too many positional arguments"),
    "no folder": (
        lambda r: r.to_csv("nowhere/log.csv"),
        "target must be in a folder that is there; nowhere is not",
    ),
    "no folder of a law": (lambda r: LAW.save("nowhere/law.json"), "must be in a folder that is"),
    "misspelt column": (lambda r: Record.from_csv("log.csv", rigg=RIG), "Did you mean 'rig'"),
}


@pytest.mark.parametrize(("call", "message"), CALLS.values(), ids=CALLS)
def test_wrong_call_is_refused_in_one_line(record, call, message):
    with pytest.raises(ValueError, match=message) as refusal:
        call(record)
    assert "\n" not in str(refusal.value)


FILES = {
    "Record.from_csv": lambda r, path: Record.from_csv(path, rig=RIG),
    "Record.read": lambda r, path: Record.read(path, rig=RIG),
    "mapped": lambda r, path: Record.read(path, rig=RIG, columns={"counts": ["a", "b"]}),
    "read_records": lambda r, path: read_records(path, rig=RIG),
    "read_table": lambda r, path: read_table(path),
    "read_robot": lambda r, path: read_robot(path),
    "check_model": lambda r, path: check_model(path),
    "Chain.from_urdf": lambda r, path: Chain.from_urdf(path),
    "Chain.from_mjcf": lambda r, path: Chain.from_mjcf(path),
    "Table.from_csv": lambda r, path: Table.from_csv(path),
    "Identification.load": lambda r, path: Identification.load(path),
    "write_model": lambda r, path: write_model(ARM, path, "new.urdf"),
    "Record.to_csv": lambda r, path: r.to_csv(path),
    "Record.to_mcap": lambda r, path: r.to_mcap(path),
    "write_robot": lambda r, path: write_robot(read_robot("paper_puma560"), path),
    "Law.save": lambda r, path: LAW.save(path),
    "checkpoint": lambda r, path: Checkpoint(path, "identify"),
}


# An integer would be read as the number of an open file.
@pytest.mark.parametrize("call", FILES.values(), ids=FILES)
def test_a_number_is_no_path(record, call):
    with pytest.raises(ValueError, match=r"must be a path; got 3\. ") as refused:
        call(record, 3)
    assert "\n" not in str(refused.value)


def test_numbers_of_numpy_are_numbers():
    assert Rig(drive=RIG.drive, encoder=RIG.encoder, period=np.float32(0.5)).period == 0.5
    assert Link(name="1", alpha=np.int64(0), a=0, d=0).alpha == 0.0


def test_a_log_in_radians_is_refused(tmp_path, record):
    angles = np.column_stack([record.t, PATH(record.t).q, 1e-4 * record.error_pulses])
    np.savetxt(tmp_path / "log.csv", angles, delimiter=",")
    with pytest.raises(ValueError, match="must hold whole pulses"):
        Record.from_csv(tmp_path / "log.csv", rig=RIG, law=LAW)
