"""Every result in a notebook, a terminal and a list: HTML that is whole and escaped, 80 columns,
one short line.
"""

import dataclasses
import functools
import inspect
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from uncertain import with_uncertainty

import ctc
import identification
import plant
from ctc import (
    ComputedTorque,
    Float,
    LearntTorque,
    Uncertainty,
    certify,
    compare,
    evaluate,
    evaluate_float,
    margins,
    sweep_resonance,
)
from ctc.campaigns import Campaign, Change, Judgement
from ctc.certification import Reserves
from ctc.learning import Learning
from ctc.payload import PayloadEvent
from ctc.tuning import InnerTrial, Trial, Tuning
from ctc.verdict import Comparison, LowestResonance
from identification import fit_torque, identify, oscillation, pulse_budget
from identification.equation_error import BetweenRuns, FitTrial, FrictionTrial, Wound
from identification.payload import Load, PayloadEstimate
from identification.planning import FrequencyResponse, MotorFit
from identification.repeatability import Spread
from identification.results import Gears, Physical, WrittenModel
from identification.search import GearResonance
from plant import Body, Dynamics, PositionServo, puma560, simulate, visibility
from plant.checkup import Cause, Rival
from plant.models import ModelCheck, ModelFinding
from plant.parts import SLIDES, TURNS, Shown, Verdict

NASTY = ("<b>&'\"</td>", "shoulder_lift_joint_of_the_left_arm")
RIG, LAW, PATH = puma560.rig(), puma560.p_law(), puma560.reference()
SHORT = {"duration": 0.3, "steps_per_sample": 4}


@functools.cache
def arm():
    """The paper's, with joints of such names and so with parameters of such names."""
    chain = puma560.dynamics().chain
    links = tuple(
        dataclasses.replace(link, name=name) for link, name in zip(chain.links, NASTY, strict=True)
    )
    dynamics = Dynamics.from_chain(dataclasses.replace(chain, links=links))
    rotors = RIG.drive.reflected_inertia()
    bodies = (((17.4, 0.068, 0.539), rotors[0]), ((7.6, 0.0, 0.3), rotors[1]))
    return dynamics.arm(dynamics.f([
        Body(mass=mass, com=(x, -0.2, 0), inertia=(0, 0, 0, 0, 0, izz), rotor=rotor)
        for (mass, x, izz), rotor in bodies
    ]))  # fmt: skip


@functools.cache
def record():
    return simulate(arm(), RIG, LAW, PATH, duration=1.5)


@functools.cache
def found():
    return identify(arm().dynamics, record(), method="equation_error", progress=False)


@functools.cache
def certificate():
    drawn = {
        "covariance": np.diag((0.02 * arm().f) ** 2),
        "samples": 40,
        "resonance": (60, 80),
        "progress": False,
    }
    return certify(
        arm(),
        RIG,
        ComputedTorque(arm(), RIG),
        PATH,
        **with_uncertainty(**drawn, **SHORT | {"steps_per_sample": 8}),
    )


def compared(laws):
    return compare(arm(), RIG, laws, PATH, **SHORT)


def trial():
    return Trial(
        family=NASTY[0],
        law=LAW,
        numbers={f"a_variable_{i}": 150.0 for i in range(5)},
        left=3,
        of=2000,
        allowed=0,
        peak=2.0,
        chatter=np.array([1.0, 2.0]),
        noise=0.1,
    )


def gears():
    numbers = dict.fromkeys(
        ("pose", "damping_ratio", "damping_low", "damping_high"), np.array([0.1, 0.1])
    )
    ends = {
        "hz": np.array([40.0, 50]),
        "low": np.array([39.0, 45]),
        "high": np.array([41.0, np.inf]),
    }
    return GearResonance(
        joints=NASTY, searched=np.array([True, True]), played=NASTY[:1], **ends, **numbers
    )


def seen():
    wound = Wound(np.array([[1e-6, 1e-8], [2e-9, 1e-9]]), np.array([[1e-7, 2e-8], [1e-9, 1e-9]]))
    one = Gears.of(wound, NASTY, None, units=(TURNS, SLIDES))
    return dataclasses.replace(one, runs=(one, one), between=RESULTS["BetweenRuns"]())


def load(**options):
    place = {"com": np.array([0.1, 0, np.nan]), "com_std": np.array([0.01, 0, np.inf])}
    numbers = {
        "names": ("mass", "drive.coulomb[0]"),
        "values": np.array([2.0, 0.1]),
        "covariance": np.eye(2) * 1e-4,
    }
    return Load(
        mass=2.0,
        std=0.01,
        arm=arm(),
        rig=RIG,
        rms_innovation=0.3,
        warnings=(NASTY[0],),
        **place,
        **numbers,
    )


def estimate():
    zeros = {"parameters": np.zeros(10), "position": np.zeros(3)}
    return PayloadEstimate(
        mass=2.0,
        std=0.1,
        interval=np.array([1.8, 2.2]),
        sufficient=False,
        explained=True,
        misfit=1.0,
        message=NASTY[0],
        **zeros,
    )


def learning():
    law = LearntTorque(law=ComputedTorque(arm(), RIG), rig=RIG, reference=PATH, terms=np.ones(8))
    two, many = (
        np.ones((2, 2)),
        {"missing": (np.ones(2),), "beyond": (0.1,), "peak": (3.0,), "innovations": (1.0,)},
    )
    return Learning(
        law=law,
        arm=arm(),
        rig=RIG,
        covariance=np.diag(arm().f ** 2),
        friction_std=two,
        rest=0.1,
        gain=0.5,
        left_out=(NASTY[0],),
        diverged=False,
        before=np.zeros(8),
        wanted=np.zeros(8),
        **many,
    )


BODY = Body(mass=1.0, com=(0, 0, 0.1))
RESULTS = {
    "Assumed": lambda: found().assumed(),
    "Budget": lambda: pulse_budget(arm(), RIG, LAW, PATH, duration=0.5),
    "Campaign": lambda: Campaign(
        results={NASTY[0]: 1.0}, errors={NASTY[1]: f"ValueError: {NASTY[0]}"}
    ),
    "Cause": lambda: Cause(
        name="gear",
        joints=(1,),
        size=0.97,
        unit="",
        log_odds=14.0,
        sentence="the gear is not the rig's",
        remedy="Count the teeth",
        rivals=(Rival("length", (1,), 1.03, 12.0),),
    ),
    "Certificate": certificate,
    "Certificates": lambda: certify(
        arm(),
        RIG,
        LAW,
        {NASTY[0]: PATH, NASTY[1]: PATH.later(1.0)},
        **with_uncertainty(
            covariance=np.diag((0.02 * arm().f) ** 2),
            samples=20,
            progress=False,
            after=0.1,
            **SHORT,
        ),
    ),
    "Checkup": (
        lambda: dataclasses.replace(record(), error_pulses=2 * record().error_pulses).check()
    ),
    "Comparison": lambda: compared({NASTY[0]: LAW, NASTY[1]: ComputedTorque(arm(), RIG)}),
    "Detection": lambda: found().diagnostics.detection,
    "Diagnostics": lambda: found().diagnostics,
    "FloatVerdict": lambda: evaluate_float(arm(), Float(arm(), RIG, assist=0.4)),
    "Evaluation": lambda: compared({"P": LAW}).evaluations["P"],
    "Evaluations": lambda: evaluate(
        arm(), RIG, LAW, {NASTY[0]: PATH, "b": PATH.later(1)}, backend="numba", **SHORT
    ),
    "BetweenRuns": lambda: BetweenRuns(
        values=np.ones((2, 3)),
        std=np.ones((2, 3)),
        compared=np.ones(3, bool),
        agree=np.ones(3, bool),
        groups={"f": 0.5},
        deviation=np.ones(3),
        freedom=np.ones(3),
        further=4,
        never=1,
    ),
    "Finding": lambda: record().check().findings[0],
    "Fit": lambda: found().fit,
    "FitTrial": lambda: FitTrial(
        at=40.0, unit="Hz", rows=99, worse=1.0, against=20.0, passed=True, chosen=True
    ),
    "FrictionTrial": lambda: FrictionTrial(
        kind="asymmetric",
        share=None,
        better=0.4,
        errors=9.0,
        levels=np.ones(2),
        units=("N m", "N"),
        usual=np.ones(2),
    ),
    "GearResonance": gears,
    "InnerTrial": lambda: InnerTrial(
        register=NASTY[0],
        inner=PositionServo(gain=(0.1, 0.1)),
        left=1,
        of=64,
        peak=3.0,
        chatter=np.ones(2),
        noise=0.1,
    ),
    "Gears": seen,
    "Identification": found,
    "Judgement": lambda: Judgement(
        robot=NASTY[0],
        time=0.0,
        level=0.01,
        looked=(Change(NASTY[1], NASTY[1], "N m", 1.0, 1.2, 0.01, 1e-9, 0.0),),
    ),
    "Learning": learning,
    "Load": load,
    "LowestResonance": lambda: LowestResonance(hz=60.0, damping_ratio=0.01, within=1),
    "Margins": lambda: margins(arm(), RIG, ComputedTorque(arm(), RIG)),
    "ModelCheck": lambda: ModelCheck(
        path=Path(f"{NASTY[1]}.urdf"), findings=(RESULTS["ModelFinding"](),)
    ),
    "ModelFinding": lambda: ModelFinding(link=NASTY[0], mistake="grams", evidence=9.0, repair=BODY),
    "FrequencyResponse": lambda: FrequencyResponse(
        frequency=np.array([1.0, 20.0]),
        plant=np.full((2, 2, 2), 1e-3 + 0j),
        plant_std=np.full((2, 2, 2), 1e-5),
        loop=np.ones((2, 2, 2), complex),
        loop_std=np.full((2, 2, 2), 0.01),
        period=1e-3,
        joints=NASTY,
        held=1e-3,
    ),
    "MotorFit": lambda: MotorFit(
        names=("law.gain[0]",), values=np.array([0.3]), std=np.array([0.01])
    ),
    "Oscillation": lambda: oscillation(record(), arm()),
    "PayloadEstimate": estimate,
    "PayloadEvent": lambda: PayloadEvent(
        time=1.0, kind="taken", before=0.0, after=2.5, windows=3, message=NASTY[0]
    ),
    "Physical": lambda: Physical(arm=arm(), bodies=(BODY, BODY), distance=2.5),
    "Reserves": lambda: Reserves(
        samples=40,
        allowed=0.0,
        holds=True,
        bandwidth=100.0,
        period=1e-3,
        tried=[("bandwidth", 100.0, 0), ("period", 1e-3, 0)],
    ),
    "ResonanceSweep": lambda: sweep_resonance(
        arm(), RIG, {NASTY[0]: LAW}, PATH, hz=(50, 100), **SHORT
    ),
    "Search": lambda: found().search,
    "Sign": lambda: found().diagnostics.detection.signs[0],
    "Spread": lambda: Spread(
        names=arm().dynamics.names,
        runs=(found(), found()),
        f=np.array([arm().f] * 2),
        alteration=np.full(arm().dynamics.p, 0.1),
        published=np.full(arm().dynamics.p, 0.1),
    ),
    "Uncertainty": lambda: Uncertainty(resonance=(40, 80)),
    "TorqueError": lambda: fit_torque(arm().dynamics, record()).error_on(record()),
    "TorqueFit": lambda: fit_torque(arm().dynamics, record()),
    "Trial": trial,
    "Tuning": lambda: Tuning(law=LAW, trials=(trial(),), certificate=certificate(), fresh=200),
    "Visibility": lambda: visibility(arm().dynamics, PATH),
    "WrittenModel": lambda: WrittenModel(
        path=Path("arm.urdf"),
        bodies={NASTY[0]: BODY},
        rotors=np.zeros(2),
        arm=arm(),
        difference=np.zeros(7),
    ),
}


class Page(HTMLParser):
    """Every tag closed in its order; the text outside the style."""

    def __init__(self, html):
        super().__init__()
        self.open, self.words, self.names = [], "", set()
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.open.append(tag)
        self.names |= {tag, *(name for name, _ in attributes)}

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.words += data


def results(of=Shown):
    """Names of all classes of the packages that are shown."""
    ours = [
        each
        for each in of.__subclasses__()
        if each.__module__.split(".")[0] in ("plant", "identification", "ctc")
    ]
    return {name for each in ours for name in (each.__name__, *results(each))}


def test_every_result_is_here():
    # shown in a Certificate, and its base
    assert results() - {"Worst", "Certified"} == set(RESULTS)


def test_what_is_printed_for_a_table_is_one_of_them():
    """What a docstring says to print is shown in a notebook, too."""
    for package in (plant, identification, ctc):
        for name in package.__all__:
            each = getattr(package, name)
            if inspect.isclass(each) and "rint it" in (each.__doc__ or ""):
                assert issubclass(each, Shown), name


@pytest.mark.parametrize("name", RESULTS)
def test_html_is_whole_escaped_and_small(name):
    html = RESULTS[name]()._repr_html_()
    page = Page(html)
    assert "src" not in page.names
    assert "href" not in page.names
    # none of a joint's name
    assert html.count("<b>") == html.count("</b>") == html.count('<p class="verdict')
    assert NASTY[0] not in html
    assert len(html) < 40_000
    assert page.words.strip()
    if name in (
        "Evaluation",
        "Comparison",
        "Margins",
        "Certificate",
        "Certificates",
        "Evaluations",
        "GearResonance",
        "Identification",
        "Trial",
    ):
        assert NASTY[0] in page.words


@pytest.mark.parametrize("name", RESULTS)
def test_the_first_thing_shown_is_the_verdict_where_there_is_one(name):
    pieces = list(RESULTS[name]()._shown())
    assert not any(isinstance(piece, Verdict) for piece in pieces[1:]) or name == "Tuning"
    judged = (
        "Evaluation",
        "Comparison",
        "Certificate",
        "Certificates",
        "Evaluations",
        "Checkup",
        "Identification",
        "Margins",
        "TorqueFit",
        "Load",
    )
    assert isinstance(pieces[0], Verdict) or name not in judged
    assert name not in judged or pieces[0].good is not None


@pytest.mark.parametrize("name", RESULTS)
def test_text_has_80_columns(name):
    text = str(RESULTS[name]())
    if name not in ("Detection", "LowestResonance"):  # a sentence, for other texts
        assert max(map(len, text.splitlines())) <= 80
    assert text.strip()


@pytest.mark.parametrize("name", RESULTS)
def test_repr_is_one_short_line(name):
    said = repr(RESULTS[name]())
    assert "\n" not in said
    assert len(said) <= 100, said
    assert said.startswith(f"{name}(")
    assert "array(" not in said


def test_a_list_of_results_is_a_list_of_lines():
    assert repr([trial()]) == f"[Trial({NASTY[0]}: 3 of 2000 samples exceed the limit, 0 may)]"


def test_a_comparison_of_many_laws_is_still_one_line():
    one = compared({"P": LAW}).evaluations["P"]
    many = Comparison(
        evaluations={f"a law of a long name {i}": one for i in range(9)}, diverged={"x": "why"}
    )
    assert repr(many) == "Comparison(9 controllers, 1 diverged)"


def test_a_repr_simulates_nothing():
    one = compare(arm(), RIG, {"P": LAW}, PATH, **SHORT).evaluations["P"]
    assert "P: " in repr(one)
    assert "on_gears" not in vars(one)
    assert "rigid gears assumed" in str(one)
    assert "on_gears" in vars(one)


@pytest.mark.parametrize(
    ("part", "begins"),
    [
        (lambda c: c.plants, "Plants(40 that differ in "),
        (lambda c: c.runs, "Runs(40 of "),
        (lambda c: c.sensitivities[0], "Influence("),
        (lambda c: c.cells[0], "Cell(resonance: 60 to "),
        (lambda c: c.worst, "Worst(plant "),
    ],
)
def test_what_a_certificate_holds_is_one_line_too(part, begins):
    said = repr(part(certificate()))
    assert said.startswith(begins)
    assert "\n" not in said
    assert len(said) <= 100
