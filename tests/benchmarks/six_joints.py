"""A six-joint arm: its closed-loop kernel beside pinocchio's articulated-body algorithm.

    python tests/benchmarks/six_joints.py [--cpp]

One sub-step of the loop holds an inertia matrix, two Coriolis torques, gravity, the inverse,
friction with three sweeps, six encoders and the P law; one call of pinocchio's `aba` is forward
dynamics alone. With --cpp its loop is compiled from C++ too, which takes a minute and the headers
of the packages `pin` and `cmeel-eigen`.
"""

import argparse
import ctypes
import os
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "oracles"))
import pinocchio as pin
from closed_loops import direct_rig
from pinocchio_arm import inertia_matrix, pinocchio_model, placement

from identification.replay import squared_error
from plant import Body, Chain, Dynamics, Link, Lumping, P
from plant.simulation import LANES, ClosedLoop, LoopKernel

HERE = Path(__file__).parent
ROWS = ((0, 0, 0), (-1, 0, 0.15), (0, 0.43, -0.1), (1, -0.02, 0.43), (-1, 0, 0), (1, 0, 0))
"""alpha in right angles, a and d [m]: a shoulder, an elbow and a wrist like the PUMA 560's."""


def arm(random):
    """A chain of that shape with random bodies."""
    links = [
        Link(name=str(i + 1), alpha=alpha * np.pi / 2, a=a, d=d)
        for i, (alpha, a, d) in enumerate(ROWS)
    ]
    bodies = []
    for _ in links:
        root = random.normal(size=(3, 3)) * 0.1
        inertia = np.trace(root @ root.T) * np.eye(3) - root @ root.T
        bodies.append(Body(mass=random.uniform(0.5, 5), com=random.uniform(-0.2, 0.2, 3),
                           inertia=inertia[np.triu_indices(3)], rotor=0.0))  # fmt: skip
    return Chain(links=tuple(links)), tuple(bodies)


def kernel_time(chain, bodies, samples=500):
    """Seconds until the kernel has run for the first time, and seconds per individual and
    sub-step.
    """
    n = chain.n
    started = time.perf_counter()
    dynamics = Dynamics(chain=chain, lumping=Lumping.standard(chain))
    rig = direct_rig(np.full(n, 0.1), np.full(n, 0.1), smooth=False)
    law = P(gain=np.full(n, 1e-3))
    loop = ClosedLoop(
        dynamics=dynamics, rig=rig, law=law, steps_per_sample=4, score=squared_error(n)
    )
    kernel = LoopKernel(loop, range(dynamics.p))
    pose = np.linspace(0.1, 0.6, n)
    tables = [
        np.zeros((0, 4 * n + 1)),
        np.zeros((samples, 4 * n + 1)),
        np.zeros((4 * samples, 4 * n + 1)),
    ]
    for table in tables:
        table[:, :n], table[:, 3 * n : 4 * n], table[:, -1] = pose, rig.counts(pose), loop.h
    state = np.repeat(loop.initial_state(pose, np.zeros(n))[:, None], LANES, axis=1)
    f = np.repeat(dynamics.f(bodies)[:, None], LANES, axis=1)
    uniform = loop.number_values(dynamics.f(bodies))[list(kernel.uniform)]

    prepared = kernel.prepared((*tables, np.ones((samples, n + 1))))

    def run():
        final, steps = kernel.run(prepared, state, f, uniform)
        assert steps == 4 * samples
        assert (final[-1] == 1).all()

    run()
    first = time.perf_counter() - started
    return first, timed(run) / (4 * samples * LANES), loop.substep.n_instructions()


def without_cache(call):
    """Its result, with an empty cache of kernels that is gone afterwards."""
    before = os.environ.get("ONEPULSE_CACHE")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["ONEPULSE_CACHE"] = folder
        try:
            return call()
        finally:
            os.environ.pop("ONEPULSE_CACHE")
            if before is not None:
                os.environ["ONEPULSE_CACHE"] = before


def timed(call, rounds=7):
    """Median seconds of a call."""
    seconds = []
    for _ in range(rounds):
        started = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds))


def cpp_loop():
    """The C++ loop, compiled now."""
    prefix = Path(sysconfig.get_paths()["purelib"], "cmeel.prefix")
    if not (prefix / "include" / "eigen3").is_dir():
        raise SystemExit(
            "the headers of Eigen must be there; they are not. pip install cmeel-eigen"
        )
    library = Path(tempfile.mkdtemp(), "aba.so")
    command = ["g++", "-O3", "-march=native", "-w", "-DNDEBUG", "-std=c++17", "-shared", "-fPIC"]
    command += ["-DBOOST_MPL_LIMIT_LIST_SIZE=30", "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS"]
    command += [
        f"-I{prefix / 'include'}",
        f"-I{prefix / 'include' / 'eigen3'}",
        HERE / "c" / "aba.cpp",
        "-o",
        library,
    ]
    command += [f"-L{prefix / 'lib'}", "-lpinocchio_default", f"-Wl,-rpath,{prefix / 'lib'}"]
    subprocess.run(command, check=True)  # noqa: S603 - our own source
    return ctypes.CDLL(str(library)).aba_loop


def aba_times(chain, bodies, *, cpp):
    """Seconds per call of `aba`, by name of the loop."""
    model, random, n, count = (
        pinocchio_model(chain, bodies),
        np.random.default_rng(1),
        chain.n,
        20000,
    )
    data = model.createData()
    q, qd, tau = random.uniform(-1, 1, (3, count, n))

    def in_python():
        for i in range(count):
            pin.aba(model, data, q[i], qd[i], tau[i])

    times = {"pinocchio, loop in Python": timed(in_python) / count}
    if cpp:
        loop, qdd = cpp_loop(), np.empty((count, n))
        places = [placement(link) for link in chain.links]
        rows = np.array([np.append(place.rotation.ravel(), place.translation) for place in places])
        inertias = np.array([[b.mass, *b.com, *inertia_matrix(b).ravel()] for b in bodies])
        gravity = np.array(chain.gravity, dtype=float)
        address = [
            x.ctypes.data_as(ctypes.c_void_p) for x in (rows, inertias, gravity, q, qd, tau, qdd)
        ]
        long = ctypes.c_long
        times["pinocchio, loop in C++"] = (
            timed(lambda: loop(long(n), *address[:3], long(count), *address[3:])) / count
        )
        np.testing.assert_allclose(qdd[7], pin.aba(model, data, q[7], qd[7], tau[7]), rtol=1e-9)
    return times


def main():
    """Print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cpp", action="store_true")
    chain, bodies = arm(np.random.default_rng(0))
    first, step, instructions = without_cache(lambda: kernel_time(chain, bodies))
    times = aba_times(chain, bodies, cpp=parser.parse_args().cpp)
    print(f"six joints: {instructions} instructions, model to first run {first:.1f} s\n")
    print("| engine | what | microseconds | to the kernel |\n|---|---|---|---|")
    print(f"| this engine, 1 thread | a whole sub-step of the loop | {step * 1e6:.3f} | 1 |")
    for name, seconds in times.items():
        print(f"| {name} | forward dynamics alone | {seconds * 1e6:.3f} | {seconds / step:.1f} |")


if __name__ == "__main__":
    main()
