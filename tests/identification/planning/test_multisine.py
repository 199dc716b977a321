"""Multisines for frequency responses: within every limit, at the stated lines, of low crest
factor, orthogonal.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest

from identification import design_motion
from plant import puma560

ARM, RIG = puma560.arm(), puma560.rig()
LIMITS = {"position": ((0.1, 0.5), (-0.6, -0.2)), "velocity": (0.4, 0.3), "acceleration": (40, 60)}
WANTED = (1.4, 3.1, 4.9, 10.0, 22.0)


@cache
def motions():
    return design_motion(ARM, RIG, kind="multisine", period=1.4, frequencies=WANTED, **LIMITS)


def test_they_keep_every_limit_and_reach_one():
    t, limits = (
        np.linspace(0, 1.4, 3001),
        [np.array(LIMITS[name]) for name in ("velocity", "acceleration")],
    )
    low, high = np.array(LIMITS["position"]).T
    room = (high - low) / 2
    shares = []
    for each in motions():
        q, *faster = each(t)
        shares += [np.abs(q - (low + high) / 2).max(axis=0) / room]
        shares += [np.abs(x).max(axis=0) / limit for x, limit in zip(faster, limits, strict=True)]
        shares += [each.torque_share(ARM, RIG) / 0.8]
    # up to 0.1 %: of what lies between the samples of the design
    assert 0.98 < np.max(shares) < 1.002


def test_weak_drives_get_a_smaller_motion_at_the_same_lines():
    weak = dataclasses.replace(
        RIG, drive=dataclasses.replace(RIG.drive, current_limit=RIG.drive.current_limit * 0.8)
    )
    smaller = design_motion(ARM, weak, kind="multisine", period=1.4, frequencies=WANTED, **LIMITS)
    assert max(each.torque_share(ARM, weak).max() for each in smaller) == pytest.approx(
        0.8, rel=2e-3
    )
    assert (
        np.abs(smaller[0].cosine).max(axis=1) < 0.9 * np.abs(motions()[0].cosine).max(axis=1)
    ).any()


def test_lines_are_the_nearest_that_share_no_factor_with_the_joints():
    for each in motions():
        lines = [
            np.flatnonzero(np.hypot(c, s)) + 1 for c, s in zip(each.cosine, each.sine, strict=True)
        ]
        for found in lines:
            # odd: 2, 4.3, 6.9, 14 and 30.8 of 1 / 1.4 s
            np.testing.assert_array_equal(found, [1, 5, 7, 13, 31])


def test_the_crest_factor_is_lower_than_schroeders():
    velocity = motions()[0](np.linspace(0, 1.4, 3001)[:-1]).qd
    crest = np.abs(velocity).max(axis=0) / velocity.std(axis=0)
    phase = -np.pi * np.arange(5) ** 2 / 5
    angle = 2 * np.pi * np.outer(np.arange(3000) / 3000, [1, 5, 7, 13, 31]) + phase
    schroeder = np.cos(angle).sum(axis=1)
    assert crest.max() < 0.9 * np.abs(schroeder).max() / schroeder.std()


def test_records_are_orthogonal_at_every_line():
    E = np.stack(
        [np.array(each.cosine) - 1j * np.array(each.sine) for each in motions()], axis=2
    )  # (n, lines, records)
    for line in np.flatnonzero(np.abs(E).max(axis=(0, 2))):
        gram = E[:, line] @ E[:, line].conj().T
        assert abs(gram[0, 1]) < 1e-12 * abs(gram[0, 0])


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"frequencies": (0.0, 3.0)}, "frequencies must be positive"),
        ({"frequencies": (800.0,)}, "below half the sampling rate, 714.3 Hz"),
        ({"frequencies": ()}, "frequencies must be"),
        ({"kind": "chirp"}, "kind must be one of"),
        (
            {"kind": "parameters"},
            'frequencies is for kind="multisine"; got it for kind="parameters"',
        ),
        ({"law": puma560.p_law()}, 'law is for kind="parameters"; got it for kind="multisine"'),
        ({"harmonics": 5}, 'harmonics is for kind="parameters"; got it for kind="multisine"'),
        ({"starts": 3}, 'starts is for kind="parameters"; got it for kind="multisine"'),
        ({"seed": 0}, 'seed is for kind="parameters"; got it for kind="multisine"'),
        ({"iterations": 9}, 'iterations is for kind="parameters"; got it for kind="multisine"'),
        ({"executor": list}, 'executor is for kind="parameters"'),
    ],
)
def test_bad_input_is_refused_in_one_line(change, why):
    with pytest.raises(ValueError, match=why) as error:
        design_motion(
            ARM,
            RIG,
            **{"kind": "multisine", "frequencies": WANTED, "period": 1.4, **LIMITS} | change,
        )
    assert "\n" not in str(error.value)


def test_a_pose_that_the_drives_cannot_hold_is_refused():
    weak = dataclasses.replace(
        RIG, drive=dataclasses.replace(RIG.drive, current_limit=RIG.drive.current_limit / 40)
    )
    with pytest.raises(ValueError, match="drives hold the arm with torque to spare"):
        design_motion(ARM, weak, kind="multisine", period=1.4, frequencies=WANTED, **LIMITS)
