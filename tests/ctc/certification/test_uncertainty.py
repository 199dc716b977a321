"""One part states what is not known: in a file of its own, in a robot file, on the command line."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from ctc import Uncertainty
from ctc.commandline import command_parser, stated_uncertainty
from plant import Part, read_robot, write_robot

STATED = Uncertainty(
    friction=0.02,
    resonance=((40, 80), (30, 50)),
    lag=1e-3,
    load=(0, 0.5),
    load_position=(0, -0.4, 0),
    phase=False,
    friction_drift=(-0.1, 0.1),
)


def test_a_robot_file_and_a_file_of_its_own_give_it_back(tmp_path):
    write_robot(
        dataclasses.replace(read_robot("paper_puma560"), uncertainty=STATED), tmp_path / "arm.toml"
    )
    text = (tmp_path / "arm.toml").read_text(encoding="utf-8")
    assert "[uncertainty]" in text
    assert "ripple" not in text  # what is not stated
    assert read_robot(tmp_path / "arm.toml").uncertainty == STATED
    STATED.save(tmp_path / "stated.json")
    assert Part.load(tmp_path / "stated.json") == STATED


def test_a_misspelt_key_of_a_robot_file_is_refused_with_the_nearest(tmp_path):
    write_robot(
        dataclasses.replace(read_robot("paper_puma560"), uncertainty=STATED), tmp_path / "arm.toml"
    )
    text = (tmp_path / "arm.toml").read_text(encoding="utf-8")
    (tmp_path / "wrong.toml").write_text(
        text.replace("\nfriction =", "\nfrictoin ="), encoding="utf-8"
    )
    with pytest.raises(
        ValueError, match=r"\[uncertainty\] must have keys of Uncertainty; got 'frictoin'"
    ):
        read_robot(tmp_path / "wrong.toml")


def test_options_of_the_command_line_go_before_the_robot_file(tmp_path):
    path = tmp_path / "arm.toml"
    write_robot(dataclasses.replace(read_robot("paper_puma560"), uncertainty=STATED), path)
    given = command_parser().parse_args(
        ["certify", "found.json", "--robot", str(path), "--lag", "0", "2e-3", "--delay", "1e-4"]
    )
    found = SimpleNamespace(covariance=np.eye(1))
    assert stated_uncertainty(given, found) == dataclasses.replace(
        STATED, lag=(0, 2e-3), delay=1e-4
    )
    assert (
        stated_uncertainty(command_parser().parse_args(["tune", "found.json"]), found)
        == Uncertainty()
    )
    write_robot(read_robot("paper_puma560"), tmp_path / "bare.toml")
    given = command_parser().parse_args(
        ["tune", "found.json", "--robot", str(tmp_path / "bare.toml")]
    )
    with pytest.raises(ValueError, match=r"must have a table \[uncertainty\]; it has none"):
        stated_uncertainty(given, found)


def test_three_ends_of_a_range_are_refused(capsys):
    with pytest.raises(SystemExit):
        command_parser().parse_args(["certify", "found.json", "--lag", "0", "1", "2"])
    assert "the two ends of a range; got 3" in capsys.readouterr().err


def test_print_names_what_is_stated_and_nothing_else():
    rows = {line.split()[0]: line for line in str(STATED).splitlines()[1:]}
    assert set(rows) == {
        "friction",
        "resonance[0]",
        "resonance[1]",
        "damping_ratio",
        "load",
        "lag",
        "friction_drift",
    }
    assert rows["resonance[1]"].split()[1:] == ["30", "to", "50", "Hz"]
    assert rows["friction_drift"].split()[1:] == ["-0.1", "to", "0.1", "of", "it"]


def test_numbers_are_kept_as_they_are_used():
    assert STATED.lag == (1e-3, 1e-3)
    assert STATED.damping_ratio == (0.01, 0.03)
    np.testing.assert_array_equal(STATED.load_position, (0, -0.4, 0))
    assert STATED.imperfections["lag"] == (1e-3, 1e-3)


@pytest.mark.parametrize(
    ("stated", "named"),
    [
        ({"resonance": [(40, 80), (50,)]}, "resonance must be numbers"),
        ({"resonance": ("low", "high")}, "resonance must be numbers"),
        ({"resonance": np.zeros((0, 2))}, "resonance must be"),
        ({"lag": [1e-3, [2e-3]]}, "lag must be numbers"),
    ],
    ids=str,
)
def test_ranges_that_are_none_or_have_no_effect_are_refused_in_one_line(stated, named):
    with pytest.raises(ValueError, match=named) as refusal:
        Uncertainty(**stated)
    assert "\n" not in str(refusal.value)
