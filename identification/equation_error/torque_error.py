"""Error of a torque that an arm and its rig predict along a log: one metric for every fit.

Both sides of the torque equation pass the same low-pass, whose band is stated, and all rows count
unless a least speed is stated: a fit may choose its band and its rows, and errors of different fits
could not be compared in those. Near standstill friction carries anything up to its level, so that
no model of the arm explains the torque there.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error.filters import BAND_MOST, CUTOFF, derivatives
from identification.equation_error.regressor import Filtering, compared, regressor_along
from identification.equation_error.torque_logs import TorqueLog, torque_logs
from plant import Arm, Rig
from plant.parts import (
    Floats,
    Frozen,
    Piece,
    Shown,
    Table,
    Verdict,
    array,
    frozen,
    heading,
    norm,
    real,
    with_units,
)

# Band [Hz] where none is stated, or less where the sample rate carries less: joints move slower,
# and what is faster is vibration. The same for all fits.
BAND = 10.0

# Further columns, and their values.
Further = Mapping[str, tuple[Callable[..., ArrayLike], float]]


@frozen
class TorqueError(Shown, Frozen):
    """Measured less predicted torques of a log, or of several together.

    Attributes
    ----------
    joints : tuple of str
    units : tuple of str
        Of each joint's torque: N m, or N of a slide.
    rms : (n,) numpy.ndarray
        Root mean square of each joint's error, in its unit; NaN of a joint whose torque was
        not measured.
    relative : (n,) numpy.ndarray
        Length of each joint's error over that of its measured torque.
    total : float
        The same of all joints together.
    band : float
        Of the low-pass that both sides passed [Hz].
    rows : int
        Rows that were compared: all but those at the ends of a log and beside its gaps.
    least_speed : (n,) numpy.ndarray
        Speed [rad/s] below which a joint does not count in a row.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    rms: Floats
    relative: Floats
    total: float
    band: float
    rows: int
    least_speed: Floats

    def _short(self) -> str:
        return f"{self.total:.2%} of the torque, {self.rows} rows, band {self.band:.3g} Hz"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(f"error {self._short()}", None)
        yield self.table

    @property
    def table(self) -> Table:
        """A row per joint."""
        # Where joints turn and slide, each size has its unit.
        sizes = with_units([f"{rms:.3g}" for rms in self.rms], self.units)
        rows = [
            (joint, f"{relative:.2%}", size)
            for joint, relative, size in zip(self.joints, self.relative, sizes, strict=True)
            if np.isfinite(relative)
        ]
        return Table(("error of the torque", "relative", heading("rms", self.units)), rows)


class Machine(Protocol):
    """An arm with the friction and the springs of its rig, and further columns of its torque."""

    @property
    def arm(self) -> Arm: ...

    @property
    def rig(self) -> Rig: ...

    @property
    def further(self) -> Further: ...


class PredictsTorque:
    """A result with an arm and its rig, whose torque is compared with logs."""

    @property
    def further(self) -> Further:
        """Further columns, and their values."""
        return {}

    def error_on(
        self: Machine,
        q: Any,
        torque: Any = None,
        *,
        rig: Rig | None = None,
        band: float | None = None,
        least_speed: ArrayLike = 0.0,
    ) -> TorqueError:
        """Error of the torque on other logs, joint by joint, over all rows; gears are rigid.

        Parameters
        ----------
        q, torque, rig
            Records, or positions with torques and their rig, as `fit_torque` takes them.
        band : float, optional
            In which torques are compared [Hz]; by default 10, or less where the sample rate carries
            less: the same for all fits, whatever their own band is.
        least_speed : float or (n,) array_like, optional
            Joint speed [rad/s] below which a joint does not count: near standstill friction carries
            anything up to its level.

        Returns
        -------
        TorqueError

        Raises
        ------
        ValueError
            Bad input; a band that the sample rate does not carry; a log without rows away from its
            ends and gaps.
        """
        return torque_error(self.arm, self.rig, q, torque, rig, band, self.further, least_speed)


def torque_error(
    arm: Arm,
    rig: Rig,
    q: Any,
    torque: Any = None,
    stated: Rig | None = None,
    band: float | None = None,
    further: Further | None = None,
    least_speed: ArrayLike = 0.0,
) -> TorqueError:
    """Error of the torque of an arm with the friction and the springs of this rig.

    `q`, `torque`, `stated`: records, or positions with torques and the rig of the log, as
    `fit_torque` takes them. `further`: further columns, and their values. `least_speed`: one, or
    one per joint [rad/s].
    """
    logs = torque_logs(arm.dynamics, q, torque, stated)
    return error_of_logs(arm, rig, logs, band, further or {}, least_speed)


def error_of_logs(
    arm: Arm,
    rig: Rig,
    logs: Sequence[TorqueLog],
    band: float | None = None,
    further: Further | None = None,
    least_speed: ArrayLike = 0.0,
) -> TorqueError:
    """The same of logs."""
    # All logs are compared in one band, which the slowest of them must carry.
    most = min(BAND_MOST / log.rig.period for log in logs)
    band = min(BAND, most) if band is None else real("band", band, "Give Hz.", positive=True)
    if band > most:
        raise ValueError(
            f"band must be at most {most:.3g} Hz at this sample rate; got {band:g}. Lower it."
        )
    slowest = array(
        "least_speed",
        np.broadcast_to(least_speed, arm.n),
        (arm.n,),
        advice="Give one speed, or one per joint [rad/s].",
    )
    compared_logs = (_of_log(arm, rig, log, band, further or {}, slowest) for log in logs)
    # Logs count by their rows.
    measured, error = zip(*compared_logs, strict=True)
    length, residual = np.concatenate(measured), np.concatenate(error)
    # Joints whose torque was measured in some log; rows of a log without it are NaN.
    squares, count = np.nansum(residual**2, axis=0), np.isfinite(residual).sum(axis=0)
    seen = count > 0
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = np.sqrt(squares / np.nansum(length**2, axis=0))
        rms = np.sqrt(squares / count)
    present = np.isfinite(residual)
    return TorqueError(
        joints=tuple(arm.dynamics.chain.joint_labels),
        units=tuple(arm.dynamics.chain.effort_units),
        rms=np.where(seen, rms, np.nan),
        relative=np.where(seen, relative, np.nan),
        total=float(norm(residual[present]) / norm(length[present])),
        band=band,
        rows=len(residual),
        least_speed=slowest,
    )


def _of_log(
    arm: Arm, rig: Rig, log: TorqueLog, band: float, further: Further, slowest: Floats
) -> tuple[Floats, Floats]:
    """Measured torque and error (N', n) in a band; NaN of a joint that does not count."""
    dynamics = arm.dynamics
    # The low-pass before differentiation is wider than the band, so that it shapes nothing in it.
    motion = derivatives(log.q, log.rig.period, CUTOFF * band)
    columns, known = regressor_along(dynamics, rig, dynamics.names, motion, loading=arm.f)
    # Bodies and friction are linear in f; springs and friction under load are known.
    predicted = (columns * arm.f).sum(axis=2) + known
    for column, value in further.values():
        predicted = predicted + value * np.asarray(column(*motion))
    # A column that was not measured would spread its NaN through the filter.
    missing = np.isnan(log.torque).all(axis=0)
    filtering = Filtering(CUTOFF * band, band, 1, slowest)
    system = compared(
        [np.where(missing, 0.0, log.torque), predicted],
        motion.qd,
        log.rig.period,
        filtering,
        log.valid,
    )
    used = system.used & ~missing
    # A row counts if it tells of any joint.
    rows = used.any(axis=1)
    if not rows.any():
        raise ValueError(
            "some rows must be faster than least_speed, and away from the ends of the log and from"
            f" gaps; none of {len(log.q)} is at {band:g} Hz. Log longer, or give a wider band."
        )
    measured = np.where(used[rows], system.torque[rows], np.nan)
    return measured, measured - system.regressor[rows, :, 0]
