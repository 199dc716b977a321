"""Control scripts of the guide, each against a bus that reads its packets and moves an arm."""

import builtins
import dataclasses
import re
import struct
import types
from pathlib import Path

import numpy as np
import pytest
from servos import GAIN, arm, rig

from ctc import ComputedTorque
from plant import Encoder, MitDrive, PointToPoint, PositionServo, SteppedArm

PAGE = Path(__file__).parents[3] / "docs/guides/servo_scripts.md"
CELLS = re.compile(r"^```{code-cell}\n(.*?)^```", re.DOTALL | re.MULTILINE)
SCRIPTS = re.compile(r"^```{code-block} python\n(.*?)^```", re.DOTALL | re.MULTILINE)
ARM = arm()
PATH = PointToPoint(start=(0.3, -0.2), goal=(0.7, 0.2), duration=0.6)
LIMIT = 3.35
MIDDLE = 2048
# Every so many reads one is lost.
LOST = 17


class Bench:
    """An arm at 1 kHz with a clock of its own; `torque_of` is the inner loop."""

    def __init__(self, loop):
        self.robot = SteppedArm(
            ARM, dataclasses.replace(loop, inner=None, period=1e-3), (0.3, -0.2)
        )
        self.now = 0.0
        self.reads = 0
        self.errors = []
        self.torque_of = lambda robot: np.zeros(2)
        self.ended = 0

    def sleep(self, seconds):
        """The time that the script waits; the packets take none."""
        self.now += seconds
        while self.ended < round(self.now / 1e-3):
            self.robot.step(np.clip(self.torque_of(self.robot), -LIMIT, LIMIT))
            self.ended += 1
        self.errors.append(PATH(np.array([self.now])).q[0] - self.robot.q)

    def is_lost(self):
        self.reads += 1
        # The first counts must come.
        return self.reads > 1 and self.reads % LOST == 0

    @property
    def modules(self):
        return {"time": types.SimpleNamespace(perf_counter=lambda: self.now, sleep=self.sleep)}


def executed(bench, law, title, **modules):
    """Run the cells of the page and the script below this title; its names afterwards."""
    fakes = bench.modules | {name: types.SimpleNamespace(**of) for name, of in modules.items()}

    def imported(name, *arguments, **options):
        return fakes[name] if name in fakes else builtins.__import__(name, *arguments, **options)

    names = {"__builtins__": vars(builtins) | {"__import__": imported}, "law": law, "path": PATH}
    text = PAGE.read_text()
    for cell in CELLS.findall(text):
        exec(cell, names)  # noqa: S102
    section = next(part for part in text.split("\n## ") if part.startswith(title))
    (script,) = SCRIPTS.findall(section)
    assert len([line for line in script.splitlines() if line.strip()]) <= 40
    exec(script, names)  # noqa: S102
    assert names["running"].status.startswith("running")
    assert bench.reads > 2 * LOST
    assert bench.now == pytest.approx(PATH.duration)
    return names


class Port:
    """A serial port: `Port.packets` splits what was written, `Port.answer` reads a register."""

    def __init__(self, bench):
        self.bench, self.written, self.answers = bench, {1: {}, 2: {}}, b""
        self.goals = None
        bench.torque_of = lambda robot: (
            np.zeros(2) if self.goals is None else GAIN * (self.goals - robot.pulses)
        )

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return False

    def reset_input_buffer(self):
        self.answers = b""

    def read(self, count):
        given, self.answers = self.answers[:count], self.answers[count:]
        return b"" if self.bench.is_lost() else given

    def write(self, data):
        for identity, instruction, parameters in self.packets(data):
            if instruction == 3:
                address, values = self.address(parameters)
                self.written[identity] |= {address + i: value for i, value in enumerate(values)}
            else:
                assert identity == 254
                getattr(self, f"instruction_{instruction}")(parameters)

    def aim(self, goals):
        assert all(0 <= goal <= 4095 for goal in goals)
        self.goals = np.array(goals) - MIDDLE


class FeetechPort(Port):
    @staticmethod
    def packets(data):
        while data:
            assert data[:2] == b"\xff\xff"
            end = 4 + data[3]
            assert sum(data[2:end]) & 255 == 255  # of all and their inverted sum
            yield data[2], data[4], data[5 : end - 1]
            data = data[end:]

    @staticmethod
    def address(parameters):
        return parameters[0], parameters[1:]

    def instruction_130(self, parameters):
        assert parameters == bytes([56, 2, 1, 2])
        for i, count in enumerate(self.bench.robot.pulses):
            body = [i + 1, 4, 0, *(int(count) + MIDDLE).to_bytes(2, "little")]
            self.answers += bytes([255, 255, *body, ~sum(body) & 255])

    def instruction_131(self, parameters):
        assert parameters[:2] == bytes([42, 2])
        assert parameters[2::3] == bytes([1, 2])
        self.aim([int.from_bytes(parameters[k : k + 2], "little") for k in (3, 6)])


class DynamixelPort(Port):
    @staticmethod
    def remainder(data):
        """The checksum as a division of polynomials: another way than the page's."""
        value = int.from_bytes(data, "big") << 16
        for bit in range(value.bit_length() - 1, 15, -1):
            if value >> bit & 1:
                value ^= 0x18005 << (bit - 16)
        return value.to_bytes(2, "little")

    @classmethod
    def packets(cls, data):
        assert data[:4] == b"\xff\xff\xfd\x00"
        end = 7 + int.from_bytes(data[5:7], "little")
        assert cls.remainder(data[: end - 2]) == data[end - 2 :]
        yield data[4], data[7], data[8 : end - 2]

    @staticmethod
    def address(parameters):
        return int.from_bytes(parameters[:2], "little"), parameters[2:]

    def instruction_130(self, parameters):
        assert parameters == bytes([132, 0, 4, 0, 1, 2])
        for i, count in enumerate(self.bench.robot.pulses):
            word = (int(count) + MIDDLE).to_bytes(4, "little", signed=True)
            body = bytes([255, 255, 253, 0, i + 1, 8, 0, 0x55, 0, *word])
            self.answers += body + self.remainder(body)

    def instruction_131(self, parameters):
        assert parameters[:4] == bytes([116, 0, 4, 0])
        assert parameters[4::5] == bytes([1, 2])
        words = (parameters[5:9], parameters[10:14])
        self.aim([int.from_bytes(word, "little", signed=True) for word in words])


@pytest.mark.parametrize(
    ("title", "kind", "registers"),
    [
        ("Feetech", FeetechPort, {21: 32, 22: 0, 23: 0, 41: 0, 46: 0, 47: 0}),
        ("Dynamixel", DynamixelPort, {64: 1, 80: 0, 82: 0, 84: 32, 85: 3, 108: 0, 112: 0, 115: 0}),
    ],
)
def test_a_script_of_servos_follows_the_path(title, kind, registers):
    loop = rig(inner=PositionServo(gain=GAIN, register=(-2048, 2047)))
    bench = Bench(loop)
    port = kind(bench)
    executed(bench, ComputedTorque(ARM, loop), title, serial={"Serial": lambda *_, **__: port})
    for identity in (1, 2):
        assert {key: port.written[identity][key] for key in registers} == registers
        # The goal itself is written to all servos at once alone.
        assert not {42, 43, 116, 117, 118, 119} & set(port.written[identity])
    errors = np.abs(loop.position_in_pulses(np.array(bench.errors)))
    # Plain goals leave the joints some 40 counts behind; each lost read costs a few.
    assert errors.max() < 5


class Bus:
    """A CAN bus of two drives; a subclass decodes its frames."""

    def __init__(self, bench, loop):
        self.bench, self.loop, self.answers = bench, loop, []
        self.fields = np.zeros((5, 2))
        self.losing = False
        bench.torque_of = self.torque

    def torque(self, robot):
        q, qd, kp, kd, tau = self.fields
        return kp * (q - robot.q) + kd * (qd - robot.qd) + tau

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return False

    def recv(self, timeout):
        return self.answers.pop(0) if self.answers else None

    def answer(self, i, **fields):
        # Of a read one of the two is lost.
        if i == 1:
            self.losing = self.bench.is_lost()
        if not (i == 2 and self.losing):
            self.answers.append(types.SimpleNamespace(**fields))


class DamiaoBus(Bus):
    """Answers as a drive truncates its position to 16 bits."""

    enabled = frozenset()

    def position(self, i):
        # The identity, and 16 bits of the position; speed, torque and temperatures are not read.
        value = int(np.floor((self.bench.robot.q[i - 1] + 12.5) / 25 * 65535))
        return bytes([i, *value.to_bytes(2, "big"), 0, 0, 0, 30, 30])

    def send(self, message):
        data = message.data
        assert len(data) == 8
        if message.arbitration_id == 0x7FF:
            assert data[2] == 0xCC
            i = int.from_bytes(data[:2], "little")
            self.answer(i, data=self.position(i))
            return
        i = message.arbitration_id
        if data[:7] == b"\xff" * 7:
            assert data[7] == 0xFC
            self.enabled |= {i}
            return
        assert i in self.enabled
        word = int.from_bytes(data, "big")
        for row, (end, width) in reversed(
            list(enumerate(zip(self.ends, (16, 12, 12, 12, 12), strict=True)))
        ):
            share = (word & (2**width - 1)) / (2**width - 1)
            word >>= width
            self.fields[row, i - 1] = share * end if row in (2, 3) else (2 * share - 1) * end
        self.answers.append(types.SimpleNamespace(data=self.position(i)))

    @property
    def ends(self):
        return self.loop.inner.limits


class MoteusBus(Bus):
    def send(self, message):
        assert message.is_fd
        assert message.arbitration_id >> 8 == 0x80
        i, data = message.arbitration_id & 0x7F, message.data
        if data == bytes([0x1D, 0x01]):
            turn = struct.pack("<f", self.bench.robot.q[i - 1] / (2 * np.pi))
            self.answer(i, arbitration_id=i << 8, data=bytes([0x2D, 0x01]) + turn)
            return
        # Mode 10; five floats from 0x020 on.
        assert data[:6] == bytes([0x01, 0x00, 10, 0x0C, 5, 0x20])
        position, velocity, tau, kp, kd = struct.unpack("<5f", data[6:])
        # The gains as the script states them, N m and N m s per turn.
        whole = 2 * np.pi
        self.fields[:, i - 1] = (
            whole * position,
            whole * velocity,
            kp * 400 / whole,
            kd * 10 / whole,
            tau,
        )


def drives(bits):
    loop = rig(0.002, None)
    loop = dataclasses.replace(loop, encoder=Encoder(resolution=65535 / 25 * 2 * np.pi))
    inner = MitDrive.for_arm(ARM, loop, stiffness=40, bits=bits)
    return dataclasses.replace(loop, inner=inner)


@pytest.mark.parametrize(
    ("title", "kind", "bits"),
    [("Damiao", DamiaoBus, (16, 12, 12, 12, 12)), ("moteus", MoteusBus, (32,) * 5)],
)
def test_a_script_of_frames_follows_the_path(title, kind, bits):
    loop = drives(bits)
    bench = Bench(loop)
    bus = kind(bench, loop)
    message = types.SimpleNamespace
    executed(
        bench,
        ComputedTorque(ARM, loop),
        title,
        can={"Bus": lambda *_, **__: bus, "Message": lambda **fields: message(**fields)},
    )
    errors = np.abs(loop.position_in_pulses(np.array(bench.errors)))
    assert errors.max() < 6
