"""Every controller of the library on the paper's arm, as a log may come from it."""

import numpy as np

from ctc import Adaptive, ComputedTorque, ComputedTorquePID, FeedForward, PDGravity, SlidingMode
from plant import PD, PID, Cascade, P, puma560

ARM, RIG = puma560.literature_arm(1.5), puma560.rig()
T = RIG.period
_PD = PD(gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=3000.0, period=T)
_CASCADE = {"position": (60.0, 60.0), "speed": (1e-3, 8e-4), "integral": (0.05, 0.04), "period": T}
LAWS = {
    "P": P(gain=(0.1, 0.08)),
    "PD": _PD,
    "PD, fast": PD(gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=3000.0),
    "PID": PID(
        gain=(0.1, 0.075), integral=(0.5, 0.4), derivative=(4e-4, 3e-4), filter=3000.0, period=T
    ),
    "cascade": Cascade(filter=3000.0, **_CASCADE),
    "cascade, difference over 2": Cascade(difference=2, **_CASCADE),
    "computed torque": ComputedTorque(ARM, RIG, bandwidth=150),
    "computed torque with PID": ComputedTorquePID(
        ARM,
        RIG,
        bandwidth=170.6,
        ratio=1.041,
        integral=11.62,
        roll_off=2188,
        roll_off_damping=1.185,
    ),
    "feed-forward + PD": FeedForward(ARM, RIG, feedback=_PD),
    "gravity + PD": PDGravity(ARM, RIG, feedback=_PD),
    "adaptive": Adaptive(
        ARM, RIG, bandwidth=60.0, gain=(60.0, 30.0), adaptation=np.full(9, 0.01), filter=1000.0
    ),
    "sliding mode": SlidingMode(ARM, RIG, bandwidth=60.0, reach=20.0, layer=1.0, filter=1000.0),
}
"""The adaptive law starts from the true f."""
