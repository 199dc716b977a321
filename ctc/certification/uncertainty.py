"""Uncertainty of a plant, and plants drawn from it.

Drawn are the identified numbers (from their covariance, or from given arms), friction that was not identified, a load
in the hand, the encoders' zeros between two pulses, the delay of the torque, and samples whose counts are lost. A
certificate covers nothing else.
"""

import dataclasses
import re
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ctc.certification.gears import Gears
from ctc.certification.identified import identified
from ctc.certification.imperfections import between
from ctc.certification.plants import Plants
from ctc.certification.statement import statement
from identification import Identification
from plant import Arm, Body, Phase, Rig, Transport
from plant.machine.motor_inertia import least_inertia_margin
from plant.parts.arguments import array, instance, real
from plant.parts.checkpoint import Checkpoint

_PATIENCE = 20
"""Draws per plant at most, until one is an arm."""

_NOT_NEGATIVE = re.compile(r"drive\.(viscous|coulomb|curve\.breakaway|elasticity)|springs(\[\d+\])?\.stiffness")


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Uncertainty:
    """Distribution of the plants.

    Parameters
    ----------
    covariance : (k, k) array_like, optional
        Of ``found.values``, normal; by default ``found.covariance``. With an `Arm` in place of ``found``, of its f.
    plants : (M, p) array_like, optional
        Instead: f of given arms, taken in turn.
    friction : float
        Relative standard deviation of every viscous coefficient and Coulomb level, normal, each on its own; for those
        that were identified, their covariance is used instead.
    load : float or (2,) array_like
        Point mass in the hand [kg]: one value, or uniform between two.
    load_position : (3,) array_like, optional
        Of the load, in the frame of the last link's body [m].
    phase : bool
        Whether the encoders' zeros are drawn, uniform in ±1/2 pulse, each on its own.
    delay : float or (2,) array_like
        Of the torque [s], constant during a run: one value, or uniform between two; at most one period of the law.
    dropped : float
        Probability that the counts of a sample do not arrive; the law then reads those of the sample before.
    gears : Gears
        What gears and drives do.

    Raises
    ------
    ValueError
    """

    covariance: ArrayLike | None = None
    plants: ArrayLike | None = None
    friction: float = 0.1
    load: Any = (0.0, 0.0)
    load_position: ArrayLike | None = None
    phase: bool = True
    delay: Any = (0.0, 0.0)
    dropped: float = 0.0
    gears: Gears = Gears()  # noqa: RUF009 - frozen

    def __post_init__(self) -> None:
        for name, unit in (("load", "kg"), ("delay", "s")):
            object.__setattr__(self, name, between(name, getattr(self, name), unit))
        if not 0 <= real("friction", self.friction, "Give a share, such as 0.1.") <= 1:
            raise ValueError(f"friction must be a share from 0 to 1; got {self.friction}. 0.1 is 10 %.")
        if not 0 <= real("dropped", self.dropped, "Give a probability, such as 0.01.") < 1:
            raise ValueError(f"dropped must be from 0 to below 1; got {self.dropped}. Give a probability.")
        instance("phase", self.phase, bool, "Say True or False.")
        if self.load[1] > 0 and self.load_position is None:
            raise ValueError(
                "load_position must be given with a load; got None. Give x, y and z in the last frame [m]."
            )
        if self.covariance is not None and self.plants is not None:
            raise ValueError("one of covariance and plants must be given; got both. Leave one out.")

    def stated(self) -> dict[str, Any]:
        """What was stated, by name, arrays as such."""
        named = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        shapes: dict[str, tuple[int | str | None, ...]]
        shapes = {"covariance": ("k", "k"), "plants": ("M", "p"), "load_position": (3,)}
        advice = "Give numbers, as for certify."
        return named | {
            name: array(name, named[name], shape, advice=advice)
            for name, shape in shapes.items()
            if named[name] is not None
        }

    def draw(
        self, found: Identification | Arm, rig: Rig, samples: int, seed: int, pose: Any = None, progress: bool = False,
        checkpoint: Checkpoint | None = None,
    ) -> Plants:  # fmt: skip
        """Draw plants.

        Parameters
        ----------
        found : Identification or Arm
        rig : Rig
        samples, seed : int
        pose : (n,) array_like, optional
            At which resonances are those of the gears [rad]; zeros by default.
        progress : bool
            Show a progress bar where the records of an identification are fitted again.
        checkpoint : Checkpoint, optional
            Of which these fits are stages.

        Returns
        -------
        Plants

        Raises
        ------
        ValueError
            No covariance to draw from, or one so large that hardly a draw is an arm.
        """
        instance("rig", rig, Rig, "The order is found, rig, law, reference.")
        pose = np.zeros(rig.n) if pose is None else pose
        self.gears.require_possible(rig)
        known = identified(self, found, pose, progress, checkpoint)
        arm, unknown, dynamics, random = known.arm, known.names, known.arm.dynamics, np.random.default_rng(seed)
        places = self.gears.places(np.random.default_rng((seed, 2)), samples)
        rig = _with_found(rig, {n: v for n, v in zip(unknown, known.values, strict=True) if n not in dynamics.names})
        given = None if self.plants is None else _possible(dynamics, rig, self.plants)
        direction, friction = self._load_direction(dynamics), self._friction(rig, unknown)

        def some(rows):
            """Draws (count, K), their f with the load (count, p), whether each is an arm, and the names."""
            count = len(rows)
            values = dict(zip(unknown, known.draw(random, places[rows, :-1]).T, strict=True))
            if given is not None:
                values = dict(zip(dynamics.names, given[rows % len(given)].T, strict=True))
            for name, level in friction.items():
                values[name] = level * (1 + self.friction * random.standard_normal(count))
            values["load"] = random.uniform(self.load[0], self.load[1], count)
            f = np.tile(arm.f, (count, 1))
            for i, name in enumerate(dynamics.names):
                f[:, i] = values.get(name, f[:, i])
            f = f + values["load"][:, None] * direction
            sound = least_inertia_margin(dynamics, rig, f) >= 0
            for name in values:
                sound &= not _NOT_NEGATIVE.match(name) or values[name] >= 0
            return np.column_stack([*values.values()]), f, sound, tuple(values)

        values, f, sound, names = some(np.arange(samples))
        redrawn = 0
        while not sound.all():
            again = np.flatnonzero(~sound)
            redrawn += len(again)
            if redrawn > _PATIENCE * samples:
                raise ValueError(
                    f"draws must be arms; {redrawn} were not (D(q) indefinite, or negative friction), and "
                    f"{samples - len(again)} were. Give a smaller covariance, or identify with a better experiment."
                )
            values[again], f[again], sound[again], _ = some(again)
        if self.phase:
            names += tuple(f"encoder.phase.shift[{i}]" for i in range(rig.n))
            values = np.hstack([values, random.uniform(-0.5, 0.5, (samples, rig.n))])
            encoder = dataclasses.replace(rig.encoder, phase=Phase(shift=(0.0,) * rig.n))
            rig = dataclasses.replace(rig, encoder=encoder)
        if self.delay[1] or self.dropped:
            names += ("transport.delay",)
            values = np.column_stack([values, random.uniform(self.delay[0], self.delay[1], samples)])
            rig = dataclasses.replace(rig, transport=Transport(delay=self.delay[1]))
        own, said = rig, statement(self, rig, known)
        rig = self.gears.prepared(arm, rig, pose)
        gears = self.gears.draw(random, arm, rig, f, pose, places)
        names, values = names + gears.names, np.hstack([values, gears.values])
        varying = np.flatnonzero(np.ptp(values, axis=0) > 0)
        expected = np.zeros_like(values)
        if known.refits is not None:
            expected[:, [names.index(name) for name in unknown]] = known.centres(places[:, :-1])
        return Plants(
            arm=arm, rig=rig, f=f, names=tuple(names[i] for i in varying), values=values[:, varying],
            dropped=float(self.dropped), redrawn=redrawn, seed=seed, own=own, ranges=self.gears,
            derived_names=gears.derived_names, derived=gears.derived, said=said, expected=expected[:, varying],
        )  # fmt: skip

    def _friction(self, rig, unknown):
        """Name -> value of the friction that was not identified."""
        known = dict(zip(rig.number_names(), rig.number_values(), strict=True)) if self.friction > 0 else {}
        names = [name for name in known if name.startswith(("drive.viscous", "drive.coulomb"))]
        return {name: known[name] for name in names if name not in unknown and known[name] > 0}

    def _load_direction(self, dynamics):
        """Change (p,) of f per kg in the hand."""
        if self.load[1] == 0:
            return np.zeros(dynamics.p)
        position = array("load_position", self.load_position, (3,), advice="Give x, y and z in the last frame [m].")
        nothing = [Body(mass=0.0, com=(0, 0, 0)) for _ in range(dynamics.n - 1)]
        return dynamics.f([*nothing, Body(mass=1.0, com=position)])


def _with_found(rig, values):
    """The rig with the values that were identified of its numbers."""
    missing = [name for name in values if name not in rig.number_names()]
    if missing:
        raise ValueError(f"rig must have {missing[0]}, which was identified; it has no such number. Pass found.rig.")
    return rig.filled(values)


def _possible(dynamics, rig, plants):
    """Given arms (M, p), all validated."""
    plants = array(
        "plants", plants, ("M", dynamics.p), advice=f"Give f of one arm per row: {', '.join(dynamics.names)}."
    )
    if not len(plants):
        raise ValueError("plants must hold at least one arm; got none. Give f of one arm per row.")
    wrong = np.flatnonzero(least_inertia_margin(dynamics, rig, plants) < 0)
    if len(wrong):
        raise ValueError(
            f"plants must all be arms; row {wrong[0]} has D(q) below the motors' own inertia. Leave it out."
        )
    return plants
