"""The exported C against the simulation, whose torque comes from casadi and from LLVM
instructions, not from C.
"""

import ctypes
import dataclasses
import re
import shutil
import subprocess
from functools import cache

import casadi as ca
import numpy as np
import pytest

from ctc import Adaptive, ComputedTorque, ComputedTorquePID
from plant import (
    PD,
    PID,
    Cascade,
    Counterbalance,
    Elasticity,
    FrictionCurve,
    JointSpring,
    Law,
    LinkReference,
    P,
    number,
    part,
    puma560,
    simulate,
    write_replay,
)
from plant.compiler import STATE, statements

STRICT = "-std=c99 -O2 -Wall -Wextra -Werror -pedantic"
ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
CC = shutil.which("cc")
needs_c = pytest.mark.skipif(
    CC is None or shutil.which("make") is None, reason="no C compiler (cc) or no make here"
)


def elastic_rig():
    gears = Elasticity.from_resonance(ARM, 25, 0.02, drive=RIG.drive)
    return dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears))


SPRINGS = (
    JointSpring(stiffness=(80.0, 30.0), angle=(0.3, -0.5)),
    Counterbalance(
        stiffness=(800.0, 300.0),
        base_arm=(0.3, 0.2),
        link_arm=(0.1, 0.1),
        free_length=(0.1, 0.1),
        angle=(1.0, 0.0),
    ),
)
# Every number of a friction curve, and a level that rises with the load.
FRICTION = dataclasses.replace(
    RIG.drive,
    curve=FrictionCurve(
        offset=(0.02, -0.03),
        breakaway=(0.1, 0.05),
        speed=(4.0, 6.0),
        viscous_offset=(3e-4, -5e-4),
        saturation=(20.0, np.inf),
        rise=(0.5, 0.0),
    ),
    load_friction=(0.1, 0.05),
)
RUBBED = dataclasses.replace(RIG, drive=FRICTION)
LAWS = {
    "friction": ComputedTorque(ARM, RUBBED),
    "computed torque": ComputedTorque(ARM, RIG),
    "measured and delayed": ComputedTorque(ARM, RIG, measured=True, delay=1),
    "PID": ComputedTorquePID(
        ARM, RIG, bandwidth=179.0, ratio=1.44, integral=66.4, roll_off=1085.0, roll_off_damping=0.99
    ),
    "elastic gears": ComputedTorque(ARM, elastic_rig(), bandwidth=80, dead_zone=0.4),
    "P": puma560.p_law(),
    "springs": ComputedTorque(ARM, dataclasses.replace(RIG, springs=SPRINGS)),
}  # fmt: skip


@cache
def simulated(name):
    if name == "elastic gears":
        return simulate(ARM, elastic_rig(), LAWS[name], LinkReference(ARM, elastic_rig(), PATH))
    if name == "friction":
        return simulate(ARM, RUBBED, LAWS[name], PATH)
    rig = dataclasses.replace(RIG, springs=SPRINGS) if name == "springs" else RIG
    return simulate(ARM, rig, LAWS[name], PATH)


def run(*command, cwd=None, check=True):
    return subprocess.run(  # noqa: S603
        [str(each) for each in command], cwd=cwd, capture_output=True, text=True, check=check
    )


def built(folder, law, rig=RIG, guards=None, **options):
    law.to_c(folder, rig, guards=guards, **options)
    run("make", f"CFLAGS={STRICT}", cwd=folder)
    return folder / options.get("name", "controller")


def replayed(program, record):
    path = program.parent / "record.csv"
    write_replay(record, path)
    return np.loadtxt(run(program, path).stdout.splitlines(), delimiter=",", ndmin=2)


# -- the same torque -----------------------------------------------------------------------------
@needs_c
@pytest.mark.parametrize("name", LAWS)
def test_the_same_pulses_give_the_torque_of_the_simulation(tmp_path, name):
    """All of (6), to 1e-12 of the largest torque: some thousand roundings, which the observer's
    gains amplify.
    """
    record = simulated(name)
    torque = replayed(built(tmp_path, LAWS[name]), record)
    # links that swing on their gears sum rounding up
    off = 1e-11 if name == "elastic gears" else 1e-12
    np.testing.assert_allclose(
        torque, record.torque, rtol=0, atol=off * np.abs(record.torque).max()
    )


@needs_c
def test_the_limit_of_the_amplifier_is_in_the_controller(tmp_path):
    """Started 0.02 rad off, the loop saturates, and the observer must know of it; the same as in
    the simulation.
    """
    record = simulate(
        ARM, RIG, LAWS["computed torque"], PATH, duration=0.5, initial=[[0.02, -0.02], [0, 0]]
    )
    at_limit = np.abs(record.torque) >= RIG.drive.torque_limit() * (1 - 1e-12)
    assert at_limit.any(axis=0).all()
    torque = replayed(built(tmp_path, LAWS["computed torque"]), record)
    np.testing.assert_allclose(
        torque, record.torque, rtol=0, atol=1e-12 * np.abs(record.torque).max()
    )


@needs_c
def test_counts_of_the_converter_are_the_rounded_current(tmp_path):
    """Where the scaled current is within 1e-9 of a half, rounding may go either way."""
    scale, record = np.array([2500.0, -1234.5]), simulated("computed torque")
    counts = replayed(
        built(tmp_path, LAWS["computed torque"], output="dac", counts_per_ampere=scale), record
    )
    exact = record.current * scale
    clear = np.abs(exact - np.floor(exact) - 0.5) > 1e-9
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(counts[clear], np.rint(exact)[clear])
    assert np.abs(counts).max() > 10_000


@part
class Everything(Law):
    """A law that goes where others do not: */ /* ??/ a comment's end, "quotes", ünicode.

    Parameters
    ----------
    weight : (n,) array_like
        Of everything; */ int x; /*
    """

    period = None

    weight: np.ndarray = number(("n",))

    def initial_state(self, n):
        return np.full(n, -0.5)

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        x, y = setpoint.q, setpoint.qd
        terms = [
            ca.sin(x),
            ca.cos(x) * ca.tan(y / 9),
            ca.exp(-x * x),
            ca.sqrt(1 + x * x),
            ca.atan2(x, 1 + y * y),
            ca.if_else(x > y, x - (y - (x - y)), x / (1 + y * y) / 3),
            ca.fabs(x) ** 1.5,
            ca.tanh(x),
            ca.if_else(ca.logic_and(x > 0, ca.logic_not(y <= 0)), 2, -3) / (1 + (x < y)),
            ca.copysign(2, y),
            ca.ceil(x) - ca.floor(y),
            ca.fmin(x, y),
            1 / (x * x + 1) + 2 / (x * x + 1),
            ca.sign(y),
            ca.if_else(ca.logic_or(x > 1, y > 1), x, y),
            ca.log(1 + x * x),
            ca.asin(x / 9) + ca.acos(y / 9),
        ]
        return self.weight * sum(terms, 0 * x) + state + 1e-3 * pulses, ca.tanh(
            state + x * y + torque * 1e-3
        )


@needs_c
def test_every_operation_is_casadis(tmp_path):
    """A law made of all of them, against casadi evaluating its block: to rounding, 1e-13 of the
    largest.
    """
    law = Everything(weight=(1.0, -2.0))
    record = simulate(ARM, RIG, LAWS["P"], PATH, duration=0.28)
    torque = replayed(built(tmp_path, law), record)
    block, motion = law.block(RIG), PATH(record.t)
    counts, state, given, expected = (
        record.reference_pulses - record.error_pulses,
        block.initial,
        np.zeros(2),
        [],
    )
    for k in range(len(record)):
        step = block.step(
            state,
            *(x[k] for x in motion),
            RIG.counts(motion.q[k]),
            counts[k],
            given,
            RIG.period,
            block.values,
        )
        asked, state = (x.full().ravel() for x in step)
        given = RIG.drive.limited(asked)
        expected.append(given)
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


def test_an_expression_keeps_its_order():
    """Brackets stand where C would otherwise join the operations in another order, and nowhere
    else.
    """
    x = ca.SX.sym("x", 3)
    a, b, c = ca.vertsplit(x)
    results = [
        a - (b - c),
        a - b - c,
        a / (b * c),
        a * b / c,
        -(a + b) * c,
        (a + b) * c,
        a + b * c,
        -(-a - b),
        a - (-b),
    ]
    function = ca.Function("f", [x], [ca.vertcat(*results)])
    _, text, used = statements(function, [[("a", STATE), ("b", STATE), ("c", STATE)]])
    assert text[:7] == [
        "a - (b - c)",
        "a - b - c",
        "a / (b * c)",
        "a * b / c",
        "-((a + b) * c)",
        "(a + b) * c",
        "a + b * c",
    ]
    assert used == {"a", "b", "c"}
    values = {"a": 0.7, "b": -1.3, "c": 2.1}
    got = [eval(each, {}, values) for each in text]  # noqa: S307 - C's arithmetic is Python's here
    np.testing.assert_array_equal(got, function([*values.values()]).full().ravel())


# -- a good citizen ------------------------------------------------------------------------------
def library(folder, law):
    law.to_c(folder, RIG, guards=None)
    run(CC, *STRICT.split(), "-fPIC", "-shared", "-o", "lib.so", "controller.c", "-lm", cwd=folder)
    return ctypes.CDLL(str(folder / "lib.so"))


class Controller:
    """One instance in C, as a program in C would have it."""

    def __init__(self, library):
        self.library, self.memory = library, ctypes.create_string_buffer(4096)
        library.controller_init(self.memory)

    def step(self, pulses, q, qd, qdd):
        torque = (ctypes.c_double * 2)()
        motion = [(ctypes.c_double * 2)(*each) for each in (q, qd, qdd)]
        refused = self.library.controller_step(
            self.memory, (ctypes.c_int32 * 2)(*pulses), *motion, torque
        )
        return refused, list(torque)


@needs_c
def test_two_controllers_do_not_share_state(tmp_path):
    c = library(tmp_path, LAWS["computed torque"])
    one, other = Controller(c), Controller(c)
    on_it = (RIG.cell_centre(np.array([3, -2])), (0.1, 0.2), (0, 0))
    first = one.step((3, -3), *on_it)
    assert one.step((3, -3), *on_it) != first  # there is a state
    assert other.step((3, -3), *on_it) == first
    c.controller_init(one.memory)
    assert one.step((3, -3), *on_it) == first


@needs_c
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_reference_that_is_no_number_changes_nothing(tmp_path, bad):
    c = library(tmp_path, LAWS["computed torque"])
    one, other = Controller(c), Controller(c)
    good = ((0.1, 0.2), (0.3, 0.4), (0.5, 0.6))
    before = one.step((3, -2), *good)
    assert other.step((3, -2), *good) == before
    for place in range(3):
        motion = [list(each) for each in good]
        motion[place][1] = bad
        memory = bytes(one.memory)
        assert one.step((3, -2), *motion) == (1, before[1])
        assert bytes(one.memory) == memory
    assert one.step((4, -2), *good) == other.step((4, -2), *good)


@needs_c
@pytest.mark.skipif(shutil.which("nm") is None, reason="no nm here")
def test_the_object_needs_only_mathematics_and_has_no_memory_of_its_own(tmp_path):
    """Nothing from outside but functions of <math.h>; no writable data."""
    built(tmp_path, LAWS["measured and delayed"])
    symbols = [
        line.split()[-2:] for line in run("nm", tmp_path / "controller.o").stdout.splitlines()
    ]
    needed = {name.split("@")[0].lstrip("_") for kind, name in symbols if kind == "U"}
    known = {"sin", "cos", "sincos", "sqrt", "trunc", "floor", "GLOBAL_OFFSET_TABLE_"}
    assert needed <= known
    assert not [name for kind, name in symbols if kind in "bBdDC"]


@needs_c
def test_every_number_of_the_controller_has_a_name_and_a_comment(tmp_path):
    f = ARM.f.copy()
    f[6] += 1 / 3
    ComputedTorque(puma560.dynamics().arm(f), RIG, bandwidth=123.456).to_c(tmp_path, guards=None)
    source = (tmp_path / "controller.c").read_text()
    assert repr(float(f[6])) in source
    assert "Magnitude of the regulator's poles [rad/s]" in source
    assert "static const double law_bandwidth = 123.456;" in source
    assert len(re.findall(r"^/\* .*?\*/\nstatic const double", source, re.M | re.S)) == len(
        re.findall(r"^static const double", source, re.M)
    )
    header = (tmp_path / "controller.h").read_text()
    assert "#define CONTROLLER_PERIOD 0.0007" in header
    assert "ComputedTorque" in header


# -- the program that replays a record -----------------------------------------------------------
@needs_c
def test_the_program_refuses_what_is_no_record_and_says_where(tmp_path):
    program = built(tmp_path, LAWS["P"])
    row = "1,2,0.1,0.2,0.3,0.4,0.5,0.6"
    cases = {
        "short": (f"a,b\n{row}\n1,2,0.1\n", "line 3 must hold 2 counts and 6 numbers"),
        "long": (f"{row},7\n", "line 1 must hold"),
        "half a count": ("1.5" + row[1:], "line 1 must hold"),
        "too large": ("3000000000" + row[1:], "line 1 must hold"),
        "words": (f"{row}\nnan{row[1:]}\n", "line 2 must hold"),
        "no number": (row.replace("0.1", "nan"), "no finite torque in row 1"),
        "empty": ("\n", "holds no row"),
    }
    for name, (text, said) in cases.items():
        (tmp_path / "bad.csv").write_text(text)
        done = run(program, tmp_path / "bad.csv", check=False)
        assert done.returncode == 1, name
        assert said in done.stderr
    assert "cannot be read" in run(program, tmp_path / "none.csv", check=False).stderr
    assert run(program, check=False).returncode == 2
    (tmp_path / "good.csv").write_text(f"# names follow\n{row}\r\n\n{row}")
    assert len(run(program, tmp_path / "good.csv").stdout.splitlines()) == 2
    assert re.fullmatch(
        r"[\d.]+ ns per step\n", run(program, "--time", tmp_path / "good.csv").stdout
    )


# -- what is refused -----------------------------------------------------------------------------
def test_files_that_are_not_its_own_stay(tmp_path):
    law = LAWS["P"]
    (tmp_path / "notes.txt").write_text("mine")
    law.to_c(tmp_path, RIG)
    law.to_c(tmp_path, RIG)  # over its own
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "CMakeLists.txt",
        "Makefile",
        "controller.c",
        "controller.h",
        "main.c",
        "notes.txt",
    ]
    with pytest.raises(ValueError, match=r"main.c must not exist, or be an export of left"):
        law.to_c(tmp_path, RIG, name="left")
    assert not (tmp_path / "left.c").exists()
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "Makefile").write_text("all:\n")
    with pytest.raises(ValueError, match="Makefile must not exist"):
        law.to_c(tmp_path / "new", RIG)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["Makefile"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"rig": None}, "rig must be given, since P holds none"),
        ({"rig": ARM}, "rig must be of type Rig"),
        ({"name": "../up"}, "name must be a small letter"),
        ({"name": "main"}, "and not main"),
        ({"name": "a b"}, "name must be"),
        ({"name": "x\n"}, "name must be"),
        ({"name": 7}, "name must be"),
        ({"output": "torqe"}, "Did you mean 'torque'"),
        ({"outptu": "torque"}, "Did you mean 'output'"),
        ({"output": "dac"}, "counts_per_ampere must be numbers|counts_per_ampere must have shape"),
        ({"output": "dac", "counts_per_ampere": (1, 0)}, "must not be zero"),
        (
            {"output": "dac", "counts_per_ampere": (1, 5000)},
            r"must reach the current limit, 12 A at joint q\[1\]",
        ),
        ({"output": "dac", "counts_per_ampere": (1, 1), "largest_count": 20.5}, "must be whole"),
        ({"output": "dac", "counts_per_ampere": (1, 1), "largest_count": 2**31}, "below 2.31"),
        ({"counts_per_ampere": (1, 1)}, "Choose output='dac'"),
        ({"guards": "none"}, "guards must be of type Guards"),
        ({"guard": None}, "Did you mean 'guards'"),
        ({"folder": 3}, "folder must be a path"),
        ({"folder": __file__}, "is a file. Name another"),
        (
            {
                "rig": dataclasses.replace(
                    RIG, encoder=dataclasses.replace(RIG.encoder, smooth=True)
                )
            },
            "got a smooth one",
        ),
    ],
    ids=str,
)
def test_bad_input_is_refused_in_one_line(tmp_path, options, said):
    with pytest.raises(ValueError, match=said) as refusal:
        P(gain=(1, 1)).to_c(**{"folder": tmp_path / "c", "rig": RIG, **options})
    assert "\n" not in str(refusal.value)
    assert not (tmp_path / "c").exists()


@part
class Holding(P):
    """Its place is a number with the name of an argument that it does not read."""

    q_r: object = number(("n",))

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        error = rig.position_in_pulses(self.q_r) - pulses
        return rig.drive.joint_torque(self.gain * error), state


@needs_c
def test_an_argument_is_unread_although_a_number_has_its_name(tmp_path):
    built(tmp_path, Holding(gain=(0.2, 0.1), q_r=(0.1, -0.2)))  # warnings are errors
    assert "(void)q_r; (void)qd_r; (void)qdd_r;" in (tmp_path / "controller.c").read_text()


@part
class Accented(P):
    """A law whose number has a name that C does not allow."""

    größe: np.ndarray = number(("n",))

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return self.größe * setpoint.q, state


def test_a_name_beyond_ascii_leaves_no_partial_export(tmp_path):
    with pytest.raises(ValueError, match=r"controller.c must be ASCII; got 'ö'"):
        Accented(gain=(1, 1), größe=(1, 1)).to_c(tmp_path / "c", RIG)
    assert not (tmp_path / "c").exists()


def test_a_path_through_a_file_or_a_link_to_nowhere_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for folder in ("notes.txt/out", "link", "link/out"):
        with pytest.raises(ValueError, match=r"(notes.txt|link) is a file. Name another"):
            LAWS["P"].to_c(tmp_path / folder, RIG)
    assert not (tmp_path / "nowhere").exists()


def test_a_converter_of_exactly_the_current_limit_is_enough(tmp_path):
    """8191 / (8191 / 15) is a bit below 15."""
    drive = dataclasses.replace(RIG.drive, current_limit=(15.0, 15.0))
    rig = dataclasses.replace(RIG, drive=drive)
    options = {"rig": rig, "output": "dac", "largest_count": 8191}
    LAWS["P"].to_c(tmp_path, counts_per_ampere=(8191 / 15, -8191 / 15), **options)
    with pytest.raises(ValueError, match="must reach the current limit"):
        LAWS["P"].to_c(tmp_path, counts_per_ampere=(8191 / 15, -8192 / 15), **options)


def test_a_smooth_record_has_no_counts(tmp_path):
    rig = dataclasses.replace(RIG, encoder=dataclasses.replace(RIG.encoder, smooth=True))
    record = dataclasses.replace(
        simulated("P"), error_pulses=simulated("P").error_pulses + 0.25, rig=rig
    )
    with pytest.raises(ValueError, match="pulses of the record must be whole"):
        write_replay(record, tmp_path / "record.csv")


# -- under sanitizers: ordinary samples, and whatever a caller may give --------------------------
SANITIZERS = (
    "-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all"
    " -fno-omit-frame-pointer"
)

DRIVER = r"""
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include "controller.h"

int main(void)
{
    static const double odd[] = {0.0, -0.0, 1e-320, 1.0, -3.0, 1e5, 1e300, -1e300, NAN, INFINITY, -INFINITY};
    static const int32_t counts[] = {0, 1, -1, 799, -40000, INT32_MAX, INT32_MIN, INT32_MAX - 1, 12345};
    const int kinds = (int)(sizeof odd / sizeof *odd), numbers = (int)(sizeof counts / sizeof *counts);
    controller_state *self = malloc(sizeof *self);
    double torque[CONTROLLER_JOINTS] = {0.0}, limit = 1e9;
    long refused = 0, bad = 0;
    controller_init(self);
    for (long k = 0; k < 60000; ++k) {
        double q[CONTROLLER_JOINTS], qd[CONTROLLER_JOINTS], qdd[CONTROLLER_JOINTS];
        int32_t pulses[CONTROLLER_JOINTS];
        const int kind = (int)(k / 2000 % 4); /* ordinary, stuck counts, odd numbers, odd counts */
        for (int j = 0; j < CONTROLLER_JOINTS; ++j) {
            const double s = 1e-3 * (double)(k % 2000) + j;
            q[j] = 0.3 * sin(s), qd[j] = 0.3 * cos(s), qdd[j] = -0.3 * sin(s);
            pulses[j] = kind == 1 ? 7 : (int32_t)(13000.0 * q[j]);
            if (kind == 2) {
                q[j] = odd[rand() % kinds], qd[j] = odd[rand() % kinds], qdd[j] = odd[rand() % kinds];
            }
            if (kind == 3) {
                pulses[j] = counts[rand() % numbers];
            }
        }
        const int gave = controller_step(self, pulses, q, qd, qdd, torque);
        refused += gave == 1;
        for (int j = 0; j < CONTROLLER_JOINTS; ++j) {
            bad += !(fabs(torque[j]) < limit);
        }
        if (k % 2000 == 1999) {
            controller_init(self);
        }
    }
    free(self);
    printf("%ld %ld\n", refused, bad);
    return bad != 0;
}
"""

STATED = LAWS | {
    "PD": PD(gain=(0.1, 0.08), derivative=(1e-3, 8e-4), filter=2000.0, period=RIG.period),
    "cascade": Cascade(
        position=(20, 20),
        speed=(200, 80),
        integral=(1000.0, 400.0),
        filter=2000.0,
        period=RIG.period,
    ),
    "plain PID": PID(
        gain=(0.1, 0.08),
        integral=(0.5, 0.4),
        derivative=(1e-3, 8e-4),
        filter=2000.0,
        period=RIG.period,
    ),
    "adaptive": Adaptive(
        ARM, RIG, bandwidth=60.0, gain=(60.0, 30.0), adaptation=np.full(9, 0.01), filter=1000.0
    ),
}


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory):
    """Whether this compiler has the sanitizers."""
    folder = tmp_path_factory.mktemp("sanitizers")
    (folder / "a.c").write_text("int main(void) { return 0; }\n")
    command = [CC, *SANITIZERS.split(), "-o", folder / "a", folder / "a.c"]
    if run(*command, check=False).returncode or run(folder / "a", check=False).returncode:
        pytest.skip("this compiler has no sanitizers")


@needs_c
@pytest.mark.parametrize("name", STATED)
def test_nothing_that_a_caller_gives_is_undefined(tmp_path, sanitized, name):
    law = STATED[name]
    rig = elastic_rig() if name == "elastic gears" else RIG
    law.to_c(tmp_path, rig, guards=None)
    (tmp_path / "driver.c").write_text(DRIVER)
    flags = ["-std=c99", "-O1", "-g", *SANITIZERS.split()]
    run(CC, *flags, "-o", "driver", "driver.c", "controller.c", "-lm", cwd=tmp_path)
    done = run(tmp_path / "driver", check=False)
    assert done.returncode == 0, done.stdout + done.stderr[:2000]
    refused, bad = map(int, done.stdout.split())
    assert refused > 0  # the odd numbers came
    assert bad == 0


@needs_c
def test_a_replay_of_a_record_is_sound_too(tmp_path, sanitized):
    LAWS["computed torque"].to_c(tmp_path, RIG)
    write_replay(simulated("computed torque"), tmp_path / "record.csv")
    run("make", f"CFLAGS=-std=c99 -O1 -g {SANITIZERS}", f"LDFLAGS={SANITIZERS}", cwd=tmp_path)
    done = run(tmp_path / "controller", tmp_path / "record.csv", check=False)
    assert done.returncode == 0, done.stderr[:2000]
    assert len(done.stdout.splitlines()) == len(simulated("computed torque"))


def test_the_sanitizers_would_say_so(tmp_path, sanitized):
    (tmp_path / "a.c").write_text(
        "int main(int n, char **v) { int a[2] = {0}; (void)v; return a[n + 4]; }\n"
    )
    run(CC, "-O1", *SANITIZERS.split(), "-o", "a", "a.c", cwd=tmp_path)
    assert run(tmp_path / "a", check=False).returncode != 0
