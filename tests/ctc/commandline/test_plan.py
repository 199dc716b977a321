"""``onepulse campaign``: the other commands over many robots' logs, by a plan."""

import json
import shutil

import pytest

from ctc import Fleet
from ctc.commandline import main, typed_arguments
from identification import Identification
from plant import puma560, read_robot, simulate, write_robot

PLAN = """
folder = "study"
do = ["check", "identify", "certify"]

[robots.left]
robot = "paper_puma560"
logs = "left_*.csv"

[robots.right]
robot = "paper_puma560"
logs = ["right.csv"]

[identify]
seed = 3

[certify]
samples = 20
within = 40
bandwidth = 150
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cell")
    robot = read_robot("paper_puma560")
    record = simulate(robot.arm, robot.rig, robot.law, puma560.reference(), duration=1.0)
    for name in ("left_1", "left_2"):
        record.to_csv(folder / f"{name}.csv")
    (folder / "right.csv").write_text("t,what\n0,1\n")
    (folder / "plan.toml").write_text(PLAN)
    return folder


def run(capsys, *arguments):
    code = main(["campaign", *map(str, arguments)])
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.mark.slow
def test_a_plan_fills_a_fleet_and_writes_its_page(place, capsys):
    (place / "fleet.toml").write_text("""folder = "weeks"
do = ["identify"]
fleet = "cell.sqlite"
notes = "left_{week}"

[robots.left]
robot = "paper_puma560"
logs = "left_*.csv"
""")
    code, out, err = run(capsys, place / "fleet.toml")
    assert (code, err) == (1, "")
    assert (
        "left/left_1: not in the fleet: the record must have notes of robot and time; time is"
        " missing" in out
    )
    text = (
        (place / "fleet.toml")
        .read_text()
        .replace("left_{week}", "{robot}_{time}")
        .replace("_*.csv", "_2026*.csv")
    )
    for day in ("2026-05-04", "2026-05-11"):
        shutil.copyfile(place / "left_1.csv", place / f"left_{day}.csv")
    (place / "fleet.toml").write_text(text.replace("weeks", "dated"))
    code, out, err = run(capsys, place / "fleet.toml", "--json")
    assert (code, err, json.loads(out)["fleet"]) == (0, "", {})
    # one log, put twice
    assert [row.time for row in Fleet(place / "cell.sqlite").parameters()][::9] == [1778457600.0]
    assert (
        "0 of 1 robots: the last log shows the same arm; 1 cannot be judged yet."
        in (place / "cell.html").read_text()
    )
    (place / "fleet.toml").write_text(text.replace('"cell.sqlite"', "3"))
    code, out, err = run(capsys, place / "fleet.toml")
    assert code == 2
    assert "fleet of" in err
    for path in place.glob("left_2026*.csv"):
        path.unlink()


def test_a_plan_from_end_to_end(place, capsys):
    code, out, err = run(capsys, place / "plan.toml", "--json")
    data = json.loads(out)
    assert (code, err) == (1, ""), err
    assert sorted(data["results"]) == ["left/left_1", "left/left_2"]
    assert list(data["errors"]) == ["right/right"]
    assert "right.csv" in data["errors"]["right/right"]
    assert data["results"]["left/left_1"]["certify"]["samples"] == 20
    found = Identification.load(place / "study" / "left" / "left_1" / "found.json")
    assert found.search.seed == 3

    code, out, err = run(capsys, place / "plan.toml", "--status")
    assert (code, out.splitlines()[0]) == (0, "2 done, 0 open, 1 failed, of 3 logs")
    code, out, err = run(capsys, place / "plan.toml")
    assert code == 2
    assert "holds a campaign. Pass --resume" in err
    before = (place / "study" / "left" / "left_1" / "found.json").stat().st_mtime_ns
    code, out, err = run(capsys, place / "plan.toml", "--resume")
    assert code == 1
    assert "right/right: failed" in out
    assert (place / "study" / "left" / "left_1" / "found.json").stat().st_mtime_ns == before
    # one more log, first in the alphabet
    shutil.copyfile(place / "left_1.csv", place / "left_0.csv")
    (place / "left_1.csv").touch()
    code, out, err = run(capsys, place / "plan.toml", "--resume")
    (place / "left_0.csv").unlink()
    assert (code, out.splitlines()[0]) == (1, "3 logs done, 0 with a negative verdict, 1 failed")
    assert (place / "study" / "left" / "left_1" / "found.json").stat().st_mtime_ns == before


@pytest.mark.parametrize("certified", [False, True])
def test_a_report_has_the_certificate_if_the_plan_makes_one(certified, tmp_path):
    steps = ["check", "identify", *(["certify"] if certified else []), "report"]
    arguments = typed_arguments("report", {"do": steps}, "arm.toml", "log.csv", tmp_path)
    assert ("--certificate" in arguments) == certified
    assert (str(tmp_path / "certificate.json") in arguments) == certified


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[identify]", "[identfy]", "must be one of"),
        ("seed = 3", "sed_of = 3", "unrecognized arguments: --sed-of"),
        ('"left_*.csv"', '"wrong_*.csv"', "'wrong_*.csv' matches nothing"),
        ('"check", "identify", "certify"', '"certify"', "must have identify before certify"),
        ('"check", "identify", "certify"', '"identify", "check"', "in this order"),
        ('robot = "paper_puma560"\nlogs = "left', 'robot = "nothing"\nlogs = "left', "nothing"),
        ('folder = "study"', "", "must have folder"),
        ("[certify]", "[certify", "must be a plan in TOML"),
        ('folder = "study"', 'folder = "new"\nexecutor = "cloud"', "executor must be threads, processes or dask:"),
        ('folder = "study"', 'folder = "new"\nexecutor = 3', "executor must be of type str"),
        ('"left_*.csv"', "3", "must have texts robot and logs"),
        ('"left_*.csv"', "''", "must have texts robot and logs"),
        ('["right.csv"]', '["right.csv", "r*.csv"]', "two are 'right/right'"),
        ("[identify]", "[identify]\noutput = 'mine.json'", "must not have 'output'"),
        ('folder = "study"', 'folder = "new"\nreport = 3', "report of"),
        ("[robots.left]", '[robots."hall/left"]', "'hall/left'"),
        ("[robots.left]", '[robots.".."]', "'..'"),
        ("[identify]", "[identify]\nout = 'mine.json'", "must not have 'out'"),
        ('folder = "study"', 'folder = "new"\nfleet = "cell.html"', "fleet of"),
    ],
)  # fmt: skip
def test_bad_plans_are_one_line(place, capsys, old, new, said):
    (place / "bad.toml").write_text(PLAN.replace(old, new, 1))
    try:
        code, out, err = run(capsys, place / "bad.toml", "--resume")
    except SystemExit as stop:
        code, err = stop.code, capsys.readouterr().err
    assert code == 2
    assert said in err
    assert err.count("\n") == 1
    assert not (place / "new").exists()


def checked(folder, log, robot="paper_puma560"):
    """A plan that checks these logs of one robot."""
    lines = 'folder = "study"', 'do = ["check"]', "[robots.left]"
    (folder / "plan.toml").write_text("\n".join([*lines, f"robot = {robot!r}", f"logs = {log!r}"]))
    return folder / "plan.toml"


@pytest.mark.parametrize("pattern", ["*.csv", "log[2].csv"])
def test_brackets_in_the_names_of_folder_and_log_are_no_pattern(capsys, tmp_path, pattern):
    folder = tmp_path / "cell[1]"
    folder.mkdir()
    (folder / "log[2].csv").write_text("t,what\n0,1\n")
    code, out, err = run(capsys, checked(folder, pattern), "--json")
    assert (code, err, list(json.loads(out)["results"])) == (0, "", ["left/log[2]"])


def test_a_log_may_be_a_folder(capsys, tmp_path):
    """As a rosbag2 is; this one is empty, which its task says."""
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("nothing: 0")
    code, out, err = run(capsys, checked(tmp_path, "bag"), "--json")
    assert (code, err, list(json.loads(out)["errors"])) == (1, "", ["left/bag"])


@pytest.mark.parametrize("changed", ["arm.toml", "log.csv"])
def test_a_changed_file_is_other_work(capsys, tmp_path, changed):
    """Its old result must not pass for the new one's. A log without counts is quick."""
    (tmp_path / "log.csv").write_text("t,what\n0,1\n")
    write_robot(read_robot("paper_puma560"), tmp_path / "arm.toml")
    plan = checked(tmp_path, "log.csv", "arm.toml")
    assert run(capsys, plan)[0] == run(capsys, plan, "--resume")[0] == 0
    with open(tmp_path / changed, "a") as file:
        file.write("\n")
    code, _, err = run(capsys, plan, "--resume")
    assert code == 2
    assert "other work of this name" in err


def test_status_of_nothing(place, capsys, tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN)
    code, out, err = run(capsys, tmp_path / "plan.toml", "--status")
    assert code == 2
    assert "there is none" in err
