"""Monte Carlo probability of leaving a pulse limit under parameter uncertainty, and what causes it.

Read `certify`, then what it does in turn: `uncertainty` draws `plants`, `population` simulates them, `certificate`
counts with `binomial` bounds; `sensitivity`, `reserves` and `figure` ask why, how robust, and show it.
"""
