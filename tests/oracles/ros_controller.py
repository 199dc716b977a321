"""A ros2_control controller in a stand-in of its controller manager, through C."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np

HERE = Path(__file__).with_name("ros2")
STRICT = ["-std=c++17", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-Werror=suggest-override"]
PLAIN_C = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror"]
UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED = range(1, 5)
TOPIC = "~/joint_trajectory"


class Controller:
    """A package, compiled as strictly as can be, and its controller."""

    def __init__(self, folder, name="arm_controller"):
        self.name, made = name, folder / "made.so"
        both = ["-O1", "-fPIC", "-ffp-contract=off", "-c"]
        quick = ["-O0", "-fPIC", "-c"]
        gcc, gxx = shutil.which("gcc"), shutil.which("g++")
        objects = [folder / "c.o", folder / "plugin.o", folder / "harness.o"]
        include = [f"-I{HERE / 'include'}", f"-I{folder}"]
        for command in (
            [gcc, *PLAIN_C, *both, folder / f"{name}.c", "-o", objects[0]],
            [gxx, *STRICT, *both, *include, folder / f"{name}_controller.cpp", "-o", objects[1]],
            [gxx, *STRICT, *quick, *include, HERE / "harness.cpp", "-o", objects[2]],
            [gxx, "-shared", *objects, "-o", made, "-pthread"],
        ):
            subprocess.run([str(part) for part in command], check=True)  # noqa: S603
        self.c = ctypes.CDLL(str(made))
        self.c.said.restype = self.c.reference_name.restype = ctypes.c_char_p
        self.c.state_value.restype, self.c.allocations.restype = ctypes.c_double, ctypes.c_long
        self.c.update.argtypes = [
            ctypes.c_longlong,
            ctypes.c_longlong,
            ctypes.c_void_p,
            ctypes.c_void_p,
        ]
        for name in ("activate", "give_reference"):
            getattr(self.c, name).argtypes = [ctypes.c_void_p]

    def begin(self, at, rate=1429, chained=False, **parameters):
        """Load, configure and activate; the states after each."""
        for key, value in parameters.items():
            if isinstance(value, str):
                self.c.override_text(key.encode(), value.encode())
            else:
                self.c.override_names(key.encode(), ",".join(value).encode())
        kind = f"{self.name}_plugin::Controller".encode()
        states = [self.c.load(kind, self.name.encode(), rate)]
        if states[0] == 0:
            states.append(self.c.configure())
        if states[-1] == INACTIVE:
            assert self.c.chain(int(chained))
            states.append(self.c.activate(array(at)))
        self.now = 10**18
        return states

    def update(self, position, period=700_000, rows=1):
        """One sample: 0 or 1 as `update` says, and the commands, `rows` of each joint."""
        self.now += period
        torque = np.full(rows * len(position), 7.0)
        return self.c.update(self.now, period, array(position), array(torque)), torque

    def send(self, joints, times, rows, accelerations=True, stamp=0):
        """A trajectory: times [s] and rows (points, 3, n); what the log says."""
        rows = np.ascontiguousarray(rows, float)
        stamps = np.round(1e9 * np.asarray(times)).astype(np.int64)
        names = ",".join(joints).encode()
        self.c.send(
            TOPIC.encode(),
            names,
            len(stamps),
            array(stamps),
            array(rows),
            int(not accelerations),
            ctypes.c_longlong(stamp),
        )
        return self.said

    @property
    def said(self):
        return self.c.said().decode()


def array(values):
    """A pointer to numbers, which live as long as it."""
    values = values if isinstance(values, np.ndarray) else np.ascontiguousarray(values, float)
    pointer = values.ctypes.data_as(ctypes.c_void_p)
    pointer.kept = values
    return pointer
