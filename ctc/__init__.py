"""Computed torque: from an identified arm to a controller, and to a verdict in encoder pulses.

Reading order: `model_law` (what all laws with an arm share) -> `observer` (what the encoder tells of the tracking
error) -> `computed_torque` (the law, Fig. 2) -> its rivals `feed_forward`, `computed_torque_integral`, `adaptive`,
`sliding_mode` -> `evaluation` (the verdict) -> `comparison` (of several laws) -> `certify` (the verdict over what is
not known: `uncertainty`, `plants`, `population`, `certificate`, `sensitivity`, `reserves`) -> `error_loop`, `margins`,
`design` (the loop linearised, how far it is from instability, gains for it) -> `plots`, `certificate_figure` (figures).
``python -m ctc`` runs the paper from end to end.
"""

from importlib.util import find_spec
from pathlib import Path

_home = Path(__file__).resolve().parent.parent
for _name in ("plant", "identification"):
    _found = find_spec(_name)
    if _found is None or _found.origin is None or Path(_found.origin).resolve().parent.parent != _home:
        raise ImportError(
            f"package {_name!r} must be beside {_home / 'ctc'}; it would be imported from "
            f"{_found.origin if _found else 'nowhere'}. Uninstall the other distribution, or put {_home} first."
        )

from ctc.adaptive import Adaptive  # noqa: E402
from ctc.certificate import Certificate, clopper_pearson  # noqa: E402
from ctc.certify import certify  # noqa: E402
from ctc.comparison import Comparison, compare  # noqa: E402
from ctc.computed_torque import ComputedTorque  # noqa: E402
from ctc.computed_torque_integral import ComputedTorqueIntegral  # noqa: E402
from ctc.error_loop import error_loop  # noqa: E402
from ctc.evaluation import Evaluation, evaluate  # noqa: E402
from ctc.feed_forward import FeedForward, PDGravity  # noqa: E402
from ctc.margins import Margins, margins  # noqa: E402
from ctc.sliding_mode import SlidingMode  # noqa: E402

__all__ = [
    "Adaptive", "Certificate", "Comparison", "ComputedTorque", "ComputedTorqueIntegral", "Evaluation", "FeedForward",
    "Margins", "PDGravity", "SlidingMode", "certify", "clopper_pearson", "compare", "error_loop", "evaluate", "margins",
]  # fmt: skip
