"""`Uncertainty`: unknown properties of an arm and its rig beside the identified covariance."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ctc.certification.imperfections import IMPERFECTIONS, between
from ctc.verdict import require_swinging
from plant import Part, part, structure
from plant.machine import DAMPING_RATIO
from plant.parts import Piece, Shown, Table, array

# Resonance [Hz] below which no gear of an arm has its own: a lower number is in kHz.
_SOFTEST = 1.0
# Range of the damping ratio unless stated.
_DAMPING = (DAMPING_RATIO, 0.03)
Range = Any  # one number, or the two ends of a range


@part
class Uncertainty(Shown, Part):
    """Distributions of unknown properties of an arm and its rig, for `certify` and `tune`.

    Two numbers are the ends of a range. Samples are uniform in it, and independent for each joint.
    Printing shows a table of what is uncertain.

    Parameters
    ----------
    covariance : (k, k) array_like, optional
        Of ``found.fit.values``, whose distribution is normal; by default ``found.covariance``. If
        an `Arm` takes the place of ``found``, it is the covariance of the arm's f.
    plants : (M, p) array_like, optional
        In place of a covariance: f of given arms, taken in turn.
    friction : float
        Relative standard deviation of every viscous coefficient and Coulomb level; they are normal
        and independent. Those that were identified have their covariance instead.
    load : float or (2,) array_like
        Point mass in the gripper [kg].
    load_position : (3,) array_like, optional
        Of the load, in the frame of the last link's body [m].
    phase : bool
        Whether the encoders' offsets are sampled, uniform in ±1/2 pulse, each on its own.
    delay : float or (2,) array_like
        Of the torque [s], constant during a run; at most one period of the controller.
    dropped : float
        Probability that the counts of a sample do not arrive; the controller then reads the counts
        of the sample before.
    resonance : (2,) or (n, 2) array_like, optional
        Lowest and highest locked-rotor resonance at the reference's first pose [Hz]: one pair for
        all joints alike, or one for each. None for the rig's own gears. It is a range, not a
        distribution: bounds hold for its worst cell of 10 %.
    damping_ratio : float or (2,) array_like, optional
        Of that resonance; 0.01 to 0.03 by default. On rigid gears, of the lowest resonance that the
        verdict names; 0.01 by default.
    backlash : float or (2,) array_like
        Of each gear, joint side [rad]; the gears must have a `resonance`, here or in the rig.
    lag : float or (2,) array_like
        Time constant of the motor currents [s], of all.
    jitter : float or (2,) array_like
        Largest displacement of a sampling instant, as a share of the period.
    friction_drift : float or (2,) array_like
        Relative change of all friction, with a time constant of 1 s; may be negative.
    presliding : float or (2,) array_like
        Distance of `plant.Presliding` [rad of the motor].
    load_friction : float or (2,) array_like
        Friction as a share of the transmitted torque.
    ripple : float or (2,) array_like
        Amplitude of the torque ripple, six cycles per turn of the motor [N m], motor side.
    quadrature : float or (2,) array_like
        Amplitude of the encoder's error within four counts [pulses].
    supply : float or (2,) array_like
        Voltage of each position servo over the stated one, such as (0.9, 1.1). A wrong gain of the
        servo has the same effect.

    Raises
    ------
    ValueError
        Ranges whose ends are not in order; a load without its place.

    See Also
    --------
    ctc.certify, ctc.tune

    Examples
    --------
    >>> from ctc import Uncertainty
    >>> print(Uncertainty(friction=0.02, resonance=(40, 80)))
    uncertain          from, to  unit
    friction               0.02  of each level (standard deviation)
    phase           -0.5 to 0.5  pulses
    resonance          40 to 80  Hz
    damping_ratio  0.01 to 0.03
    """

    covariance: ArrayLike | None = structure(default=None)
    plants: ArrayLike | None = structure(default=None)
    friction: float = structure(float, default=0.1)
    load: Range = structure(default=(0.0, 0.0))
    load_position: ArrayLike | None = structure(default=None)
    phase: bool = structure(bool, default=True)
    delay: Range = structure(default=(0.0, 0.0))
    dropped: float = structure(float, default=0.0)
    resonance: Any = structure(default=None)
    damping_ratio: Range = structure(default=None)
    backlash: Range = structure(default=(0.0, 0.0))
    lag: Range = structure(default=(0.0, 0.0))
    jitter: Range = structure(default=(0.0, 0.0))
    friction_drift: Range = structure(default=(0.0, 0.0))
    presliding: Range = structure(default=(0.0, 0.0))
    load_friction: Range = structure(default=(0.0, 0.0))
    ripple: Range = structure(default=(0.0, 0.0))
    quadrature: Range = structure(default=(0.0, 0.0))
    supply: Range = structure(default=(0.0, 0.0))

    __repr__ = Shown.__repr__

    def __post_init__(self) -> None:
        # 1. Numbers and ranges.
        # Values as they are stored: pairs of numbers in place of one, arrays in place of lists.
        values: dict[str, Any] = {
            name: between(name, getattr(self, name), unit, signed)
            for name, (unit, signed) in _RANGES.items()
        }
        if not 0 <= self.friction <= 1:
            raise ValueError(
                f"friction must be a share from 0 to 1; got {self.friction}. 0.1 is 10 %."
            )
        if not 0 <= self.dropped < 1:
            raise ValueError(
                f"dropped must be from 0 to below 1; got {self.dropped}. Give a probability."
            )
        # A mass without a place has no inertia about any joint.
        if values["load"][1] > 0 and self.load_position is None:
            raise ValueError(f"load_position must be given with a load; got None. {_PLACE}")
        # Given arms already are a distribution.
        if self.covariance is not None and self.plants is not None:
            raise ValueError("one of covariance and plants must be given; got both. Leave one out.")
        # Shapes as far as they are known here: the names of the unknowns come with `found`.
        for name, shape, advice in _ARRAYS:
            if getattr(self, name) is not None:
                values[name] = array(name, getattr(self, name), shape, advice=advice)
        # 2. Gears.
        values["resonance"] = None if self.resonance is None else _pairs(self.resonance)
        damping = self.damping_ratio
        # Stated resonances need a damping.
        if damping is None and self.resonance is not None:
            damping = _DAMPING
        if damping is not None:
            damping = between("damping_ratio", damping, "a ratio")
        values["damping_ratio"] = damping
        # The higher end decides: an overdamped gear has no resonance to be stated.
        require_swinging(max(values["damping_ratio"] or (0.0,)))
        # The part is frozen, and has checked its own values.
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def imperfections(self) -> dict[str, tuple[float, float]]:
        """Name -> (low, high) of every imperfection of gears, drives and encoders."""
        return {name: getattr(self, name) for name in IMPERFECTIONS}

    def _short(self) -> str:
        return ", ".join(name for name, _, _ in self._rows()) or "nothing beside the covariance"

    def _rows(self) -> Iterator[tuple[str, str, str]]:
        """Name, value and unit of each number that is uncertain."""
        for name, _, _ in _ARRAYS[:2]:
            if getattr(self, name) is not None:
                yield name, " x ".join(map(str, getattr(self, name).shape)), "given"
        if self.friction:
            yield "friction", f"{self.friction:g}", "of each level (standard deviation)"
        if self.phase:
            yield "phase", "-0.5 to 0.5", "pulses"
        if self.dropped:
            yield "dropped", f"{self.dropped:g}", "of the samples"
        # A single range is that of all joints: it has no index.
        for i, pair in enumerate(self.resonance or ()):
            yield "resonance" if len(self.resonance) == 1 else f"resonance[{i}]", spread(pair), "Hz"
        if self.resonance is not None:
            yield "damping_ratio", spread(self.damping_ratio), ""
        for name, (unit, _) in _RANGES.items():
            if any(getattr(self, name)):
                yield name, spread(getattr(self, name)), unit

    def _shown(self) -> Iterator[Piece]:
        yield Table(("uncertain", "from, to", "unit"), list(self._rows()), words=(2,))


_RANGES = {"load": ("kg", False), "delay": ("s", False)}
# Name -> unit of each range, and whether it may be negative.
_RANGES |= {name: (row.unit, row.signed) for name, row in IMPERFECTIONS.items()}

_PLACE = "Give x, y and z in the last frame [m]."
_ARRAYS: tuple[tuple[str, tuple[int | str | None, ...], str], ...] = (
    ("covariance", ("k", "k"), "Give one row per name of found.fit.unknown."),
    ("plants", ("M", "p"), "Give f of one arm per row."),
    ("load_position", (3,), _PLACE),
)


def spread(ends: tuple[float, float]) -> str:
    """A range in words."""
    return f"{ends[0]:g}" if ends[0] == ends[1] else f"{ends[0]:g} to {ends[1]:g}"


def _pairs(resonance: Any) -> tuple[tuple[float, float], ...]:
    """Ends of each range of resonances: of one for all joints, or of one for each."""
    # As objects: rows of different lengths have a message of their own below.
    entries = np.array(resonance, dtype=object)
    if entries.ndim == 0 or not entries.size:
        raise ValueError(
            f"resonance must be (lowest, highest) [Hz]; got {resonance!r:.60}. Give a range."
        )
    # One pair is a range for all joints alike.
    pairs = [resonance] if entries.ndim == 1 else resonance
    pairs = array("resonance", pairs, ("m", 2), advice="Give the lowest and the highest [Hz].")
    good = (pairs[:, 0] > 0) & (pairs[:, 0] <= pairs[:, 1])
    if not good.all():
        low, high = pairs[~good][0]
        raise ValueError(
            f"resonance must be (lowest, highest), above 0 Hz; got ({low:g}, {high:g}). Swap or"
            " correct."
        )
    # A unit of kHz is the usual mistake.
    if pairs[:, 0].min() < _SOFTEST:
        soft = f"got {pairs.min():g}. No gear is so soft: is it in kHz?"
        raise ValueError(f"resonance must be {_SOFTEST:g} Hz or more; {soft}")
    return tuple(map(tuple, pairs.tolist()))
