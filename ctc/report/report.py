"""`write_report`: an identification and its controller as one HTML file."""

import datetime
from pathlib import Path

import numpy as np

from ctc.certification import Certificate, Certificates, Certified
from ctc.report.page import page
from ctc.report.sections import sections
from ctc.verdict import Evaluation
from identification import Identification
from plant.parts import instance, known_options, progress_bar, require_new, write_whole

# Sections of a page with all results.
_SECTIONS = 8


@known_options
def write_report(
    found: Identification,
    *results: Evaluation | Certificate | Certificates | str | Path,
    path: str | Path | None = None,
    title: str = "Identification of a robot arm",
    overwrite: bool = False,
) -> None:
    """Write a self-contained HTML page about an identification and its controller.

    It has the verdict, the parameters, the fit, the logs, the assumptions, the controller and the
    provenance.

    It needs no network and no script, and is readable on a phone and on paper.

    Parameters
    ----------
    found : Identification
    *results : Evaluation, and Certificate or Certificates
        Of a controller for `found`, one of each at most, in any order; the path may come last. Of
        the motions of `Certificates` the page shows the worst, beside the verdict on all.
    path : str or Path
        Such as ``"page.html"``.
    title : str
    overwrite : bool
        Replace an existing file.

    Raises
    ------
    ValueError
        Other types, or two results of one type; results of another identification; no path; an
        existing file.

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
    # 1. The path may come last, as in other functions that write.
    values = list(results)
    if path is None and values and isinstance(values[-1], (str, Path)):
        path = values.pop()  # type: ignore[assignment]  # one of them, as was just asked
    if path is None:
        raise ValueError('path must be that of the page; got none. Give path="page.html".')

    # 2. One result of each type, both of this identification: the page names no other arm.
    by_type: dict[type, Evaluation | Certified] = {}
    for result in values:
        kind = Certified if isinstance(result, Certified) else Evaluation
        if not isinstance(result, kind) or kind in by_type:
            got = f"got {result!r:.60}. Pass what evaluate and certify returned."
            raise ValueError(f"results must be one Evaluation and one Certificate at most; {got}")
        by_type[kind] = result
    strangers = []
    for made in by_type.values():
        law = made.law if isinstance(made, Certified) else made.record.law
        # Laws without a model fit every arm.
        arm = getattr(law, "arm", None)
        if arm is not None and not np.array_equal(arm.f, found.arm.f):
            strangers.append(type(made).__name__.lower())
    if strangers:
        both = f"{' and '.join(strangers)} {'have' if len(strangers) > 1 else 'has'} another"
        advice = "Make it again from found, or give the identification that they are of"
        raise ValueError(f"results must be of laws with this identification's f; {both}. {advice}.")

    # 3. The file is checked before the figures are drawn, which takes seconds.
    file = require_new(path, overwrite)
    joints = ", ".join(found.arm.dynamics.chain.joint_labels)
    today = datetime.date.today().isoformat()
    subtitle = f"{joints}; {found.search.method}; written on {today}"
    parts = []
    with progress_bar(_SECTIONS, "report", "section", False) as bar:
        for part in sections(found, by_type.get(Evaluation), by_type.get(Certified)):
            parts.append(part)
            bar.update()
    write_whole(file, [page(instance("title", title, str, "Give a line."), subtitle, parts)])
