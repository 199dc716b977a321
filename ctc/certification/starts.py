"""Starts from a hold: the controller has held the arm, and static friction may carry anything within its cone."""

import dataclasses
from typing import Any

import numpy as np

from plant import Resumed
from plant.simulation.population import Population

_AT_REST = 1.0  # pulses/s


def held(certificate: Any, samples: int) -> Any:
    """The certificate of the first samples, each from a hold: the disturbance torque is what the model lacks at rest,
    and of Coulomb friction any share from -1 to 1, uniform, of each joint.
    """
    law, path, arm = certificate.law, certificate.reference, certificate.plants.arm
    if isinstance(samples, bool) or not isinstance(samples, int) or not 1 <= samples <= len(certificate.plants):
        most = len(certificate.plants)
        raise ValueError(f"samples must be a whole number from 1 to {most}; got {samples!r}. Sample more.")
    errors = law.torque_errors(arm.n) if hasattr(law, "torque_errors") else ()
    if not errors:
        name = type(law).__name__
        raise ValueError(f"the controller must learn a disturbance torque; {name} does not. Use ComputedTorque.")
    motion = path(np.zeros(1))
    if np.abs(certificate.plants.rig.position_in_pulses(motion.qd[0])).max() > _AT_REST:
        raise ValueError(f"the path must begin at rest; this one begins with {motion.qd[0]} rad/s. Take another.")
    plants, still = certificate.plants.first(samples), np.zeros(arm.n)
    shares = np.random.default_rng((plants.seed, 3)).uniform(-1, 1, (samples, arm.n))
    drive, weight = plants.rig.drive, np.asarray(arm.dynamics.Y(motion.q[0], still, still))
    friction = [drive.coupling.joint_torque(row) for row in shares * drive.joint_coulomb()]
    lacking = (plants.f - law.arm.f) @ weight.T + friction
    names, values = plants.numbers()
    resumed = Resumed(law=law, state=law.initial_state(arm.n))
    options = {name: certificate.settings[name] for name in ("steps_per_sample", "duration", "after")}
    runs = Population(
        arm, plants.rig, resumed, path, (*names, *(f"law.state[{i}]" for i in errors[0])),
        np.hstack([values, lacking]), within=certificate.within, lost=plants.lost if plants.dropped else None,
        **options,
    ).run(certificate.threads)  # fmt: skip
    return dataclasses.replace(certificate, plants=plants, runs=runs)
