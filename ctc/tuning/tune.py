"""The quietest law that keeps its limit over what is stated to be uncertain."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.certification.certify import certify
from ctc.certification.samples import draw
from ctc.certification.uncertainty import Uncertainty
from ctc.tuning.families import families
from ctc.tuning.search import ROUNDS, Tunings
from ctc.tuning.tuning import Trial, Tuning
from ctc.verdict.on_gears import SETTLED
from identification import Identification, IdentificationWarning
from identification.results.summary import warn_of_doubts
from plant import Arm, Reference, Rig
from plant.parts.arguments import instance, known_options, real
from plant.parts.checkpoint import Checkpoint
from plant.parts.progress import progress_bar
from plant.simulation.threads import cores

_PLANTS, _MORE, _FRESH = 16, 80, 2000
"""Plants with which a search begins; with how many if some may leave; and others on which its best are checked."""

_GENERATIONS = sum(generations for generations, _ in ROUNDS)


@known_options
def tune(
    found: Identification | Arm, rig: Rig, reference: Reference, uncertainty: Uncertainty | None = None, *,
    within: float = 1, allowed: float = 0.0, after: float = SETTLED, samples: int = 10_000, seed: int = 0,
    duration: float | None = None, threads: int | None = None, progress: bool = True,
    checkpoint: str | Path | None = None,
) -> Tuning:  # fmt: skip
    """Find the quietest law that keeps its limit over the stated uncertainty.

    Of computed torque with observer, computed torque with a PID that rolls off, feed-forward with PD and, along a
    `LinkReference` of identified gears, flexible-joint computed torque with PD, tunings are searched by the genetic
    algorithm on plants drawn from the uncertainty, and the best are tried on fresh ones. Quiet is a small mean change
    of the torque from sample to sample.

    Parameters
    ----------
    found : Identification or Arm
        The model of the laws, and where the plants are drawn; an arm needs its `covariance` or `plants`. With a
        `resonance`, an identification on rigid gears is fitted again on such gears: the laws have the f of the middle.
    rig : Rig
        Of the plants, such as ``found.rig``.
    reference : Reference
    uncertainty : Uncertainty, optional
        What is not known, as for `certify`.
    within : float
        Limit of the counted error [pulses].
    allowed : float
        Share of the plants that may leave the limit, such as 0.05, for less chatter. So few of the fresh plants leave
        that of a law given beforehand 95 % confidence would follow; it was chosen on them, so the certificate, on
        plants of its own, is the verdict.
    after : float
        Samples before this time do not count [s].
    samples : int
        Plants of the certificate.
    seed : int
        Same seed, same result, to the bit, on any number of threads.
    duration : float, optional
        [s]; by default one period of the reference.
    threads : int, optional
        By default one per core.
    progress : bool
        Show a progress bar, where standard error is a terminal.
    checkpoint : str or Path, optional
        File in which what has been tried is kept, as of `certify`.

    Returns
    -------
    Tuning
        ``.law``, the table of all families in ``.table``, and the law's ``.certificate``. Where no law holds, that
        which loses the fewest plants.

    Raises
    ------
    ValueError
        Bad input.

    Notes
    -----
    On two free cores one to three minutes along path (6), of 3.65 s (160 s of one core on average,
    tests/benchmarks/tuning.py), in proportion to `duration`; before, the fits of `certify` where it has some.

    See Also
    --------
    ctc.certify, ctc.ComputedTorque

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import identify
    >>> from ctc import Uncertainty, tune
    >>> path = puma560.reference()
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), path)
    >>> found = identify(puma560.dynamics(), record, progress=False)
    >>> stated = Uncertainty(friction=0.02)
    >>> tuning = tune(found, found.rig, path, stated, samples=8, duration=0.1, progress=False)
    >>> print(tuning.law.bandwidth > 0, tuning.certificate.failures)
    True 0
    """
    instance("rig", rig, Rig, "The order is found, rig, reference, uncertainty.")
    instance("reference", reference, Reference, "The order is found, rig, reference, uncertainty.")
    if not real("within", within, "Give pulses, such as 1.") > 0:
        raise ValueError(f"within must be positive; got {within:g}. The promise is 1 pulse.")
    if not 0 <= real("allowed", allowed, "Give a share, such as 0.05.") < 1:
        raise ValueError(f"allowed must be from 0 to below 1; got {allowed:g}. Give a share, such as 0.05.")
    duration = reference.duration if duration is None else duration
    stated = Uncertainty() if uncertainty is None else uncertainty
    instance("uncertainty", stated, Uncertainty, "Give Uncertainty(friction=0.1, ...).")
    stated.require_followed(rig.period / 4)
    if isinstance(found, Identification):
        warn_of_doubts(found, "tune")
    pose = reference(np.zeros(1)).q[0]

    def inputs() -> dict[str, Any]:
        return {
            "identification": found, "rig": rig, "reference": reference, "seed": seed,
            "uncertainty": stated, "settings": (within, float(allowed), after, duration),
        }  # fmt: skip

    kept = Checkpoint(checkpoint, "tune").bind(inputs)
    searching, fresh = (
        draw(stated, found, rig, count, seed + i, pose, progress, kept)
        for i, count in enumerate((_MORE if allowed else _PLANTS, _FRESH))
    )
    arm, scale = fresh.arm, _scale(fresh.arm, fresh.rig, reference, float(duration))
    threads = int(threads or cores())
    options = {"within": within, "duration": duration, "after": after}
    laws, trials = families(arm, fresh.own, reference), list[Trial]()
    with (
        kept,
        progress_bar(len(laws) * _GENERATIONS, "tune", "generation", progress) as bar,
    ):
        for i, family in enumerate(laws):
            bar.set_postfix_str(family.name)
            tunings = Tunings(
                family=family, plants=fresh, reference=reference, options=options, scale=scale, threads=threads,
                allowed=float(allowed), checkpoint=kept.part(family.name),
            )  # fmt: skip
            safe = min((trial.noise for trial in trials if trial.holds), default=np.inf)
            trials.append(tunings.best(searching.numbers()[1], seed, bar.update, safe))
            bar.update((i + 1) * _GENERATIONS - bar.n)
    best = min(trials, key=lambda trial: trial.rank)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentificationWarning)  # said by tune
        certificate = certify(
            found, rig, best.law, reference, stated, samples=samples, seed=seed + 2, within=within, after=after,
            threads=threads, duration=duration, progress=progress, checkpoint=kept.part("certificate"),
        )  # fmt: skip
    return Tuning(law=best.law, trials=tuple(trials), certificate=certificate, fresh=_FRESH)


def _scale(arm: Arm, rig: Rig, reference: Reference, duration: float) -> NDArray[np.float64]:
    """Torque [N m] of each joint that its chatter is compared to: root mean square along the reference."""
    motion = reference(np.linspace(0, duration, 200))
    torque = [arm.inverse(*row) for row in zip(motion.q, motion.qd, motion.qdd, strict=True)]
    torque = np.array(torque) - rig.spring_torque(motion.q)
    return np.sqrt(np.mean(np.square(torque), axis=0))
