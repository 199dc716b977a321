"""A log without a mapping is described, and the mapping that the description gives reads it."""

import dataclasses
import json

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from plant import Drive, Encoder, LoadError, LogContents, Record, Rig, puma560, simulate
from plant.logs import logfile

N, n = 400, 3
RIG = Rig(
    drive=Drive(
        gear=(50.0, -101.0, 80.0),
        motor_inertia=(1e-4,) * n,
        viscous=(0,) * n,
        coulomb=(0,) * n,
        motor_gain=(0.2,) * n,
        current_limit=(10,) * n,
    ),
    encoder=Encoder(resolution=(4096, 1024, 2000)),
    period=2e-3,
)
COUNTS = np.round(9000 * np.sin(np.arange(N)[:, None] / [31, 47, 59]) + [4000, 0, 900])
Q = RIG.to_angle(COUNTS)
T = RIG.period * np.arange(N)

# How loggers name the columns of joint 1, 2, 3: time, position, torque, current, reference.
STYLES = {
    "rtde": ("timestamp", "actual_q_{}", "actual_torque_{}", "actual_current_{}", "target_q_{}"),
    "short": ("t", "q{}", "tau{}", "i{}", "q_ref{}"),
    "brackets": ("Time", "pos[{}]", "trq[{}]", "cur[{}]", "cmd_pos[{}]"),
    "joints": ("time_s", "j{}_position", "j{}_effort", "j{}_amps", "j{}_position_desired"),
    "camel": (
        "stamp",
        "jointPosition{}",
        "jointTorque{}",
        "motorCurrent{}",
        "jointPositionSetpoint{}",
    ),
}
UNITS = {"s": 1, "ms": 1e3, "us": 1e6}


def exported(path, style, time_unit, degrees, start):
    time, *names = STYLES[style]
    scale = 180 / np.pi if degrees else 1.0
    values = (scale * Q, 5 * np.cos(Q), 3 * np.sin(Q), scale * (Q + 1e-3))
    columns = {time: (start + T) * UNITS[time_unit]}
    for name, value in zip(names, values, strict=True):
        columns |= {name.format(i + 1): value[:, i] for i in range(n)}
    np.savetxt(
        path,
        np.column_stack(list(columns.values())),
        "%.15g",
        "\t",
        comments="",
        header="\t".join(columns),
    )


@settings(derandomize=True, max_examples=40, deadline=None)
@given(
    style=st.sampled_from(sorted(STYLES)),
    time_unit=st.sampled_from(sorted(UNITS)),
    degrees=st.booleans(),
    start=st.sampled_from([0.0, 17.5, 1.7e9]),
)
def test_the_mapping_of_a_description_reads_the_log(
    tmp_path_factory, style, time_unit, degrees, start
):
    path = tmp_path_factory.mktemp("log") / "run.csv"
    exported(path, style, time_unit, degrees, start)
    contents = Record.read(path)
    assert set(contents.columns) == {"t", "position", "torque", "current", "reference_position"}
    assert contents.units["t"] == time_unit
    assert contents.units["position"] == ("deg" if degrees else "rad")
    record = Record.read(path, rig=RIG, columns=contents.columns, units=contents.units)
    np.testing.assert_array_equal(record.counts, COUNTS)
    np.testing.assert_allclose(record.torque, 5 * np.cos(Q), rtol=1e-12)


def test_a_description_names_rate_gaps_and_what_is_no_number(tmp_path, capsys):
    t = np.delete(T, slice(100, 140))
    np.savez(
        tmp_path / "a.npz", stamp=1e3 * t, enc=np.delete(COUNTS, slice(100, 140), 0), note=["a"]
    )
    contents = Record.read(tmp_path / "a.npz")
    printed = capsys.readouterr().out
    assert printed == f"{contents}\n"
    assert "every 2 ms (500 Hz) for 0.798 s, 1 gap of up to 82 ms" in printed
    assert "note" in printed
    assert "no numbers" in printed
    assert contents.columns == {"t": "stamp", "counts": ["enc[0]", "enc[1]", "enc[2]"]}
    record = Record.read(
        tmp_path / "a.npz", rig=RIG, columns=contents.columns, units=contents.units
    )
    np.testing.assert_array_equal(record.counts, np.delete(COUNTS, slice(100, 140), 0))


def test_the_number_of_joints_chooses_between_columns(tmp_path):
    """Two encoders per joint, and one more: those of the rig's joints are mapped."""
    table = {"t": T, "q": Q, "motor_q": np.column_stack([Q, Q[:, :1]])}
    scipy.io.savemat(tmp_path / "a.mat", table)
    assert Record.read(tmp_path / "a.mat", rig=RIG).columns["position"] == [
        "q[0]",
        "q[1]",
        "q[2]",
    ]


def test_a_log_whose_words_say_nothing_has_no_mapping(tmp_path, capsys):
    np.savetxt(tmp_path / "a.csv", np.column_stack([T, Q]), header="a,b,w,x", delimiter=",")
    contents = Record.read(tmp_path / "a.csv")
    assert contents.columns == {}
    assert 'columns = {"t": "a", "position": [...]}' in capsys.readouterr().out


def test_the_library_s_own_file_needs_no_mapping(tmp_path):
    log = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.1)
    log.to_csv(tmp_path / "own.csv")
    assert Record.read(tmp_path / "own.csv") == log
    with pytest.raises(LoadError, match="must be a file; there is none"):
        Record.read(tmp_path / "none.csv")


def test_the_tables_of_a_robot_file_are_those_of_the_description(tmp_path):
    import tomllib

    exported(tmp_path / "run.csv", "rtde", "ms", False, 0.0)
    contents = Record.read(tmp_path / "run.csv")
    assert isinstance(contents, LogContents)
    tables = tomllib.loads(contents.toml().partition("robot file:\n")[2])
    assert tables == json.loads(json.dumps({"columns": contents.columns, "units": contents.units}))


@pytest.mark.parametrize(
    ("measured", "commanded"),
    [
        ("ist_{}", "soll_{}"),
        ("ang_i_{}", "ang_s_{}"),
        ("Winkel_Ist_{}", "Winkel_Soll_{}"),
        ("Lageist_{}", "Lagesoll_{}"),
    ],
)
@pytest.mark.parametrize("joints", ["123", "abc"])
@pytest.mark.parametrize("order", [1, -1])
def test_german_columns_are_told(tmp_path, measured, commanded, joints, order):
    """A letter behind a word names a joint: it is neither a current nor a count."""
    forms = (measured, commanded)[::order]
    names = [form.format(joint) for form in forms for joint in joints]
    head = ";".join(["Zeit", *names, *(f"Strom_{joint}" for joint in joints)])
    rows = np.column_stack([T, Q, Q, Q])
    np.savetxt(tmp_path / "a.csv", rows, header=head, delimiter=";", comments="")
    contents = Record.read(tmp_path / "a.csv")
    assert contents.columns["t"] == "Zeit"
    fields = ("position", "reference_position")[::order]
    assert [contents.columns[field] for field in fields] == [names[:3], names[3:]]
    assert len(contents.columns["current"]) == 3


@pytest.mark.parametrize(
    ("measured", "commanded", "beside", "joints"),
    [
        ("count_{}", "asked_{}", "torque_{}", "12"),
        ("enc{}", "cmd{}", "target_reached{}", "12"),
        ("{}Position", "{}Target", "{}CommandCurrent", ("upper", "rear")),
        ("{}_counts", "{}_ref", "{}_cmd_current", ("upper", "rear")),
        ("{}", "{}_target", "torque_{}", ("shoulder", "quill")),
    ],
)
def test_commands_without_a_quantity_are_of_the_positions_of_their_joints(
    tmp_path, measured, commanded, beside, joints
):
    names = [form.format(joint) for form in (measured, commanded, beside) for joint in joints]
    counts = COUNTS[:, :2] if "c" in measured else Q[:, :2]
    rows = np.column_stack([T, counts, Q[:, :2], np.sign(Q[:, :2])])
    np.savetxt(tmp_path / "a.csv", rows, header=",".join(["t", *names]), delimiter=",", comments="")
    contents = Record.read(tmp_path / "a.csv")
    assert contents.columns["reference_position"] == names[2:4]
    assert contents.units["reference_position"] == "rad"


def test_a_command_beside_commanded_positions_is_of_something_else(tmp_path):
    names = ["t", "q1", "q2", "q_ref1", "q_ref2", "command1", "command2"]
    rows = np.column_stack([T, Q[:, :2], Q[:, :2], np.cos(Q[:, :2])])
    np.savetxt(tmp_path / "a.csv", rows, header=",".join(names), delimiter=",", comments="")
    assert Record.read(tmp_path / "a.csv").columns["reference_position"] == names[3:5]


def test_angles_and_metres_of_one_log_are_proposed_joint_by_joint(tmp_path):
    names = ["position_1 [rad]", "position_2 [mm]", "commanded_1 [rad]", "commanded_2 [m]"]
    rows = np.column_stack([T, Q[:, 0], 1e3 * Q[:, 1], Q[:, :2]])
    np.savetxt(tmp_path / "a.csv", rows, header=",".join(["t", *names]), delimiter=",", comments="")
    contents = Record.read(tmp_path / "a.csv")
    assert contents.units["position"] == ["rad", "mm"]
    assert contents.columns["reference_position"] == names[2:]
    assert contents.units["reference_position"] == ["rad", "m"]


def test_commanded_angles_of_motors_are_proposed_as_such(tmp_path):
    names = ["motor_pos_1", "motor_pos_2", "motor_pos_cmd_1", "motor_pos_cmd_2"]
    rows = np.column_stack([T, Q[:, :2], Q[:, :2]])
    np.savetxt(tmp_path / "a.csv", rows, header=",".join(["t", *names]), delimiter=",", comments="")
    contents = Record.read(tmp_path / "a.csv")
    assert contents.columns["motor_position"] == names[:2]
    assert contents.columns["reference_motor_position"] == names[2:]


def described(tmp_path, columns):
    """What a table of these columns holds: name -> values (N,)."""
    rows = np.column_stack(list(columns.values()))
    np.savetxt(tmp_path / "a.csv", rows, header=",".join(columns), delimiter=",", comments="")
    return Record.read(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("error", "unit", "scale"),
    [("following_error_{} [pulses]", "pulses", 1.0), ("err_{} [rad]", "rad", 1e-3)],
)
def test_an_error_with_a_unit_is_no_position(tmp_path, error, unit, scale):
    errors = {error.format(i): scale * np.round(30 * Q[:, i]) for i in range(n)}
    positions = {f"q_{i} [rad]": Q[:, i] for i in range(n)}
    contents = described(tmp_path, {"t": T} | errors | positions)
    assert contents.columns == {"t": "t", "position": list(positions)}
    assert {str(contents.roles[name]) for name in errors} == {f"error [{unit}]"}


@pytest.mark.parametrize(
    ("name", "scale", "unit"),
    [
        ("q{}_deg", 0.01, "deg"),
        ("pos_{}_degrees", 0.01, "deg"),
        ("q{}_mrad", 1e3, "mrad"),
        ("joint_{}_pos_mm", 300.0, "mm"),
        ("q{}_gon", 50.0, "gon"),
        ("rot_pos_{}", 1.0, "rad"),
    ],
)
def test_a_unit_in_a_name_needs_no_brackets(tmp_path, name, scale, unit):
    columns = {name.format(i + 1): scale * np.sin(T + i) for i in range(n)}
    assert described(tmp_path, {"t": T} | columns).units["position"] == unit


@pytest.mark.parametrize("unit", ["deg/10", "0.1 deg", "1e-3 rad", "N mm"])
def test_a_multiple_of_a_unit_is_not_taken_for_the_unit(tmp_path, unit):
    field, name = ("torque", "tau") if "N" in unit else ("position", "q")
    columns = {f"q_{i} [rad]": Q[:, i] for i in range(n)} if "N" in unit else {}
    columns |= {f"{name}_{i} [{unit}]": 300 * Q[:, i] for i in range(n)}
    assert described(tmp_path, {"t": T} | columns).units[field] == unit


def test_times_in_a_multiple_of_a_unit_have_no_rate_yet(tmp_path):
    contents = described(tmp_path, {"t [0.1 ms]": 1e4 * T, "q1 [rad]": Q[:, 0]})
    assert contents.units["t"] == "0.1 ms"
    assert "0.1 ms" in contents.rate


def test_torques_in_a_unit_that_needs_a_constant_are_in_no_other(tmp_path):
    """Not in N m, which would be 1000 times as much; reading them asks for the constant."""
    torques = {f"tau_{i} [mNm]": 5e3 * Q[:, i] for i in range(n)}
    contents = described(tmp_path, {"t": T} | {f"q_{i}": Q[:, i] for i in range(n)} | torques)
    assert contents.units["torque"] == "mN m"
    with pytest.raises(ValueError, match='"N m per mN m": constant'):
        Record.read(contents.path, rig=RIG, columns=contents.columns, units=contents.units)


def test_a_period_in_a_name_s_unit_may_be_unusual(tmp_path):
    assert described(tmp_path, {"time_ms": 0.1 * np.arange(N), "q1": Q[:, 0]}).units["t"] == "ms"


@pytest.mark.parametrize("name", ["count", "ticks", "sample_count"])
def test_a_count_of_samples_is_no_encoder_of_three_joints(tmp_path, name):
    columns = {"t": T, name: np.arange(N)} | {f"q{i + 1}": Q[:, i] for i in range(n)}
    assert described(tmp_path, columns).columns["position"] == ["q1", "q2", "q3"]


@pytest.mark.parametrize("form", ["{}_{}", "{}[{}]", "{}.{}"])
def test_the_letter_d_of_a_pair_means_desired(tmp_path, form):
    """As in the robot states of Franka; without its partner the letter is that of a joint."""
    of = {"q": Q, "q_d": Q + 0.1, "tau_J": 5 * Q, "tau_J_d": 6 * Q}
    columns = {form.format(name, i): x[:, i] for name, x in of.items() for i in range(n)}
    assert described(tmp_path, {"t": T} | columns).columns == {"t": "t"} | {
        field: [form.format(name, i) for i in range(n)]
        for field, name in (("position", "q"), ("reference_position", "q_d"), ("torque", "tau_J"))
    }
    letters = {f"q_{letter}": Q[:, 0] for letter in "abcd"}
    assert described(tmp_path, {"t": T} | letters).columns["position"] == list(letters)


def test_an_infinite_sample_leaves_the_unit_as_it_is(tmp_path):
    angles = {f"q_{i}": Q[:, i].copy() for i in range(n)}
    angles["q_1"][7] = np.inf
    contents = described(tmp_path, {"t": T} | angles)
    assert contents.units["position"] == "rad"


@pytest.mark.parametrize(("scale", "role"), [(1.0, "error [pulses]"), (1e-3, "error")])
def test_errors_with_fractions_are_in_no_pulses(tmp_path, scale, role):
    """The joints of a group have one unit, also the one whose error is 0."""
    errors = {f"joint_position_error_{i}": scale * np.round(30 * Q[:, i]) for i in range(n)}
    errors["joint_position_error_1"][:] = 0
    contents = described(tmp_path, {"t": T} | errors)
    assert {str(contents.roles[name]) for name in errors} == {role}


@pytest.mark.parametrize("rig", [None, RIG])
def test_counts_of_a_joint_that_hardly_moves_are_counts(tmp_path, rig):
    counts = {f"pos_{i}": COUNTS[:, i].copy() for i in range(n)}
    counts["pos_1"] = np.round(COUNTS[:, 1] / 225)
    described(tmp_path, {"t": T} | counts)
    contents = Record.read(tmp_path / "a.csv", rig=rig)
    assert contents.columns["counts"] == list(counts)


def test_whole_numbers_beside_fractions_are_counts_alone(tmp_path):
    """A gripper in steps has the word of the joints, which are in rad; one of them rests at 0."""
    angles = {f"pos_{i}": Q[:, i].copy() for i in range(n)}
    angles["pos_1"][:] = 0
    described(tmp_path, {"t": T} | angles | {"gripper_pos": COUNTS[:, 0]})
    contents = Record.read(tmp_path / "a.csv", rig=RIG)
    assert contents.columns["position"] == list(angles)


def test_a_command_of_a_word_that_is_not_known_is_of_no_position(tmp_path):
    angles = {f"q_{i}": Q[:, i] for i in range(n)}
    voltages = {f"pwm_{i}": np.cos(Q[:, i]) for i in range(n)}
    commands = {f"set_pwm_{i}": np.cos(Q[:, i]) for i in range(n)}
    contents = described(tmp_path, {"t": T} | angles | voltages | commands)
    assert contents.columns == {"t": "t", "position": list(angles)}
    assert {contents.roles[name].quantity for name in commands} == {"other"}


@pytest.mark.parametrize("form", ["joint_{}", "joint_{}_pos", "axis_{}", "arm_{}/q"])
@pytest.mark.parametrize("letters", ["abc", "ABC"])
def test_the_joint_c_has_what_the_joints_a_and_b_have(tmp_path, form, letters):
    angles = {form.format(letter): Q[:, i] for i, letter in enumerate(letters)}
    contents = described(tmp_path, {"t": T} | angles)
    assert {role.quantity for name, role in contents.roles.items() if name in angles} == {
        "position"
    }


def test_the_letter_c_means_counts_where_no_joints_have_letters(tmp_path):
    counts = {f"c{i}": COUNTS[:, i] for i in range(n)}
    letters = {f"{letter}{i}": Q[:, i] for letter in "ab" for i in range(n)}
    contents = described(tmp_path, {"t": T} | letters | counts | {"joint_c": COUNTS[:, 0]})
    assert contents.columns["counts"] == list(counts)
    assert contents.roles["joint_c"].quantity == "counts"


@pytest.mark.parametrize(
    ("start", "step", "unit"),
    [
        (3e8, 1000, "us"),  # five minutes after the machine started
        (4e9, 250, "us"),  # an hour after
        (2e12, 5000, "us"),  # weeks after
        (2e8, 1, "ms"),
        (1e13, 2_000_000, "ns"),
        (1.7e9, 0.1, "s"),  # Unix times, down to the slowest logs
        (1.7e9, 1, "s"),
        (1.7e12, 100, "ms"),
        (1.7e15, 2000, "us"),
        (1.7e18, 100_000_000, "ns"),
        (1.7e18, 1e10, "ns"),
    ],
)
def test_the_step_tells_unix_times_from_a_clock_that_started_with_the_machine(
    tmp_path, start, step, unit
):
    contents = described(tmp_path, {"t": start + step * np.arange(N), "q_1": Q[:, 0]})
    assert contents.units["t"] == unit


def test_the_largest_group_is_mapped_and_the_measured_one_of_two_of_a_size(tmp_path):
    angles = {f"q_{i}": Q[:, i] for i in range(n)}
    contents = described(tmp_path, {"t": T, "motor_pos": Q[:, 0]} | angles)
    assert contents.columns["position"] == list(angles)
    actual = {f"actual_{name}": values for name, values in angles.items()}
    contents = described(tmp_path, {"t": T} | angles | actual)
    assert contents.columns["position"] == list(actual)


@pytest.mark.parametrize("form", ["q_{} [deg/10]", "arm/enc_{} (inc/rev)", "qd_{} [rad/s]"])
def test_the_slash_of_a_unit_parts_no_group(tmp_path, form):
    names = [form.format(i) for i in range(n)]
    contents = described(tmp_path, {"t": T} | dict(zip(names, Q.T, strict=True)))
    assert len({contents.roles[name].group for name in names}) == 1
    if "qd" not in form:
        assert names in contents.columns.values()


def test_words_of_an_archive_do_not_count_as_columns(tmp_path, monkeypatch):
    """They are left out, so they are not expanded; the numbers still have to fit."""
    limits = dataclasses.replace(logfile.LIMITS, columns=1 << 20)
    monkeypatch.setattr(logfile, "LIMITS", limits)
    numbers = {"t": T, **{f"q{i + 1}": Q[:, i] for i in range(n)}}
    np.savez_compressed(tmp_path / "log.npz", **numbers, note=np.zeros(1 << 19, "U1"))
    assert Record.read(tmp_path / "log.npz").text == ("note",)
    np.savez_compressed(tmp_path / "log.npz", **numbers, more=np.zeros(1 << 18))
    with pytest.raises(LoadError, match="must hold at most 1 MiB; it declares 2"):
        Record.read(tmp_path / "log.npz")


def test_columns_that_stand_beside_a_block_are_no_labels_of_it():
    columns = {"q": np.zeros((3, 2)), "q.a": np.ones(3), "q.b": np.ones(3)}
    assert logfile.LogTable(columns, {}, tuple(columns)).elements("q") == ["q[0]", "q[1]"]
    labelled = logfile.LogTable({"q": columns["q"]}, {}, ("q", "q.a", "q.b"))
    assert labelled.elements("q") == ["q.a", "q.b"]


def test_words_beside_a_column_of_a_like_name_are_told(tmp_path):
    (tmp_path / "a.csv").write_text("t,q,q.mode\n0,1,run\n0.1,2,run\n0.2,3,stop\n")
    assert Record.read(tmp_path / "a.csv").text == ("q.mode",)
    table = logfile.LogTable({"q": np.zeros((3, 2))}, {}, ("q", "q.a", "q.b", "note"))
    assert table.text() == ("note",)
