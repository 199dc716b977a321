"""A running controller for a control script: the equations of the simulator, sample by sample."""

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.machine import Rig
from plant.parts import Floats, choice, instance
from plant.realtime.c_running import write_running
from plant.realtime.compiled_step import compensates_gravity, compiled
from plant.realtime.guards import Guards, limited
from plant.realtime.memory import RUNNING, Layout, view
from plant.realtime.pieces import sent_by
from plant.realtime.status import ARGUMENTS, RunLog, Status, clock, numbers, refuse, whole_counts

_FLOAT = np.dtype(float)
# Whole counts come as int64 or, from arithmetic, as float.
_COUNTS = (np.dtype(np.int64), np.dtype(float))


class Running:
    """A controller at work, with guards and safe stop; `Law.start` makes it.

    Attributes
    ----------
    core : Core
        The compiled step and its memory, for loops that are compiled by numba.
    pulses : (n,) numpy.ndarray
        Counts that the law was given in the last call.
    torque : (n,) numpy.ndarray
        Joint torque of the last call [N m], with the part that the firmware adds.
    state : numpy.ndarray
        State of the law.
    reference : (n,) numpy.ndarray
        Commanded joint position [rad] of the last call; during a stop, the stop commands it.
    stopped : bool
        Whether a guard has stopped the arm.
    bridged : int
        Number of calls with a bridged sample.
    status : Status
        A str: "running", with the last bridged sample, or "safe stop" and why; ``status.brake``
        asks for the brakes.
    goal : (n,) numpy.ndarray
        Goals [counts] of the last call, whole numbers, to be sent to the position servos of a rig
        with a `PositionServo` inside. In a stop that does not use the law, the goal holds the servo
        where it was, with the torque of the stop; if the guards stop by "zero", the goal follows
        the counts. Any other rig raises a ValueError.
    frame : (5, n) numpy.ndarray
        MIT frames (q, qd, kp, kd, tau) of the last call, to be sent to the drives of a rig with a
        `MitDrive` inside. q, qd and tau are at steps of their fields; kp and kd are those of the
        `MitDrive`, which the frame has at the nearest step (`MitDrive.whole_gains`). Any other rig
        raises a ValueError.
    friction : (2, n) numpy.ndarray
        Coulomb [N m] and viscous [N m s/rad] friction, motor side, that a learning law has learnt
        so far. Save it, and give it to the law at the next start. A stop in which the law begins
        anew returns to the friction of the start. Any other law raises a ValueError.
    """

    def __init__(
        self,
        law: Any,
        rig: Rig,
        pulses: ArrayLike,
        guards: Guards | None = None,
        torque_limit: ArrayLike | None = None,
        without: Sequence[str] = (),
    ) -> None:
        instance("rig", rig, Rig, "Pass found.rig.")
        if guards is not None:
            instance("guards", guards, Guards, "Give Guards(...), or None for none.").warn_of_units(
                rig
            )
        # The limit becomes that of the amplifier in the rig, so that law and guards know it.
        rig = limited(rig, torque_limit)
        block = law.block(rig)
        self.law = law
        self.rig = rig
        self.guards = guards
        self.n = rig.n
        self.period = block.period or rig.period
        self._block = block
        counts = whole_counts(pulses, self.rig)
        self.core = compiled(law, rig, block, guards, without)
        self.without = without
        self._step, self._memory = self.core
        parts = view(self._memory, rig.n, 0)
        self._run = parts.run
        self._joints = parts.joints
        self._weighs = compensates_gravity(law, guards)
        self._shape = (rig.n,)
        # `reset` returns to this memory.
        self._initial = self._memory.copy()
        # Nobody waits for this lock: a second thread is refused.
        self._free = threading.Lock()
        # Each call copies its arguments into these arrays, and the compiled step writes the torque.
        self._arguments = tuple(np.empty((len(ARGUMENTS), rig.n)))
        self._torque = np.empty(rig.n)
        self._log: RunLog | None = None
        # A function computes what the inner loop receives; the places of its inputs in the memory
        # are looked up once.
        if block.sent is not None:
            self._sending = sent_by(law, rig, block, guards, without)
            layout = Layout.of(block, rig.n)
            self._sent_places = [
                [place for place, _ in layout.components(name)] for name in self._sending.sources
            ]
        self._set(counts)

    def to_c(
        self,
        folder: str | Path,
        *,
        name: str = "controller",
        output: str = "torque",
        counts_per_ampere: ArrayLike | None = None,
        largest_count: int = 32767,
        target: str | None = None,
        precision: str = "double",
    ) -> None:
        """Export this controller as C99, with all its guards, as it was at its start.

        The arguments are those of `Law.to_c`, and these two.

        Parameters
        ----------
        target : {None, "cortex-m7", "cortex-m4f"}
            A microcontroller: with toolchain file and Makefile, and a program that replays a record
            in QEMU.
        precision : {"double", "single"}
            Precision of all numbers. Double precision gives the same bits as this computer; single
            precision has no clock (`now` in `step`).
        """
        # The exporter gets law, guards and `without` as `start` got them, and the limited rig.
        write_running(
            self.law,
            self.rig,
            self.guards,
            folder,
            name,
            self.without,
            begin=view(self._initial, self.n, 0).state,
            target=target,
            precision=precision,
            output=output,
            counts_per_ampere=counts_per_ampere,
            largest_count=largest_count,
        )

    def log_to(self, path: str | Path) -> RunLog:
        """Append every sample from now on to a new MCAP file, readable at any time.

        The method returns the log, which is a context manager; close it at the end. If the process
        is killed, the log loses its last samples: up to 64 kB, or as much as its index if the log
        is long. Loops that call the `core` themselves are not logged.

        Raises
        ------
        ValueError
            A file that is there, or a folder that is not.
        """
        self._log = log = RunLog(path, self)
        return log

    def reset(self, pulses: ArrayLike) -> None:
        """Start anew at these counts (n,), with the law's initial state and without a stop.

        After a safe stop: find out why (`status`), plan a reference that begins at the arm's
        position (``rig.cell_centre(pulses)``), and reset.
        """
        self._set(whole_counts(pulses, self.rig))

    def step(
        self,
        pulses: ArrayLike | None = None,
        q_r: ArrayLike | None = None,
        qd_r: ArrayLike | None = None,
        qdd_r: ArrayLike | None = None,
        *,
        now: float | None = None,
        **unknown: Any,
    ) -> Floats:
        """Torque to be applied until the next call; to be called once per period.

        Parameters
        ----------
        pulses : (n,) array_like
            Encoder counts, read now. They must be whole, unless the encoder has ``smooth=True``.
        q_r, qd_r, qdd_r : (n,) array_like
            Reference for now, joint side [rad, rad/s, rad/s^2]. With guards, a reference that is
            not finite is replaced by an extrapolation of the last one; only the first reference
            must be finite.
        now : float, optional
            Time of a steady clock [s] (``time.perf_counter()``), for the guard that sees calls come
            late.

        Returns
        -------
        (n,) numpy.ndarray
            Joint torque after the amplifier's limit, less the firmware's part [N m]; to be
            commanded as ``rig.drive.current(torque)``.

        Raises
        ------
        ValueError
            Something missing, wrong shapes, counts that are not whole, a clock that does not
            advance; without guards also NaN in the reference, or a law that gives no finite torque.
            Counts, torque and state are those of the call before then.
        """
        # Waiting for the other thread would break the period, so the call is refused at once.
        if not self._free.acquire(False):
            raise ValueError(
                "step must be called by one thread at a time; another is in it. Start one"
                " controller each."
            )
        try:
            # Plain arrays of the right shape and kind, as a control loop has them, are copied at
            # once; all else is checked argument by argument.
            arguments = self._arguments
            shape = self._shape
            try:
                fits = pulses.shape == q_r.shape == qd_r.shape == qdd_r.shape == shape  # type: ignore[union-attr]  # caught
                plain = type(pulses) is type(q_r) is type(qd_r) is type(qdd_r) is np.ndarray
                real = q_r.dtype is qd_r.dtype is qdd_r.dtype is _FLOAT  # type: ignore[union-attr]  # caught
                numeric = real and pulses.dtype in _COUNTS  # type: ignore[union-attr]  # caught
                if not (fits and plain and numeric) or unknown:
                    raise ValueError
                arguments[0][...] = pulses
                arguments[1][...] = q_r
                arguments[2][...] = qd_r
                arguments[3][...] = qdd_r
            except (AttributeError, ValueError):
                self._take((pulses, q_r, qd_r, qdd_r), unknown)
            # NaN stands for "no clock" in the compiled step.
            time = np.nan if now is None else clock(now)
            refusal = self._step(*arguments, time, self._memory, self._torque)
            if refusal:
                refuse(refusal, arguments, self.rig, self._run.now, time)
            if self._log is not None:
                self._log.sample()
            return self._torque.copy()
        finally:
            self._free.release()

    # -- attributes -------------------------------------------------------------------------------
    @property
    def pulses(self) -> Floats:
        return self._row("counts")

    @property
    def torque(self) -> Floats:
        return self._row("torque")

    @property
    def reference(self) -> Floats:
        return self._row("q")

    @property
    def state(self) -> Floats:
        return self.core.law_state(self.n).copy()

    @property
    def goal(self) -> NDArray[np.int_]:
        return self._sent("goal").astype(int)

    @property
    def frame(self) -> Floats:
        return self._sent("frame").reshape(-1, self.n)

    def _sent(self, name: str) -> Floats:
        """What an inner loop of the rig gets of the last call, by its name."""
        inner = self.law.rig_of_frames(self.rig).inner
        if inner is None or inner.sends != name:
            sends = "torque" if inner is None else inner.sends
            kind = "has none" if inner is None else f"has a {type(inner).__name__}"
            raise ValueError(
                f"{name} needs a rig with an inner loop that takes it; this one {kind}: take"
                f" running.{sends}."
            )
        values = [self._memory[places] for places in self._sent_places]
        sent: Floats = self._sending.function(*values).full()[:, 0]
        return sent

    @property
    def friction(self) -> Floats:
        learnt: Floats = self.law.friction_in(self.state)
        return learnt

    def begin(self, state: Floats) -> None:
        """Start anew in a state (s,) of the law, to which `reset` and a stop return, too."""
        start = view(self._initial, self.n, 0)
        # In the first of the two a stop lets the law begin anew.
        start.initial[:] = start.state[:] = state
        self._set(self.pulses)

    @property
    def stopped(self) -> bool:
        return bool(self._run.cause != RUNNING)

    @property
    def bridged(self) -> int:
        return int(self._run.bridged)

    @property
    def status(self) -> Status:
        return Status.of(
            self._run, self.law.joint_labels(self.rig), self.law.joint_units(self.rig), self._weighs
        )

    def _row(self, name: str) -> Floats:
        """Copy (n,) of a field of the joints."""
        values: Floats = self._joints[name].copy()
        return values

    # -- arguments of any kind --------------------------------------------------------------------
    def _set(self, counts: Floats) -> None:
        # In place: the compiled step and the views hold this array.
        self._memory[:] = self._initial
        self._joints["counts"] = counts
        self._joints["held_counts"] = counts

    def _take(self, values: tuple[Any, ...], unknown: Mapping[str, Any]) -> None:
        """Take arguments of any kind."""
        for name in unknown:
            choice("an argument of step", name, (*ARGUMENTS, "now"))
        for name, value, argument in zip(ARGUMENTS, values, self._arguments, strict=True):
            if value is None:
                raise ValueError(
                    f"step takes ({', '.join(ARGUMENTS)}); {name} is missing. Give all four."
                )
            # Counts and angles are confused most often, so the advice names what is meant.
            advice = (
                "Give the encoder count of each joint."
                if name == "pulses"
                else "Give one value per joint [SI]."
            )
            argument[:] = numbers(name, value, self.n, advice)
