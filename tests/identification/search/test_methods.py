"""The default method and its stages: known robots found again, one interface, refusals before any
search.

Bands are those of tests/benchmarks/identification.py: of the nine, f3 hardly shows in this motion.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest

from ctc import ComputedTorque, evaluate
from identification import GeneticSettings, Objective, identify, oscillation
from identification.equation_error import (
    Known,
    equation_error,
    fit_deflection,
    mode_in,
    pass_band,
    torque_of,
)
from identification.results import INTERVALS, Detection, verdict_of
from identification.search import methods, polish, triangular_root
from plant import (
    Body,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    Link,
    PointToPoint,
    Record,
    Rig,
    linearise,
    modes,
    p_gains,
    puma560,
    simulate,
)

DYNAMICS, RIG, PATH = puma560.dynamics(), puma560.rig(), puma560.reference()
WIDTH = np.diff(puma560.PRINTED_RANGES, axis=1).ravel()
ARMS = {"published": puma560.arm, "literature with a tool": lambda: puma560.literature_arm(1.5)}
GAINS = ((0.1, 0.08), (0.2, 0.15))
TINY = GeneticSettings(individuals=6, subpopulations=2, generations=3)
CASES = pytest.mark.parametrize(("arm", "gain"), [(arm, gain) for arm in ARMS for gain in GAINS])


@cache
def measured(arm="published", gain=(0.2, 0.15), period=3.65):
    return simulate(
        ARMS[arm](), RIG, puma560.p_law(gain), puma560.reference(period), steps_per_sample=16
    )


@cache
def found(arm="published", gain=(0.2, 0.15), seed=0):
    return identify(DYNAMICS, measured(arm, gain), seed=seed, progress=False)


def off(values, arm="published"):
    """Errors in per cent of the printed ranges."""
    return 100 * np.abs(values[:9] - ARMS[arm]().f) / WIDTH


# -- the equation error --------------------------------------------------------------------------
def test_torques_are_those_of_the_law():
    record = measured()
    np.testing.assert_allclose(torque_of(record), record.torque, rtol=1e-12, atol=1e-9)
    bare = dataclasses.replace(record, torque=None, current=None)
    np.testing.assert_allclose(torque_of(bare), record.torque, rtol=1e-12, atol=1e-9)


def test_torques_under_a_law_with_memory_are_read_from_the_log():
    law = ComputedTorque(puma560.arm(), RIG)
    record = simulate(puma560.arm(), RIG, law, PATH, duration=0.1)
    held = (record.torque[1:] + record.torque[:-1]) / 2  # from one sample to the next
    np.testing.assert_array_equal(torque_of(record)[1:], held)
    by_current = dataclasses.replace(record, torque=None)
    np.testing.assert_allclose(torque_of(by_current)[1:], held, rtol=1e-12, atol=1e-9)
    with pytest.raises(ValueError, match="must hold torques or currents"):
        torque_of(dataclasses.replace(by_current, current=None))


@CASES
def test_mode_in_the_spectrum_is_that_of_the_linearised_loop(arm, gain):
    poses = PATH(np.linspace(0, PATH.duration, 9)).q
    slow = [modes(linearise(ARMS[arm](), RIG, puma560.p_law(gain), pose))[0, 0] for pose in poses]
    assert min(slow) * 0.9 < mode_in(measured(arm, gain)) < max(slow) * 1.1
    assert pass_band(measured(arm, gain), ARMS[arm]()) == pytest.approx(2 * max(slow), rel=0.05)


@pytest.mark.parametrize(
    ("shown", "cause"),
    [
        (lambda record: {"error_pulses": np.zeros((len(record), 2))}, "errors are constant"),
        (
            lambda record: {
                "rig": dataclasses.replace(record.rig, period=0.04),
                "t": 0.04 * np.arange(len(record)),
            },
            r"sampled every 0\.04 s",
        ),
    ],
    ids=["no errors", "slow"],
)
@pytest.mark.parametrize(
    "search",
    [
        oscillation,
        pass_band,
        lambda record: equation_error(DYNAMICS, [record], DYNAMICS.names),
        lambda record: fit_deflection(DYNAMICS, [record], DYNAMICS.names, Known()),
    ],
    ids=["oscillation", "pass_band", "equation_error", "fit_deflection"],
)
def test_a_log_without_an_oscillation_is_refused(shown, cause, search):
    with pytest.raises(ValueError, match=f"must show the oscillation of its loop.*{cause}"):
        search(dataclasses.replace(measured(), **shown(measured())))


@CASES
def test_equation_error_is_off_by_no_more_than_it_says(arm, gain):
    fit = equation_error(DYNAMICS, [measured(arm, gain)], DYNAMICS.names)
    assert (np.abs(fit.values - ARMS[arm]().f) < 4 * fit.std).all()
    assert np.median(off(fit.values, arm)) < 2.0


# -- many unknowns -------------------------------------------------------------------------------
def test_with_many_unknowns_the_genetic_algorithm_is_left_out(monkeypatch):
    monkeypatch.setattr(methods, "SEEDED", methods.SeededSettings(direct=8))
    direct = identify(DYNAMICS, measured(), progress=False)
    assert not len(direct.search.history)
    assert list(direct.search.stages) == ["equation error", "prediction error"]
    assert (np.abs(direct.f - found().f) < 0.2 * found().fit.std).all()
    given = identify(DYNAMICS, measured(), settings=TINY, progress=False)
    assert len(given.search.history) == TINY.generations + 1


# -- the default ---------------------------------------------------------------------------------
SLOW = [pytest.param(*each, marks=pytest.mark.slow) for each in zip(ARMS, GAINS, strict=True)]


@pytest.mark.parametrize(("arm", "gain"), [*zip(ARMS, reversed(GAINS), strict=True), *SLOW])
def test_default_finds_the_robots_again(arm, gain):
    result = found(arm, gain)
    wrong = off(result.f, arm)
    assert np.median(wrong) < 1.0
    assert np.delete(wrong, 2).max() < 3.5
    assert wrong[2] < 12.0  # f3
    assert (np.abs(result.fit.values - ARMS[arm]().f) < 3 * result.fit.std).all()
    true = Objective(DYNAMICS, measured(arm, gain))(ARMS[arm]().f[None])[0]
    assert result.objective <= 1.3 * true
    assert result.evaluations <= 4000
    assert 0.28 < result.fit.rms_innovation < 0.33
    assert result.warnings == []


@pytest.mark.parametrize("period", [pytest.param(3.65, marks=pytest.mark.slow), 2.0])
def test_default_is_good_enough_for_one_pulse_at_any_speed(period):
    law = ComputedTorque(found().arm, found().rig)
    report = evaluate(puma560.arm(), RIG, law, puma560.reference(period), backend="numba")
    assert report.within(1), report


@pytest.mark.slow  # with other settings also in test_sums and test_procedure
def test_same_seed_same_bits_on_any_number_of_threads():
    runs = [
        identify(DYNAMICS, measured(), seed=3, threads=threads, progress=False)
        for threads in (1, 2)
    ]
    for name in ("f", "objective", "covariance", "history", "initial_population"):
        np.testing.assert_array_equal(getattr(runs[0], name), getattr(runs[1], name))
    assert (found().initial_population != runs[0].initial_population).any()


@pytest.mark.slow
def test_friction_that_is_unknown_is_found_within_five_per_cent():
    names = ("drive.viscous[0]", "drive.coulomb[0]", "drive.viscous[1]", "drive.coulomb[1]")
    # what the user believes
    drive = dataclasses.replace(RIG.drive, viscous=(0.3e-3, 3e-3), coulomb=(0.05, 0.3))
    log = dataclasses.replace(measured(), rig=dataclasses.replace(RIG, drive=drive))
    result = identify(
        DYNAMICS, log, unknown=(*names[:2], *DYNAMICS.names, *names[2:]), progress=False
    )
    np.testing.assert_allclose(result.rig.drive.viscous, RIG.drive.viscous, rtol=0.05)
    np.testing.assert_allclose(result.rig.drive.coulomb, RIG.drive.coulomb, rtol=0.05)
    assert np.median(off(result.f)) < 1.5


@pytest.mark.slow
def test_gains_that_are_unknown_come_back_in_the_law():
    law = puma560.p_law((0.19, 0.16))
    result = identify(
        DYNAMICS,
        dataclasses.replace(measured(), law=law),
        unknown=(*DYNAMICS.names, "law.gain[0]", "law.gain[1]"),
        progress=False,
    )
    np.testing.assert_allclose(result.law.gain, (0.20, 0.15), rtol=0.02)


def test_gain_and_friction_together_are_reported_as_inseparable():
    """With all friction and both gains unknown, everything can be scaled: nothing tells how much
    a pulse is worth.
    """
    friction = [f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in (0, 1)]
    unknown = (*DYNAMICS.names, *friction, "law.gain[0]", "law.gain[1]")
    with pytest.raises(
        ValueError,
        match=r"separately identifiable; law.gain\[1\] is a combination of f1, .*law.gain\[0\]",
    ):
        identify(DYNAMICS, measured(), unknown=unknown, settings=TINY, progress=False)


# -- one interface -------------------------------------------------------------------------------
@pytest.mark.parametrize("method", ["equation_error", "output_error", "prediction_error", "paper"])
def test_every_method_gives_one_kind_of_result(method):
    result = identify(DYNAMICS, measured(), method=method, settings=TINY, progress=False)
    assert result.search.method == method
    np.testing.assert_array_equal(result.arm.f, result.fit.values)
    assert np.isfinite(result.objective)
    assert Objective(DYNAMICS, measured())(result.f[None]) == [result.objective]
    text = result.summary()
    assert all(name in text for name in DYNAMICS.names)
    if method == "paper":
        with pytest.raises(ValueError, match="this fit provides none: its method has none"):
            result.fit.std  # noqa: B018
    else:
        assert np.median(off(result.f)) < 3.0
        assert (result.fit.std > 0).all()


def test_ranges_are_kept():
    ranges = np.column_stack([puma560.PUBLISHED - 0.01 * WIDTH, puma560.PUBLISHED + 0.01 * WIDTH])
    ranges[4] = puma560.PUBLISHED[4]
    result = identify(DYNAMICS, measured(), ranges=ranges, settings=TINY, progress=False)
    assert (result.f >= ranges[:, 0]).all()
    assert (result.f <= ranges[:, 1]).all()
    assert result.f[4] == puma560.PUBLISHED[4]
    assert result.fit.std[4] == 0.0


@pytest.mark.slow
def test_last_of_several_records_is_kept_aside():
    records = [measured(), measured(period=2.5)]
    result = identify(DYNAMICS, records, settings=TINY, progress=False)
    assert result.records == (records[0],)
    assert result.held_out == (records[1],)
    assert 0.3 < result.diagnostics.held_out_difference < 1.5
    assert "validation" in " ".join(result.summary().split())
    both = identify(DYNAMICS, records, settings=TINY, held_out=(), progress=False)
    assert both.records == tuple(records)
    assert both.diagnostics.held_out_difference is None
    noise = [np.diag(each.fit.noise_covariance) for each in (both, result)]
    assert (noise[0] < noise[1]).all()  # twice the data


def test_a_clean_log_is_no_evidence_where_the_rig_could_not_be_tested():
    tested = found()
    detection = Detection(reason="the model diverges beside the optimum")
    diagnostics = dataclasses.replace(tested.diagnostics, detection=detection)
    untested = dataclasses.replace(tested, diagnostics=diagnostics)
    assert untested.doubts == tested.doubts == []
    assert verdict_of(tested).good
    assert verdict_of(untested).good is None
    assert "not tested" in verdict_of(untested).sentence


def test_summary_says_what_goes_with_what():
    lines = found().summary().splitlines()
    assert lines[0] == "Nothing in the log contradicts what was stated."
    assert lines[1].startswith("seeded, 1 record(s)")
    f2 = next(line for line in lines if line.startswith("f2"))
    assert "f7" in f2 or "f3" in f2 or "f4" in f2
    listed = str(found().assumed()).splitlines()
    assert lines[-len(listed) :] == listed
    begins = [line for line in lines if line[0] != " "]
    at = begins.index(listed[0])
    assert begins[at - 1].startswith("intervals count noise and a rig that is right within")
    assert begins[at - 2].startswith("no sign of compliance")


def test_bound_is_below_what_was_reached_and_needs_a_reference():
    bound = found().bound()
    assert (bound < 1.2 * found().fit.std).all()
    assert (bound > 0.05 * found().fit.std).all()
    counted = dataclasses.replace(
        found(), records=(dataclasses.replace(measured(), reference=None),)
    )
    with pytest.raises(ValueError, match="must have a reference for a bound"):
        counted.bound()
    assert "bound" in found().summary()
    assert "bound" not in counted.summary()


def test_plot_draws_errors_innovations_spectrum_and_intervals():
    import matplotlib

    matplotlib.use("Agg")
    axes = found().plot()
    assert [axis.get_title(loc="left") for axis in axes if axis.get_title(loc="left")] == [
        "joint 2 (q[0])",
        "a segment",
        "innovation: measured minus predicted",
        "joint 3 (q[1])",
        "spectrum",
        INTERVALS,
    ]
    matplotlib.pyplot.close(axes[0].figure)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["seeded", "equation_error"])
def test_a_log_under_computed_torque_repeats_its_torques(method):
    """Its law has a memory that no log holds; its torques are in the log."""
    law = ComputedTorque(puma560.arm(), RIG, bandwidth=50.0)
    record = simulate(puma560.arm(), RIG, law, PATH, steps_per_sample=16)
    result = identify(DYNAMICS, record, method=method, settings=TINY, progress=False)
    assert off(result.f).max() < (3.0 if method == "equation_error" else 1.0)
    assert result.law == law


def test_fit_that_is_no_arm_of_this_rig_leaves_no_intervals():
    """Motors of three times the inertia: what the log shows is too light for them."""
    drive = dataclasses.replace(RIG.drive, motor_inertia=3 * RIG.drive.motor_inertia)
    rig = dataclasses.replace(RIG, drive=drive)
    log = dataclasses.replace(measured().cut(0.0, 1.5), rig=rig)
    result = identify(DYNAMICS, log, settings=TINY, progress=False)
    assert result.covariance is None
    assert result.fit.rms_innovation is None
    assert any("falls short of the motors' own inertia" in text for text in result.warnings)
    assert "warning: D(q)" in result.summary()


@pytest.mark.slow
def test_ranges_that_exclude_the_truth_are_warned_about():
    ranges = np.column_stack([puma560.PUBLISHED - 0.5 * WIDTH, puma560.PUBLISHED + 0.5 * WIDTH])
    ranges[6] = 8.0, 12.0
    result = identify(DYNAMICS, measured(), ranges=ranges, progress=False)
    assert any(
        "f7 ends at the lower end" in text or "simulated and measured" in text
        for text in result.warnings
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "wrong",
    ["errors", *(pytest.param(each, marks=pytest.mark.slow) for each in ("gear", "joints"))],
)
def test_signs_and_order_that_are_wrong_are_warned_about(wrong):
    record = dataclasses.replace(
        measured(), reference=None, torque=None, current=None, true_q=None, true_qd=None
    )
    if wrong == "gear":
        drive = dataclasses.replace(RIG.drive, gear=RIG.drive.gear * (1, -1))
        record = dataclasses.replace(record, rig=dataclasses.replace(RIG, drive=drive))
    if wrong == "joints":
        record = dataclasses.replace(
            record,
            reference_pulses=record.reference_pulses[:, ::-1],
            error_pulses=record.error_pulses[:, ::-1],
        )
    if wrong == "errors":
        record = dataclasses.replace(record, error_pulses=-record.error_pulses)
    try:
        warnings = identify(DYNAMICS, record, settings=TINY, progress=False).warnings
    except ValueError as refusal:
        warnings = [str(refusal)]
    assert warnings


@pytest.mark.slow
def test_held_out_takes_one_record_or_several():
    other, options = measured(period=2.5), {"method": "equation_error", "progress": False}
    results = [
        identify(DYNAMICS, measured(), held_out=kept, **options) for kept in (other, [other])
    ]
    assert (
        results[0].diagnostics.held_out_difference == results[1].diagnostics.held_out_difference > 0
    )
    for nonsense in (True, 5, "record"):
        with pytest.raises(ValueError, match="must be at least one Record; got"):
            identify(DYNAMICS, measured(), held_out=nonsense, **options)


# -- bad input -----------------------------------------------------------------------------------
def test_log_of_an_arm_that_stands_still_is_refused():
    still = PointToPoint(start=(-0.5, 0.5), goal=(-0.5, 0.5), duration=1.0)
    with pytest.raises(ValueError, match="every motor must move by at least 20 pulses"):
        identify(DYNAMICS, simulate(puma560.arm(), RIG, puma560.p_law(), still), progress=False)


def test_log_at_the_amplifiers_limit_is_refused():
    drive = dataclasses.replace(RIG.drive, current_limit=(2.0, 12.0))
    weak = simulate(
        puma560.arm(), dataclasses.replace(RIG, drive=drive), puma560.p_law(), PATH, duration=1.5
    )
    with pytest.raises(
        ValueError,
        match=r"below the amplifier's limit; by its law the motor of joint 2 \(q\[0\]\) is at it for",
    ):
        identify(DYNAMICS, weak, progress=False)


def test_log_shorter_than_its_oscillation_is_refused():
    record = measured()
    cut = {name: getattr(record, name)[:100] for name in ("t", "reference_pulses", "error_pulses")}
    with pytest.raises(ValueError, match=r"at least 200 samples"):
        identify(DYNAMICS, Record(**cut, rig=RIG, law=record.law, reference=PATH), progress=False)


def test_log_of_another_rig_is_warned_about():
    """Ten times the dry friction: no f repeats these errors."""
    drive = dataclasses.replace(RIG.drive, coulomb=(1.2, 1.4))
    other = dataclasses.replace(measured().cut(0.0, 1.5), rig=dataclasses.replace(RIG, drive=drive))
    result = identify(DYNAMICS, other, settings=TINY, progress=False)
    assert any("simulated and measured errors differ" in text for text in result.warnings)
    assert "warning: " in result.summary()


@pytest.mark.slow
def test_coarse_encoder_is_enough_for_one_of_its_pulses():
    """100 pulses per motor turn, an eighth of the paper's: identified from them, and tracked to
    one of them.
    """
    rig = dataclasses.replace(RIG, encoder=dataclasses.replace(RIG.encoder, resolution=(100, 100)))
    law = puma560.p_law((0.20 * 8, 0.15 * 10))
    record = simulate(puma560.arm(), rig, law, PATH, steps_per_sample=16)
    result = identify(DYNAMICS, record, seed=1, progress=False)
    report = evaluate(
        puma560.arm(),
        rig,
        ComputedTorque(result.arm, result.rig, bandwidth=100.0),
        PATH,
        backend="numba",
    )
    assert report.within(1), report


# -- arms nearby ---------------------------------------------------------------------------------
def test_the_root_of_a_covariance_is_its_factor_and_leaves_what_does_not_vary():
    rows = np.random.default_rng(0).normal(size=(9, 5)) * (1, 1, 0, 1, 1)
    root = triangular_root(rows.T @ rows)
    np.testing.assert_allclose(root @ root.T, rows.T @ rows, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(np.triu(root, 1), 0)


# -- fits that let go of the log -----------------------------------------------------------------
def first_found(monkeypatch, changed):
    """Calls of the search, of which the first ends elsewhere."""
    whole, calls = polish.gauss_newton, []

    def search(prediction, start, step, bounds, **more):
        calls.append(whole(prediction, start, step, bounds, **more))
        return calls[-1] if len(calls) > 1 else changed(calls[0], bounds)

    monkeypatch.setattr(polish, "gauss_newton", search)
    return calls


def test_a_fit_whose_observer_lets_go_of_the_log_is_made_again_by_stages(monkeypatch):
    """The first search of a humanoid's leg ends so, at 0.51 pulses (benchmarks/healthy.py, log
    158).
    """
    calls = first_found(
        monkeypatch,
        lambda fit, bounds: dataclasses.replace(
            fit, values=np.append(1.3 * fit.values[:9], bounds[9:, 0]), rms_innovation=0.51
        ),
    )
    log = simulate(puma560.arm(), RIG, puma560.p_law(), PATH, duration=0.7)
    values = identify(DYNAMICS, log, method="prediction_error", seed=0, progress=False).fit
    assert len(calls) > 3
    assert values.rms_innovation < 0.35
    assert (np.abs(values.values - puma560.arm().f) < 4 * values.std).all()


@pytest.mark.slow
def test_a_fit_in_which_a_light_joint_has_less_than_its_rotor_is_made_again_with_the_stated_one(
    monkeypatch,
):
    """So the search ends at the last joint of a flying arm, 0.37 pulses for 0.34
    (benchmarks/healthy.py, log 173).
    """
    drive = Drive(
        gear=(100.0, 100.0),
        motor_inertia=(2e-8, 2.3e-10),
        viscous=(1e-5, 2e-7),
        coulomb=(2e-6, 1e-7),
        motor_gain=1.0,
        current_limit=1.0,
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=4096.0), period=1e-3)
    bodies = (
        Body(mass=0.2, com=(0.05, 0, 0), inertia=(1e-5, 0, 0, 3e-4, 0, 3e-4)),
        Body(mass=0.03, com=(0.01, 0.005, 0), inertia=(1e-6, 0, 0, 3e-6, 0, 4e-6)),
    )
    chain = Chain(links=(Link(name="1", alpha=np.pi / 2), Link(name="2", a=0.1)), bodies=bodies)
    dynamics = Dynamics.from_chain(chain.with_rotors(drive))
    truth, rotor = dynamics.arm(dynamics.f()), dynamics.names.index("J2")
    path = Harmonics(
        period=3.0,
        offset=(0.2, 0.1),
        cosine=((0.3, 0.1), (-0.2, 0.15)),
        sine=((0.1, -0.2), (0.3, 0.1)),
    )
    log = simulate(truth, rig, p_gains(truth, rig, path, peak=30), path, duration=1.0)

    def below(fit, bounds):
        values = fit.values.copy()
        values[rotor] = -4 * truth.f[rotor]
        return dataclasses.replace(fit, values=values, rms_innovation=0.6)

    calls = first_found(monkeypatch, below)
    found = identify(dynamics, log, method="prediction_error", seed=0, progress=False).fit
    assert len(calls) == 2
    assert found.fallback_reason is None
    assert (np.abs(found.values - truth.f) < 4 * found.std).all()
