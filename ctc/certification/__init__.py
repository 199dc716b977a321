"""Monte Carlo probability of exceeding a pulse limit under parameter uncertainty, and its causes.

Read `certify`, then its steps in turn: `samples` draws `plants` from an `uncertainty`,
`plant.simulation.population` simulates them, `certificate` counts failures with exact bounds and
sensitivities (`certified`); `rare`, `reserves` and `figure` add rare failures, reserves and plots.
"""
