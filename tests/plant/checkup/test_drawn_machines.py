"""Right logs of drawn machines: no check ends with an error, and a lag accuses nothing."""

import pytest
from random_rigs import drawn


def test_a_joint_that_rests_ends_no_check():
    """Its error is one number throughout."""
    assert drawn(71).record.check().causes == ()


SEEDS = [19, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 11, 21, 26))]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_loop_that_lags_has_the_right_scale(seed):
    """A cascade follows as a low-pass does: its counts go less far than the reference."""
    assert drawn(seed).record.check().causes == ()


@pytest.mark.parametrize("seed", [20, 59, pytest.param(77, marks=pytest.mark.slow)])
def test_what_springs_hold_and_fast_hardware_reads_accuses_nothing(seed):
    """A soft loop follows at another scale; fast hardware reads its counter beside the log's."""
    assert drawn(seed).record.check().causes == ()
