"""A fleet over weeks: what is told of robots whose truth is known, and what is refused."""

import contextlib
import copy
import csv
import dataclasses
import datetime
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from threading import Barrier

import numpy as np
import pytest

from ctc import Fleet
from ctc.campaigns import Change, Values, effect_of, seconds_of
from identification import fit_torque, identify
from plant import Record, puma560, read_records, simulate
from plant.parts import from_plain, to_plain

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
LOG = simulate(ARM, RIG, puma560.p_law(), PATH, duration=0.1)
NAMES = (*ARM.dynamics.names, "drive.viscous[1]", "drive.coulomb[0]")
NOTES = {"robot": "cell_7", "time": "2026-05-12", "temperature": 24.5}
STD = 0.01


@cache
def long_log():
    return simulate(ARM, RIG, puma560.p_law(), PATH, duration=2.0)


@cache
def fit():
    return fit_torque(ARM.dynamics, long_log(), band=20.0, unknown=NAMES)


@cache
def identified():
    record = simulate(ARM, RIG, puma560.p_law(), PATH, duration=0.5)
    return identify(ARM.dynamics, record, method="equation_error", progress=False)


def several(*notes):
    """An identification of several records, with these notes."""
    records = (dataclasses.replace(log(i), notes=each) for i, each in enumerate(notes))
    return dataclasses.replace(identified(), records=tuple(records))


def found(values):
    """What a fit that gives these values looks like."""
    return dataclasses.replace(
        fit(), values=np.array(values), covariance=STD**2 * np.eye(len(values))
    )


def log(i, robot="cell_7", week=0, **more):
    """The i-th log, unlike all others."""
    day = str(np.datetime64("2026-03-02") + 7 * week)
    return dataclasses.replace(
        LOG, t=LOG.t * (1 + 1e-6 * i), notes={"robot": robot, "time": day, **more}
    )


def filled(path, weeks=8, robots=6, growing=None, slope=0.0, seed=0):
    """A fleet of known truth: values about 2, robots differ by 0.2, weeks by 0.03; one may grow."""
    random, fleet = np.random.default_rng(seed), Fleet(path)
    own = 2 + 0.2 * random.standard_normal((robots, len(NAMES)))
    for week in range(weeks):
        for robot in range(robots):
            warm = 20 + 5 * random.standard_normal()
            y = own[robot] + np.hypot(0.03, STD) * random.standard_normal(len(NAMES))
            y[-2] += slope * (warm - 20)
            if robot == growing:
                y[-1] += 0.1 * week
            fleet.add(log(week * robots + robot, f"cell_{robot}", week, temperature=warm), found(y))
    return fleet, own


# -- notes of a record ---------------------------------------------------------------------------
def test_notes_are_kept_by_files_and_processes(tmp_path):
    record = dataclasses.replace(LOG, notes=NOTES)
    record.to_csv(tmp_path / "log.csv")
    again = (from_plain(to_plain(record)), Record.from_csv(tmp_path / "log.csv"),
             copy.deepcopy(record), record.cut(0.02), record.resampled(2 * RIG.period))  # fmt: skip
    assert [each.notes for each in again] == 5 * [NOTES]
    assert record == LOG
    assert LOG.notes == {}


def test_notes_come_from_names_of_files_and_from_columns(tmp_path):
    (tmp_path / "cell_7").mkdir()
    LOG.to_csv(tmp_path / "cell_7" / "run_2026-05-12_24.5C.csv")
    pattern = str(tmp_path / "*" / "*.csv")
    assert read_records(pattern, notes="{robot}/run_{time}_{temperature}C")[0].notes == NOTES
    assert read_records(pattern, notes={"robot": "x"})[0].notes == {"robot": "x"}
    with pytest.raises(ValueError, match=r"notes must fit the name 'run_2026-05-12_24.5C.csv'"):
        read_records(pattern, notes="{robot}_at_{time}")
    with pytest.raises(ValueError, match="in braces"):
        read_records(pattern, notes="robot")
    table = {"q": np.zeros((4, 2)), "warm": [np.nan, 20, 22, 24], "clock": [5e8, 6e8, 7e8, 8e8]}
    record = Record.from_table(
        table, rig=RIG, columns={"counts": "q", "temperature": "warm", "time": "clock"}
    )
    assert record.notes == {"temperature": 22.0, "time": 5e8}
    assert (record.valid == 1).all()


@pytest.mark.parametrize(
    "wrong", [{"temperature": "warm"}, {"robot": ""}, {3: "x"}, {"load": np.nan}, ["robot"]]
)
def test_notes_that_are_none_are_refused(wrong):
    with pytest.raises(ValueError, match="note"):
        dataclasses.replace(LOG, notes=wrong)


# -- the statistics ------------------------------------------------------------------------------
def test_effects_are_those_that_made_the_values():
    random, J, R = np.random.default_rng(1), 300, 12
    robot = np.tile(np.arange(J), R)
    warm, std = 5 * random.standard_normal(J * R), random.uniform(0.01, 0.05, J * R)
    value = 2 + 0.2 * random.standard_normal(J)[robot] + 0.03 * random.standard_normal(J * R)
    value += std * random.standard_normal(J * R) - 0.004 * warm
    names = tuple(map(str, range(J)))
    effect = effect_of(
        Values("f1", "f1", "", names, robot, np.repeat(np.arange(R), J) * 1.0, warm, value, std)
    )
    # three standard deviations of a deviation's
    assert effect.robots == pytest.approx(0.2, rel=3 / np.sqrt(2 * J))
    # noise of the logs is twice that of weeks
    assert effect.weeks == pytest.approx(0.03, rel=6 / np.sqrt(2 * J * R))
    assert abs(effect.slope + 0.004) < 4 * effect.slope_std < 0.002
    assert effect.mean == pytest.approx(2, abs=4 * 0.2 / np.sqrt(J))
    assert effect.freedom == J * (R - 1)


def test_false_alarms_are_as_rare_as_said(tmp_path):
    """Of robots that do not change: differences in their standard deviations are Student's, and
    so is what is told.
    """
    chances, z = [], []
    for seed in range(5):
        # too few for a line
        fleet, own = filled(tmp_path / f"{seed}.sqlite", weeks=2, robots=20, seed=seed)
        random = np.random.default_rng(100 + seed)
        for robot in range(20):
            y = own[robot] + np.hypot(0.03, STD) * random.standard_normal(len(NAMES))
            looked = fleet.judge(log(999, f"cell_{robot}", 3, temperature=20.0), found(y)).looked
            chances.append(looked[0].false_alarm)
            z += [(each.after - each.before) / each.std for each in looked]
    # 1,100 of them, of 55 variances of 20 degrees
    assert np.std(z) == pytest.approx(np.sqrt(20 / 18), rel=0.08)
    # three standard deviations of 100
    assert (np.array(chances) < 0.2).mean() == pytest.approx(0.18, abs=0.12)


def test_a_change_is_named(tmp_path):
    fleet, own = filled(tmp_path / "fleet.sqlite", robots=30)
    y = own[3] + np.array([*np.zeros(len(NAMES) - 1), 0.5])
    judged = fleet.judge(log(999, "cell_3", 9, temperature=20.0), found(y), level=1e-3)
    assert [each.name for each in judged.changes] == ["drive.coulomb[0]"]
    assert judged.verdict.startswith("Coulomb friction of joint 2 up 2")
    assert "%" in judged.verdict
    assert fleet.judge(log(999, "cell_3", 9, temperature=20.0), found(own[3])).verdict == "same arm"


def test_a_change_comes_with_what_the_log_states_wrongly(tmp_path):
    """In the words of the checkup; none beside a right log, or where nothing is doubted."""
    fleet, own = filled(tmp_path / "fleet.sqlite")
    notes = {"robot": "cell_3", "time": "2026-05-04", "temperature": 20.0}
    right = dataclasses.replace(long_log(), notes=notes)
    turned = dataclasses.replace(right, torque=-right.torque, current=None)
    changed = found(own[3] + np.array([*np.zeros(len(NAMES) - 1), 0.5]))
    cause, *_ = turned.check().causes
    judgement = fleet.judge(turned, changed)
    assert cause.sentence in judgement.statements[0]
    assert cause.sentence in " ".join(str(judgement).split())
    assert fleet.judge(right, changed).statements == ()
    assert fleet.judge(turned, found(own[3])).statements == ()
    # What a fit found in its log may also hide a change.
    doubted = dataclasses.replace(found(own[3]), causes=(cause,))
    judgement = fleet.judge(turned, doubted)
    assert (judgement.changes, judgement.statements) == ((), (cause.line,))
    assert judgement.verdict == f"wrong statements: {cause.line}"


def test_what_grows_is_seen_in_a_line_before_it_stands_out(tmp_path):
    fleet, _ = filled(tmp_path / "fleet.sqlite", growing=2)
    first = next(iter(fleet))
    assert (first.robot, first.looked[0].name) == ("cell_2", "drive.coulomb[0]")
    assert first.looked[0].since is not None
    assert [each.robot for each in fleet if each.changes] == ["cell_2"]


def test_temperature_is_taken_out_before_a_log_is_judged(tmp_path):
    fleet, own = filled(tmp_path / "fleet.sqlite", robots=20, slope=-0.02)
    effect = next(each for each in fleet.effects() if each.of.name == "drive.viscous[1]")
    assert effect.slope == pytest.approx(-0.02, abs=4 * effect.slope_std)
    y = own[4] + np.array([*np.zeros(len(NAMES) - 2), -0.02 * 15, 0])
    assert fleet.judge(log(999, "cell_4", 9, temperature=35.0), found(y)).verdict == "same arm"
    assert (
        fleet.judge(log(999, "cell_4", 9, temperature=20.0), found(y)).changes[0].name
        == "drive.viscous[1]"
    )


def test_a_robot_unlike_the_others_is_set_apart(tmp_path):
    fleet, own = filled(tmp_path / "fleet.sqlite", robots=12)
    odd = own[5] + np.array([2.0, *np.zeros(len(NAMES) - 1)])
    for week in range(3):
        fleet.add(log(500 + week, "odd", week), found(odd))
    effect = fleet.effects()[0]
    apart = [
        robot for robot, chance in zip(effect.of.robots, effect.apart, strict=True) if chance < 0.01
    ]
    assert apart == ["odd"]
    assert effect.robots < 0.35  # as without it


def test_a_robot_whose_logs_scatter_is_not_set_apart():
    """Its mean of 6 is known to 7 only: the others' small scatter is not its own."""
    logs, robots = 10, 5
    robot = np.tile(np.arange(robots), logs)
    week = np.repeat(np.arange(logs), robots)
    sign = (-1.0) ** week
    value = np.where(robot == 4, 6 + 20 * sign, sign)
    unknown = np.full(len(value), np.nan)
    names = tuple(map(str, range(robots)))
    values = Values("f1", "f1", "", names, robot, 1.0 * week, unknown, value, 0 * value + 0.01)
    effect = effect_of(values)
    assert effect.weeks == pytest.approx(1.0, rel=0.2)  # that of the other four
    assert effect.std[4] == pytest.approx(20 / np.sqrt(10), rel=0.1)
    assert effect.apart.min() > 0.1


@pytest.mark.parametrize(("robots", "most"), [(6, 1), (8, 2)])
def test_a_quarter_of_the_fleet_at_most_is_set_apart(robots, most):
    value = np.r_[0.1 * np.arange(robots - 3), 100.0, 1e5, 1e9]
    names = tuple(map(str, range(robots)))
    unknown = np.full(robots, np.nan)
    effect = effect_of(
        Values("f1", "f1", "", names, np.arange(robots), unknown, unknown, value, 0 * value + 1)
    )
    assert (effect.apart < 0.01).sum() == most


# -- the file ------------------------------------------------------------------------------------
def test_the_file_is_as_documented_and_adding_again_replaces(tmp_path):
    fleet, own = filled(tmp_path / "fleet.sqlite", weeks=2)
    fleet.add(log(0, "cell_0", 0), found(own[0]))
    assert len(fleet) == 12
    with contextlib.closing(sqlite3.connect(tmp_path / "fleet.sqlite")) as base:
        text = """select value from parameters join logs using (identification)
            join identifications on identifications.id = identification join robots on robots.id = robot
            where robots.name = 'cell_0' and parameters.name = 'f1' order by time"""
        assert base.execute(text).fetchone() == (own[0][0],)
        assert base.execute("select count(*) from logs").fetchone() == (12,)
        assert base.execute("select count(*) from parameters").fetchone() == (12 * len(NAMES),)
    rows = Fleet(tmp_path / "fleet.sqlite").parameters()
    assert rows == fleet.parameters()
    assert rows[0]._fields == (
        "robot",
        "time",
        "temperature",
        "name",
        "label",
        "value",
        "std",
        "unit",
    )


def test_csv_and_parquet_have_the_same_rows(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    fleet, _ = filled(tmp_path / "fleet.sqlite", weeks=2)
    fleet.to_csv(tmp_path / "fleet.csv")
    fleet.to_parquet(tmp_path / "fleet.parquet")
    rows = [row._asdict() for row in fleet.parameters()]
    assert parquet.read_table(tmp_path / "fleet.parquet").to_pylist() == rows
    with open(tmp_path / "fleet.csv", encoding="utf-8", newline="") as file:
        assert list(csv.DictReader(file)) == [
            {name: str(value) for name, value in row.items()} for row in rows
        ]
    with pytest.raises(ValueError, match="target must be a new file"):
        fleet.to_csv(tmp_path / "fleet.csv")


@pytest.mark.slow
def test_the_page_does_not_grow_with_logs(tmp_path):
    sizes = []
    for weeks, robots in ((6, 16), (30, 40)):
        fleet, _ = filled(tmp_path / f"{weeks}.sqlite", weeks=weeks, robots=robots, growing=3)
        fleet.report(tmp_path / f"{weeks}.html")
        page = (tmp_path / f"{weeks}.html").read_text()
        assert "cell_3" in page
        assert "Coulomb friction of joint 2 up" in page
        sizes.append(len(page))
    assert sizes[1] < 1.6 * sizes[0]  # 12.5 times the logs; the figure has up to 60 instants


def stated(path, values, assumed=()):
    """A fleet of these values (weeks, robots, k); those at the indices `assumed` have no std."""
    fleet = Fleet(path)
    for week, robot in np.ndindex(values.shape[:2]):
        variance = np.full(len(NAMES), STD**2)
        variance[[k for w, r, k in assumed if (w, r) == (week, robot)]] = 0.0
        result = dataclasses.replace(found(values[week, robot]), covariance=np.diag(variance))
        fleet.add(log(week * values.shape[1] + robot, f"cell_{robot}", week), result)
    return fleet


def scattered(weeks, robots):
    return 2 + 0.03 * np.random.default_rng(0).standard_normal((weeks, robots, len(NAMES)))


def test_the_dates_of_the_page_are_those_of_all_parameters(tmp_path):
    """The first one is assumed in the last weeks."""
    assumed = [(week, robot, 0) for week in (2, 3) for robot in (0, 1)]
    fleet = stated(tmp_path / "fleet.sqlite", scattered(4, 2), assumed)
    fleet.report(tmp_path / "page.html")
    assert "8 identifications, 2026-03-02 to 2026-03-23" in (tmp_path / "page.html").read_text()


def test_the_legend_names_every_robot_also_where_the_first_panel_lacks_it(tmp_path):
    values = scattered(4, 4)
    # The surest change is of a parameter that the other robot does not have.
    values[-1, 1, 0] += 3.0
    values[-1, 2, 1] += 1.0
    axes = stated(tmp_path / "fleet.sqlite", values, [(week, 2, 0) for week in range(4)]).plot()
    axes[0, 0].figure.canvas.draw()
    names = [text.get_text() for text in axes[0, 0].get_legend().get_texts()]
    assert names == ["nine in ten robots", "cell_1", "cell_2"]
    points = [[len(curve.lines[0].get_xdata()) for curve in axis.containers] for axis in axes.flat]
    assert points[:2] == [[4, 0], [4, 4]]


def test_a_change_from_zero_is_no_percentage(tmp_path):
    values = scattered(4, 4)
    values[:, 1, 0] = 0, 0, 0, 5
    axis = stated(tmp_path / "fleet.sqlite", values).plot()[0, 0]
    assert "%" not in axis.get_ylabel()
    np.testing.assert_array_equal(axis.containers[0].lines[0].get_ydata(), values[:, 1, 0])


def test_a_log_does_not_speak_for_itself(tmp_path):
    """In a small fleet a defect would widen what weeks differ by, and excuse itself."""
    fleet, own = filled(tmp_path / "fleet.sqlite", weeks=4, robots=2, seed=3)
    new, y = log(99, "cell_1", 5, temperature=20.0), own[1] + 0.6 * np.eye(len(NAMES))[-1]
    before = fleet.judge(new, found(y))
    fleet.add(new, found(y))
    assert before.changes
    assert fleet.judge(new, found(y)).verdict == before.verdict == next(iter(fleet)).verdict
    with pytest.raises(ValueError, match="this one is of 'cell_1' already"):
        fleet.add(new, found(y), notes={"robot": "cell_0"})
    assert [row.robot for row in fleet.parameters()][-1] == "cell_1"


@pytest.mark.parametrize(("change", "said"), [
    (lambda record, fit: (dataclasses.replace(record, notes={"time": 0.0}), fit), "robot is missing"),
    (lambda record, fit: (dataclasses.replace(record, notes={"robot": "a"}), fit), "time is missing"),
    (lambda record, fit: (several({"robot": "a", "time": 5e8}, {"time": 5e8}),), "robot is missing"),
    (lambda record, fit: (several({"robot": "a"}, {"robot": "a"}),), "time is missing"),
    (lambda record, fit: (several({"robot": "a", "time": 5e8}, {"robot": "b"}),), "got a, b"),
    (lambda record, fit: (dataclasses.replace(record, notes={"robot": "a", "time": "May"}), fit), "time must be Unix"),
    (lambda record, fit: (dataclasses.replace(record, notes={"robot": "a", "time": 17e17}), fit), "time must be Unix"),
    (lambda record, fit: (fit,), "got TorqueFit"),
    (lambda record, fit: (), "got nothing"),
])  # fmt: skip
def test_what_is_no_log_of_a_robot_is_refused(tmp_path, change, said):
    fleet = Fleet(tmp_path / "fleet.sqlite")
    with pytest.raises(ValueError, match=said):
        fleet.add(*change(log(0), fit()))
    with pytest.raises(ValueError, match="notes must be of type Mapping; got a value of type list"):
        fleet.add(log(0), fit(), notes=["a"])
    assert len(fleet) == 0


@pytest.mark.parametrize("given", [7, 7.0, np.int64(7), "7"])
@pytest.mark.parametrize("by_call", [True, False])
def test_a_robot_has_one_name_however_it_is_given(tmp_path, given, by_call):
    """A record keeps a number as 7.0."""
    fleet = Fleet(tmp_path / "fleet.sqlite")
    record = log(0, "other" if by_call else given)
    fleet.add(record, fit(), notes={"robot": given} if by_call else None)
    assert fleet.parameters()[0].robot == "7"
    with pytest.raises(ValueError, match="robot is missing"):
        fleet.add(record, fit(), notes={"robot": None})


@pytest.mark.parametrize("notes", [({"time": 5e8}, {}), ({}, {"time": 5e8})])
def test_any_record_of_an_identification_gives_its_time(tmp_path, notes):
    fleet = Fleet(tmp_path / "fleet.sqlite")
    fleet.add(several(*({"robot": "a", **each} for each in notes)))
    assert fleet.parameters()[0].time == 5e8


MAY = datetime.datetime(2026, 5, 12, tzinfo=datetime.UTC)


@pytest.mark.parametrize(
    ("time", "seconds"),
    [
        (datetime.date(2026, 5, 12), MAY.timestamp()),
        ("20260512", MAY.timestamp()),
        (MAY, MAY.timestamp()),
        ("1711122510", 1711122510.0),
        ("17111225101", 17111225101.0),
    ],
)
def test_times_are_read(time, seconds):
    assert seconds_of(time) == seconds


@pytest.mark.parametrize("time", [1711122510123, "1711122510123", 20260512, None])
def test_times_that_are_none_are_refused(time):
    """Milliseconds look like a compact date of the year 1711."""
    with pytest.raises(ValueError, match="time must be Unix seconds"):
        seconds_of(time)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (2.0, 2.2, "f up 10 %"),
        (-2.0, -1.9, "f down 5 %"),
        (2.0, 5.0, "f up 150 %"),
        (0.5, -0.5, "f changed by -1 Nm"),
        (0.01, 2.0, "f changed by +2 Nm"),
    ],
)
def test_a_change_in_words(before, after, said):
    assert str(Change("f", "f", "Nm", before, after, 0.1, 1e-6)) == said


def test_bad_files_and_empty_fleets_are_refused_in_a_line(tmp_path):
    (tmp_path / "text").write_text("no database, and long enough to be told from one")
    with pytest.raises(ValueError, match="file is not a database"):
        Fleet(tmp_path / "text")
    with pytest.raises(ValueError, match="unable to open"):
        Fleet(tmp_path / "none" / "fleet.sqlite")
    with pytest.raises(ValueError, match="must be a file; got ':memory:'"):
        Fleet(":memory:")
    with contextlib.closing(sqlite3.connect(tmp_path / "other")) as base:
        base.execute("create table x (y)")
    with pytest.raises(ValueError, match="is another database"):
        Fleet(tmp_path / "other")
    fleet = Fleet(tmp_path / "fleet.sqlite")
    for draw in (fleet.plot, lambda: fleet.report(tmp_path / "page.html")):
        with pytest.raises(ValueError, match="it is empty"):
            draw()
    fleet.add(log(0), fit())
    assert next(iter(fleet)).verdict.startswith("not judged: it has no log before")
    fleet.report(tmp_path / "page.html")
    assert fleet.judge(log(1, week=1), fit()).verdict.startswith(
        "not judged: no robot has two logs"
    )
    with pytest.raises(ValueError, match="level must be between"):
        fleet.judge(log(1, week=1), fit(), level=2)


def test_two_logs_of_one_time_are_two(tmp_path):
    """The later one is judged with its own temperature and values."""
    fleet, own = filled(tmp_path / "fleet.sqlite", slope=-0.02)
    hot = log(998, "cell_3", 9, temperature=40.0)
    fleet.add(hot, found(own[3]))
    cold = log(999, "cell_3", 9, temperature=10.0)
    fleet.add(cold, found(own[3] + 0.1))
    judgement = next(each for each in fleet if each.robot == "cell_3")
    assert judgement.looked == fleet.judge(cold, found(own[3] + 0.1)).looked


def test_a_file_that_cannot_be_written_is_refused_in_a_line(tmp_path, monkeypatch):
    fleet = Fleet(tmp_path / "fleet.sqlite")
    connect = sqlite3.connect

    def read_only(path):
        base = connect(path)
        base.execute("pragma query_only = on")
        return base

    monkeypatch.setattr(sqlite3, "connect", read_only)
    with pytest.raises(ValueError, match=r"fleet.sqlite: attempt to write a readonly database"):
        fleet.add(log(0), fit())


def test_a_file_is_made_whole_or_not_at_all(tmp_path, monkeypatch):
    connect = sqlite3.connect

    def interrupted(path):
        """A connection that ends before the version is written."""
        base = connect(path)
        last = (sqlite3.SQLITE_PRAGMA, "user_version")

        def allowed(action, name, value, *_):
            ends = (action, name) == last and value
            return sqlite3.SQLITE_DENY if ends else sqlite3.SQLITE_OK

        base.set_authorizer(allowed)
        return base

    with monkeypatch.context() as patched:
        patched.setattr(sqlite3, "connect", interrupted)
        with pytest.raises(ValueError, match="not authorized"):
            Fleet(tmp_path / "fleet.sqlite")
    assert len(Fleet(tmp_path / "fleet.sqlite")) == 0


def test_several_make_one_file_together(tmp_path):
    barrier = Barrier(8)

    def made(i):
        barrier.wait()
        return len(Fleet(tmp_path / f"{i // 8}.sqlite"))

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(made, range(80))) == 80 * [0]
