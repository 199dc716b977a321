"""Many independent tasks by name, on one machine or many, kept in a folder as they end.

Read `campaign`, then `ledger`, which holds what was finished. How calls reach workers is in
`plant.simulation.executors`.
"""
