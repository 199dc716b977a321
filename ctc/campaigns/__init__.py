"""Many independent tasks by name, on one machine or many; and robots over weeks: `Fleet`.

Read `campaign`, then `ledger`, its finished tasks; `fleet`, then `effects`, `judgement` and
`fleet_page`, judges the robots. How calls reach workers is in `plant.simulation.executors`.
"""
