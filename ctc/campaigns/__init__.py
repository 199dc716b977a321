"""Many independent tasks by name, on one machine or many; and robots over weeks: `Fleet`.

Read `campaign`, then `ledger`, its finished tasks; `fleet`, then `effects`, `judgement` and
`fleet_page`, judges the robots. How calls reach workers is in `plant.simulation.executors`.
"""

from ctc.campaigns.campaign import Campaign, campaign
from ctc.campaigns.effects import Values, effect_of
from ctc.campaigns.fleet import Fleet
from ctc.campaigns.judgement import Change, Judgement, seconds_of
from ctc.campaigns.ledger import rows_of

__all__ = [
    "Campaign",
    "Change",
    "Fleet",
    "Judgement",
    "Values",
    "campaign",
    "effect_of",
    "rows_of",
    "seconds_of",
]
