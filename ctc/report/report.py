"""`write_report`: an identification and its controller as one HTML file."""

import datetime
from pathlib import Path

import numpy as np

from ctc.certification.certificate import Certificate
from ctc.report.page import page
from ctc.report.sections import sections
from ctc.verdict.evaluation import Evaluation
from identification import Identification
from plant.parts.arguments import instance, known_options
from plant.parts.files import require_new, write_whole


@known_options
def write_report(
    found: Identification,
    *results: Evaluation | Certificate | str | Path,
    path: str | Path | None = None,
    title: str = "Identification of a robot arm",
    overwrite: bool = False,
) -> None:
    """Write one self-contained HTML page: verdict, parameters, fit, logs, assumptions, controller,
    provenance.

    It needs no network and no script, and is readable on a phone and on paper.

    Parameters
    ----------
    found : Identification
    *results : Evaluation or Certificate
        Of a controller for it, one of each at most, in any order; the path may come last.
    path : str or Path
        Such as ``"page.html"``.
    title : str
    overwrite : bool
        Replace a file that is there.

    Raises
    ------
    ValueError
        Something else, or two of a kind; results of another identification; no path; a file that is
        there.

    See Also
    --------
    identification.Identification, ctc.Certificate, ctc.Evaluation

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import identify
    >>> from ctc import write_report
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference())
    >>> found = identify(puma560.dynamics(), record, progress=False)
    >>> write_report(found, path="page.html")
    """
    instance(
        "found", found, Identification, "Give what identify returned, or Identification.load(...)."
    )
    given = list(results)
    if path is None and given and isinstance(given[-1], (str, Path)):
        path = given.pop()  # type: ignore[assignment]  # one of them, as was just asked
    if path is None:
        raise ValueError('path must be that of the page; got none. Give path="page.html".')
    kinds: dict[type, Evaluation | Certificate] = {}
    for each in given:
        if not isinstance(each, (Evaluation, Certificate)) or type(each) in kinds:
            got = f"got {each!r:.60}. Pass what evaluate and certify returned."
            raise ValueError(f"results must be one Evaluation and one Certificate at most; {got}")
        kinds[type(each)] = each
    laws = [
        (each, each.law if isinstance(each, Certificate) else each.record.law)
        for each in kinds.values()
    ]
    arms = [(type(each).__name__.lower(), getattr(law, "arm", None)) for each, law in laws]
    others = [
        name for name, arm in arms if arm is not None and not np.array_equal(arm.f, found.arm.f)
    ]
    if others:
        both = f"{' and '.join(others)} {'have' if len(others) > 1 else 'has'} another"
        advice = "Make it again from found, or give the identification that they are of"
        raise ValueError(f"results must be of laws with this identification's f; {both}. {advice}.")
    place = require_new(path, overwrite)
    today = datetime.date.today().isoformat()
    subtitle = (
        f"{', '.join(found.arm.dynamics.chain.joint_labels)}; {found.search.method}; written on"
        f" {today}"
    )
    parts = sections(found, kinds.get(Evaluation), kinds.get(Certificate))
    write_whole(place, [page(instance("title", title, str, "Give a line."), subtitle, parts)])
