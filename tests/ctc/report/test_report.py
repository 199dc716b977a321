"""The page: self-contained, escaped, complete; in a browser it fits a phone and a sheet."""

import dataclasses
import html
import os
import re
import shutil
import subprocess
from html.parser import HTMLParser

import matplotlib.pyplot as plt
import numpy as np
import pytest

from ctc import ComputedTorque, certify, evaluate, write_report
from ctc.certification import Rare
from ctc.report import page as page_of
from ctc.report import section, thin
from identification import identify
from plant import puma560, simulate
from plant.parts import items, preformatted, table

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()


@pytest.fixture(scope="module")
def found():
    return identify(
        ARM.dynamics,
        simulate(ARM, RIG, puma560.p_law(), PATH, duration=1.5),
        seed=1,
        progress=False,
    )


@pytest.fixture(scope="module")
def page(found, tmp_path_factory):
    """The page with all sections."""
    place, law = tmp_path_factory.mktemp("page") / "page.html", ComputedTorque(found.arm, found.rig)
    proof = certify(found, found.rig, law, PATH, samples=20, duration=0.3, progress=False)
    write_report(found, proof, evaluate(found.arm, found.rig, law, PATH, duration=0.5), place)
    return place


class Tags(HTMLParser):
    """Every tag closed, every id once."""

    VOID = ("meta", "br", "hr", "path", "use", "line", "rect", "circle", "image", "stop")

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.links = [], [], []

    def handle_starttag(self, tag, attributes):
        named = dict(attributes)
        self.ids += [named["id"]] if "id" in named else []
        self.links += [named[key] for key in ("href", "src") if key in named]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag


def test_the_page_is_sound_and_points_nowhere_else(page):
    text, tags = page.read_text(encoding="utf-8"), Tags()
    tags.feed(text)
    assert tags.open == []
    assert len(set(tags.ids)) == len(tags.ids)
    assert all(link.startswith("#") and link[1:] in tags.ids for link in tags.links)
    assert not re.search(r"https?:|<script|url\((?!#)", text)


def test_it_says_what_was_found(page, found):
    text = page.read_text(encoding="utf-8")
    headings = re.findall(r"<h2>(.*?)</h2>", text)
    assert headings == [
        "Verdict",
        "Parameters",
        "Fit",
        "Logs",
        "Assumptions",
        "Controller",
        "Certificate",
        "Where it comes from",
    ]
    for name, value, std in zip(found.short_names, found.fit.values, found.fit.std, strict=True):
        row = re.search(rf"<tr><td>{name}</td>(.*?)</tr>", text)
        # value, half-width, unit, std, from, to
        cells = re.findall(r"<td[^>]*>([^<]*)</td>", row[1])
        assert abs(float(cells[0]) - value) <= 0.06 * std  # rounded to two digits of the deviation
        assert float(cells[1].removesuffix(" %")) == pytest.approx(196 * std / abs(value), rel=0.06)
        assert float(cells[3]) == pytest.approx(std, rel=0.06)
        assert float(cells[4]) < value < float(cells[5])
    assert found.provenance()["records"][0] in text
    record = found.records[0]
    seconds = f"{record.t[-1] - record.t[0]:.3g}"
    log = re.search(
        r"<h2>Logs</h2>.*?<tbody>(.*?)</tbody>|<h2>Logs</h2>.*?</tr>(.*?)</tr>", text, re.S
    )
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", log[1] or log[2])
    assert cells[-3:] == [f"{len(record)}", seconds, f"{1e3 * record.rig.period:g}"]
    assert "of 20 Monte Carlo samples" in text
    assert "Not sampled, and so not covered" in text
    assert re.search(r"<td>drive\.gear\[1\]</td><td[^>]*>-53\.7</td>", text)  # what was stated
    assert "rad/s." in text


def test_warnings_come_first(found, tmp_path):
    doubtful = simulate(ARM, RIG, puma560.p_law(), PATH, duration=1.0)
    with pytest.warns(UserWarning, match="identified with"):
        wrong = identify(puma560.arm().dynamics, _with_gain(doubtful, 1.5), seed=1, progress=False)
    held = evaluate(
        wrong.arm, wrong.rig, ComputedTorque(wrong), PATH, backend="numba", duration=0.5
    )
    write_report(wrong, held, path=tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert (
        text.index("The identification is unreliable")
        < text.index("<h3>Warnings</h3>")
        < text.index("Parameters")
    )
    assert "Nothing in the log contradicts" not in text
    assert "on the nominal arm, of an unreliable identification" in text
    assert "✓" not in text[: text.index("<h3>Warnings</h3>")]


def test_notes_stand_apart_from_the_warnings(found, tmp_path):
    """They doubt no value: without a warning they accuse nothing."""
    noted = dataclasses.replace(found)
    # As a file keeps them.
    noted.__dict__["_warnings"] = {"a line for any log.": False}
    write_report(noted, tmp_path / "noted.html")
    text = (tmp_path / "noted.html").read_text(encoding="utf-8")
    assert "<h3>Warnings</h3>" not in text
    assert "<h3>Notes</h3>\n<ul>\n<li>a line for any log.</li>" in text


@pytest.mark.slow
def test_a_card_with_a_cross_says_why_on_the_card(found, tmp_path):
    """Of a path that begins in motion, and of a probability that is not shown to be as low as
    was asked.
    """
    law, under_way = ComputedTorque(found), PATH.later(0.5)
    rare = Rare(
        asked=1e-6,
        probability=1e-3,
        variation=0.1,
        upper=1e-2,
        below=False,
        stuck=False,
        levels=np.ones(1),
        evaluations=9,
    )
    proof = certify(found, found.rig, law, PATH, samples=8, duration=0.3, progress=False)
    proof = dataclasses.replace(proof, rare=rare)
    assert not proof.failures
    write_report(
        found,
        proof,
        evaluate(found.arm, found.rig, law, under_way, duration=0.5),
        tmp_path / "page.html",
    )
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    nominal, sampled = re.findall(r'<li class="bad"><b>✗ (.*?)</li>', text)
    assert "samples within ±1 pulse" in nominal
    assert "The path begins in motion (joint 3 (q[1])" in nominal
    assert "an arm at rest there is up to" in nominal
    assert "not shown to be as rare as 1e-06" in sampled


def _with_gain(record, factor):
    law = puma560.p_law(tuple(factor * np.asarray(record.law.gain)))
    return dataclasses.replace(record, law=law, torque=None, current=None)


def test_texts_are_escaped():
    raw = ["<b>", "&amp", "<i>", "<u>", "<a>", "<q>", "</pre>"]
    title, subtitle, heading, item, head, cell, code = raw
    made = page_of(
        title,
        subtitle,
        [section(heading, items([item]), table((head,), [(cell,)]), preformatted(code))],
    )
    for each in raw:
        assert html.escape(each) in made
    made = re.sub(r"<style>.*</style>", "", made, flags=re.DOTALL)
    assert not re.search(r"<[biuaq]>|</pre>.*</pre>", made)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "path must be"),
        ((None, "a.html"), "results must be"),
        ((RIG, "a.html"), "results must be"),
    ],
    ids=["no path", "nothing", "a rig"],
)
def test_other_arguments_are_refused(found, arguments, says):
    with pytest.raises(ValueError, match=says):
        write_report(found, *arguments)


def test_a_page_that_is_there_stays(found, page):
    before = page.read_bytes()
    with pytest.raises(ValueError, match="is there"):
        write_report(found, page)
    assert page.read_bytes() == before


# -- in a browser --------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def browser():
    browser = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if browser is None:
        if os.environ.get("CI_BROWSER"):
            pytest.fail("a browser must be there: .ci/run installs Debian's chromium")
        pytest.skip("no chromium here; `apt-get install chromium` to run this test")

    def run(*arguments, home):
        base = [
            browser,
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            f"--user-data-dir={home}",
        ]
        offline = [
            "--host-resolver-rules=MAP * ~NOTFOUND",
            "--disable-background-networking",
            "--enable-logging=stderr",
        ]
        command = [*base, *offline, *arguments]
        # our own
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)  # noqa: S603

    return run


def test_a_browser_shows_it_on_a_phone_and_prints_it(browser, page, tmp_path):
    """A frame as wide as a phone measures the page, since a headless window is wider."""
    text = page.read_text(encoding="utf-8")
    probe = (
        "<script>onload = () => { const e = document.documentElement;document.title ="
        " [e.scrollWidth, e.clientWidth, document.querySelectorAll('svg').length].join('"
        " ');parent.postMessage(document.title, '*'); }</script></body>"
    )
    (tmp_path / "inner.html").write_text(text.replace("</body>", probe), encoding="utf-8")
    (tmp_path / "phone.html").write_text(
        "<iframe src='inner.html' width='390' height='800'></iframe><p id='told'></p><script>"
        "onmessage = e => { document.getElementById('told').textContent = e.data; }</script>"
    )
    done = browser(
        "--virtual-time-budget=8000",
        "--dump-dom",
        f"file://{tmp_path}/phone.html",
        home=tmp_path / "a",
    )
    wide, there, figures = map(
        int, re.search(r'id="told">(\d+) (\d+) (\d+)<', done.stdout).groups()
    )
    assert wide <= there
    assert 300 < there < 391
    assert figures == 3
    assert "CONSOLE" not in done.stderr
    browser(
        "--no-pdf-header-footer",
        f"--print-to-pdf={tmp_path}/page.pdf",
        f"file://{page}",
        home=tmp_path / "b",
    )
    sheet = (tmp_path / "page.pdf").read_bytes()
    assert sheet[:5] == b"%PDF-"
    assert 2 <= len(re.findall(rb"/Type\s*/Page\b", sheet)) <= 12


def test_no_table_is_cut_off_on_a_screen(browser, page, tmp_path):
    """In a window of 1,200 pixels every table has its room: none is to be scrolled."""
    probe = (
        "<script>onload = () => parent.postMessage([...document.querySelectorAll('.wide')]"
        ".map(e => e.scrollWidth - e.clientWidth).join(' '), '*');</script></body>"
    )
    text = page.read_text(encoding="utf-8")
    (tmp_path / "inner.html").write_text(text.replace("</body>", probe), encoding="utf-8")
    (tmp_path / "screen.html").write_text(
        "<iframe src='inner.html' width='1200' height='800'></iframe><p id='told'></p><script>"
        "onmessage = e => { document.getElementById('told').textContent = e.data; }</script>"
    )
    address = f"file://{tmp_path}/screen.html"
    done = browser("--virtual-time-budget=8000", "--dump-dom", address, home=tmp_path / "a")
    beyond = re.search(r'id="told">([\d ]+)<', done.stdout).group(1).split()
    assert len(beyond) >= 4
    assert set(beyond) == {"0"}


def test_a_long_curve_is_drawn_by_its_extremes():
    """Two samples per place of the axis: the least and the largest of all are there, in their
    order.
    """
    t, y = np.linspace(0, 4, 5000), np.random.default_rng(1).normal(size=5000)
    axis = plt.subplots(figsize=(4, 2))[1]
    (long,) = axis.plot(t, y, drawstyle="steps-post")
    (short,) = axis.plot(t[:100], y[:100])
    thin(long, axis)
    thin(short, axis)
    drawn_t, drawn = long.get_data()
    assert (drawn.min(), drawn.max()) == (y.min(), y.max())
    assert (np.diff(drawn_t) > 0).all()
    assert np.isin(drawn, y).all()
    assert len(drawn) <= 2 * 4 * 40
    assert len(short.get_xdata()) == 100
    plt.close("all")


def test_missing_samples_take_no_others_from_a_long_curve():
    t, y = np.linspace(0, 4, 5000), np.random.default_rng(1).normal(size=5000)
    # Every tenth sample is missing, and a whole stretch, which stays a gap.
    y[::10] = np.nan
    y[2000:3000] = np.nan
    axis = plt.subplots(figsize=(4, 2))[1]
    (line,) = axis.plot(t, y)
    thin(line, axis)
    drawn_t, drawn = line.get_data()
    assert (np.nanmin(drawn), np.nanmax(drawn)) == (np.nanmin(y), np.nanmax(y))
    outside = (drawn_t < t[1990]) | (drawn_t > t[3010])
    assert np.isfinite(drawn[outside]).all()
    assert np.isnan(drawn[~outside]).any()
    assert len(drawn) > 3 * 40
    plt.close("all")


def test_the_page_is_light(page):
    """Two joints and 2,000 samples; seven and 5,700 are 0.4 MB."""
    assert page.stat().st_size < 200_000


def words(place):
    """The text of a page, without its marks."""
    return " ".join(
        html.unescape(re.sub("<[^>]+>", " ", place.read_text(encoding="utf-8"))).split()
    )


@pytest.mark.slow
def test_path_logs_and_conditions_are_named(found, tmp_path):
    """Of a path that begins in motion and leaves the log, and of records that came with files'
    names.
    """
    log, away = (
        simulate(ARM, RIG, puma560.p_law(), PATH, duration=1.5),
        puma560.reference(2.5).later(0.6),
    )
    named = dataclasses.replace(
        found,
        records=(dataclasses.replace(found.records[0], name="one.csv"),),
        held_out=(
            dataclasses.replace(log, name="two.csv"),
            dataclasses.replace(log.cut(0, 1.0), name="two.csv"),
        ),
        diagnostics=dataclasses.replace(found.diagnostics, held_out_difference=0.6),
    )
    law = ComputedTorque(named)
    evaluation = evaluate(named.arm, named.rig, law, away, duration=0.5)
    write_report(named, evaluation, tmp_path / "moving.html")
    said = words(tmp_path / "moving.html")
    assert "✗ ComputedTorque on the nominal arm" in said
    assert f"The {str(evaluation.from_rest)[4:]}." in said
    fastest = np.abs(away(evaluation.record.t).qd).max(axis=0)
    assert (
        f"The path of this verdict (Later), 0.5 s; greatest speeds: joint 2 (q[0]) {fastest[0]:.2g}"
        " rad/s" in said
    )
    assert "The path leaves the log: joint" in said
    assert "which no search saw" not in said
    assert (
        "In the validation data, two.csv, record 2, two.csv, record 3, they differ by 0.60 pulses"
        in said
    )
    assert "SHA-256 of one.csv, as it was read" in said
    assert "validation, only simulated: two.csv, two.csv" in " ".join(str(named).split())
    write_report(
        named, evaluate(named.arm, named.rig, law, PATH, duration=0.5), tmp_path / "within.html"
    )
    assert "leaves the log" not in words(tmp_path / "within.html")


@pytest.mark.parametrize(("off", "named"), [((0, 1), "certificate has"), ((1, 0), "evaluation has"),
                                            ((1, 1), "evaluation and certificate have")])  # fmt: skip
def test_which_result_is_of_another_identification_is_said(found, tmp_path, off, named):
    other = dataclasses.replace(found, arm=ARM.dynamics.arm(found.f * 1.01))
    laws = [ComputedTorque((found, other)[each].arm, found.rig) for each in off]
    evaluation = evaluate(found.arm, found.rig, laws[0], PATH, duration=0.05)
    certificate = certify(found, found.rig, laws[1], PATH, samples=2, duration=0.05, progress=False)
    with pytest.raises(ValueError, match=rf"with this identification's f; {named} another\."):
        write_report(found, evaluation, certificate, tmp_path / "mixed.html")
    assert not (tmp_path / "mixed.html").exists()


@pytest.mark.slow
def test_of_a_set_the_page_names_the_worst_motion_and_has_the_verdict_on_all(found, tmp_path):
    """The same shares as on the screen."""
    law = ComputedTorque(found.arm, found.rig)
    motions = {"slow": PATH.slowed(2.0), "as logged": PATH}
    proofs = certify(found, found.rig, law, motions, samples=20, duration=0.3, progress=False)
    worst = proofs[proofs.worst]
    held = evaluate(found.arm, found.rig, law, worst.reference, duration=0.3)
    write_report(found, proofs, held, path=tmp_path / "set.html")
    said = words(tmp_path / "set.html")
    assert proofs.verdict in said
    assert "20 sampled arms, in 2 motions" in said
    assert said.count(f"in '{proofs.worst}', the worst of the motions") == 3
    # Of a path of its own the page does not say that it is that motion.
    other = evaluate(found.arm, found.rig, law, PATH.slowed(3.0), duration=0.3)
    write_report(found, proofs, other, path=tmp_path / "other.html")
    assert words(tmp_path / "other.html").count("the worst of the motions") == 1
