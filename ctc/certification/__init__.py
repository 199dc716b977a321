"""Monte Carlo probability of exceeding a pulse limit under parameter uncertainty, and its causes.

Read `certify`, then its steps in turn: `samples` draws `plants` from an `uncertainty`,
`plant.simulation.population` simulates them, `certificate` counts failures with exact bounds and
sensitivities (`certified`); `rare`, `reserves` and `figure` add rare failures, reserves and plots.
"""

from ctc.certification.certificate import Certificate
from ctc.certification.certificates import Certificates
from ctc.certification.certified import Certified, Influence, cells, clopper_pearson, influences
from ctc.certification.certify import Motions, Task, certify
from ctc.certification.identified import refits
from ctc.certification.imperfections import IMPERFECTIONS
from ctc.certification.plants import Plants
from ctc.certification.rare import Normals, Rare, subset_simulation
from ctc.certification.reserves import Reserves
from ctc.certification.samples import draw
from ctc.certification.statement import SEARCH, percent
from ctc.certification.uncertainty import Uncertainty

__all__ = [
    "IMPERFECTIONS",
    "SEARCH",
    "Certificate",
    "Certificates",
    "Certified",
    "Influence",
    "Motions",
    "Normals",
    "Plants",
    "Rare",
    "Reserves",
    "Task",
    "Uncertainty",
    "cells",
    "certify",
    "clopper_pearson",
    "draw",
    "influences",
    "percent",
    "refits",
    "subset_simulation",
]
