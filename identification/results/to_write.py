"""What is to be written into a model file: the arm, its bodies and rotors, the drive whose friction is known."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from identification.results.identification import Identification
from identification.results.physical import Physical
from identification.results.realised import Realised, realised
from plant import Arm, Body, Drive
from plant.mechanics.model_tree import ModelFile
from plant.parts.user_warning import warn

_RIDGE = 1e-9
"""Share of the largest variance that is added to all: a number kept fixed has no variance."""


def prior_bodies(
    prior: str | Path | Mapping[str, Body] | None, read: Callable[[str | Path], ModelFile]
) -> Mapping[str, Body]:
    """Bodies by link."""
    if prior is None:
        return {}
    if isinstance(prior, Mapping):
        return prior
    return {name: body for name, body in read(prior).bodies.items() if body is not None}


def given(found_or_arm: Identification | Physical | Arm, friction: bool) -> tuple[Arm, Drive | None]:
    """The arm, and the drive whose friction is to be written."""
    if isinstance(found_or_arm, Identification):
        return found_or_arm.arm, found_or_arm.rig.drive if friction else None
    arm = found_or_arm.arm if isinstance(found_or_arm, Physical) else found_or_arm
    if not isinstance(arm, Arm):
        got = type(found_or_arm).__name__
        raise ValueError(f"found_or_arm must be what identify gave, or an Arm; got a {got}. Pass found, or found.arm.")
    return arm, None


def bodies_of(
    found_or_arm: Identification | Physical | Arm,
    arm: Arm,
    model: ModelFile,
    prior: Mapping[str, Body],
    nearest: bool,
    armature: NDArray[np.float64],
) -> Realised:
    """What is to be written, or a refusal."""
    rotors, scale = armature, None
    if isinstance(found_or_arm, Identification):
        stated = found_or_arm.rig.drive.reflected_inertia()
        rotors, scale = np.where(stated > 0, stated, rotors), _whitening(found_or_arm)
    elif arm.dynamics.chain.bodies:
        stated = np.array([body.rotor for body in arm.dynamics.chain.bodies])
        rotors = np.where(stated > 0, stated, rotors)
    if isinstance(found_or_arm, Physical):
        rotors = np.array([body.rotor for body in found_or_arm.bodies])
    got = realised(arm, model, rotors, prior, scale)
    if got.exact:
        return got
    difference = got.f - arm.f
    names = arm.dynamics.names
    text = ", ".join(f"{names[i]} {difference[i]:+.3g}" for i in np.argsort(-np.abs(difference))[:4])
    unmet = "no bodies with positive density, and no rotors, were found to have these f"
    if not nearest:
        raise ValueError(f"f must be what bodies can have; {unmet}: the nearest differ by {text}. Pass nearest=True.")
    warn(f"{unmet}; written are the nearest, which differ by {text}.")
    return got


def _whitening(found: Identification) -> NDArray[np.float64] | None:
    """W with W C W' = 1, C the covariance of f; None without one."""
    if found.covariance is None:
        return None
    names, unknown = found.arm.dynamics.names, found.unknown
    if not all(name in unknown for name in names):
        return None
    rows = [unknown.index(name) for name in names]
    covariance = np.asarray(found.covariance)[np.ix_(rows, rows)]
    ridge = _RIDGE * np.diag(covariance).max() * np.eye(len(rows))
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance + ridge)))
