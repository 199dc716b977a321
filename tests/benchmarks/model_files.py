"""Public model files: each arm simulated, by the library and by MuJoCo, identified from the log, and controlled.

    python tests/benchmarks/model_files.py [--robots PART ...] [--paths 3] [--mujoco] [--law] [--friction]
        [--idle still step] [--rows FILE] [--write]

Arms of 5 to 7 joints, arms and legs of humanoids included, of the package `example-robot-data` (the extra `robots`).
Gears of 100, 4,096 pulses per turn of the motor, 1 ms; rotors of 0.3 of the mean inertia of their axis, dry friction of
5 % of the largest torque of the path. The log is of 6 s, under `p_gains` for a peak of 30 pulses (100 where that is
refused), without noise but that of its counts; all that a rig states is right. Each path is of four harmonics in the
middle of the joints' ranges. With --mujoco the log is MuJoCo's, of the same file without its meshes, friction its own
and identified, and its loop is four times as fast: of each step by Runge-Kutta, since those of first order are seen in
what a log knows best. "off" is the error of f in its own covariance, per parameter (1 where that is right), "of each"
in the standard deviation of each, rms; "torque" that of the torque on another path, rms. With --law computed torque of
what was found drives the arm on two everyday motions. With --idle a joint in the middle hardly moves, or moves in step
with the one before it, in the log and elsewhere; the bodies are 10 % off the file's then, which are the prior, and it
must be said what does not excite all. Seconds are those of the processor, all threads, kernels that are built for a new
arm included: they do not depend on what else the machine does.

Rows are kept in a file, one JSON object a line: called again, cells that are in it are not run anew. With --write its
rows become the table of docs/results.md and its picture.
"""

import argparse
import contextlib
import dataclasses
import json
import sys
import time
import warnings
import xml.etree.ElementTree as ET  # of an installed package
from pathlib import Path

import numpy as np

from ctc import ComputedTorque
from identification import identify
from identification.results import doubts, of_prior
from plant import (
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    Record,
    Rig,
    everyday_motions,
    p_gains,
    simulate,
)
from plant.parts import colour_of

ARMS = {
    "Panda": ("panda", None, "panda_hand_tcp"),
    "UR3": ("ur3_robot", None, "ee_link"),
    "UR5": ("ur5_robot", None, "ee_link"),
    "UR10": ("ur10_robot", None, "ee_link"),
    "Kinova j2s6s200": ("kinova", None, "j2s6s200_end_effector"),
    "xArm 7": ("xarm7", None, "link_eef"),
    "Z1": ("z1", None, "link06"),
    "SO-100": ("so100", None, "jaw"),
    "SO-101": ("so101", None, "gripper_frame_link"),
    "flying arm": ("hextilt_flying_arm_5", None, "flying_arm_5__gripper"),
    "TIAGo": ("tiago_no_hand", "torso_lift_link", "wrist_ft_tool_link"),
    "TIAGo Pro, left": ("tiago_pro", "torso_lift_link", "arm_left_7_link"),
    "TALOS, left arm": ("talos_full_v2", "torso_2_link", "arm_left_7_link"),
    "TALOS, left leg": ("talos_full_v2", None, "left_sole_link"),
    "Baxter, left": ("baxter", None, "left_hand_camera_link"),
    "PR2, left": ("pr2", "torso_lift_link", "l_wrist_roll_link"),
    "CENTAURO, left": ("centauro", "torso_2", "ball1_tip"),
    "Romeo, left arm": ("romeo_small", "torso", "l_wrist"),
    "Romeo, left leg": ("romeo_small", None, "l_sole"),
    "Alex, left arm": ("alex_nub_hands", "Torso", "LeftWristRollLink"),
    "G1, left arm": ("g1_29dof_rev_1_0", "torso_link", "left_wrist_yaw_link"),
    "G1, left leg": ("g1_29dof_rev_1_0", None, "left_ankle_roll_link"),
    "iCub, left arm": ("icub", "chest", "l_hand"),
    "human, left arm": ("human", "left_clavicle", "left_hand"),
    "simple humanoid, left arm": ("simple_humanoid", "torso", "l_wrist"),
}
"""Name -> file, base, tip."""

PAGE = Path(__file__).parents[2] / "docs" / "results.md"
PICTURE = PAGE.parent / "images" / "model_files.png"
MARK = "model files"
STEPS, ENGINE = 16, 64
"""Sub-steps of a sample: of the library's log, whose loop feels counts as often, and of
MuJoCo's, by Runge-Kutta.
"""


def folder():
    """Where the package has its robots."""
    for place in map(Path, sys.path):
        found = place / "cmeel.prefix" / "share" / "example-robot-data" / "robots"
        if found.is_dir():
            return found
    raise SystemExit("example-robot-data is not installed. pip install -e .[robots]")


def file_of(name):
    """The model file of an arm."""
    return next(folder().rglob(f"{ARMS[name][0]}.urdf"))


def path_of(chain, seed, idle=None):
    """Four harmonics in the middle of the ranges, at most 0.8 rad off it; one joint idle."""
    draw, n = np.random.default_rng(seed), chain.n
    lower, upper = (
        np.clip(side, -np.pi, np.pi) for side in (chain.limits.lower, chain.limits.upper)
    )
    middle, room = (lower + upper) / 2, np.minimum((upper - lower) / 2, 0.8)
    waves = draw.uniform(-1, 1, (2, n, 4)) / np.arange(1, 5)
    scale, one = 0.9 * room / np.abs(waves).sum(axis=(0, 2)), n // 2
    if idle == "still":
        scale[one] *= 1e-5
    elif idle == "step":
        waves[:, one], scale[one - 1 : one + 1] = waves[:, one - 1], scale[one - 1 : one + 1].min()
    return Harmonics(
        period=6.0, offset=middle, cosine=waves[0] * scale[:, None], sine=waves[1] * scale[:, None]
    )


def rig_of(chain, path):
    """A rig for this arm, and the arm with its rotors."""
    bare = Dynamics.from_chain(chain, rotors=False)
    arm = bare.arm(bare.f())
    motion = path(np.linspace(0, path.period, 200))
    inertia = 0.3 * np.mean([np.diag(arm.D(q)) for q in motion.q], axis=0)
    gear = 100.0
    torque = np.max([np.abs(arm.inverse(*state)) for state in zip(*motion, strict=True)], axis=0)
    torque = np.maximum(torque, 0.05 * torque.max()) + inertia * np.abs(motion.qdd).max(axis=0)
    every = np.ones(chain.n)
    drive = Drive(
        gear=gear * every, motor_inertia=inertia / gear**2, coulomb=0.05 * torque / gear,
        viscous=0.05 * torque / gear / (gear * np.abs(motion.qd).max(axis=0)), motor_gain=every,
        current_limit=4 * torque / gear,
    )  # fmt: skip
    return Rig(drive=drive, encoder=Encoder(resolution=4096 * every), period=1e-3)


def mujoco_log(name, chain, rig, law, path, duration):
    """The record of the arm in MuJoCo: what lies before and beside it stands, without mass; no
    shapes.
    """
    import mujoco

    root, moving = ET.parse(file_of(name)).getroot(), [link.name for link in chain.links]  # noqa: S314
    joints = {
        joint.get("name"): joint
        for joint in root.findall("joint")
        if joint.find("child") is not None
    }
    behind, grown = {joints[moving[0]].find("child").get("link")}, True
    while grown:
        more = {
            j.find("child").get("link")
            for j in joints.values()
            if j.find("parent").get("link") in behind
        }
        grown, behind = not more <= behind, behind | more
    for link in root.findall("link"):
        for tag in ("visual", "collision", *([] if link.get("name") in behind else ["inertial"])):
            for element in link.findall(tag):
                link.remove(element)
    for key, joint in joints.items():
        for element in joint.findall("mimic"):
            joint.remove(element)
        if key in moving:
            joint.set(
                "type", "continuous" if joint.get("type") == "revolute" else joint.get("type")
            )
        else:
            joint.set("type", "fixed")
    # Virtual bodies between joints have no mass.
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", boundmass="1e-6", boundinertia="1e-10")
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    place = [model.joint(key).qposadr[0] for key in moving]
    speed = [model.joint(key).dofadr[0] for key in moving]
    model.dof_armature[speed] = rig.drive.reflected_inertia()
    model.dof_damping[speed], model.dof_frictionloss[speed] = (
        rig.drive.joint_viscous(),
        rig.drive.joint_coulomb(),
    )
    # hard
    model.dof_solref[speed], model.dof_solimp[speed] = [0.0002, 1], [0.9999, 0.9999, 0.001, 0.5, 2]
    model.opt.timestep, model.opt.gravity[:] = rig.period / ENGINE, chain.gravity
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    count = round(duration / rig.period)
    motion = path(np.arange(count * ENGINE) * rig.period / ENGINE)
    asked, per_count = rig.counts(motion.q), rig.drive.gear * law.gain
    middle = path((np.arange(count * ENGINE) + 0.5) * rig.period / ENGINE).q
    wanted = rig.counts(middle)
    data.qpos[place], data.qvel[speed] = motion.q[0], motion.qd[0]
    errors = np.empty((count, chain.n))
    for k in range(count * ENGINE):
        q = data.qpos[place]
        if k % ENGINE == 0:
            errors[k // ENGINE] = asked[k] - rig.counts(q)
        halfway = rig.counts(q + 0.5 * model.opt.timestep * data.qvel[speed])
        data.qfrc_applied[speed] = rig.drive.limited(per_count * (wanted[k] - halfway))
        mujoco.mj_step(model, data)
    t = np.arange(count) * rig.period
    return Record(
        t=t, reference_pulses=asked[::ENGINE], error_pulses=errors, rig=rig, law=law, reference=path
    )


def within(truth, rig, found):
    """Share of the samples of two everyday motions that computed torque of what was found keeps
    within a pulse.
    """
    motions = everyday_motions(truth, rig)
    runs = [
        simulate(truth, rig, ComputedTorque(found), motions[name])
        for name in ("all slowly", "there and back")
    ]
    return min(float((np.abs(run.error_pulses) <= 1).all(axis=1).mean()) for run in runs)


def gains(truth, rig, path):
    """P gains for a peak of 30 pulses; of a larger one, as a refusal says, where the loop would
    be too fast.
    """
    for peak in (30, 100, 300):
        with contextlib.suppress(ValueError):
            return p_gains(truth, rig, path, peak=peak)
    return p_gains(truth, rig, path, peak=1000)


def row(name, seed, given):
    """What one arm on one path gives."""
    file, base, tip = file_of(name), *ARMS[name][1:]
    chain = Chain.from_urdf(file, base=base, tip=tip)
    path = path_of(chain, seed, given.idle)
    rig = rig_of(chain, path_of(chain, seed))
    dynamics = Dynamics.from_chain(chain.with_rotors(rig.drive))
    truth = dynamics.arm(dynamics.f())
    if given.idle:
        heavier = np.random.default_rng(seed).normal(1, 0.1, chain.n)
        bodies = zip(dynamics.chain.bodies, heavier, strict=True)
        truth = dynamics.arm(
            dynamics.f(
                [dataclasses.replace(b, mass=b.mass * k, inertia=b.inertia * k) for b, k in bodies]
            )
        )
    law = gains(truth, rig, path)
    if given.mujoco:
        record = mujoco_log(name, chain, rig, law, path, 6.0)
    else:
        record = simulate(truth, rig, law, path, duration=6.0, steps_per_sample=STEPS)
    begun = time.process_time()
    unknown = ("f", "friction") if given.mujoco or given.friction else None
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        prior = {"prior": 0.3} if given.idle == "step" else {}
        found = identify(dynamics, record, unknown=unknown, progress=False, **prior)
    seconds = time.process_time() - begun
    off, p = found.f - truth.f, len(truth.f)
    cell = {
        "n": chain.n,
        "f": p,
        "cpu": seconds,
        "warnings": [each.split(";")[0] for each in doubts(found)],
    }
    if given.idle:
        cell["said"] = any("the log does not excite all" in str(each.message) for each in told)
        cell["of the prior"] = len(of_prior(found))
    if found.covariance is not None:
        cell["off"] = float(np.sqrt(off @ np.linalg.solve(found.covariance[:p, :p], off) / p))
        cell["within_3"] = float(np.mean(np.abs(off) <= 3 * found.fit.std[:p]))
        cell["of each"] = float(np.sqrt(np.mean((off / found.fit.std[:p]) ** 2)))
    other = path_of(chain, seed + 100, given.idle)(np.linspace(0, 6, 200))
    torques = [
        np.array([arm.inverse(*state) for state in zip(*other, strict=True)])
        for arm in (found.arm, truth)
    ]
    cell["torque"] = float(
        np.sqrt(np.mean((torques[0] - torques[1]) ** 2) / np.mean(torques[1] ** 2))
    )
    if given.law:
        try:
            cell["law"] = within(truth, dataclasses.replace(rig, drive=found.rig.drive), found)
        # drives that the path was light for cannot make everyday motions
        except ValueError as refusal:
            cell["no law"] = str(refusal)
    return cell


def healthy(cell):
    """Whether a cell is as it should be."""
    good = not cell.get("refused") and not cell["warnings"] and cell.get("said", True)
    return good and cell.get("off", 9) <= 1.3 and cell["torque"] < 0.01


def tables(rows):
    """The table of all rows, one arm a line."""
    lines = [
        (
            "| arm | joints | f | cells healthy | off | torque elsewhere [%] | law: always within"
            " ±1, least share [%] | identify [s of all threads] | warning, or the cause |"
        ),
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name in ARMS:
        cells = [cell for cell in rows if cell["arm"] == name]
        good = [cell for cell in cells if not cell.get("refused")]
        if not cells:
            continue
        said = sorted({text for cell in cells for text in cell.get("warnings", [])})
        said += sorted(
            {
                f"{key}: {cell[key]}"
                for key in ("refused", "no law")
                for cell in cells
                if cell.get(key)
            }
        )

        def span(key, digits, factor=1.0, good=good):
            values = [factor * cell[key] for cell in good if key in cell]
            ends = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
            return "" if not values else ends[0] if ends[0] == ends[1] else " to ".join(ends)

        spans = [
            span(key, digits, factor) if any(key in cell for cell in good) else ""
            for key, digits, factor in (("off", 2, 1), ("torque", 2, 100), ("cpu", 0, 1))
        ]
        laws = [cell["law"] for cell in good if "law" in cell]
        spans.insert(
            2, f"{sum(x == 1 for x in laws)} of {len(laws)}, {100 * min(laws):.2f}" if laws else ""
        )
        first = good[0] if good else {"n": "", "f": ""}
        count = f"{sum(map(healthy, cells))} of {len(cells)}"
        lines.append(
            f"| {name} | {first['n']} | {first['f']} | {count} | {' | '.join(spans)} |"
            f" {'; '.join(said)} |"
        )
    return "\n".join(lines)


def draw(rows):
    """Error of f and of the torque, robots by rows, one mark a cell."""
    from matplotlib.figure import Figure

    names = [name for name in ARMS if any(cell["arm"] == name for cell in rows)][::-1]
    figure = Figure(figsize=(10, 0.28 * len(names) + 1.7), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for source, marker, colour in (("own", "o", colour_of(0)), ("MuJoCo", "s", colour_of(1))):
        cells = [cell for cell in rows if cell["log"] == source and not cell.get("refused")]
        if not cells:
            continue
        for axes, key, factor in ((left, "off", 1), (right, "torque", 100)):
            shown = [cell for cell in cells if key in cell]
            places = [
                names.index(cell["arm"]) + (0.12 if source == "own" else -0.12) for cell in shown
            ]
            axes.plot(
                [factor * cell[key] for cell in shown],
                places,
                marker,
                ms=5,
                color=colour,
                mfc="none",
                label=f"{source} log",
            )
    left.axvspan(0.7, 1.3, color="0.92", zorder=0)
    left.set(
        xlabel="error of f in its covariance, per parameter [-] (shaded: 0.7 to 1.3)",
        xlim=(0, None),
    )
    left.set_yticks(range(len(names)), names)
    right.axvline(1, color="0.8", zorder=0)
    right.set(xlabel="torque on another path, rms error [%]", xscale="log")
    for axes in (left, right):
        axes.grid(True, color="0.92")
    figure.legend(*right.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


def write(rows):
    """Table and picture into the documentation."""
    before, rest = PAGE.read_text(encoding="utf-8").split(f"<!-- {MARK} -->\n")
    after = rest.split(f"<!-- end of {MARK} -->")[1]
    good = (
        f"{sum(map(healthy, rows))} of {len(rows)} cells are healthy; the law keeps every sample of"
        " two everyday "
    )
    good += f"motions within ±1 pulse in {sum(cell.get('law') == 1 for cell in rows)}."
    text = f"{before}<!-- {MARK} -->\n{good}\n\n{tables(rows)}\n<!-- end of {MARK} -->{after}"
    PAGE.write_text(text, encoding="utf-8")
    draw(rows).savefig(PICTURE, dpi=110)


def main():
    """Run the cells that are not in the file yet; print their rows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="*", default=[], help="parts of names")
    parser.add_argument("--paths", type=int, default=1)
    parser.add_argument(
        "--mujoco", action="store_true", help="MuJoCo's log in place of the library's"
    )
    parser.add_argument("--friction", action="store_true", help="identified, too")
    parser.add_argument("--idle", choices=["still", "step"], help="one joint of the log")
    parser.add_argument(
        "--law", action="store_true", help="drive the arm by computed torque of what was found"
    )
    parser.add_argument("--rows", type=Path, default=Path("model_files.jsonl"))
    parser.add_argument(
        "--write",
        action="store_true",
        help="write the documentation of the rows there are, and end",
    )
    given = parser.parse_args()
    rows = (
        [json.loads(line) for line in given.rows.read_text().splitlines()]
        if given.rows.exists()
        else []
    )
    if given.write:
        return write(rows)
    log = "MuJoCo" if given.mujoco else "own"
    for seed in range(given.paths):
        for name in ARMS:
            cell = {
                "arm": name,
                "path": seed,
                "log": log,
                "friction": given.friction or given.mujoco,
            }
            cell |= {"idle": given.idle} if given.idle else {}
            there = any(all(old.get(key) == cell[key] for key in cell) for old in rows)
            if there or (given.robots and not any(part in name for part in given.robots)):
                continue
            begun = time.perf_counter()
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    cell |= row(name, seed, given)
            except ValueError as refusal:
                cell["refused"] = str(refusal)
            rows.append(cell | {"all": time.perf_counter() - begun})
            with given.rows.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
            print(
                {key: round(x, 4) if isinstance(x, float) else x for key, x in rows[-1].items()},
                flush=True,
            )
    print(f"{sum(map(healthy, rows))} of {len(rows)} cells healthy")
    return None


if __name__ == "__main__":
    main()
