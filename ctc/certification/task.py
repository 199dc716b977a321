"""What `certify` and `tune` have in common: their arguments checked, the motions by name, the samples."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ctc.certification.plants import Plants
from ctc.certification.samples import draw
from ctc.certification.uncertainty import Uncertainty
from ctc.verdict.on_gears import require_followed
from identification import Identification
from identification.results.summary import warn_of_doubts
from plant import Arm, Law, Reference, Rig
from plant.compiler.background import cores
from plant.motion.everyday import motions_of, naming
from plant.parts.arguments import instance, real, whole
from plant.parts.checkpoint import Checkpoint

Motions = Reference | Mapping[str, Reference]


class Task:
    """Arguments of `certify` and `tune`, `work`, checked; `laws` are those that the user gave.

    `motions` is name -> (reference, duration [s]); a reference alone has the name "". `checkpoint` is bound to all that
    decides the result, and `settings` of the work.
    """

    def __init__(
        self, work: str, found: Identification | Arm, rig: Rig, laws: tuple[Law, ...], reference: Motions,
        uncertainty: Uncertainty | None, *, within: float, after: float | None, duration: float | None, samples: int,
        seed: int, threads: int | None, progress: bool, checkpoint: str | Path | Checkpoint | None,
        steps_per_sample: int, executor: Any, settings: tuple[Any, ...] = (), inputs: Mapping[str, Any] = {},
    ) -> None:  # fmt: skip
        if executor is not None and checkpoint is not None:
            raise ValueError("checkpoint must be left out with an executor; got both. Or use campaign(folder=).")
        order = f"The order is found, rig, {'law, ' if laws else ''}reference, uncertainty."
        instance("rig", rig, Rig, order)
        for law in laws:
            if instance("law", law, Law, order).replays:
                raise ValueError(f"the law must be a controller; {type(law).__name__} repeats a log. Use another.")
        motions = motions_of(getattr(found, "arm", found), rig, reference, order)
        whole("samples", samples, "Leave it out.")
        self.seed = whole("seed", seed, "Leave it out.", least=0)
        self.threads = cores() if threads is None else whole("threads", threads, "Leave it out.")
        self.within = real("within", within, "Give pulses, such as 1.")
        self.motions = dict[str, tuple[Reference, float]]()
        for name, motion in motions.items():
            lasts = motion.duration if duration is None else duration
            with naming(name):
                lasts = real("duration", lasts, "Leave it out for one period of the reference.", positive=True)
                if after is not None and not 0 <= real("after", after, "Give seconds, or 0.") < lasts:
                    raise ValueError(
                        f"after must be from 0 to below the duration {lasts:g} s; got {after:g}. Give less."
                    )
            self.motions[name] = motion, lasts
        self.uncertainty = Uncertainty() if uncertainty is None else uncertainty
        instance("uncertainty", self.uncertainty, Uncertainty, "Give Uncertainty(friction=0.1, ...).")
        if self.uncertainty.resonance is not None:
            require_followed("resonance", self.uncertainty.resonance, rig.period / steps_per_sample)
        if isinstance(found, Identification):
            warn_of_doubts(found, work)
        self.found, self.rig, self.progress, self.several = found, rig, progress, isinstance(reference, Mapping)
        self.first = next(iter(motions.values()))
        inputs = {
            "identification": found, "rig": rig, **inputs, "reference": motions if self.several else reference,
            "seed": self.seed, "uncertainty": self.uncertainty,
            "settings": (self.within, steps_per_sample, duration, after, *settings),
        }  # fmt: skip
        self.checkpoint = Checkpoint(checkpoint, work).bind(lambda: inputs)

    def sampled(self, count: int, further: int = 0, normals: Any = None) -> Plants:
        """Monte Carlo samples, the same for all motions; resonances are those at the pose where the first begins."""
        pose = self.first(np.zeros(1)).q[0]
        return draw(
            self.uncertainty, self.found, self.rig, int(count), self.seed + further, pose, self.progress,
            self.checkpoint, normals,
        )  # fmt: skip
