"""Computed torque: from an identified arm to a controller, and its error in encoder pulses.

Arm + Rig -> Law, which the plant, or a real arm, can run. The rooms, each above all that it
imports:

=============== ====================================================================================
`commandline`   ``onepulse check | identify | certify | campaign | report | robots | demo``
`campaigns`     `campaign`: many tasks, one machine or many; `Fleet`: many robots over weeks
`report`        `write_report`: an identification and its controller as one page
`tuning`        `tune`: the controller of least chatter that keeps a limit over stated uncertainty
`learning`      `learn`: the torque that was missing along a path, from repetitions of it
`certification` `certify`: probability of exceeding a pulse limit under parameter uncertainty
`stability`     the error loop linearised, its margins, gains by design (python-control)
`verdict`       `evaluate` one arm under one controller, `compare` several, animate
`payload`       a load in the gripper, identified and taken into the model while the arm runs
`laws`          computed torque (observer, PID), feed-forward, adaptive ...
`figures`       figures of records and results, in one style
=============== ====================================================================================

``onepulse demo``, or ``python -m ctc``, runs the paper from end to end.
"""

from importlib.util import find_spec
from pathlib import Path

# The three packages come from one distribution and have no versions of their own: another copy of
# `plant` or `identification` on the path would be mixed with this one in silence.
_home = Path(__file__).resolve().parent.parent
for _name in ("plant", "identification"):
    # Without importing it: a wrong copy must not run before it is refused.
    _found = find_spec(_name)
    if (
        _found is None
        or _found.origin is None
        or Path(_found.origin).resolve().parent.parent != _home
    ):
        raise ImportError(
            f"package {_name!r} must be beside {_home / 'ctc'}; it would be imported from"
            f" {_found.origin if _found else 'nowhere'}. Uninstall the other distribution, or put"
            f" {_home} first."
        )

# After that check, since all of them import both packages. From the rooms' own modules, so that the
# public names have one place each.
from ctc.campaigns.campaign import campaign
from ctc.campaigns.fleet import Fleet
from ctc.certification.certificate import Certificate
from ctc.certification.certify import certify
from ctc.certification.uncertainty import Uncertainty
from ctc.figures.errors import plot_record
from ctc.laws.adaptive import Adaptive
from ctc.laws.computed_torque import ComputedTorque
from ctc.laws.computed_torque_pid import ComputedTorquePID
from ctc.laws.computed_torque_settings import ComputedTorqueSettings
from ctc.laws.default_gains import DefaultGainSettings
from ctc.laws.feed_forward import FeedForward, PDGravity
from ctc.laws.float import Float, FloatSettings
from ctc.laws.sliding_mode import SlidingMode
from ctc.learning.learn import learn
from ctc.learning.learnt_torque import LearntTorque
from ctc.learning.settings import LearnSettings
from ctc.payload.estimator import PayloadEstimator
from ctc.report.report import write_report
from ctc.stability.design import motor_gain, observer_gains, pid_gains
from ctc.stability.margins import error_loop, margins
from ctc.tuning.tune import tune
from ctc.verdict.animation import animate, plot_arm
from ctc.verdict.evaluation import Evaluation
from ctc.verdict.evaluations import compare, evaluate
from ctc.verdict.floating import FloatVerdict, evaluate_float
from ctc.verdict.resonance_sweep import sweep_resonance

# The public names, sorted; docs/reference/api.md lists the same.
__all__ = [
    "Adaptive",
    "Certificate",
    "ComputedTorque",
    "ComputedTorquePID",
    "ComputedTorqueSettings",
    "DefaultGainSettings",
    "Evaluation",
    "FeedForward",
    "Fleet",
    "Float",
    "FloatSettings",
    "FloatVerdict",
    "LearnSettings",
    "LearntTorque",
    "PDGravity",
    "PayloadEstimator",
    "SlidingMode",
    "Uncertainty",
    "animate",
    "campaign",
    "certify",
    "compare",
    "error_loop",
    "evaluate",
    "evaluate_float",
    "learn",
    "margins",
    "motor_gain",
    "observer_gains",
    "pid_gains",
    "plot_arm",
    "plot_record",
    "sweep_resonance",
    "tune",
    "write_report",
]
