"""The command `onepulse`: its answers, exit codes, and one line for whatever is wrong."""

import csv
import html
import json
import math
import os
import re
import subprocess
import sys
import tomllib
import types
import warnings
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from model_texts import urdf

import ctc.commandline.commands as commands
from ctc import Certificate
from ctc.commandline import Answer, in_the_shell, main, path_of, records_of
from identification import Identification
from identification.results import SummarySettings, doubts
from plant import (
    Body,
    Cascade,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    Link,
    P,
    Rig,
    Robot,
    everyday_motions,
    puma560,
    read_robot,
    simulate,
    write_robot,
)  # fmt: skip
from plant.models import FOLDER, unit_of

MAPPED = """
[columns]
t = "time"
counts = ["c1", "c2"]
reference_position = ["r1", "r2"]

[units]
t = "s"
counts = "pulses"
reference_position = "rad"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A robot file, its log as another program writes it, and that of the library."""
    place = tmp_path_factory.mktemp("job")
    robot = read_robot("paper_puma560")
    record = simulate(
        robot.arm, robot.rig, robot.law, puma560.reference(), duration=1.5, steps_per_sample=8
    )
    record.to_csv(place / "own.csv")
    asked = puma560.reference()(record.t).q
    with open(place / "log.csv", "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time", "c1", "c2", "r1", "r2"])
        rows.writerows(
            zip(
                *(column.tolist() for column in (record.t, *record.counts.T, *asked.T)), strict=True
            )
        )
    (place / "arm.toml").write_text((FOLDER / "paper_puma560.toml").read_text() + MAPPED)
    rows = [
        [t, 0.3 * math.sin(math.pi * t) ** 4, -0.2 * math.sin(math.pi * t) ** 4]
        for t in np.linspace(0, 1, 41)
    ]
    (place / "path.csv").write_text("\n".join(",".join(f"{x:.9f}" for x in row) for row in rows))
    return place


@pytest.fixture(scope="module")
def answer(folder):
    """Exit code, output and errors of `onepulse identify`, which writes found.json."""
    given = ("--robot", "arm.toml", "-o", "found.json", "--json", "--quiet")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
            code = main(["identify", "log.csv", *given])
    return code, out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def identified(answer):
    """The file of an identification, for tests of what follows."""
    assert answer[0] == 0
    return "found.json"


def run(capsys, *arguments):
    code = main([str(each) for each in arguments])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_from_a_log_to_a_page(folder, answer, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    code, out, err = run(capsys, "check", "log.csv", "--robot", "arm.toml", "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["logs"]["log.csv"][0]["verdict"] == "fine"
    assert json.loads(out)["causes"] == {"log.csv": []}
    code, out, err = answer
    told = json.loads(out)
    assert (code, err, told["doubts"], told["causes"]) == (0, "", [], [])
    found = Identification.load("found.json")
    assert [
        told["values"][name]["value"] for name in found.fit.unknown
    ] == found.fit.values.tolist()
    code, out, err = run(
        capsys,
        "certify",
        "found.json",
        "--path",
        "path.csv",
        "--samples",
        "40",
        "--within",
        "2",
        "-o",
        "proof.json",
    )
    assert (code, err) == (0, "")
    assert "of 40 Monte Carlo samples" in out
    assert out.endswith("wrote proof.json\n")
    options = ("--certificate", "proof.json", "--title", "Cell 7", "-o", "page.html")
    code, out, err = run(capsys, "report", "found.json", *options)
    assert (code, out, err) == (0, "wrote page.html\n", "")
    page = (folder / "page.html").read_text(encoding="utf-8")
    assert page.count("<section>") == 8
    assert "<title>Cell 7</title>" in page


def test_the_shell_speaks_no_python(folder, capsys, monkeypatch):
    """Calls and keyword arguments in answers and on the page; code that is to be run in Python
    stays.
    """
    monkeypatch.chdir(folder)
    # as of arms with many parameters
    settings = SummarySettings(unknowns=3)
    monkeypatch.setattr("identification.results.summary.SETTINGS", settings)
    code, out, _ = run(
        capsys,
        "identify",
        "log.csv",
        "--robot",
        "arm.toml",
        "-o",
        "said.json",
        "--quiet",
        "--force",
    )
    given = (
        "certify",
        "said.json",
        "--samples",
        "200",
        "--friction",
        "0.3",
        "-o",
        "said_proof.json",
        "--force",
    )
    code, proof, _ = run(capsys, *given)
    assert code == 1
    text = " ".join(f"{out} {proof}".split())
    assert "what the names of parameters mean: onepulse report" in text
    assert "Call identify with --unknown friction" in text
    assert re.search(r"certify with --resonance [\d.]+ [\d.]+\.", text)
    run(
        capsys,
        "report",
        "said.json",
        "--certificate",
        "said_proof.json",
        "-o",
        "said.html",
        "--force",
    )
    page = (folder / "said.html").read_text(encoding="utf-8")
    assert "again = identify(found.arm.dynamics" in page
    shown = html.unescape(re.sub(r"(?s)<(svg|pre|style)\b.*?</\1>|<[^>]*>", "", page))
    assert re.search(r"certify with --resonance [\d.]+ [\d.]+\.", shown)
    for said in (text, shown):
        assert re.findall(r"\bfound\.\w+|print\(|\w+\(\.\.\.|\b\w+=|\(arm, rig\)", said) == []


@pytest.mark.slow
def test_friction_is_named_by_a_word_beside_f_and_the_page_is_of_one_controller(
    folder, capsys, monkeypatch
):
    monkeypatch.chdir(folder)
    words = ("--unknown", "friction", "--quiet")
    assert (
        run(capsys, "identify", "log.csv", "--robot", "arm.toml", "-o", "rubbed.json", *words)[0]
        == 0
    )
    names = Identification.load("rubbed.json").fit.unknown
    assert len(names) == 13
    assert set(names[9:]) == {
        f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in (0, 1)
    }
    given = ("--path", "path.csv", "--samples", "40", "--bandwidth", "150", "--load", "0", "0.1")
    code, out, err = run(capsys, "certify", "rubbed.json", *given, "-o", "rubbed_proof.json")
    assert code == 2
    assert "--load-position must be given with a load; got None" in err
    for wrong, said in (
        (("--samples", "0"), "--samples must be a whole number of at least 1"),
        (("--after", "9"), "--after must be from 0 to below the duration 1 s"),
        (
            ("--resonance", "90", "40"),
            "--resonance must be (lowest, highest), above 0 Hz; got (90, 40)",
        ),
    ):
        code, out, err = run(capsys, "certify", "rubbed.json", "--path", "path.csv", *wrong)
        assert (code, out) == (2, "")
        assert err.startswith(f"onepulse: {said}")
    place = ("--load-position", "0", "-0.4", "0")
    code, out, err = run(capsys, "certify", "rubbed.json", *given, *place, "-o", "proof2.json")
    assert code in (0, 1), err
    assert "with a bandwidth of 150 rad/s" in out
    assert "friction ±" not in out  # it was identified
    assert "resonance=" not in out
    assert "friction=" not in out
    assert (
        run(capsys, "report", "rubbed.json", "--certificate", "proof2.json", "-o", "rubbed.html")[0]
        == 0
    )
    run(capsys, "identify", "log.csv", "--robot", "arm.toml", "-o", "alone.json", "--quiet")
    code, _, err = run(
        capsys, "report", "alone.json", "--certificate", "proof2.json", "-o", "mixed.html"
    )
    assert code == 2
    assert "must be of laws with this identification's f" in err
    assert not (folder / "mixed.html").exists()


@pytest.mark.filterwarnings("default::UserWarning")  # which the command prints
@pytest.mark.slow
def test_a_prior_of_the_model_s_bodies_is_given_by_its_spread(tmp_path, capsys, monkeypatch):
    """The second joint stands still: with --prior its spread, without it that of the default,
    which is said.
    """
    monkeypatch.chdir(tmp_path)
    bodies = (
        Body(mass=5.0, com=(0.2, 0.02, 0.0), inertia=(0.01, 0, 0, 0.1, 0, 0.1)),
        Body(mass=2.0, com=(0.15, 0.01, 0.0), inertia=(0.004, 0, 0, 0.03, 0, 0.03)),
    )
    drive = Drive(
        gear=(100, 100),
        motor_inertia=(8e-5, 3e-5),
        viscous=(1e-3, 5e-4),
        coulomb=(0.03, 0.1),
        motor_gain=(1, 1),
        current_limit=(5, 5),
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=(4096, 4096)), period=1e-3)
    links = (Link(name="shoulder", alpha=-math.pi / 2), Link(name="elbow", a=0.4))
    dynamics = Dynamics.from_chain(Chain(links=links, bodies=bodies).with_rotors(drive))
    robot = Robot(name="arm", rig=rig, arm=dynamics.arm(dynamics.f()), law=P(gain=(0.02, 0.01)))
    write_robot(robot, "arm.toml")
    path = Harmonics(
        period=2.0, offset=(0.0, 0.5), cosine=((0.5, 0.2), (1e-4, 0)), sine=((0.2, -0.3), (0, 1e-4))
    )
    simulate(robot.arm, rig, robot.law, path, duration=2.0, steps_per_sample=8).to_csv("log.csv")
    asked = ("identify", "log.csv", "--robot", "arm.toml", "-o", "found.json", "--force", "--quiet")
    for given, spread in ((("--prior", "0.1"), 0.1), ((), 0.3)):
        code, out, err = run(capsys, *asked, *given)
        assert code == 0
        assert re.search(
            rf"joint elbow \(q\[1\]\) moves by \d+ pulses. From the prior \({100 * spread:g}"
            r" %\) are",
            err,
        )
        found = Identification.load("found.json")
        assert found.fit.prior.spread == spread
        assert found.fit.prior.mean == pytest.approx(dynamics.f())
        assert f"from the prior ({100 * spread:g} %)" in " ".join(out.split())
    code, _, err = run(
        capsys, "identify", "log.csv", "--robot", "arm.toml", "-o", "no.json", "--prior", "-0.1"
    )
    assert code == 2
    assert (
        err
        == "onepulse: --prior must be a positive number; got -0.1. Give a relative spread such as"
        " 0.3.\n"
    )


def test_torques_are_fitted_and_those_of_another_log_predicted(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    robot = read_robot("paper_puma560")
    for name, period in (("one", 3.65), ("other", 5.0)):
        path = puma560.reference(period=period)
        simulate(robot.arm, robot.rig, robot.law, path).to_csv(f"{name}.csv")
    options = ("--robot", "paper_puma560", "--band", 8, "--json")
    code, out, err = run(capsys, "fit-torque", "one.csv", *options, "--held-out", "other.csv")
    answer = json.loads(out)
    assert (code, err) == (1 if answer["warnings"] else 0, "")
    assert set(answer["values"]) == set(robot.dynamics.names)
    own, other = answer["errors"].values()
    assert own["band"] == other["band"] == 8
    assert 0 < own["relative"] < 0.3
    assert 0 < other["relative"] < 0.3
    assert len(other["joints"]) == 2


def test_a_path_that_begins_in_motion_is_no(folder, identified, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    path = np.loadtxt("path.csv", delimiter=",", skiprows=1)
    cut = path[np.flatnonzero(path[:, 0] >= 0.4)]
    np.savetxt(
        "moving.csv", cut - [cut[0, 0], 0, 0], delimiter=",", header="t,q_1,q_2", comments=""
    )
    options = ("--samples", "8", "--within", "5", "--json", "--quiet")
    code, out, _ = run(capsys, "certify", identified, "--path", "moving.csv", *options)
    told = json.loads(out)
    assert (code, told["failures"]) == (1, 0)
    assert told["from_rest"].startswith("the path begins in motion (")
    assert told["from_rest"] in told["verdict"].replace("The path", "the path")
    assert told["log_shows_below"] > 10
    assert told["beyond_log"][0].startswith("joint 2 (q[0]) 0.00 to 0.30 rad (log: -1.45 to 0.00)")


@pytest.mark.slow
def test_a_law_is_tuned_and_handed_on(folder, identified, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    path = np.loadtxt("path.csv", delimiter=",")
    np.savetxt("brief.csv", path[path[:, 0] <= 0.15], delimiter=",")
    given = (
        identified,
        "--path",
        "brief.csv",
        "--samples",
        "8",
        "--friction",
        "0.02",
        "--after",
        "0.03",
        "-o",
        "tuned.json",
    )
    code, out, err = run(capsys, "tune", *given, "--json", "--quiet")
    told = json.loads(out)
    assert (code, told["failures"], err) == (0, 0, "")
    certificate = Certificate.load("tuned.json")
    assert told["law"] == type(certificate.law).__name__
    assert certificate.law.arm == Identification.load(identified).arm
    assert "friction ±2 %" in str(certificate)
    assert certificate.settings["after"] == told["after"] == 0.03
    assert told["failures_before"] == certificate.failures_before
    assert (
        run(capsys, "report", identified, "--certificate", "tuned.json", "-o", "tuned.html")[0] == 0
    )


# one path: test_from_a_log_to_a_page; sets of motions: certification/test_certificates
@pytest.mark.slow
def test_everyday_motions_and_a_path_are_a_row_each(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    run(capsys, "identify", "log.csv", "--robot", "arm.toml", "-o", "daily.json", "--quiet")
    given = (
        "certify",
        "daily.json",
        "--everyday",
        "--path",
        "path.csv",
        "--samples",
        "8",
        "--after",
        "0.3",
        "--quiet",
    )
    creeping = ("certify", "daily.json", "--everyday", "--samples", "8", "--hold", "--quiet")
    assert "from a hold, static friction" in " ".join(run(capsys, *creeping)[1].split())
    code, out, err = run(capsys, *given, "-o", "day.json", "--json")
    told, certificates = json.loads(out), Certificate.load("day.json")
    found = Identification.load("daily.json")
    assert code in (0, 1), err
    assert (
        list(told["motions"])
        == list(certificates)
        == [*everyday_motions(found.arm, found.rig), "path"]
    )
    assert certificates["creep"].reference == everyday_motions(found.arm, found.rig)["creep"]
    assert told["worst"] == certificates.worst
    assert told["verdict"] == certificates.verdict
    row = told["motions"]["creep"]
    assert (row["failures"], row["after"]) == (certificates["creep"].failures, 0.3)
    assert row["failures_with_start"] == certificates["creep"].failures_with_start
    assert told["failures"] >= max(each["failures"] for each in told["motions"].values())
    code, out, _ = run(capsys, *given)
    assert certificates.verdict.replace("±", "+-") in " ".join(out.split()).replace("±", "+-")
    assert (
        run(capsys, "report", "daily.json", "--certificate", "day.json", "-o", "day.html")[0] == 0
    )
    assert (folder / "day.html").stat().st_size > 10_000


@pytest.mark.slow
def test_what_is_in_doubt_is_certified_with_that_doubt(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    text = (
        (folder / "arm.toml")
        .read_text()
        .replace("coulomb = [0.124, 0.146]  # N m", "coulomb = [0.0, 0.0]")
    )
    (folder / "rubbing.toml").write_text(text)
    told = run(
        capsys, "identify", "log.csv", "--robot", "rubbing.toml", "-o", "rubbing.json", "--quiet"
    )
    assert told[0] == 1, told[2]
    given = ("certify", "rubbing.json", "--path", "path.csv", "--samples", "8", "--within", "50")
    code, out, _ = run(capsys, *given)
    assert code == 1
    assert out.startswith("The identification is unreliable (")
    told = json.loads(run(capsys, *given, "--json")[1])
    assert told["failures"] == 0
    assert told["doubts"] == doubts(Identification.load("rubbing.json"))


@pytest.mark.parametrize(
    "command", [("certify", "kept.json"), ("report", "kept.json"), ("tune", "kept.json")]
)
def test_what_is_read_is_never_overwritten(folder, capsys, monkeypatch, command):
    monkeypatch.chdir(folder)
    (folder / "kept.json").write_text("kept")
    (folder / "kept.html").unlink(missing_ok=True)
    (folder / "kept.html").symlink_to("kept.json")
    code, _, err = run(
        capsys, *command, "-o", "kept.html" if command[0] == "report" else "kept.json", "--force"
    )
    assert code == 2
    assert "is what is read. Name another file to write." in err
    for place in ("log.csv", "arm.toml"):
        assert (
            run(capsys, "identify", "log.csv", "--robot", "arm.toml", "-o", place, "--force")[0]
            == 2
        )
    assert (folder / "kept.json").read_text() == "kept"
    (folder / "kept.html").unlink()


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        ((1, 1), ""),
        (
            (1, 180 / math.pi),
            "has angles of up to 17.2 rad, many times those of the log: are they in degrees?",
        ),
        (
            (1, 1),
            "has rows 0.1 s apart; a spline goes through them. Give one every 0.02 s or less.",
        ),
        ((1000, 1), "lasts 1000 s, the log 1.5 s: is its t in ms?"),
    ],
)
def test_a_path_in_other_units_or_coarse_is_named(folder, monkeypatch, scale, said):
    monkeypatch.chdir(folder)
    path = np.loadtxt("path.csv", delimiter=",")
    path = path[::4] if "rows" in said else path
    np.savetxt("units.csv", path * [scale[0], scale[1], scale[1]], delimiter=",")
    robot = read_robot("arm.toml")
    found = types.SimpleNamespace(records=records_of(["log.csv"], robot), arm=robot.arm)
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        path_of(found, "units.csv")
    assert [str(each.message) for each in given] == ([f"units.csv {said}"] if said else [])


@pytest.mark.slow
def test_an_output_that_is_full_closed_or_narrow(folder):
    command = [
        sys.executable,
        "-c",
        "import sys; from ctc.commandline.main import main; sys.exit(main())",
        "robots",
    ]
    given = {"cwd": folder, "capture_output": True, "text": True, "check": False}
    there = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    full = subprocess.run(["/bin/sh", "-c", '"$@" > /dev/full', "sh", *command], **given, env=there)  # noqa: S603
    assert full.returncode == 2
    assert full.stderr.startswith("onepulse: the answer must be printed; No space left")
    assert full.stderr.count("\n") == 1
    closed = subprocess.run(["/bin/sh", "-c", '"$@" | true', "sh", *command], **given, env=there)  # noqa: S603
    assert "Traceback" not in closed.stderr
    enough = subprocess.run(  # noqa: S603
        ["/bin/sh", "-c", '{ "$@"; echo $? >&2; } | true', "sh", *command], **given, env=there
    )
    assert enough.stderr == "0\n"  # whoever read it has seen enough; what was to be done is done
    narrow = {**there, "PYTHONIOENCODING": "ascii"}
    said = subprocess.run([*command[:-1], "check", "own.csv"], **given, env=narrow)  # noqa: S603
    assert (said.returncode, said.stderr) == (0, "")


def test_a_finding_is_no_success(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    text = (folder / "arm.toml").read_text()
    (folder / "turned.toml").write_text(
        text.replace("gear = [107.8, -53.7]", "gear = [107.8, 53.7]")
    )
    code, out, err = run(capsys, "check", "log.csv", "--robot", "turned.toml")
    assert (code, err) == (1, "")
    assert "wrong" in out


WRONG = {
    "no command": ((), "the following arguments are required: COMMAND"),
    "another command": (("identfy",), "invalid choice: 'identfy'"),
    "no log": (
        ("check", "nix.csv", "--robot", "arm.toml"),
        "nix.csv must be a file; there is none",
    ),
    "no robot": (
        ("check", "log.csv", "--robot", "nix.toml"),
        "nix.toml must be a robot file; there is none",
    ),
    "a robot that is none": (("robots", "puma650"), "a robot of the package is one of"),
    "an unknown key": (("check", "log.csv", "--robot", "key.toml"), "Did you mean 'viscous'"),
    "an unknown unit": (("check", "log.csv", "--robot", "unit.toml"), "'rads'"),
    "another column": (("check", "own.csv", "--robot", "arm.toml"), "own.csv"),
    "an unreadable log": (("check", "arm.toml"), "must end in one of .csv"),
    "no number": (
        ("check", "nan.csv"),
        "line 43 must have finite numbers; got nan in column 'error_1",
    ),
    "a log as a path": (
        ("certify", "found.json", "--path", "own.csv"),
        (
            "own.csv must have the columns t [s], q_1, q_2 [rad]; it has 12 columns beside t. Give"
            " those alone"
        ),
    ),
    "one result for another": (
        ("report", "found.json", "--certificate", "found.json", "-o", "a.html"),
        (
            "found.json must be a file of onepulse certify or tune; it is one of onepulse identify."
            " Give that to"
        ),
    ),
    "no option": (
        ("tune", "found.json", "--limit", "-1"),
        "--limit -1; --within is: limit [pulses] (default 1). See: onepulse tune --help",
    ),
    "an output that is there": (
        ("identify", "log.csv", "--robot", "arm.toml", "-o", "own.csv"),
        "own.csv is there",
    ),
    "an output nowhere": (
        ("identify", "log.csv", "--robot", "arm.toml", "-o", "no/a.json"),
        "Make the folder first",
    ),
    "no result": (("certify", "log.csv"), "a log is to be identified first"),
    "an older version": (("certify", "old.json"), "format"),
    "another method": (
        ("identify", "log.csv", "--robot", "arm.toml", "-o", "a.json", "--method", "magic"),
        "magic",
    ),
    "a word": (
        ("identify", "log.csv", "--robot", "arm.toml", "-o", "a.json", "--unknown", "frction"),
        "'friction'?",
    ),
    "a seed": (("demo", "--seed", "-1"), "argument --seed: "),
    "no limit": (("certify", "found.json", "--within", "much"), "invalid float value: 'much'"),
    "a page that is none": (
        ("report", "found.json", "-o", "log.csv", "--force"),
        "the page must be an .html file",
    ),
    "figures in a file": (
        ("demo", "--figures", "arm.toml"),
        "arm.toml must be a folder for figures",
    ),
    "a number": (("certify", "found.json", "--samples", "many"), "invalid int value: 'many'"),
}


@pytest.mark.parametrize("name", WRONG)
def test_whatever_is_wrong_is_one_line_and_writes_nothing(
    folder, identified, capsys, monkeypatch, name
):
    monkeypatch.chdir(folder)
    text = (folder / "arm.toml").read_text()
    (folder / "key.toml").write_text(text.replace("viscous =", "viscos ="))
    (folder / "unit.toml").write_text(
        text.replace('reference_position = "rad"', 'reference_position = "rads"')
    )
    (folder / "old.json").write_text(
        '{"onepulse": "Identification", "format": 0, "provenance": {}, "content": {}}'
    )
    lines = (folder / "own.csv").read_text().splitlines()
    lines[42] = re.sub(r"^([^,]*,[^,]*,[^,]*),[^,]*", r"\1,nan", lines[42])
    (folder / "nan.csv").write_text("\n".join([*lines, ""]))
    before, (arguments, expected) = sorted(folder.iterdir()), WRONG[name]
    try:
        code, out, err = run(capsys, *arguments)
    except SystemExit as stop:  # argparse
        said = capsys.readouterr()
        code, out, err = stop.code, said.out, said.err
    assert (code, out) == (2, "")
    assert err.startswith("onepulse: ")
    assert err.count("\n") == 1
    assert expected in err
    assert sorted(folder.iterdir()) == before


def test_a_log_without_a_mapping_is_described_and_not_checked(folder, capsys, monkeypatch):
    """Without a robot file, and with one that maps no columns; the tables complete that file."""
    monkeypatch.chdir(folder)
    assert main(["check", "log.csv"]) == 0
    text = capsys.readouterr().out
    assert "every 700 us" in text
    assert 'counts = ["c1", "c2"]' in text
    assert "Nothing was checked" in text
    assert main(["check", "log.csv", "own.csv", "--json"]) in (0, 1)
    answer = json.loads(capsys.readouterr().out)
    assert list(answer["logs"]) == ["own.csv"]
    assert answer["contents"]["log.csv"]["units"]["t"] == "s"


def test_robots_of_the_package_are_written_with_their_models(tmp_path, capsys):
    code, out, err = run(capsys, "robots", "--json")
    assert (code, err) == (0, "")
    names = list(json.loads(out)["robots"])
    assert "ur5e" in names
    for name in names:
        assert run(capsys, "robots", name, "-o", tmp_path / f"{name}.toml")[0] == 0
        assert read_robot(tmp_path / f"{name}.toml").arm == read_robot(name).arm
    code, out, _ = run(capsys, "robots", "ur5e")
    assert code == 0
    assert out.startswith((FOLDER / "ur5e.toml").read_text())
    assert "# [columns]" in out


def test_the_columns_of_a_robot_file_are_those_that_a_log_of_them_is_proposed(tmp_path, capsys):
    _, out, _ = run(capsys, "robots", "new", "--dh", "2")
    # The two tables at the end of every robot file, as a user sets them into force.
    text = out[out.index("# [columns]") :].replace("# [", "[").replace("\n# ", "\n")
    tables = tomllib.loads(text)
    columns = tables["columns"]
    names = [
        name
        for value in columns.values()
        for name in (value if isinstance(value, list) else [value])
    ]
    t = 1e-3 * np.arange(400)
    q = np.column_stack([np.sin(9 * t), np.cos(8 * t)])
    log = np.column_stack([t, np.round(9000 * q), q, q])
    np.savetxt(tmp_path / "log.csv", log, header=",".join(names), delimiter=",", comments="")
    _, out, _ = run(capsys, "check", tmp_path / "log.csv")
    proposed = tomllib.loads(out[out.index("[columns]") : out.index("Nothing was checked")])
    assert proposed["columns"] == columns
    assert proposed["units"].keys() == tables["units"].keys()


UNFINISHED = {
    "period": "1e-3",
    "gear": "100",
    "motor_inertia": "1e-4",
    "motor_gain": "[0.1, 0.2]",
    "coulomb": "0.03",
    "resolution": "4096",
    "gain": "0.02",
}


def test_a_new_robot_file_is_completed_to_the_same_chain(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = urdf(1, kinds=("revolute", "revolute"))
    text = text.replace("</joint>", '<dynamics damping="0.5"/></joint>')
    (tmp_path / "robot.urdf").write_text(text)
    (tmp_path / "files").mkdir()
    made = ("robots", "new", "robot.urdf", "--tip", "l2", "-o", "files/arm.toml")
    code, out, err = run(capsys, *made)
    assert (code, out, err) == (0, 'wrote files/arm.toml; replace each "?" in it\n', "")
    assert run(capsys, *made)[0] == 2  # it is there
    code, out, err = run(capsys, "check", "log.csv", "--robot", "files/arm.toml")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert (
        "missing: rig.period, drive.gear, drive.motor_inertia, drive.motor_gain, drive.coulomb,"
        " encoder.resolution, law.gain. Replace each '?'" in err
    )
    filled = (tmp_path / "files" / "arm.toml").read_text()
    lines = {line.split(" = ")[0]: line for line in filled.splitlines() if " = " in line}
    # What is missing stands with its meaning, what the file states with its numbers.
    assert all("#" in lines[key] for key in UNFINISHED)
    assert "# the file's 0.5, 0.5 N m s/rad, on the joints" in lines["viscous"]
    for key, value in UNFINISHED.items():
        filled = filled.replace(f'{key} = "?"', f"{key} = {value}")
    (tmp_path / "files" / "arm.toml").write_text(filled)
    robot = read_robot(tmp_path / "files" / "arm.toml")
    assert robot.dynamics.chain == Chain.from_urdf("robot.urdf", tip="l2").with_rotors(
        robot.rig.drive
    )
    np.testing.assert_allclose(robot.rig.drive.torque_limit(), 1.0)  # of the file, as its damping
    np.testing.assert_allclose(robot.rig.drive.joint_viscous(), 0.5)
    assert robot.law.gain.tolist() == [0.02, 0.02]
    assert robot.rig.drive.motor_inertia.tolist() == [1e-4, 1e-4]


def test_an_arm_without_a_model_file_begins_with_rows_of_joints(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, "robots", "new", "--dh", "2", "-o", "arm.toml")
    assert (code, out, err) == (0, 'wrote arm.toml; replace each "?" in it\n', "")
    text = Path("arm.toml").read_text()
    # Each value stands with a sentence.
    values = [line for line in text.splitlines() if " = " in line and not line.startswith("#")]
    assert all(line.endswith(".") or "name = " in line for line in values)
    # Gains are in the units of the law, beside those of a drive.
    gains = {line.split()[0]: line for line in values}
    for gain in ("position", "speed", "integral"):
        assert f"[{unit_of(Cascade, gain)}]" in gains[gain]
    code, out, err = run(capsys, "check", "log.csv", "--robot", "arm.toml")
    assert (code, err.count("\n")) == (2, 1)
    assert "law.integral" in err
    assert "arm.links[0].alpha, arm.links[0].a" in err
    # A joint that turns, and a slide whose axis is that of the joint.
    text = text.replace('alpha = "?"', "alpha = 0.0").replace('theta = "?"', "theta = 0.0")
    text = text.replace('a = "?"', "a = 0.3").replace('d = "?"', "d = 0.1")
    text = text.replace('gear = "?"', "gear = [80.0, 314.159]").replace('"?"', "0.1")
    head, slide = text.rsplit("prismatic = false", 1)
    Path("arm.toml").write_text(f"{head}prismatic = true{slide}")
    robot = read_robot("arm.toml")
    expected = [
        Link(name="joint 1", a=0.3, d=0.1),
        Link(name="joint 2", a=0.3, d=0.1, prismatic=True),
    ]
    assert [*robot.dynamics.chain.links] == expected
    assert type(robot.law) is Cascade
    assert (robot.law.difference, robot.torque_delay) == (1, 0)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("new",), "or of a number of joints; got none"),
        (("new", FOLDER / "ur5e.urdf", "--dh", "6"), "got both"),
        (("new", "--dh", "0"), "must be the number of joints; got 0"),
        (("ur5e", "--dh", "6"), "go with new"),
        (("new", "none.urdf"), "none.urdf"),
        (("ur5e", "--tip", "x"), "go with new"),
        (("new", FOLDER / "ur5e.urdf", "--tip", "elbo"), "tip must be one of .*'forearm'"),
        (
            ("new", FOLDER / "ur5e.urdf", "-o", FOLDER / "ur5e.urdf", "--force"),
            "ur5e.urdf is what is read",
        ),
    ],
)
def test_what_no_robot_file_can_be_made_of(capsys, arguments, said):
    code, out, err = run(capsys, "robots", *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert re.search(said, err)


def test_options_have_their_names_in_messages():
    assert in_the_shell("Pass tip='name of a link'.", ["tip"]) == "Pass --tip 'name of a link'."
    assert (
        in_the_shell("or identify with prior=, such as 0.3.")
        == "or identify with --prior, such as 0.3."
    )
    assert (
        in_the_shell("certify with resonance=(56.3,\n    131).")
        == "certify with --resonance 56.3 131."
    )


def test_a_number_that_json_lacks_is_a_defect_and_no_negative_verdict(capsys, monkeypatch):
    """Code 1 would tell a script that the answer is no, and code 2 that its input is bad."""
    answer = Answer("", {"value": float("nan")})
    monkeypatch.setitem(commands.COMMANDS, "robots", lambda options: answer)
    assert main(["robots", "--json"]) == 3
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "defect of the library" in printed.err


def test_an_interruption_and_a_defect_have_codes_of_their_own(capsys, monkeypatch):
    for error, code, said in (
        (KeyboardInterrupt(), 130, "interrupted"),
        (TypeError("oh"), 3, "defect"),
    ):
        monkeypatch.setitem(
            commands.COMMANDS, "robots", lambda given, error=error: (_ for _ in ()).throw(error)
        )
        assert (got := run(capsys, "robots"))[0] == code
        assert said in got[2].splitlines()[-1]


def test_a_process_of_its_own(folder):
    """Nothing but the answer on standard output; no bars in a pipe."""
    command = [
        sys.executable,
        "-c",
        "import sys; from ctc.commandline.main import main; sys.exit(main())",
    ]
    done = subprocess.run(  # noqa: S603
        [*command, "check", "own.csv"], cwd=folder, capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert "fine" in done.stdout


def test_bytes_that_are_no_characters_are_printed_as_question_marks(monkeypatch, capsysbinary):
    monkeypatch.setitem(commands.COMMANDS, "robots", lambda options: Answer("a\udcffb", {}, True))
    assert main(["robots"]) == 0
    assert capsysbinary.readouterr().out == b"a?b\n"


def test_without_standard_output_the_exit_code_is_that_of_the_verdict(monkeypatch):
    monkeypatch.setattr("sys.stdout", None)
    assert main(["robots"]) == 0
