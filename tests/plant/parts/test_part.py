"""Parts: numbers by name, round trips through numbers and through JSON, refusals."""

import abc
import ast
import dataclasses
import json
import re

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant import (
    PD,
    PID,
    Body,
    Cascade,
    Chain,
    CosineTorque,
    Counterbalance,
    Coupling,
    Elasticity,
    Encoder,
    FrictionCurve,
    FrictionDrift,
    Held,
    Jitter,
    JointSpring,
    Limits,
    Link,
    LinkReference,
    LoggedCurrent,
    LoggedTorque,
    Lumping,
    MitDrive,
    P,
    Part,
    Phase,
    Placement,
    PointToPoint,
    PositionServo,
    Presliding,
    QuadratureError,
    Resumed,
    Rig,
    Spline,
    Table,
    TorqueRipple,
    Transport,
    number,
    part,
    puma560,
    simulate,
    structure,
)
from plant.laws import AlongLog
from plant.machine import CurrentLag, LoadFriction
from plant.parts import PARTS, from_plain
from plant.simulation import Correction

LINKS = (
    Link(name="1", alpha=0.1, a=0.2, d=0.3, theta=0.4),
    Link(name="2", alpha=-np.pi / 2, a=1 / 3, d=0.0),
)
CHAIN = Chain(links=LINKS, gravity=(0.1, 0.2, -9.7))
GEARS = Elasticity.from_resonance(puma560.arm(), (50, 60), 0.02)
EXAMPLES = {
    "Link": LINKS[0],
    "Limits": Limits(lower=(-1, -np.inf), upper=(1, np.inf), velocity=(2, 3), effort=(4, np.inf)),
    "Placement": Placement.of_angles(0.1, 0.2, 0.3, (1, 2, 3)),
    "Chain": CHAIN,
    "Body": Body(mass=1.1, com=(0.1, 0.2, 0.3), inertia=(1, 0.1, 0.2, 1.5, 0.3, 2), rotor=0.7),
    "Lumping": Lumping.standard(CHAIN),
    "Dynamics": puma560.dynamics(),
    "Arm": puma560.arm(),
    "Drive": puma560.rig().drive,
    "Elasticity": Elasticity(stiffness=(1e4, 2e4), damping=(3.0, 0.0), backlash=(1e-3, 0.0)),
    "Resonance": GEARS,
    "CurrentLag": CurrentLag(time=1e-3),
    "FrictionCurve": FrictionCurve(offset=(0.1, -0.2), breakaway=(0.3, 0.0), speed=(5.0, 6.0)),
    "Correction": Correction(position=(0.1, 0.2), speed=(0.01, 0.02), zero=(0.1, 0)),
    "Coupling": Coupling(matrix=((1, 0), (0.5, -1))),
    "Encoder": Encoder(resolution=(800, 1000), smooth=True),
    "Phase": Phase(shift=(0.1, -0.3)),
    "QuadratureError": QuadratureError(amplitude=(0.1, 0.2), phase=(0.0, 1 / 3)),
    "JointSpring": JointSpring(stiffness=(60.0, 0.0), angle=(0.2, 0.0), preload=(0.0, -3.0)),
    "Counterbalance": Counterbalance(
        stiffness=(800.0, 0.0),
        base_arm=(0.3, 0.2),
        link_arm=(0.1, 0.1),
        free_length=(0.1, 0.0),
        angle=(1.0, 0.0),
        tension=(0.0, -200.0),
    ),
    "CosineTorque": CosineTorque(amplitude=(30.0, 0.0), phase=(0.0, 1.0)),
    "Jitter": Jitter(share=0.1, seed=3, stream=8.0),
    "Presliding": Presliding(distance=(0.01, 0.02), damping=(1e-3, 0.0)),
    "LoadFriction": LoadFriction(share=(0.1, 0.2)),
    "FrictionDrift": FrictionDrift(amount=(-0.1, 0.2), time=(1.0, 2.0)),
    "TorqueRipple": TorqueRipple(amplitude=(0.01, 0.02), cycles=(6, 12), phase=(0.1, 0.2)),
    "Transport": Transport(delay=2e-4, lost=(3, 7), bit=0.5),
    "Rig": puma560.rig(),
    "P": puma560.p_law(),
    "LoggedTorque": LoggedTorque(),
    "LoggedCurrent": LoggedCurrent(),
    "PD": PD(gain=(0.2, 0.15), derivative=(1e-3, 0), filter=2000.0),
    "PID": PID(
        gain=(0.2, 0.15), integral=(2, 0), derivative=(1e-3, 0), filter=2000.0, period=0.7e-3
    ),
    "PositionServo": PositionServo(
        gain=(0.2, 1 / 3), damping=1e-4, speed=(np.inf, 3400), supply=0.9
    ),
    "MitDrive": MitDrive(kp=(80, 10 / 3), kd=2, limits=((12.5, 12), 30, 500, 5, 10)),
    "Cascade": Cascade(position=(50, 60), speed=(2e-3, 1e-3), integral=(0.1, 0), filter=2000.0),
    "Resumed": Resumed(law=puma560.p_law(), state=()),
    "AlongLog": AlongLog(
        law=PD(gain=(0.2,), derivative=(1e-3,), filter=2000.0), state=(1.0, 1 / 3), whole=False
    ),
    "Harmonics": puma560.reference(),
    "Later": puma560.reference().later(1 / 3),
    "Moved": puma560.reference().moved((1.0, -1.0), (0.1, 1 / 3)),
    "Held": Held(times=(0, 1), points=((0.0,), (0.5,))),
    "PointToPoint": PointToPoint(start=(0.0, 0.1), goal=(1.0, 2.0), duration=0.3),
    "Spline": Spline(times=(0, 1, 2), points=((0, 0), (1, 1 / 3), (2, 0))),
    "Scaled": PointToPoint(start=(0.0,), goal=(1.0,), duration=0.3).slowed(2.0),
    "LinkReference": LinkReference(
        puma560.arm(),
        dataclasses.replace(
            puma560.rig(), drive=dataclasses.replace(puma560.rig().drive, elasticity=GEARS)
        ),
        puma560.reference(),
    ),
    "Table": Table(times=(0.1, 1), points=((0,), (0.1,))),
}
EVERY = pytest.mark.parametrize("example", EXAMPLES.values(), ids=EXAMPLES.keys())


@part
class Nested(Part):
    rig: Rig = structure()
    scale: float = number(())
    table: np.ndarray = number(("m",), finite=False)
    mode: str = structure(default="fast")


def nested():
    return Nested(rig=puma560.rig(), scale=2.5, table=(1.0, np.inf, -0.0))


def test_every_kind_of_the_package_is_among_the_examples():
    kinds = {
        kind.split(".")[1]
        for kind in PARTS
        if kind.startswith("plant.") and not kind.startswith("plant._")
    }
    assert kinds - {"P"} <= set(EXAMPLES), "add an example for the new part"


def test_numbers_are_named_by_their_path():
    rig = puma560.rig()
    names = rig.number_names()
    assert names[:3] == ["drive.gear[0]", "drive.gear[1]", "drive.motor_inertia[0]"]
    assert names[-2:] == ["encoder.resolution[0]", "encoder.resolution[1]"]
    assert rig.number_values()[names.index("drive.coulomb[1]")] == 0.146
    law = puma560.p_law((0.3, 0.2))
    assert law.number_names("law.") == ["law.gain[0]", "law.gain[1]"]
    assert law.numbers("law.") == {"law.gain[0]": 0.3, "law.gain[1]": 0.2}
    assert puma560.arm().number_names() == [f"f[{i}]" for i in range(9)]
    assert nested().number_names()[-4:] == ["scale", "table[0]", "table[1]", "table[2]"]
    assert PointToPoint(start=(0,), goal=(1,), duration=1).number_names() == []


@EVERY
def test_numbers_there_and_back(example):
    values = example.number_values()
    assert len(values) == len(example.number_names())
    assert example.with_numbers(values) == example
    if len(values):
        changed = values * 0.5  # a bit of `Transport` stays a power of two
        assert example.with_numbers(changed) != example
        np.testing.assert_array_equal(example.with_numbers(changed).number_values(), changed)


@pytest.mark.parametrize("length", [0, 1, 3])
def test_a_vector_of_another_length_is_refused(length):
    law = P(gain=(1.0, 2.0))
    with pytest.raises(
        ValueError, match=rf"vector must have shape \(2,\); got shape \({length},\)"
    ):
        law.with_numbers(np.ones(length))
    with pytest.raises(ValueError, match=f"vector must have 2 symbols; got {length}"):
        law.with_numbers(ca.SX.sym("x", length))


def test_a_list_of_numbers_is_checked_like_an_array():
    law = P(gain=(1.0, 2.0))
    assert law.with_numbers([3.0, 4.0]) == P(gain=(3.0, 4.0))
    with pytest.raises(ValueError, match="gain of P must be finite; got nan"):
        law.with_numbers([np.nan, 1.0])


def test_numbers_of_a_nested_part_there_and_back():
    example = nested()
    assert example.with_numbers(example.number_values()) == example
    assert isinstance(example.with_numbers(example.number_values()).scale, float)


def test_symbols_take_the_place_of_numbers_one_by_one():
    example = nested()
    symbols = ca.SX.sym("x", len(example.number_values()))
    copy = example.with_numbers(symbols)
    assert isinstance(copy.rig.drive.gear, ca.SX)
    assert copy.mode == "fast"
    leaves = [value for _, _, _, value in copy._leaves()]
    values = np.arange(symbols.shape[0], dtype=float)
    together = ca.Function("f", [symbols], [ca.vertcat(*leaves)])(values).full().ravel()
    np.testing.assert_array_equal(together, values)


@EVERY
def test_description_survives_json_and_restores_an_equal_part(example):
    text = json.dumps(example.describe())
    again = from_plain(json.loads(text))
    assert type(again) is type(example)
    assert again == example
    assert hash(again) == hash(example)
    assert example.describe()["kind"] == f"plant.{type(example).__name__}"
    np.testing.assert_array_equal(again.number_values(), example.number_values())


@settings(derandomize=True, max_examples=50)
@given(st.lists(st.floats(min_value=1e-300, max_value=1e300), min_size=1, max_size=4))
def test_no_bit_is_lost_on_the_way(gain):
    law = P(gain=gain)
    assert from_plain(json.loads(json.dumps(law.describe()))).gain.tobytes() == law.gain.tobytes()


def test_parts_with_other_numbers_or_structure_differ():
    assert P(gain=(1.0, 2.0)) != P(gain=(1.0, 2.0 + 4e-16))
    assert Encoder(resolution=(1,)) != Encoder(resolution=(1,), smooth=True)
    assert P(gain=(1.0,)) != (1.0,)
    assert len({P(gain=(1.0,)), P(gain=(1.0,)), P(gain=(2.0,))}) == 2


def test_equal_parts_have_equal_hashes():
    assert P(gain=(0.0,)) == P(gain=(-0.0,))
    assert hash(P(gain=(0.0,))) == hash(P(gain=(-0.0,)))
    for modes in ((1, 1.0), ({"a": 1, "b": 2}, {"b": 2, "a": 1})):
        one, other = (dataclasses.replace(nested(), mode=mode) for mode in modes)
        assert one == other
        assert hash(one) == hash(other)
    with pytest.raises(TypeError):
        hash(dataclasses.replace(nested(), mode=object()))


def test_parts_are_frozen_and_do_not_keep_the_caller_s_array():
    gain = np.array([1.0, 2.0])
    law = P(gain=gain)
    gain[0] = 9.0
    assert law.gain[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        law.gain[0] = 3.0
    with pytest.raises(AttributeError):
        law.gain = gain


def test_none_may_be_the_default_of_a_number_that_is_structure():
    @part
    class Paced(Part):
        period: float = structure(float, default=None)

    assert Paced().period is None
    assert Paced(period=2).period == 2.0
    with pytest.raises(ValueError, match="period of Paced must be a finite number"):
        Paced(period="2")


# -- refusals ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("package", "hint"), [("ctc", "import ctc first"), ("identification", "import identification first"),
                          ("mine", "check the file")]
)  # fmt: skip
def test_unknown_kind_says_which_package_to_import(package, hint):
    with pytest.raises(
        ValueError,
        match=rf"kind must be a known one, such as .*; got '{package}\.Magic'\. Please {hint}\.",
    ) as error:
        from_plain({"kind": f"{package}.Magic"})
    assert "\n" not in str(error.value)


def test_description_with_missing_or_unknown_fields_is_refused():
    with pytest.raises(ValueError, match=r"missing a required (keyword-only )?argument: 'gain'"):
        from_plain({"kind": "plant.P"})
    with pytest.raises(ValueError, match="Did you mean 'gain'"):
        from_plain({"kind": "plant.P", "gains": [1.0]})
    for kind in (None, 7, ["plant.P"]):
        with pytest.raises(
            ValueError,
            match=r"kind must be a known one, such as .*; got .*\. Please check the file\.",
        ):
            from_plain({"kind": kind, "gain": [1.0]})


MISSPELT = {
    "Held": "point",
    "LoggedTorque": "heldd",
    "LoggedCurrent": "heldd",
    "Limits": "velocty",
    "Link": "alhpa",
    "Chain": "gravitiy",
    "Body": "inertai",
    "Lumping": "matirx",
    "Dynamics": "range",
    "Arm": "ff",
    "Drive": "gaer",
    "Encoder": "smoth",
    "Rig": "priod",
    "P": "gian",
    "PositionServo": "dead_zon",
    "MitDrive": "bit",
    "Harmonics": "cosin",
    "PointToPoint": "gaol",
    "Spline": "point",
    "Table": "time",
    "Placement": "positon",
    "FrictionCurve": "ofset",
    "Coupling": "matirx",
    "Phase": "shfit",
    "Transport": "dealy",
    "Correction": "positoin",
    "Scaled": "palces",
    "Resumed": "stat",
    "AlongLog": "whol",
    "Later": "tim",
    "Moved": "sign",
    "PD": "derivativ",
    "PID": "intergal",
    "Cascade": "sped",
    "Elasticity": "stifness",
    "Resonance": "hx",
    "CurrentLag": "tmie",
    "QuadratureError": "amplitud",
    "Jitter": "shrae",
    "JointSpring": "stifness",
    "Counterbalance": "tensoin",
    "CosineTorque": "amplitud",
    "Presliding": "distence",
    "LoadFriction": "shrae",
    "FrictionDrift": "amuont",
    "TorqueRipple": "cylces",
    "LinkReference": "refrence",
}


@EVERY
def test_misspelt_field_is_a_value_error_with_the_nearest_name(example):
    if not dataclasses.fields(example):
        with pytest.raises(
            ValueError, match=rf"{type(example).__name__} has no options; got 'hold'. Leave it out."
        ):
            type(example)(hold=1.0)
        return
    wrong = MISSPELT[type(example).__name__]
    with pytest.raises(
        ValueError, match=rf"an option of {type(example).__name__} .*got '{wrong}'\. Did you mean '"
    ):
        type(example)(**{wrong: 1.0})


def test_misspelt_option_of_simulate():
    with pytest.raises(ValueError, match="Did you mean 'steps_per_sample'"):
        simulate(
            puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), step_per_sample=4
        )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: P(gain=(1.0, np.nan)), "gain of P must be finite; got nan at index 1"),
        (
            lambda: P(gain=1.0),
            r"gain of P must have shape \(n,\); got shape \(\), 1\.0\. Give a list, one",
        ),
        (lambda: P(gain=()), r"gain of P must have shape \(n,\), of one joint or more; got none"),
        (lambda: Encoder(resolution=np.nan), r"Encoder must be finite; got nan\. Give one number"),
        (
            lambda: Nested(rig=puma560.rig(), scale=(1, 2), table=(1,)),
            r"scale of Nested must have shape \(\)",
        ),
        (
            lambda: Nested(rig=puma560.rig(), scale=1, table=(np.nan,)),
            "table of Nested must be numbers; got NaN",
        ),
        (lambda: Link(name="1", alpha="x", a=0, d=0), "alpha of Link must be a finite number"),
        (lambda: Chain(links=()), r"links must be at least one Link; got \(\)"),
        (lambda: Chain(links=(1, 2)), "links must be at least one Link"),
        (lambda: Chain(links=LINKS, gravity=(0, 0)), "gravity must have shape"),
        (lambda: Body(mass=1, com=(0, 0), inertia=(0,) * 6), r"com of Body must have shape \(3,\)"),
        (
            lambda: puma560.dynamics().arm(np.ones(8)),
            re.escape("f has shape (8,); this arm has 9 parameters (f1..f9)"),
        ),
    ],
)
def test_bad_field_is_refused_by_name(make, message):
    with pytest.raises(ValueError, match=message) as error:
        make()
    assert "\n" not in str(error.value)


def test_a_matrix_of_numbers_is_no_field():
    with pytest.raises(ValueError, match=r"shape must be \(\) or one length; got \(2, 2\)"):
        number((2, 2))


def test_an_abstract_part_is_refused_by_its_own_name():
    class Base(Part, abc.ABC):
        @abc.abstractmethod
        def torque(self): ...

    with pytest.raises(ValueError, match="Base must give all that Base declares; it lacks torque"):
        part(Base)


def test_the_advice_for_a_length_that_is_not_that_of_joints_names_no_joints():
    @part
    class Pair(Part):
        first: np.ndarray = number(("m",))
        second: np.ndarray = number(("m",))

    with pytest.raises(ValueError, match=r"second of Pair must have shape \(2,\)") as error:
        Pair(first=(1, 2), second=(1,))
    assert "joint" not in str(error.value)


def test_several_parts_may_be_a_list_and_are_parts():
    @part
    class Group(Part):
        laws: tuple = structure(several=True)

    group = Group(laws=[P(gain=(1.0,)), P(gain=(2.0,))])
    assert group.numbers() == {"laws[0].gain[0]": 1.0, "laws[1].gain[0]": 2.0}
    with pytest.raises(ValueError, match="laws of Group must be of type Part; got a value of type"):
        Group(laws=(1.0,))


def test_the_numbers_of_several_parts_in_one_field_count_by_their_place():
    """And only where the field says so: the links of a chain are structure."""
    springs = EXAMPLES["JointSpring"], EXAMPLES["CosineTorque"]
    rig = dataclasses.replace(puma560.rig(), springs=springs)
    assert rig.number_names()[-10] == "springs[0].stiffness[0]"
    assert rig.number_names()[-1] == "springs[1].phase[1]"
    symbols = ca.SX.sym("numbers", len(rig.number_names()))
    assert (
        str(rig.with_numbers(symbols).springs[1].phase[1])
        == f"numbers_{len(rig.number_names()) - 1}"
    )
    assert rig.with_numbers(rig.number_values()) == rig == from_plain(rig.describe())


@part
class Switched(Part):
    size: float = number(())
    rule: str = structure(choices=("slow", "fast", "still"), default="fast")
    measured: bool = structure(bool, default=False)
    derived: bool = structure(bool, default=None)
    label: str = structure(str, default="a")


def test_variants_differ_in_one_switch_or_choice():
    one = Switched(size=2.0)
    others = one.variants()
    assert list(others) == ["rule='slow'", "rule='still'", "measured=True"]
    for text, other in others.items():
        name, value = text.split("=")
        changed = {"rule": one.rule, "measured": one.measured} | {name: ast.literal_eval(value)}
        assert other == Switched(size=2.0, **changed)


def test_a_value_that_is_no_choice_is_refused():
    with pytest.raises(ValueError, match=r"rule of Switched must be .*'slow'.*'fats'.*'fast'\?"):
        Switched(size=1.0, rule="fats")


@part
class Alike(Part):
    gain: object = number(("n",), alike=True)
    spread: object = number(("n",), default=None)


@pytest.mark.parametrize("one", [2.0, 2, np.float64(2.0), np.array(2.0), np.array(2)])
def test_one_number_for_all_joints_may_be_an_array_without_axes(one):
    alone = Alike(gain=one)
    assert alone.gain.shape == ()
    assert dataclasses.replace(alone) == alone == Alike(gain=2.0)
    both = Alike(gain=one, spread=[1.0, 3.0])
    assert both.gain.shape == ()
    repeated = dataclasses.replace(puma560.rig().drive, viscous=one)
    assert repeated.viscous.tolist() == [2.0, 2.0]


@pytest.mark.parametrize("wrong", [np.array(True), np.array("a"), [[1.0], [1.0, 2.0]]])
def test_what_is_no_row_of_numbers_is_refused_by_the_name_of_its_field(wrong):
    with pytest.raises(ValueError, match=r"^gain of Alike must"):
        Alike(gain=wrong)
