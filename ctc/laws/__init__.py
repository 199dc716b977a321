"""Control laws that hold a model of the arm: computed torque and its rivals.

Read `model_law` (their base), `observer`, `gears`, `friction_model`, `start_boost`, `delay_queue`
(the blocks of computed torque), `computed_torque`; `computed_torque_settings`, `default_gains` and
`gear_gains` have its numbers. Then `computed_torque_pid`, `feed_forward`, `adaptive`,
`sliding_mode` and `float` in any order.
"""

from ctc.laws.adaptive import Adaptive
from ctc.laws.computed_torque import ComputedTorque
from ctc.laws.computed_torque_pid import ComputedTorquePID
from ctc.laws.computed_torque_settings import VariedSettings
from ctc.laws.feed_forward import FeedForward
from ctc.laws.float import Float
from ctc.laws.gear_gains import joint_gains, one_joint_model
from ctc.laws.model_law import ModelLaw
from ctc.laws.observer import DRIFT, correct, filter_gains, predict, regulator_gains, triple_pole

__all__ = [
    "DRIFT",
    "Adaptive",
    "ComputedTorque",
    "ComputedTorquePID",
    "FeedForward",
    "Float",
    "ModelLaw",
    "VariedSettings",
    "correct",
    "filter_gains",
    "joint_gains",
    "one_joint_model",
    "predict",
    "regulator_gains",
    "triple_pole",
]
