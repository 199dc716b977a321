"""Guards of the torque in the exported C against the running controller, on what an unstable loop gave it."""

import dataclasses
import shutil
import subprocess
from functools import cache

import numpy as np
import pytest
from guarded_loops import RIG, closed, elastic

from ctc import ComputedTorque
from plant import Guards, JointSpring, P, puma560, simulate, write_replay

STRICT = "-std=c99 -O2 -Wall -Wextra -Werror -pedantic"
PATH = puma560.reference()
SAMPLES = 500
needs_c = pytest.mark.skipif(shutil.which("cc") is None or shutil.which("make") is None, reason="no C compiler here")
BLIND = {"jump": np.inf, "stuck": np.inf, "error": np.inf}
"""The guards that C has not."""


@cache
def counted():
    """A law of 150 rad/s and the counts (N, 2) that it sees on gears of 100 Hz, without guards."""
    arm = puma560.literature_arm(1.5)
    law = ComputedTorque(arm, RIG, bandwidth=150)
    return law, closed(arm, elastic(arm, 100), law, PATH, samples=SAMPLES, guards=None).counts


def run(*command, cwd=None, check=True):
    return subprocess.run([str(each) for each in command], cwd=cwd, capture_output=True, text=True, check=check)  # noqa: S603


def in_c(folder, law, counts, motion, rig=RIG, **options):
    """What C gives for these counts: torques (N, 2), and what it says."""
    law.to_c(folder, rig, **options)
    run("make", f"CFLAGS={STRICT}", cwd=folder)
    np.savetxt(folder / "rows.csv", np.hstack([counts, *motion]), delimiter=",", fmt=["%d"] * 2 + ["%.17g"] * 6)
    said = run(folder / "controller", folder / "rows.csv")
    return np.loadtxt(said.stdout.splitlines(), delimiter=","), said.stderr


def running(law, counts, motion, guards, rig=RIG):
    """The same by the running controller: torques, and the call of the stop, from 1."""
    controller, stop = law.start(rig, counts[0], guards=guards), None
    torque = np.empty(counts.shape)
    for k in range(len(counts)):
        torque[k] = controller.step(counts[k], *(x[k] for x in motion))
        stop = k + 1 if stop is None and controller.stopped else stop
    return torque, stop, controller.status


@needs_c
@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({}, "chatter"),
        ({"chatter": None}, "saturation"),
        ({"saturation": (0.2, np.inf), "chatter": (np.inf, 1.0)}, "saturation"),
        ({"stop": "zero", "duration": 0.1}, "chatter"),
    ],
    ids=str,
)
def test_it_stops_at_the_same_sample_and_gives_the_same_torques_from_then_on(tmp_path, options, word):
    """All samples, the ramp to gravity compensation or to zero with its damping too, to 1e-12 of the limit."""
    law, counts = counted()
    guards, motion = Guards(**BLIND, **options), PATH(np.arange(SAMPLES) * RIG.period)
    torque, said = in_c(tmp_path / "c", law, counts, motion, guards=guards)
    expected, stop, status = running(law, counts, motion, guards)
    assert {"chatter": "swings by", "saturation": "was at its limit"}[word] in status
    assert said == f"safe stop in row {stop}: {word}\n"
    assert stop < SAMPLES - 100
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-12 * RIG.drive.torque_limit()[0])


@needs_c
def test_a_reference_that_is_no_number_does_not_end_a_stop(tmp_path):
    """After the stop the law is not needed: NaN changes nothing."""
    law, counts = counted()
    motion = [x.copy() for x in PATH(np.arange(SAMPLES) * RIG.period)]
    whole, _ = in_c(tmp_path / "whole", law, counts, motion, guards=Guards(**BLIND))
    stop = running(law, counts, motion, Guards(**BLIND))[1]
    for x in motion:
        x[stop:] = np.nan
    torque, said = in_c(tmp_path / "cut", law, counts, motion, guards=Guards(**BLIND))
    assert said == f"safe stop in row {stop}: chatter\n"
    np.testing.assert_array_equal(torque, whole)


@needs_c
def test_converter_counts_follow_the_ramp(tmp_path):
    law, counts = counted()
    motion, scale = PATH(np.arange(SAMPLES) * RIG.period), np.array([2500.0, -1234.5])
    torque, _ = in_c(tmp_path / "torque", law, counts, motion)
    dac, _ = in_c(tmp_path / "dac", law, counts, motion, output="dac", counts_per_ampere=scale)
    exact = RIG.drive.current(torque) * scale
    clear = np.abs(exact - np.floor(exact) - 0.5) > 1e-9
    np.testing.assert_array_equal(dac[clear], np.rint(exact)[clear])


@needs_c
def test_a_stop_ends_where_gravity_and_springs_hold_the_arm(tmp_path):
    """Both are stopped on a rig with springs; and the torques of their ramps differ from those without."""
    law, counts = counted()
    guards, motion = Guards(**BLIND, duration=0.1), PATH(np.arange(SAMPLES) * RIG.period)
    springs = JointSpring(stiffness=(30.0, 10.0), angle=(0.3, -0.5))
    rig, torques = dataclasses.replace(RIG, springs=springs), []
    for k, each in enumerate((RIG, rig)):
        torque, said = in_c(tmp_path / f"c{k}", law, counts, motion, rig=each, guards=guards)
        assert "safe stop" in said
        expected, _, _ = running(law, counts, motion, guards, rig=each)
        np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-12 * RIG.drive.torque_limit()[0])
        torques.append(torque)
    q = RIG.cell_centre(counts[-1])
    np.testing.assert_allclose((torques[1] - torques[0])[-1], springs.stiffness * (q - springs.angle), rtol=1e-9)


@needs_c
def test_a_healthy_run_is_not_stopped(tmp_path):
    """The README's: all of (6)."""
    law = ComputedTorque(puma560.arm(), RIG)
    record = simulate(puma560.arm(), RIG, law, PATH)
    torque, said = in_c(tmp_path / "c", law, record.reference_pulses - record.error_pulses, PATH(record.t))
    np.testing.assert_allclose(torque, record.torque, rtol=0, atol=1e-12 * np.abs(record.torque).max())
    assert said == ""


def test_without_guards_or_a_period_the_law_is_all_there_is(tmp_path):
    law, _ = counted()
    for name, (each, guards) in {
        "none": (law, None), "off": (law, Guards(saturation=None, chatter=np.inf)), "fast": (P(gain=(1, 1)), Guards()),
    }.items():  # fmt: skip
        each.to_c(tmp_path / name, RIG, guards=guards)
        text = (tmp_path / name / "controller.c").read_text() + (tmp_path / name / "controller.h").read_text()
        assert "guard" not in text
        assert "return !sound;" in text
    assert (tmp_path / "none" / "controller.c").read_bytes() == (tmp_path / "off" / "controller.c").read_bytes()
    law.to_c(tmp_path / "on", RIG)
    assert "until the controller starts anew" in " ".join(
        (tmp_path / "on" / "controller.h").read_text().split(" *\n * ")
    )


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"guards": "none"}, "guards must be of type Guards"),
        ({"guards": Guards(chatter=(0.5, 0.5, 0.5))}, r"chatter must have shape \(2,\)"),
        ({"guard": None}, "Did you mean 'guards'"),
    ],
    ids=str,
)
def test_bad_input_is_refused_in_one_line(tmp_path, options, said):
    with pytest.raises(ValueError, match=said) as refusal:
        counted()[0].to_c(tmp_path / "c", RIG, **options)
    assert "\n" not in str(refusal.value)
    assert not (tmp_path / "c").exists()


@needs_c
def test_a_record_replays_into_c_as_before(tmp_path):
    """`write_replay` and `main.c` with guards on."""
    law = ComputedTorque(puma560.arm(), RIG, bandwidth=150)
    record = simulate(puma560.arm(), RIG, law, PATH, duration=0.1)
    law.to_c(tmp_path)
    run("make", f"CFLAGS={STRICT}", cwd=tmp_path)
    write_replay(record, tmp_path / "record.csv")
    torque = np.loadtxt(run(tmp_path / "controller", tmp_path / "record.csv").stdout.splitlines(), delimiter=",")
    np.testing.assert_allclose(torque, record.torque, rtol=0, atol=1e-12 * np.abs(record.torque).max())
