"""The sampled loop of joints that slide one way, period by period in affine arithmetic: lines, and
a bound of the rest.

By the simulator's own sub-step and the law's own equations. Dry friction acts against the
reference's motion; the law's part of it cancels the arm's but for their difference. Equations:
docs/background/computed_torque.md.
"""

import dataclasses
from typing import Any

import casadi as ca
import numpy as np

from plant import Law, Rig
from plant.compiler.affine import Affine, Arithmetic
from plant.mechanics.arm import Arm
from plant.parts.fields import Floats
from plant.simulation.clock import Clock
from plant.simulation.closed_loop import ClosedLoop
from plant.simulation.followed_path import Path
from plant.simulation.time_tables import time_tables


class Period:
    """One period of the sliding loop: the law, then the arm, as casadi Functions and in affine
    arithmetic.
    """

    def __init__(
        self, arm: Arm, rig: Rig, law: Law, path: Path, samples: int, steps: int, names: Any
    ) -> None:
        n = rig.n
        friction = law.model_parts(*(ca.SX.zeros(rig.n),) * 3)
        known = getattr(law, "rig", rig).drive.joint_coulomb() if "friction" in friction else 0.0
        sliding = law.sliding()
        loop = ClosedLoop(dynamics=arm.dynamics, rig=rig, law=sliding, steps_per_sample=steps)
        block = sliding.block(rig)
        values = loop.sliding_values(arm.f)
        self.n = n
        self.rig = rig
        self.steps = steps
        self.samples = samples
        self.given = time_tables(loop, path, Clock.regular(samples, rig.period))[0][:, : 4 * n]
        s, p, t, g = (
            ca.SX.sym(name, k)
            for name, k in (("s", len(block.initial)), ("p", n), ("t", n), ("g", 4 * n))
        )
        asked, following = block.step(s, *ca.vertsplit(g, n), p, t, block.period, block.values)
        self.law = ca.Function("law", [s, p, t, g], ca.cse([asked, following]))
        self.limited = ca.Function("limited", [t], [rig.drive.limited(t)])

        # The arm under one torque; what dry friction differs from the law's is a torque that turns
        # with the reference.
        x = ca.SX.sym("x", 2 * n)
        own = ca.SX.sym("own", len(names))
        numbers = ca.SX(values)
        coulomb = ca.SX(rig.drive.coulomb)
        for i, name in enumerate(names):
            if name.startswith("drive.coulomb"):
                coulomb[int(name[len("drive.coulomb[") : -1])] = own[i]
            else:
                numbers[loop.number_names.index(name)] = own[i]
        shaft = rig.drive.coupling.shaft(g[n : 2 * n])
        dry = (coulomb * np.abs(rig.drive.gear) - known) * ca.sign(shaft)
        state = ca.SX(np.zeros(len(loop.state_names)))
        row = np.zeros(len(loop.time_names))
        state[: 2 * n], state[3 * n : 4 * n] = x, t - rig.drive.coupling.joint_torque(dry)
        state[-1], row[-1] = 1, loop.h
        self.arm = ca.Function(
            "arm", [x, t, own, g], ca.cse([loop.substep(state, row, numbers)[0][: 2 * n]])
        )
        self.pulses = rig.position_in_pulses(np.eye(n)).T  # a matrix: pulses = it @ q
        self.start = np.concatenate([*path.start(), np.zeros(n), block.initial, np.zeros(n)])

    def nominal(self, centre: Floats, phase: Floats) -> Floats:
        """A run (N + 1, m) without rounding: q, qd, torque, the law's state, and the torque
        before the limit.
        """
        n = self.n
        y = ca.MX.sym("y", len(self.start))
        g = ca.MX.sym("g", 4 * self.n)
        position = self.pulses @ y[:n] + phase
        asked, s = self.law(y[3 * n : -n], position + self._offset(position), y[2 * n : 3 * n], g)
        x = y[: 2 * n]
        torque = self.limited(asked)
        for _ in range(self.steps):
            x = self.arm(x, torque, centre, g)
        step = ca.Function("period", [y, g], [ca.vertcat(x, torque, s, asked)])
        return np.vstack(
            [self.start, step.mapaccum(self.samples)(self.start, self.given.T).full().T]
        )

    def _offset(self, position: Any) -> Any:
        """What counts are from a position, halfway."""
        signs = (
            ca.sign(position)
            if self.rig.encoder.rounding == "fix"
            else float(self.rig.encoder.rounding == "floor")
        )
        return -0.5 * signs

    def counted(self, position: Floats, size: Floats) -> tuple[Floats, Floats]:
        """What counts (N, n) differ from positions within these sizes by: the middle of it, and
        how far from there.
        """
        if self.rig.encoder.rounding != "fix":
            return np.full_like(position, self._offset(position)), np.full_like(position, 0.5)
        sure = np.abs(position) >= size
        return np.asarray(-0.5 * sure * np.sign(position)), np.asarray(1 - 0.5 * sure)


@dataclasses.dataclass(frozen=True, eq=False)
class Linear:
    """M (N, m, m), U (N, m, K), N (N, m, s), R (N, m), and what the centre is off the nominal
    run by (N, m).
    """

    M: Floats
    U: Floats
    N: Floats
    R: Floats
    off: Floats


def _rows(several: list[Affine], count: int, width: int) -> tuple[Floats, Floats, Floats]:
    """Values (N, k), slopes (N, k, width) and remainders (N, k) of numbers."""
    slopes = np.zeros((count, len(several), width))
    for i, each in enumerate(several):
        slopes[:, i, : each.slopes.shape[1]] = each.slopes
    values, remainders = (
        np.array([np.broadcast_to(x[j], count) for x in several]).T for j in (0, 2)
    )
    return values, slopes, remainders


def _times(matrices: Floats, vectors: Floats) -> Floats:
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _symbols(values: Floats, first: int, width: int) -> list[Affine]:
    """Numbers (N, k) whose deviations are the k of so many from `first` on."""
    return [
        Affine(x, np.broadcast_to(np.eye(width)[first + i], (len(x), width)))
        for i, x in enumerate(values.T)
    ]


def _asked(
    period: Period, run: Floats, sizes: Floats, shift: Any, held: list[int]
) -> tuple[Floats, Floats, Floats]:
    """Values, slopes along deviations, u and rounding, and remainders of what the law asks for,
    and of its state.
    """
    n, (count, m), K = period.n, run[:-1].shape, shift[1].shape[1]
    arithmetic = Arithmetic(np.hstack([sizes[:-1], np.ones((count, K + n))]))
    position = run[:-1, :n] @ period.pulses.T + shift[0]
    width = m + K + n
    middle, half = period.counted(
        position, sizes[:-1, :n] @ np.abs(period.pulses).T + np.abs(shift[1]).sum(axis=1)
    )
    counts = []
    for i in range(n):
        slopes = np.zeros((count, width))
        slopes[:, :n], slopes[:, m : m + K], slopes[:, m + K + i] = (
            period.pulses[i],
            shift[1][i],
            half[:, i],
        )
        counts.append(Affine(position[:, i] + middle[:, i], slopes))
    state = _symbols(run[:-1, 3 * n : -n], 3 * n, width)
    torque = _symbols(run[:-1, 2 * n : 3 * n], 2 * n, width)
    state = [
        each if sizes[:, 3 * n + i].any() else Affine(each.value) for i, each in enumerate(state)
    ]
    out = arithmetic(period.law, [state, counts, torque, list(period.given.T)])
    value, slopes, remainder = _rows(out, count, arithmetic.sizes.shape[1])
    as_in_run = [n + i for i in held]
    slopes[:, as_in_run], remainder[:, as_in_run] = 0, 0
    value[:, as_in_run] = run[1:, [3 * n + i for i in held]]
    return value, slopes, remainder


def _moved(
    period: Period, run: Floats, sizes: Floats, torque: Any, centre: Floats, basis: Floats
) -> Any:
    """The arm after a period (N, 2 n), its slopes along its state before, torque and u, and the
    remainder.

    `torque` is (value, size), (N, n) each.
    """
    n, (count, K) = period.n, (period.samples, basis.shape[1])
    moved = np.tile(np.eye(2 * n, 3 * n + K), (count, 1, 1))
    x = run[:-1, : 2 * n]
    rest = np.zeros((count, 2 * n))
    others = np.hstack([torque[1], np.ones((count, K))])
    width = 3 * n + K
    own = [
        Affine(c, np.tile(np.append(np.zeros(3 * n), b), (count, 1)))
        for c, b in zip(centre, basis, strict=True)
    ]
    for _ in range(period.steps):
        around = _times(np.abs(moved), np.hstack([sizes[:-1, : 2 * n], others])) + rest
        arithmetic = Arithmetic(np.hstack([around, others]))
        state = _symbols(x, 0, width)
        acting = _symbols(torque[0], 2 * n, width)
        after = arithmetic(period.arm, [state, acting, own, list(period.given.T)])
        x, by, more = _rows(after, count, arithmetic.sizes.shape[1])
        rest = _times(np.abs(by[:, :, : 2 * n]), rest) + more + np.abs(by[:, :, width:]).sum(axis=2)
        moved = by[:, :, : 2 * n] @ moved
        moved[:, :, 2 * n :] += by[:, :, 2 * n : width]
    return x, moved, rest


def linearised(
    period: Period,
    run: Floats,
    sizes: Floats,
    centre: Floats,
    basis: Floats,
    shift: Any,
    held: list[int],
) -> Linear:
    """All periods about a nominal run, right for deviations from it within sizes (N + 1, m)."""
    n = period.n
    m = run.shape[1]
    K = basis.shape[1]
    value, slopes, remainder = _asked(period, run, sizes, shift, held)

    # What the amplifier leaves of the torque: within the size of what is asked for, of which it is
    # a function.
    amplifier = Arithmetic(sizes[1:, -n:] + np.abs(value[:, :n] - run[1:, -n:]))
    left = amplifier(period.limited, [_symbols(value[:, :n], 0, n)])
    torque, share, more = _rows(left, len(value), amplifier.sizes.shape[1])
    spread = (np.abs(share) * amplifier.sizes[:, None]).sum(axis=2) + more
    x, moved, rest = _moved(period, run, sizes, (torque, spread), centre, basis)

    kept = share[:, :, :n]
    of_law = slopes[:, n:]
    by = moved[:, :, 2 * n : 3 * n]
    fresh = np.concatenate([np.zeros((len(value), n, slopes.shape[2])), share[:, :, n:]], axis=2)
    fresh[:, :, : slopes.shape[2]] = kept @ slopes[:, :n]
    pad = np.zeros((len(value), slopes.shape[1] - n, share.shape[2] - n))
    rows = np.concatenate(
        [
            by @ fresh,
            fresh,
            np.concatenate([of_law, pad], axis=2),
            np.concatenate([slopes[:, :n], pad[:, :1].repeat(n, axis=1)], axis=2),
        ],
        axis=1,
    )
    M = rows[:, :, :m]
    U = rows[:, :, m : m + K]
    N = rows[:, :, m + K :]
    M[:, : 2 * n, : 2 * n] += moved[:, :, : 2 * n]
    U[:, : 2 * n] += moved[:, :, 3 * n :]
    more = _times(np.abs(kept), remainder[:, :n]) + more
    R = np.hstack([rest + _times(np.abs(by), more), more, remainder[:, n:], remainder[:, :n]])
    return Linear(M, U, N, R, np.hstack([x, torque, value[:, n:], value[:, :n]]) - run[1:])
