"""On-line identification of a load under a controller with a model. Source: paper, conclusion."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ctc.laws import Adaptive, ModelLaw
from ctc.payload.controller import PayloadController
from ctc.payload.payload_law import PayloadLaw
from identification import Identification
from identification.payload import (
    KERNEL,
    LoadShape,
    PayloadEstimate,
    Specification,
    uncertainty,
    uninformed,
)
from plant import Rig
from plant.parts import choice, instance, known_options, real

# Shortest window [s]: the lower end of the range of the paper.
_SHORTEST_WINDOW = 0.1

# Factor on the tolerated change of the disturbance torque where gears are elastic: they swing after
# a change of the load. Chosen by hand.
_SWINGING = 2.0

# Disturbance acceleration that the rounding of counts alone makes through the observer of 60 rad/s
# of `PayloadLaw`, divided by the angle of one count [1/s^2]; chosen by hand.
_ROUNDING = 200.0


@known_options
class PayloadEstimator:
    """A controller that identifies the load in its gripper while it runs.

    At the start, and when a load is taken, dropped or changed, the controller puts a prior load
    into its model and collects counts and applied torques over a window. The load is identified
    from them, by default in another process. Then the controller swaps its model without a bump in
    the torque.

    Parameters
    ----------
    law : ModelLaw
        Law with a model of the arm without a load, and with its rig, such as `ComputedTorque`; not
        `Adaptive`. A swap re-bases its observer or integral.
    mass : (2,) array_like
        Lightest and heaviest load [kg].
    position : (3,) array_like, optional
        Centre of the load in the frame of the last link's body [m]. By default it lies somewhere
        along a line.
    window : float
        Time over which counts and torques are collected [s]; the paper has 0.1 to 0.2.
    along : (3,) array_like, optional
        Without `position`: direction of the line, from the origin of the last body's frame, on
        which the centre lies; by default the axis along which the last link's own centre lies.
    reach : (2,) array_like
        Shortest and longest distance of the centre from that origin along the line [m].
    inertia : (6,) array_like
        Ixx, Ixy, Ixz, Iyy, Iyz, Izz of 1 kg about its centre [m^2]; a point mass by default.
    prior : float, optional
        Mass in the model while a load is not known [kg]; by default the middle of its
        range.
    found : Identification, optional
        Identification that gave the arm and the rig: its covariance enters the estimate and its
        interval.
    friction : float
        Standard deviation of the friction levels as a share of them, for the interval, where
        `found` has none.
    tolerated : float
        Share by which friction may be off without a false alarm: see `alarm`.
    alarm : float
        Change of the disturbance torque that counts as a change of the load, in units of the change
        that friction (see `tolerated`) and rounding may make.
    method : {"kernel", "genetic"}
        The torque equation by smooth kernels, or the genetic algorithm of 3.7.
    beside : bool
        Identify in a process of its own. If not, the call that ends a window lasts until the load
        is identified.
    seed : int
        Of the genetic algorithm.

    Attributes
    ----------
    loop_law : PayloadLaw
        The stage that runs in the loop; ``.to_c(folder)`` exports it.

    Raises
    ------
    ValueError
        Bad input; a law that knows no arm, or has no period.

    See Also
    --------
    identification.find_load

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, PayloadEstimator
    >>> rig = puma560.rig()
    >>> law = ComputedTorque(puma560.literature_arm(0.0), rig, bandwidth=150)
    >>> estimator = PayloadEstimator(law, mass=(0, 5), position=(0.0, -0.43, 0.0))
    >>> controller = estimator.start(rig, rig.counts((0, 0)))
    >>> controller.events
    []

    Source: paper, conclusion.
    """

    def __init__(
        self,
        law: ModelLaw,
        *,
        mass: ArrayLike = (0, 5),
        position: ArrayLike | None = None,
        window: float = 0.2,
        along: ArrayLike | None = None,
        reach: ArrayLike = (0.2, 0.5),
        inertia: ArrayLike = (0,) * 6,
        prior: float | None = None,
        found: Identification | None = None,
        friction: float = 0.0,
        tolerated: float = 0.05,
        alarm: float = 1.7,
        method: str = "kernel",
        beside: bool = True,
        seed: int = 0,
    ) -> None:
        checked = instance("law", law, ModelLaw, "It must hold an arm, such as ComputedTorque.")
        # Two estimators of one load would both correct the same error.
        if isinstance(law, Adaptive):
            raise ValueError(
                "law must keep the model it is given; Adaptive changes it by itself. Use"
                " ComputedTorque."
            )
        arm = checked.arm
        rig = checked.rig
        self.law = checked
        self.method = choice("method", method, ("kernel", "genetic"))
        self.beside = beside
        self.shape = LoadShape.of(arm, mass, position, along, reach, inertia)
        self.window = real("window", window, "Give seconds, such as 0.2.")
        self.alarm = real("alarm", alarm, "Leave it out.", positive=True)

        # 1. The window: at least three smoothing kernels.
        # A kernel needs its length and a sample at each end; three fit side by side.
        samples = round(self.window / rig.period)
        least = math.ceil(3 * (KERNEL / rig.period + 2))
        if self.window < _SHORTEST_WINDOW or samples < least:
            shortest = max(_SHORTEST_WINDOW, least * rig.period)
            raise ValueError(
                f"window must be at least {shortest:.6g} s; got {window:.6g}. The paper has 0.1 to"
                " 0.2."
            )

        # 2. The load to start with.
        start = self.shape.prior
        low, high = self.shape.mass
        if prior is not None:
            if not low <= real("prior", prior, "Give kg.") <= high:
                raise ValueError(
                    f"prior must be within {low:g} to {high:g} kg; got {prior:g}. Leave it out for"
                    " the middle of that range."
                )
            # The shape's prior has the mass in the middle of the range, to which its parameters are
            # proportional.
            start = prior / (low + high) * 2 * self.shape.prior

        # 3. Changes of the disturbance torque without a change of the load: friction that is off,
        # and rounding.
        tolerated = real("tolerated", tolerated, "Give a share, such as 0.05.", positive=True)
        # Rounding by one count looks like an acceleration; times the inertia at the zero pose it is
        # a torque of each joint.
        count = np.abs(rig.to_angle(np.ones(rig.n)))
        rounding = _ROUNDING * (count * np.diag(arm.D(np.zeros(rig.n))))
        unknown, root = uncertainty(arm, rig, found, friction)
        rigid = rig.drive.elasticity is None
        noise = tolerated * rig.drive.joint_coulomb() + rounding
        # A law with a delay has already fixed the torque of the coming samples. It must therefore
        # hold the load itself, on elastic gears too. The middle place stands for all places of the
        # load.
        self.loop_law = PayloadLaw(
            law=checked,
            start_with=start,
            stiffened=rigid or bool(getattr(checked, "delay", 0)),
            per_kg=self.shape.per_kg[len(self.shape.places) // 2],
            noise=(1.0 if rigid else _SWINGING) * noise,
        )
        self.specification = Specification(
            method=self.method,
            arm=arm,
            rig=rig,
            shape=self.shape,
            unknown=unknown,
            root=root,
            samples=samples,
            seed=seed,
        )

    @property
    def prior(self) -> PayloadEstimate:
        """The estimate that the model holds while a load is not known."""
        parameters = np.array(self.loop_law.start_with)
        limits = np.array(self.shape.mass, dtype=float)
        return uninformed(self.shape, parameters, limits, "the prior: nothing identified yet")

    def start(self, rig: Rig, pulses: ArrayLike, **options: Any) -> PayloadController:
        """A running controller, as `plant.Law.start`, with ``.load`` and ``.events``."""
        instance("rig", rig, Rig, "Pass found.rig.")
        # Unstable gains show at the start, before the load can be blamed.
        self.law.require_stable(rig, pulses)
        return PayloadController(self, self.loop_law.start(rig, pulses, **options))

    def __repr__(self) -> str:
        low, high = self.shape.mass
        return (
            f"PayloadEstimator({type(self.law).__name__}, {low:g} to {high:g} kg, {self.method},"
            f" {self.window:g} s)"
        )
