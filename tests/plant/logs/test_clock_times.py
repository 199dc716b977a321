"""Tables whose rows state an instant: a date and a time, or a time of day."""

import datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant import LoadError, read_table
from plant.logs import is_instant, nanoseconds

DAYS = st.datetimes(datetime.datetime(1970, 1, 1), datetime.datetime(2200, 1, 1))
FORMATS = (
    (",", "%Y-%m-%dT%H:%M:%S.%f"),
    (",", "%Y/%m/%d %H:%M:%S.%f"),
    (";", "%d.%m.%Y %H:%M:%S,%f"),
    ("\t", "%Y-%m-%d %H:%M:%S.%fZ"),
    (";", "%Y-%m-%dT%H:%M:%S.%f+0530"),
)


@given(DAYS, st.timedeltas(datetime.timedelta(0), datetime.timedelta(days=400)))
def test_distances_are_those_of_the_calendar(begin, distance):
    microseconds = distance // datetime.timedelta(microseconds=1)
    for _, layout in FORMATS:
        texts = [day.strftime(layout) for day in (begin, begin + distance)]
        assert all(map(is_instant, texts))
        assert nanoseconds(texts[1]) - nanoseconds(texts[0]) == 1000 * microseconds


@given(DAYS, st.integers(-14 * 60, 14 * 60))
def test_zones_state_one_instant(moment, minutes):
    zone = datetime.timezone(datetime.timedelta(minutes=minutes))
    there = moment.replace(tzinfo=datetime.UTC).astimezone(zone)
    assert nanoseconds(there.isoformat(sep=" ")) == nanoseconds(f"{moment.isoformat()}Z")


@pytest.mark.parametrize(("separator", "layout"), FORMATS)
def test_a_column_of_instants_is_seconds_also_over_midnight(tmp_path, separator, layout):
    begin = datetime.datetime(2026, 12, 31, 23, 59, 59, 900_000)
    mark = "," if ",%f" in layout else "."
    rows = (
        ["stamp", "q1"],
        *(
            [
                (begin + datetime.timedelta(microseconds=700 * k)).strftime(layout),
                f"{0.1 * k:.3f}".replace(".", mark),
            ]
            for k in range(400)
        ),
    )
    path = tmp_path / "log.csv"
    path.write_text("".join(separator.join(row) + "\n" for row in rows))
    table = read_table(path)
    # Seconds of a day have a resolution of 1.5e-11.
    np.testing.assert_allclose(np.diff(table["stamp"]), 7e-4, rtol=0, atol=3e-11)
    np.testing.assert_allclose(table["q1"], 0.1 * np.arange(400), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "cell", ["25:00:00", "10:61:00", "2026-02-30T10:00:00", "03/05/2026 10:00:00"]
)
def test_what_is_no_instant_is_refused_by_its_line(tmp_path, cell):
    assert not is_instant(cell)
    path = tmp_path / "log.csv"
    path.write_text("".join(["time,q1\n", *(f"10:00:0{k},1\n" for k in range(9)), f"{cell},1\n"]))
    with pytest.raises(LoadError, match=r"line 11 .*'time'"):
        read_table(path)
