"""Real logs, in the folder CTC_DATA where there is one; examples/5_real_tx40.py says where the
originals are.
"""

import importlib.util
import os
from pathlib import Path

import numpy as np
import pytest

from identification import fit_torque, identify
from plant import replay
from plant.machine import least_inertia_margin

DATA = os.environ.get("CTC_DATA")
EXAMPLES = Path(__file__).parent.parent / "examples"


def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def folder(name):
    if not DATA:
        pytest.skip("CTC_DATA is not set: no real logs to fit")
    path = Path(DATA) / name
    if not path.is_dir():
        pytest.skip(f"CTC_DATA holds no folder {name}")
    return path


def test_tx40_fit_is_the_published_one():
    """At least 55 of the 60 published values within one published standard deviation, all within
    3; error <= 5.4 %.
    """
    table, found = example("5_real_tx40").compare(folder("staubli_tx40"))
    off = np.array([abs(ours - value) / std for _, ours, value, std in table])
    assert len(off) == 60
    assert (off <= 1).sum() >= 55
    assert off.max() <= 3
    assert found.relative_error <= 0.054


@pytest.fixture
def public_logs(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES.parent / "tests" / "benchmarks"))
    return importlib.import_module("public_logs")


@pytest.mark.filterwarnings("ignore::UserWarning")  # of what the file and the fit leave open
def test_a_slide_is_simulated_from_its_force_on_a_file_that_was_not_fitted(public_logs):
    """4.9 or 6.1 mm by processor, as the search ends elsewhere in a flat valley that dry friction
    roughens; 168 without friction that differs by direction. Published: 95.1 kg.
    """
    log = public_logs.emps(folder("emps").parent)
    found = identify(log.dynamics, log.fitted, progress=False)
    assert "drive.curve.viscous_offset[0]" in found.fit.unknown
    again = replay(found.arm, log.kept[0], rig=found.rig)
    off = found.rig.to_angle(again.counts - log.kept[0].counts)
    assert np.sqrt(np.mean(off**2)) < 6.9e-3
    assert found.f[0] == pytest.approx(95.1, rel=0.04)
    # The force itself: published 5.98 % on this file.
    assert fit_torque(log.dynamics, log.fitted).error_on(log.kept).total < 0.035


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.slow
def test_a_slow_log_of_seven_joints_gives_an_arm(public_logs):
    """At 30 Hz no prediction follows it; least squares alone have a D(q) that is not positive."""
    try:
        log = public_logs.panda(folder("ur10_panda_bags").parent)
    except (FileNotFoundError, SystemExit) as missing:
        pytest.skip(f"no model of the Panda: {missing}")
    found = identify(log.dynamics, log.fitted, held_out=(), progress=False)
    assert "bodies that can be" in found.fit.fallback_reason
    assert found.error_on(log.kept).total < 0.025
    assert least_inertia_margin(log.dynamics, found.rig, found.f[None])[0] > 0


PENDULUM = "8_real_double_pendulum"


# .ci/run runs the example itself.
@pytest.fixture(
    scope="module",
    params=[pytest.param(design, marks=pytest.mark.slow) for design in ("C.0", "A.0")],
)
def pendulum(request):
    """The example, the design, what was identified of it, and the runs kept aside."""
    there, module = folder("dfki_double_pendulum"), example(PENDULUM)
    return module, request.param, *module.study(there, request.param)


def test_double_pendulum_repeats_the_runs_kept_aside(pendulum):
    """10 s in open loop from t = 0, pooled over the runs; the authors' models: 0.049, 0.076 and
    a turn of the elbow.
    """
    module, design, found, kept = pendulum
    assert (
        module.misses(found, kept) <= {"C.0": (0.0345, 0.0579), "A.0": (0.053, 0.129)}[design]
    ).all()
    for record in kept:
        free = replay(found.arm, record, rig=found.rig)
        assert np.abs(free.counts - record.counts).max() * module.STEP < 1.0  # no elbow turns over


def test_double_pendulum_has_the_published_terms(pendulum):
    """All within 7 %, and three of four within 5 %: m2 r2 of A.0 is 6.5 % and I2 of C.0 5.7 %
    above the published.
    """
    module, design, found, _ = pendulum
    ours, theirs = module.four_terms(design, found)
    off = np.abs(ours / theirs - 1)
    assert (off <= 0.05).sum() >= 3
    assert off.max() <= 0.07


def test_double_pendulum_began_where_friction_held_it(pendulum):
    """What the fit does not know: at rest in the zeros that it found, gravity is less than dry
    friction.
    """
    _, _, found, _ = pendulum
    held = [
        np.abs(found.arm.h(zero, np.zeros(2))) / found.rig.drive.joint_coulomb()
        for zero in found.fit.zeros
    ]
    assert np.max(held) < 1


def test_double_pendulum_warns_of_least_squares_above_some_hertz(pendulum):
    """By comparison, band by band: nearly right from 2 to 4 Hz, 10 % short at 5.7 Hz, a third
    missing at 11 Hz.
    """
    *_, found, _ = pendulum
    assert any(
        "least squares on these torques is biased in bands above 4 Hz" in text
        for text in found.warnings
    )
    assert min(abs(share - 1) for share in found.diagnostics.bands.values()) < 0.08
    assert found.diagnostics.bands[16.0] < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("pendulum", ["C.0", "A.0"], indirect=True)
def test_double_pendulum_is_controlled_to_a_pulse(pendulum):
    """On the arm that the runs kept aside show, which is another: dry friction differs by up to 29
    %.

    The example, which .ci/run runs, asserts it of both designs.
    """
    module, _, found, kept = pendulum
    again = module.fit(found.arm.dynamics, kept)
    report = module.controlled(found, again)
    assert report.within(2)
    assert report.fraction_within(1) > 0.995


def test_double_pendulum_example_says_where_the_log_is_when_there_is_none(monkeypatch, capsys):
    monkeypatch.delenv("CTC_DATA", raising=False)
    assert example(PENDULUM).main() == 0
    assert "CTC_DATA is not set" in capsys.readouterr().out


def test_tx40_example_says_where_the_log_is_when_there_is_none(monkeypatch, capsys):
    monkeypatch.delenv("CTC_DATA", raising=False)
    assert example("5_real_tx40").main() == 0
    assert "CTC_DATA is not set" in capsys.readouterr().out
