"""Monte Carlo probability of leaving a pulse limit under parameter uncertainty, and what causes it.

Read `certify`, then what it does in turn: `samples` draws `plants` from an `uncertainty`,
`plant.simulation.population` simulates them, `certificate` counts with exact bounds (`certified`),
and asks why; `reserves` and `figure` ask how robust, and show it.
"""
