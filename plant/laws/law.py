"""A control law: from encoder counts and a reference to a joint torque, as one symbolic step.

A law gives its `period` (None: fast hardware, evaluated at every sub-step; otherwise [s], a whole
multiple of the sub-step), the `fields` of its state, and its `equations`. Its numba kernel, its
evaluation by casadi, its running controller and its C are all made from these.
"""

import abc
import dataclasses
import functools
import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.machine import Frame, InnerLoop, Rig
from plant.parts import TURNS, Field, Fields, JointUnits, Part, declared, known_options, vector_of
from plant.realtime import Guards, Running, write_c

Step = tuple[ca.SX, ca.SX]  # torque that a law commands, and the state that follows


class Setpoint(NamedTuple):
    """The reference now: q, qd, qdd (n,) joint side [SI], and the same position in pulses (n,).

    `logged` (n,) is this row of the column that a law replays from its record.
    """

    q: ca.SX
    qd: ca.SX
    qdd: ca.SX
    pulses: ca.SX
    logged: ca.SX | None = None


@dataclasses.dataclass(frozen=True)
class Block:
    """A law as one symbolic step for one rig, a casadi Function.

    (state, q, qd, qdd, reference_pulses, pulses, torque, dt, numbers) -> (asked, following). The
    input `torque` is the joint torque applied last, after the amplifier's limit; `asked` is the
    commanded torque, before that limit [N m]. A law that replays its record has one more input,
    `logged`. `names` and `values` (k,) belong to the numbers: first the law's (``law.``), then the
    rig's. `initial` (s,) is the state at the start.

    Above an inner loop, `asked` is the torque that the sent frame adds, after rounding and limits.
    `sent` gives that frame: (q, qd, qdd, pulses, asked, numbers) -> (3 n,), the rows of
    `plant.machine.inner_loop.Frame`.
    """

    step: ca.Function
    initial: NDArray[np.float64]
    names: list[str]
    values: NDArray[np.float64]
    period: float | None
    sent: ca.Function | None = None

    def depends(self, output: str, *inputs: str) -> bool:
        """Whether an output of the step depends on one of these inputs; all by their names."""
        row = self.step.index_out(output)
        columns = [self.step.index_in(name) for name in inputs]
        return any(self.step.jac_sparsity(row, column).nnz() for column in columns)

    def require_torque(self, what: str) -> None:
        """Refuse a block that sends goals or frames, for a target that takes torques alone."""
        if self.sent is not None:
            raise ValueError(
                f"{what} needs a rig whose torque is the law's; this one has an inner loop, to"
                " which goals or frames are sent. Run it with law.start."
            )


class Law(Part, abc.ABC):
    """Base of all laws: a new law is a `@part` class with ``period``, ``fields`` and ``equations``.

    `fields` names the state (`plant.parts.vector.Fields`); a law may give ``initial_state`` in
    their place, and slice its state itself. A law without state derives from `StatelessLaw` and
    gives its equations, and a period where it is sampled.

    See Also
    --------
    plant.StatelessLaw

    Examples
    --------
    >>> from plant import puma560
    >>> law = puma560.p_law()
    >>> controller = law.start(puma560.rig(), (0, 0))
    >>> controller.step((0, 0), (0.001, 0), (0, 0), (0, 0)).shape
    (2,)
    """

    period: float | None = declared(
        "Sampling period [s], or None: fast hardware, evaluated at every sub-step."
    )
    replays: str | None = None
    """Column of its record that the law repeats, or None."""

    @property
    def interpolates(self) -> bool:
        """Whether the column of `replays` is linear between rows; else a row holds to the next."""
        return False

    def __post_init__(self) -> None:
        super().__post_init__()
        cls = type(self)
        # By default `fields` and `initial_state` call each other: a law must define one of them.
        if cls.fields is Law.fields and cls.initial_state is Law.initial_state:
            raise ValueError(
                f"{cls.__name__} must give all that Law declares; it lacks fields. Define them, or"
                " derive from StatelessLaw."
            )

    @functools.cached_property
    def fields(self) -> Fields:
        """Names of the state, by which `equations` reads and writes it.

        The state of a law that gives `initial_state` alone is one field.
        """
        return Fields(state=vector_of(initial=self.initial_state))

    def initial_state(self, n: int) -> NDArray[np.float64]:
        """State (s,) of a law of n joints at the start, in the law's own units.

        By default that of its `fields`.
        """
        return self.fields.initial(n)

    @abc.abstractmethod
    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """One step of the law in casadi; the numbers of the law and of the rig are symbols.

        Parameters
        ----------
        rig : Rig
            Its ``drive`` crosses the gear, its ``cell_centre`` the encoder.
        state : casadi SX (s, 1)
        setpoint : Setpoint
        pulses : casadi SX (n, 1)
            Encoder counts that the law reads.
        torque : casadi SX (n, 1)
            Joint torque applied last, after the amplifier's limit [N m].
        dt : casadi SX (1, 1)
            Time since the step before [s].

        Returns
        -------
        torque, state : casadi SX (n, 1), (s, 1)
            Commanded joint torque, before the amplifier's limit [N m]; the state of the next step.
        """

    @property
    def innermost(self) -> "Law":
        """The innermost law that this law wraps; the law itself if it wraps none."""
        within = getattr(self, "law", None)
        return within.innermost if isinstance(within, Law) else self

    def rig_of_frames(self, rig: Rig) -> Rig:
        """The rig for whose inner loop and transport the law makes its frames; by default `rig`.

        A law around a law asks the inner one.
        """
        innermost = self.innermost
        return rig if innermost is self else innermost.rig_of_frames(rig)

    def period_on(self, rig: Rig) -> float | None:
        """`period` on a rig [s]; a servo's loop runs a whole number of times per sample."""
        innermost = self.innermost
        return self.period if innermost is self else innermost.period_on(rig)

    def has_memory(self, n: int) -> bool:
        """Whether the law has a state or holds its torque for a period."""
        return self.period is not None or len(self.initial_state(n)) > 0

    def joint_labels(self, rig: Rig) -> list[str]:
        """Names of the joints in messages: those of the law's arm, otherwise of the drive."""
        # Messages name joints as the user's model does; a law without a model knows the drive's
        # names only.
        arm = getattr(self, "arm", None)
        return rig.joint_labels if arm is None else arm.dynamics.chain.joint_labels

    def joint_units(self, rig: Rig) -> list[JointUnits]:
        """Units of the joints in messages; without an arm, as if all joints turned."""
        # A rig counts pulses, and knows nothing of the joints behind them.
        arm = getattr(self, "arm", None)
        return [TURNS] * rig.n if arm is None else arm.dynamics.chain.joint_units

    def sliding(self) -> "Law":
        """This law without dry friction in its model, as linear analysis needs it."""
        return self

    def replayed(self, record: Any) -> NDArray[np.float64] | None:
        """The column (N, n) of a `Record` that this law repeats, or None for a controller."""
        # A controller has no column to repeat.
        if self.replays is None:
            return None
        logged = getattr(record, self.replays)
        if logged is None:
            raise ValueError(
                f"{type(self).__name__} needs the record's {self.replays}; it has none. Give that"
                " column."
            )
        return logged

    @known_options
    def start(
        self,
        rig: Rig,
        pulses: ArrayLike,
        *,
        # Guards are frozen, so one default for all calls is safe.
        guards: Guards | None = Guards(),  # noqa: B008
        torque_limit: ArrayLike | None = None,
        without: Sequence[str] = (),
    ) -> Running:
        """This law as a running controller.

        A law without a period, such as `P`, stands for fast hardware: call it far more often than
        once per sample.

        Parameters
        ----------
        rig : Rig
        pulses : (n,) array_like
            Encoder counts now.
        guards : Guards or None
            The monitors, and how they stop the arm. With None there are none, and a call that
            cannot be answered is refused.
        torque_limit : (n,) array_like, optional
            A limit below the amplifier's [N m], magnitude, joint side (of coupled joints: on the
            shaft). The law accounts for it as for the amplifier's.
        without : sequence of str
            The parts, of "gravity", "friction" and "inertia", that firmware adds. `step` evaluates
            them at the measured angle and the reference's speed and acceleration, and leaves them
            out of the torque that it returns, as do `Running.goal` and `Running.frame`. Law,
            limits and guards use the whole torque.

        Returns
        -------
        Running
            ``.step(pulses, q_r, qd_r, qdd_r)`` -> joint torque (n,) [N m], once per period.

        Raises
        ------
        ValueError
            A law that only repeats a log; a part that the law does not have.
        """
        # A log that is repeated on a machine would drive it without any feedback.
        if self.replays:
            raise ValueError(
                f"a law at work must be a controller; {type(self).__name__} repeats a log. Use"
                " another."
            )
        return Running(self, rig, pulses, guards, torque_limit, without)

    def model_parts(self, q: ca.SX, qd: ca.SX, qdd: ca.SX) -> dict[str, ca.SX]:
        """Torques (n, 1) of the model that firmware may add in the law's place, by name.

        A law around a law gives those of the inner one.
        """
        inner = getattr(self, "law", None)
        return inner.model_parts(q, qd, qdd) if isinstance(inner, Law) else {}

    def friction_in(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Friction (2, n) that a law learnt, from its state; a law that learns none refuses."""
        raise ValueError(
            f"friction must be that of a law that learns it; {type(self).__name__} learns none."
        )

    @known_options
    def to_c(
        self,
        folder: str | Path,
        rig: Rig | None = None,
        *,
        name: str = "controller",
        output: str = "torque",
        counts_per_ampere: ArrayLike | None = None,
        largest_count: int = 32767,
        guards: Guards | None = Guards(),  # noqa: B008
        without: Sequence[str] = (),
    ) -> None:
        """This law as self-contained C99: header, source, a main that replays a record, Makefile.

        Parameters
        ----------
        folder : str or Path
            Created if it does not exist. An earlier export of the same name in it is overwritten,
            and no other file.
        rig : Rig, optional
            The rig that the controller drives; by default the law's own.
        name : str
            Of files and functions; small letters, digits and underscores.
        output : {"torque", "dac", "goal", "frame"}
            Joint torque [N m], counts of the converter that commands the motor currents, goals of a
            `PositionServo` [counts], or the five fields of a `MitDrive`, (5, n) row by row.
        counts_per_ampere : (n,) array_like, optional
            Gain of that converter, with the sign of its wiring. The output is rounded to whole
            counts, within +- `largest_count`.
        largest_count : int
            Largest count that the converter takes.
        guards : Guards or None
            The C does the same as ``start(rig, pulses, guards=guards)``, with every guard and stop.
            With None, and for laws without a period, it holds the equations alone, each number
            under its name.
        without : sequence of str
            The parts that the firmware adds, as in `start`.

        Raises
        ------
        ValueError
            No rig; names that are none in C; a converter whose range ends below the amplifier's
            limit; files that are no export of this library.
        """
        # The text of the export belongs to the running controller, so that C and Python cannot
        # differ.
        write_c(
            self,
            folder,
            rig,
            guards,
            name,
            without,
            output=output,
            counts_per_ampere=counts_per_ampere,
            largest_count=largest_count,
        )

    def block(self, rig: Rig) -> Block:
        """This law as a symbolic step for a rig."""
        n = rig.n
        kind = type(self).__name__
        # A wrong number of gains would be broadcast by casadi without a word.
        self.require_joints(n, f"{kind}.")
        initial = np.asarray(self.initial_state(n), float)
        law_names = self.number_names("law.")
        rig_names = rig.number_names()

        # 1. Symbols in place of the numbers of law and rig, and of what a step reads.
        numbers = ca.SX.sym("numbers", len(law_names) + len(rig_names))
        law = self.with_numbers(numbers[: len(law_names)])
        # The start of a state may depend on the law's numbers; its layout must not, so the copy
        # with symbols keeps the layout of the law with values.
        vars(law)["fields"] = self.fields
        symbolic_rig = rig.with_numbers(numbers[len(law_names) :])
        state = ca.SX.sym("state", len(initial))
        dt = ca.SX.sym("dt")
        joint_inputs = "q", "qd", "qdd", "reference_pulses", "pulses", "torque"
        q, qd, qdd, reference_pulses, pulses, torque = (ca.SX.sym(name, n) for name in joint_inputs)
        # A law that repeats a log reads its column as one more input.
        logged = [ca.SX.sym("logged", n)] if self.replays else []
        setpoint = Setpoint(q, qd, qdd, reference_pulses, *logged)

        # 2. The step, with checks for mistakes in a user's own law.
        arguments = (symbolic_rig, state, setpoint, pulses, torque, dt)
        commanded, following = _checked_step(law, arguments)
        # casadi broadcasts a scalar torque or state to all joints: the shapes are checked here,
        # once.
        if commanded.shape != (n, 1) or following.shape != (len(initial), 1):
            rule = f"must give torque ({n}, 1) and state ({len(initial)}, 1)"
            raise ValueError(
                f"{kind} {rule}; got {commanded.shape} and {following.shape}. One number per joint"
                " of the rig."
            )

        # 3. Above an inner loop the torque becomes a frame, which may give less of it.
        sent = None
        if rig.inner is not None:
            self._require_frames()
            known = law.rig_of_frames(symbolic_rig)
            _, commanded = _sent(known, symbolic_rig, setpoint, pulses, commanded)
            frame, _ = _sent(known, symbolic_rig, setpoint, pulses, torque)
            sent_inputs = [q, qd, qdd, pulses, torque, numbers]
            sent = ca.Function("sent", sent_inputs, [ca.densify(ca.vertcat(*frame))])

        # 4. A function of these symbols, and the values for which they stand.
        names = ["state", *joint_inputs, "dt", "numbers", "logged"]
        inputs = [state, q, qd, qdd, reference_pulses, pulses, torque, dt, numbers, *logged]
        step = ca.Function(
            # Names of the inputs are part of the kernels' text and of exported C.
            "law",
            inputs,
            [commanded, following],
            names[: len(inputs)],
            ["asked", "following"],
        )
        values = np.append(self.number_values(), rig.number_values())
        return Block(step, initial, law_names + rig_names, values, self.period_on(rig), sent)

    def _require_frames(self) -> None:
        """Refuse a law that cannot send frames to an inner loop."""
        kind = type(self).__name__
        rule = "a rig with an inner loop needs a law that sends goals or frames once per period"
        if isinstance(self, InnerLoop):
            raise ValueError(f"{rule}; {kind} is such a loop itself. Leave inner out of the rig.")
        if self.replays is not None:
            raise ValueError(
                f"{rule}; {kind} repeats the motors' own {self.replays}. Leave inner out of the"
                " rig."
            )
        if self.period is None:
            raise ValueError(
                f"{rule}; {kind} is fast hardware, which writes torques. Give it a period, or leave"
                " inner out of the rig."
            )


def _sent(
    known: Rig, rig: Rig, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX
) -> tuple[Frame, ca.SX]:
    """The frame of a joint torque (n, 1) beside the reference, and the torque that it adds.

    `known` is the rig as the law has it; its geometry, gears and counts, is that of `rig`.
    """
    inner: Any = known.inner
    # A frame holds until the next one. It is made for the reference in the middle of that time,
    # which begins later by the delay of the transport.
    late = 0 if known.transport is None else known.transport.delay
    time = rig.period / 2 + late
    q = setpoint.q + time * setpoint.qd + time * time / 2 * setpoint.qdd
    qd = setpoint.qd + time * setpoint.qdd
    frame = inner.frame(rig, q, qd, torque, pulses)
    return frame, inner.added(rig, q, qd, frame)


@functools.lru_cache(maxsize=8)
def block_of(law: Law, rig: Rig) -> Block:
    """The symbolic step of a law for a rig, kept for the next call with the same two."""
    return law.block(rig)


def _checked_step(law: Law, arguments: tuple[Any, ...]) -> Step:
    """Torque and state of a law's equations; arguments or results of another form are refused."""
    kind = type(law).__name__
    try:
        # Arguments are bound before the call, so that a TypeError inside the equations stays
        # visible.
        inspect.signature(law.equations).bind(*arguments)
    except TypeError:
        signature = inspect.signature(type(law).equations)
        raise ValueError(
            f"equations of {kind} must take (self, rig, state, setpoint, pulses, torque, dt); got"
            f" {signature}. Correct the arguments."
        ) from None
    result = law.equations(*arguments)
    rule = f"equations of {kind} must return (torque, state)"
    if not isinstance(result, tuple):
        raise ValueError(f"{rule}; got a {type(result).__name__}. Add the other.")
    if len(result) != 2:
        raise ValueError(f"{rule}; got {len(result)} values. Return these two.")
    # A plain number or a list has no shape to check.
    for part, value in zip(("torque", "state"), result, strict=True):
        if not hasattr(value, "shape"):
            raise ValueError(
                f"{rule} as casadi.SX; got a {type(value).__name__} as {part}. Write"
                " casadi.SX.zeros(rig.n), or casadi.vertcat."
            )
    return result


def state_of(law: Law) -> Field:
    """The state of a law as one field of a law around it, with the roles of its own fields.

    See Also
    --------
    plant.Fields, plant.Law

    Examples
    --------
    >>> from plant import PID, Fields, per_joint, puma560, state_of
    >>> inner = PID(gain=(0.05, 0.04), integral=(0.1, 0.1), derivative=(0, 0), filter=500.0,
    ...             period=puma560.rig().period)
    >>> Fields(law=state_of(inner), added=per_joint()).length(2) - inner.fields.length(2)
    2
    """
    starts_otherwise = type(law).initial_state is not Law.initial_state
    return vector_of(law.fields, law.initial_state if starts_otherwise else None)


class StatelessLaw(Law):
    """Base of laws without state: torque from counts, reference and the last applied torque.

    See Also
    --------
    plant.Law, plant.P

    Examples
    --------
    >>> from plant import StatelessLaw, number, part
    >>> @part
    ... class Soft(StatelessLaw):
    ...     gain: object = number(("n",))
    ...     def equations(self, rig, state, setpoint, pulses, torque, dt):
    ...         return rig.drive.joint_torque(self.gain * (setpoint.pulses - pulses)), state
    ...
    >>> Soft(gain=(0.2, 0.1)).number_names()
    ['gain[0]', 'gain[1]']
    """

    period: float | None = None

    fields = Fields()
