# ruff: noqa: S603 - compilers, QEMU, and what they made
"""A running controller in C for microcontrollers, under QEMU: the host's bits; and in single
precision.
"""

import ctypes
import dataclasses
import math
import os
import re
import shutil
import subprocess
import sys
from functools import cache

import numpy as np
import pytest

from ctc import ComputedTorque, Uncertainty
from plant import puma560, simulate, write_replay

ARM, RIG = puma560.arm(), puma560.rig()
LAW = ComputedTorque(ARM, RIG)
STRICT = "CFLAGS=-std=c99 -O2 -Wall -Wextra -Werror -pedantic -ffp-contract=off"
NEEDED = ("cc", "make", "awk", "arm-none-eabi-gcc", "qemu-system-arm")
MISSING = [tool for tool in NEEDED if shutil.which(tool) is None]
needs_board = pytest.mark.skipif(
    bool(MISSING) and "CI_ARM" not in os.environ,
    reason=f"needs {', '.join(MISSING)} (Debian: see .ci/run)",
)
needs_c = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")


@cache
def recorded():
    return simulate(ARM, RIG, LAW, puma560.reference())


def exported(folder, **options):
    LAW.start(RIG, (0, 0)).to_c(folder, **options)
    write_replay(recorded(), folder / "record.csv")
    return folder


def run(folder, *command):
    said = subprocess.run(
        [shutil.which(command[0]), *command[1:]], cwd=folder, capture_output=True, text=True
    )
    assert said.returncode == 0, said.stderr
    return said.stdout


def on_host(folder):
    run(
        folder,
        "cc",
        "-std=c99",
        "-O2",
        "-ffp-contract=off",
        "-o",
        "host",
        "main.c",
        "controller.c",
        "-lm",
    )
    return run(folder, "env", "./host", "record.csv")


def rows(text):
    return np.loadtxt(text.splitlines(), delimiter=",")


@pytest.mark.slow
@needs_board
def test_a_cortex_m7_gives_the_bits_of_the_host(tmp_path):
    """Printed with 17 digits, over all of (6), whose Python is within rounding of it."""
    folder = exported(tmp_path, target="cortex-m7")
    run(folder, "make", "controller.elf")  # as its Makefile compiles it
    board = run(folder, "make", "-s", "run")
    assert board == on_host(folder)
    assert len(rows(board)) == len(recorded())
    np.testing.assert_allclose(
        rows(board), recorded().torque, rtol=0, atol=1e-11 * np.abs(recorded().torque).max()
    )


@needs_board
def test_a_cortex_m4f_gives_them_but_for_a_rounding_of_its_compiler_s_subtraction(tmp_path):
    """libgcc 12 rounds a software difference wrongly by one bit, now and then, where exponents
    are 33 apart.
    """
    folder = exported(tmp_path, target="cortex-m4f")
    run(folder, "make", STRICT, "controller.elf")
    board, host = rows(run(folder, "make", "-s", "run")), rows(on_host(folder))
    # until then none is; what it changes is remembered for a while
    assert (board[:2600] == host[:2600]).all()
    np.testing.assert_allclose(board, host, rtol=0, atol=1e-13 * np.abs(host).max())


@needs_board
@pytest.mark.parametrize("target", ["cortex-m7", "cortex-m4f"])
def test_single_precision_runs_and_says_what_it_is(target, tmp_path):
    folder = exported(tmp_path, target=target, precision="single")
    run(folder, "make", STRICT, "controller.elf")
    torque = rows(run(folder, "make", "-s", "run"))
    error = np.abs(torque - recorded().torque).max()
    # of open-loop replay: single, and sound
    assert 1e-7 < error / np.abs(recorded().torque).max() < 0.1
    header, source = (folder / "controller.h").read_text(), (folder / "controller.c").read_text()
    assert f"Numbers: single precision, for {target}." in header
    assert "double now" not in header
    code = re.sub(r"/\*.*?\*/", "", source, flags=re.DOTALL)
    assert not re.search(r"\bdouble\b|\b(?:sin|cos|exp|sqrt|fabs|floor)\(|\d\.\d+(?![\df.e])", code)


@needs_board
def test_stack_size_and_no_heap(tmp_path):
    folder = exported(tmp_path, target="cortex-m7")
    told = run(folder, "make", "-s", "stack")
    stack = int(re.search(r"controller_step: (\d+) bytes of stack", told)[1])
    frames = [
        int(n) for n in re.findall(r"(\d+) bytes \(static\)", (folder / "stack.ci").read_text())
    ]
    assert max(frames) < stack <= sum(frames)
    assert "of no fixed size" not in told
    run(folder, "make", "controller.o")
    wanted = run(folder, "arm-none-eabi-nm", "-u", "controller.o").replace(" U ", " ").split()
    # no malloc, no printf
    assert set(wanted) <= {"sqrt", "ldexp", "memcpy", "memset", "floor", "ceil", "trunc"}
    assert "    0\t" in run(folder, "make", "-s", "size")  # neither data nor bss


@pytest.mark.skipif(
    shutil.which("cmake") is None and "CI_ARM" not in os.environ, reason="needs cmake"
)
@pytest.mark.parametrize("target", [None, pytest.param("cortex-m4f", marks=needs_board)])
def test_cmake_builds_it(target, tmp_path):
    folder = exported(tmp_path, target=target)
    chain = [] if target is None else ["-DCMAKE_TOOLCHAIN_FILE=../toolchain.cmake"]
    run(folder, "cmake", "-S", ".", "-B", "build", *chain)
    run(folder, "cmake", "--build", "build")
    assert (folder / "build" / "libcontroller.a").exists()
    if target is None:
        torque = rows(run(folder, "env", "build/controller_replay", "record.csv"))
        assert torque.shape == recorded().torque.shape


@needs_c
def test_its_own_sine_cosine_and_exponential(tmp_path):
    """Against Python's, in units in the last place; angles as far as an encoder of 32 bits turns
    a joint.
    """
    LAW.start(RIG, (0, 0)).to_c(tmp_path, target="cortex-m7")
    source = (tmp_path / "controller.c").read_text()
    own = source[source.index("/* -- sine, cosine") : source.index("/* As Python's min")]
    names = ("sine", "cosine", "exponential")
    (tmp_path / "own.c").write_text("#include <math.h>\n" + own.replace("static double", "double"))
    run(
        tmp_path,
        "cc",
        "-std=c99",
        "-O2",
        "-ffp-contract=off",
        "-shared",
        "-fPIC",
        "-o",
        "own.so",
        "own.c",
        "-lm",
    )
    library, random = ctypes.CDLL(str(tmp_path / "own.so")), np.random.default_rng(3)
    for name in names:
        getattr(library, name).argtypes, getattr(library, name).restype = (
            [ctypes.c_double],
            ctypes.c_double,
        )
    for size in (1.0, 10.0, 1e4, 1e6):
        for x in random.uniform(-size, size, 2000):
            for ours, truth in ((library.sine, math.sin), (library.cosine, math.cos)):
                assert abs(ours(x) - truth(x)) <= 2 * math.ulp(truth(x)) + 1e-16 * (size > 10)
            if size < 700:
                assert abs(library.exponential(x) - math.exp(x)) <= 2 * math.ulp(math.exp(x))
    for x in (1e7, math.inf, math.nan):
        assert math.isnan(library.sine(x))
        assert math.isnan(library.cosine(x))
    assert [library.exponential(x) for x in (-math.inf, -800.0, 0.0, 800.0)] == [
        0.0,
        0.0,
        1.0,
        math.inf,
    ]
    assert math.isnan(library.exponential(math.nan))


def test_bad_input_says_what_to_do(tmp_path):
    running = LAW.start(RIG, (0, 0))
    with pytest.raises(
        ValueError, match=r"target must be one of .*'cortex-m7', 'cortex-m4f'; got 'cortex-m0'"
    ):
        running.to_c(tmp_path, target="cortex-m0")
    with pytest.raises(ValueError, match="precision must be one of 'double', 'single'; got 'half'"):
        running.to_c(tmp_path, precision="half")
    fine = dataclasses.replace(
        RIG, encoder=dataclasses.replace(RIG.encoder, resolution=(2.0**20, 1000))
    )
    with pytest.raises(
        ValueError,
        match=r"precision must be 'double' for joint q\[0\]: in single it rounds by 6.7 pu",
    ):
        LAW.start(fine, (0, 0)).to_c(tmp_path, precision="single")
    with pytest.raises(
        ValueError, match=r"largest_count must be at most 2\^23 in single precision"
    ):
        running.to_c(
            tmp_path,
            precision="single",
            output="dac",
            counts_per_ampere=(5e5, 5e5),
            largest_count=2**23 + 1,
        )
    # An odd count that floor(x + 1/2) does not keep.
    odd = np.float32(2**23 + 1)
    assert np.floor(odd + np.float32(0.5)) != odd
    assert not list(tmp_path.iterdir())


@needs_c
def test_in_single_precision_a_count_that_it_cannot_hold_is_no_count(tmp_path):
    """From 2^24 on, float would round odd counts, and the law would not know."""
    LAW.start(RIG, (0, 0)).to_c(tmp_path, precision="single")
    zeros = ",0" * 7
    (tmp_path / "record.csv").write_text(f"{2**24}{zeros}\n")
    on_host(tmp_path)
    (tmp_path / "record.csv").write_text(f"{2**24 + 3}{zeros}\n")
    refused = subprocess.run([tmp_path / "host", tmp_path / "record.csv"], capture_output=True)
    assert refused.returncode == 1


@needs_c
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="paced on Linux")
def test_the_paced_program_counts_every_step(tmp_path):
    folder = exported(tmp_path)
    run(folder, "make", STRICT)
    told = run(folder, "env", "./controller", "--paced", "0.7", "record.csv")
    begun = re.findall(r"begun less than (\d+) us late: (\d+)", told)
    assert sum(int(count) for _, count in begun) == 1000
    late, steps = re.search(r"late steps: (\d+) of (\d+)", told).groups()
    assert (int(steps), int(late) <= 1000) == (1000, True)
    jitter = re.search(r"of the others jitter=([\d.]+)", told)
    if int(late) < 1000:
        assert Uncertainty(jitter=float(jitter[1])).jitter[1] <= 0.5  # as certify takes it
    said = subprocess.run(
        [folder / "controller", "--paced", "none", "record.csv"], cwd=folder, capture_output=True
    )
    assert said.returncode == 2


@needs_board
@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_law_that_needs_less_compiles_without_a_warning_and_gives_counts_of_a_converter(
    precision, tmp_path
):
    """Of a record to which it does not belong; a count is a rounded current, where half-way
    cases may differ.
    """
    law, scale = puma560.p_law(), (2048.0, -2048.0)
    law.start(RIG, (0, 0)).to_c(
        tmp_path, target="cortex-m4f", precision=precision, output="dac", counts_per_ampere=scale
    )
    write_replay(recorded(), tmp_path / "record.csv")
    run(tmp_path, "make", STRICT, "controller.elf")
    counts = rows(run(tmp_path, "make", "-s", "run"))
    running = law.start(RIG, recorded().counts[0])
    motion = recorded().reference(recorded().t)
    exact = [
        RIG.drive.current(running.step(*row)) * scale
        for row in zip(recorded().counts, *motion, strict=True)
    ]
    apart, pulse = (
        np.abs(counts - exact),
        np.abs(RIG.drive.current(law.gain * RIG.drive.gear) * scale),
    )
    if precision == "double":
        assert apart.max() <= 0.5 + 1e-9
    else:  # a reference at the edge of a count may be rounded into the next
        assert (apart <= pulse + 1).all()
        assert (apart <= 0.6).mean() > 0.99
