"""What a control law is: from encoder counts and a reference to a joint torque, written once as a
symbolic step.

A law gives its `period` (None: fast hardware, evaluated at every sub-step; otherwise [s], a whole
multiple of the sub-step), its state, and its `equations`: of them are made its kernel, the casadi
referee, running controller, and C.
"""

import abc
import dataclasses
import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.machine.rig import Rig
from plant.parts.arguments import known_options
from plant.parts.part import Part, declared
from plant.realtime.c_export import write_c
from plant.realtime.guards import Guards
from plant.realtime.running import Running

Step = tuple[ca.SX, ca.SX]  # torque that a law commands, and the state that follows


class Setpoint(NamedTuple):
    """The reference now: q, qd, qdd (n,) joint side [SI], and the same position in pulses (n,).

    For a law that replays a column of its record, also what was logged (n,).
    """

    q: ca.SX
    qd: ca.SX
    qdd: ca.SX
    pulses: ca.SX
    logged: ca.SX | None = None


@dataclasses.dataclass(frozen=True)
class Block:
    """A law as one symbolic step for one rig, a casadi Function.

    (state, q, qd, qdd, reference_pulses, pulses, torque, dt, numbers) -> (asked, following). Torque
    in is the joint torque applied last, after the amplifier's limit; `asked` is the commanded
    torque, before it [N m]. A law that replays its record has one more input, `logged`. `names` and
    `values` (k,) are those of the numbers: the law's own (``law.``), then the rig's; `initial` (s,)
    is the state at the start.
    """

    step: ca.Function
    initial: NDArray[np.float64]
    names: list[str]
    values: NDArray[np.float64]
    period: float | None


class Law(Part, abc.ABC):
    """Base of all laws: a new law is a `@part` class that gives ``period``, ``initial_state`` and
    ``equations``.

    A law without state derives from `StatelessLaw` and gives its equations, and a period where it
    is sampled.

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

    @abc.abstractmethod
    def initial_state(self, n: int) -> NDArray[np.float64]:
        """State (s,) of a law of n joints at the start; its length and its units are the law's
        own.
        """

    @abc.abstractmethod
    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """One step of the law in casadi; the numbers of its own fields and of the rig are symbols.

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
            Commanded joint torque, before the amplifier's limit [N m]; what follows.
        """

    def has_memory(self, n: int) -> bool:
        """Whether the commanded torque depends on more than counts and reference now: a period,
        or a state.
        """
        return self.period is not None or len(self.initial_state(n)) > 0

    def joint_labels(self, rig: Rig) -> list[str]:
        """What to call each joint (`joint_label`): by the law's arm if it has one, otherwise by
        the drive's names.
        """
        arm = getattr(self, "arm", None)
        return rig.joint_labels if arm is None else arm.dynamics.chain.joint_labels

    def sliding(self) -> "Law":
        """This law for joints that slide one way, as linear analysis has them: without dry
        friction of its own.
        """
        return self

    def replayed(self, record: Any) -> NDArray[np.float64] | None:
        """The column (N, n) of a `Record` that this law repeats, if it has it, or None for a
        controller.
        """
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
        # frozen
        self,
        rig: Rig,
        pulses: ArrayLike,
        *,
        guards: Guards | None = Guards(),  # noqa: B008
        torque_limit: ArrayLike | None = None,
        without: Sequence[str] = (),
    ) -> Running:
        """This law as a running controller; one without a period (`P`) has to be called far more
        often.

        Parameters
        ----------
        rig : Rig
        pulses : (n,) array_like
            Encoder counts now.
        guards : Guards or None
            What is monitored, and how the arm is stopped; None for nothing: a call that cannot be
            answered is refused.
        torque_limit : (n,) array_like, optional
            Lower than the amplifier's [N m], magnitude, joint side (of coupled joints: on the
            shaft). The law knows it, as it knows that one.
        without : sequence of str
            Of "gravity", "friction", "inertia" what firmware adds: left out of the torque that
            `step` returns, as it is at the measured angle with the reference's speed and
            acceleration. Law, limits and guards know the whole.

        Returns
        -------
        Running
            ``.step(pulses, q_r, qd_r, qdd_r)`` -> joint torque (n,) [N m], once per period.

        Raises
        ------
        ValueError
            A law that only repeats a log; a part that the law does not have.
        """
        if self.replays:
            raise ValueError(
                f"a law at work must be a controller; {type(self).__name__} repeats a log. Use"
                " another."
            )
        return Running(self, rig, pulses, guards, torque_limit, without)

    def model_parts(self, q: ca.SX, qd: ca.SX, qdd: ca.SX) -> dict[str, ca.SX]:
        """Torques (n, 1) of the model that firmware may add in its place; a law around a law has
        that one's.
        """
        inner = getattr(self, "law", None)
        return inner.model_parts(q, qd, qdd) if isinstance(inner, Law) else {}

    def friction_in(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Friction (2, n) as learnt in a state of the law; of a law that learns none a
        ValueError.
        """
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
        """This law as self-contained C99: a header, a source, a main that replays a record, and a
        Makefile.

        Parameters
        ----------
        folder : str or Path
            Made if it is not there; an earlier export of the same name in it is overwritten,
            nothing else is.
        rig : Rig, optional
            What the controller drives; by default the law's own.
        name : str
            Of files and functions; small letters, digits and underscores.
        output : {"torque", "dac"}
            Joint torque [N m], or counts of the converter that commands the motor currents.
        counts_per_ampere : (n,) array_like, optional
            Of that converter, signed as it is wired; the output is rounded to whole counts, within
            +- `largest_count`.
        largest_count : int
        guards : Guards or None
            The C is that of ``start(rig, pulses, guards=guards)``, with every guard and stop. None,
            and laws without a period, for the equations alone, each number under its name.
        without : sequence of str
            What the firmware adds; as `start`.

        Raises
        ------
        ValueError
            No rig; names that C could not have; a converter that ends below the amplifier's limit;
            files of others.
        """
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
        self.require_joints(n, f"{type(self).__name__}.")
        initial = np.asarray(self.initial_state(n), float)
        own = self.number_names("law.")
        rigs = rig.number_names()
        numbers = ca.SX.sym("numbers", len(own) + len(rigs))
        law = self.with_numbers(numbers[: len(own)])
        symbolic_rig = rig.with_numbers(numbers[len(own) :])
        state = ca.SX.sym("state", len(initial))
        dt = ca.SX.sym("dt")
        kind = type(self).__name__
        known = "q", "qd", "qdd", "reference_pulses", "pulses", "torque"
        q, qd, qdd, reference_pulses, pulses, torque = (ca.SX.sym(name, n) for name in known)
        logged = [ca.SX.sym("logged", n)] if self.replays else []
        setpoint = Setpoint(q, qd, qdd, reference_pulses, *logged)
        symbols = (symbolic_rig, state, setpoint, pulses, torque, dt)
        try:
            inspect.signature(law.equations).bind(*symbols)
        except TypeError:
            takes = (
                f"equations of {kind} must take (self, rig, state, setpoint, pulses, torque, dt)"
            )
            given = inspect.signature(type(self).equations)
            raise ValueError(f"{takes}; got {given}. Correct the arguments.") from None
        result = law.equations(*symbols)
        if not isinstance(result, tuple) or len(result) != 2:
            raise ValueError(
                f"equations of {kind} must return (torque, state); got a {type(result).__name__}."
                " Add it."
            )
        asked, following = result
        if asked.shape != (n, 1) or following.shape != (len(initial), 1):
            rule = f"must give torque ({n}, 1) and state ({len(initial)}, 1)"
            raise ValueError(
                f"{kind} {rule}; got {asked.shape} and {following.shape}. One number per joint of"
                " the rig."
            )
        names = ["state", *known, "dt", "numbers"]
        inputs = [state, q, qd, qdd, reference_pulses, pulses, torque, dt, numbers, *logged]
        step = ca.Function(
            "law",
            inputs,
            [asked, following],
            [*names, "logged"][: len(inputs)],
            ["asked", "following"],
        )
        values = np.append(self.number_values(), rig.number_values())
        return Block(
            step=step, initial=initial, names=own + rigs, values=values, period=self.period
        )


class StatelessLaw(Law):
    """Base of laws without state: the torque depends on counts, reference and the last applied
    torque alone.

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

    def initial_state(self, n: int) -> NDArray[np.float64]:
        """No state, (0,)."""
        return np.empty(0)
