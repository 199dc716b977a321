"""The linearised error loop of each joint under a sampled law: stability margins, and gains by
design.

Read `margins`; `design` (gains and observers) stands alone.
"""

from ctc.stability.design import motor_gain
from ctc.stability.margins import opened

__all__ = ["motor_gain", "opened"]
