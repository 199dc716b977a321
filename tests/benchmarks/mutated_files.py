"""Files of the library's own readers, spoilt as their structure is: how many are read, how long it
takes, what memory.

    python tests/benchmarks/mutated_files.py [mutations] [part of a file's name]

A saved identification, a saved rig, a checkpoint, a record, a path, models (URDF, xacro, MJCF) and
`check_model`. Half of the
mutations spoil bytes (tests/oracles/spoilt_files.py); half understand the text: a key, a number, a
row, an element is dropped, doubled, moved, or made into something else. Each must be read, or
refused in one line. Other formats: tests/benchmarks/corrupt_files.py.
"""

import json
import re
import resource
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "oracles"))
from spoilt_files import spoil
from strangers_models import Arm

from identification import Identification, identify
from plant import Chain, Record, Rig, Table, check_model, puma560, simulate
from plant.parts import Checkpoint

ODD = [
    None,
    True,
    -1,
    0,
    1e308,
    "x",
    "1_000",
    "١",
    [],
    {},
    [[[]]],
    {"kind": "plant.Rig"},
    {"float": "nan"},
    10**40,
]
URDF = """<robot name="r"><link name="base"/>
<link name="one"><inertial><origin xyz="0 0 0.1" rpy="0 0.1 0"/><mass value="2"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="first" type="revolute"><origin xyz="0 0 1"/>
<parent link="base"/><child link="one"/><axis xyz="0 1 0"/></joint>
</robot>
"""

MACRO = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="m" value="2"/>'
FRAME = '<frame pos="0 0 0.1"><body name="eye"><inertial pos="0 0 0" mass="0.1" diaginertia="1 1 1"/></body></frame>'
SECTIONS = (
    '<tendon><fixed name="t"><joint joint="grip" coef="1"/></fixed></tendon><equality><weld'
    ' body1="finger" body2="three"/></equality><actuator><motor joint="lift" gear="3" ctrlrange="-1'
    ' 1"/></actuator>'
)


def sound(folder):
    """Kind -> (file, what reads it)."""
    rig = puma560.rig()
    record = simulate(puma560.arm(), rig, puma560.p_law(), puma560.reference(), duration=0.3)
    found = identify(puma560.dynamics(), record, method="equation_error", progress=False)
    found.save(folder / "found.json")
    rig.save(folder / "rig.json")
    with Checkpoint(folder / "work.json", "work").bind(lambda: {"rig": rig}) as kept:
        kept.stage("fit", lambda: found.fit)

    def resumed(path):
        with Checkpoint(path, "work").bind(lambda: {"rig": rig}) as kept:
            return kept.stage("fit", lambda: found.fit)

    def repaired(path):
        check = check_model(path)
        str(check)
        check.write(folder / "repaired.urdf", overwrite=True)

    record.to_csv(folder / "record.csv")
    (folder / "path.csv").write_text("t, q_1\n" + "".join(f"{0.1 * i},{i}\n" for i in range(30)))
    (folder / "robot.urdf").write_text(URDF)
    # Files with a gripper, tendons and two sides, as strangers write them.
    arm = Arm(np.random.default_rng(0))
    names = ("base", "one", "two", "left_finger", "right_finger")
    (folder / "tree.urdf").write_text(arm.urdf(names=names))
    (folder / "check.urdf").write_text(arm.urdf(names=names))
    (folder / "macro.xacro").write_text(arm.urdf().replace('<robot name="r">', MACRO))
    (folder / "robot.xml").write_text(arm.mjcf(within=FRAME, more=SECTIONS))
    return {
        "found.json": Identification.load,
        "rig.json": Rig.load,
        "work.json": resumed,
        "record.csv": Record.from_csv,
        "path.csv": Table.from_csv,
        "robot.urdf": Chain.from_urdf,
        "tree.urdf": lambda path: Chain.from_urdf(path, tip="two"),
        "macro.xacro": lambda path: Chain.from_urdf(path, tip="two"),
        "robot.xml": lambda path: Chain.from_mjcf(path, tip="three"),
        "check.urdf": repaired,
    }


def places(data, at=()):
    """Where every value in a JSON text is."""
    yield at
    for key, value in (
        data.items()
        if isinstance(data, dict)
        else enumerate(data)
        if isinstance(data, list)
        else ()
    ):
        yield from places(value, (*at, key))


def mutated_json(text, every, rng):
    data = json.loads(text)
    for _ in range(rng.integers(1, 3)):
        at = every[int(rng.integers(1, len(every)))]
        owner = data
        try:
            for key in at[:-1]:
                owner = owner[key]
            match int(rng.integers(4)):
                case 0:
                    del owner[at[-1]]
                case 1:
                    owner[at[-1]] = ODD[int(rng.integers(len(ODD)))]
                case 2:
                    owner[at[-1]] = [owner[at[-1]]] * 3
                case 3:
                    owner["x" if isinstance(owner, dict) else 0] = owner[at[-1]]
        except (LookupError, TypeError):
            continue
    return json.dumps(data)


def mutated_text(text, rng):
    """A word, a number or a line dropped, doubled, moved or made into something else."""
    pattern = (r"[^\s,<>=\"]+", r"[-+]?\d[\d.e+-]*", r"[^\n]*\n", r"<[^>]*>")[int(rng.integers(4))]
    found = list(re.finditer(pattern, text)) or list(re.finditer(r".", text))
    for _ in range(rng.integers(1, 3)):
        one, other = (found[int(i)] for i in rng.integers(len(found), size=2))
        new = ["", one[0] * 2, other[0], str(ODD[int(rng.integers(len(ODD)))]), "9" * 400][
            int(rng.integers(5))
        ]
        text = text[: one.start()] + new + text[one.end() :]
    return text


def main(mutations, only=""):
    warnings.simplefilter("ignore")
    print(
        f"{'file':12}{'read':>8}{'refused':>9}{'slowest [s]':>13}{'peak memory [MB] beyond the start':>35}"
    )
    with tempfile.TemporaryDirectory() as folder:
        for name, read in sound(Path(folder)).items():
            if only not in name:
                continue
            path, rng = Path(folder, name), np.random.default_rng(17)
            whole = path.read_bytes()
            every = list(places(json.loads(whole))) if name.endswith("json") else []
            before, read_some, slowest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, 0, 0.0
            for i in range(mutations):
                if i % 2:
                    path.write_bytes(spoil(whole, rng))
                elif every:
                    path.write_text(mutated_json(whole, every, rng))
                else:
                    path.write_text(mutated_text(whole.decode(), rng))
                began = time.perf_counter()
                try:
                    read(path)
                    read_some += 1
                except ValueError as error:
                    if "\n" in str(error) or len(str(error)) > 1000:
                        raise RuntimeError(f"not a message: {error!r}") from None
                slowest = max(slowest, time.perf_counter() - began)
            peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
            print(
                f"{name:12}{read_some:8}{mutations - read_some:9}{slowest:13.2f}{peak:35.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3000, *sys.argv[2:3])
