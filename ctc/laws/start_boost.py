"""The boost of computed torque where a joint begins to move, turns back, or takes up a load.

Static friction hides what the model has wrong until a joint breaks loose. Regulator and observer
are therefore faster for a while. Unmodelled elastic gears become unstable under the boosted gains
first: the predicted distance from the counted cell then changes its sign within milliseconds, as it
does not on a rigid arm, and two such changes disable the boost
(docs/background/computed_torque.md).
"""

from typing import Any

import casadi as ca

from plant import Fields, per_joint


class NoBoost:
    """No boost, as on predicted elastic gears, which a faster regulator would make unstable."""

    # unused; kept so that the states of both kinds of gears end alike
    fields = Fields(remaining=per_joint(start=1.0))

    def factor(self, memory: Any, begins: ca.SX, error: ca.SX) -> float:
        """Factor on the bandwidth."""
        return 1

    def following(self, memory: Any, distance: ca.SX, turns: ca.SX, dt: ca.SX) -> Any:
        """The memory one sample later."""
        return memory


class StartBoost:
    """A faster regulator after each start, turn or load, until the joint is seen to swing.

    `law` is the computed torque, whose numbers it uses. Its memory: the `sign` of the last large
    distance, decaying; the number of `swings`, decaying; the share of the boost that remains.
    """

    fields = Fields(sign=per_joint(), swings=per_joint(), remaining=per_joint(start=1.0))

    def __init__(self, law: Any) -> None:
        self.law = law

    def factor(self, memory: Any, begins: ca.SX, error: ca.SX) -> ca.SX:
        """Factor (n, 1) on the bandwidth; 1 after two swings.

        `begins` (n, 1) is the share of the boost that the reference's speed allows, `error` (n, 1)
        the tracking error [pulses].
        """
        settings = self.law.settings
        share = memory.remaining * begins
        near = settings.boost_error / ca.fmax(ca.fabs(error), settings.boost_error)
        steady = 1 - ca.fmin(1, ca.fmax(0, memory.swings - 1))
        return 1 + (self.law.start_boost - 1) * share * near * steady

    def following(self, memory: Any, distance: ca.SX, turns: ca.SX, dt: ca.SX) -> Any:
        """The memory one sample later.

        `distance` (n, 1): predicted distance from the middle of the counted cell [pulses].
        `turns` (n, 1): whether a joint begins to move, or turns back.
        """
        law = self.law
        settings = law.settings
        size = ca.fabs(distance)
        sign = ca.sign(distance)
        threshold = settings.swing_distance - settings.swing_dead_zone * law.dead_zone

        # The remembered sign decays, so that its size tells how long ago the distance was large;
        # `recent` is its size after the longest time within a swing.
        decay = dt * law.bandwidth / settings.swing_time
        recent = ca.exp(decay - 1)
        swung = ca.logic_and(size > threshold, memory.sign * sign < -recent)
        load = ca.logic_and(size > threshold + settings.load_distance, memory.sign * sign > recent)
        forgotten = memory.swings * ca.exp(-dt / settings.swing_memory)
        faded = memory.sign * ca.exp(-dt * law.bandwidth / settings.swing_time)
        spent = memory.remaining * ca.exp(-dt / law.start_time)
        return memory._replace(
            sign=ca.if_else(size > threshold, sign, faded),
            swings=ca.if_else(swung, ca.fmin(2, memory.swings + 1), forgotten),
            remaining=ca.if_else(ca.logic_or(turns, load), 1, spent),
        )
