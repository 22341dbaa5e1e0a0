"""What was measured before is kept, and what has become worse is told."""

from pathlib import Path

import pytest

from benchmarks import history
from benchmarks.comparison import limit, speedup
from benchmarks.service.measurement import Measurement, least

PAGE = Path(__file__).parents[2] / "docs" / "performance.md"


def test_rows_are_compared_with_those_before(tmp_path: Path) -> None:
    """With their median, on the same machine; less speed is as bad as more time."""
    file = tmp_path / "history.jsonl"
    for seconds, times in ((2.0, 4.0), (100.0, 4.0), (2.0, 4.0), (3.0, 2.0)):
        rows = [Measurement("job", seconds, 6.0, "s"), speedup("step", 1.0, times, "ns", 1.5, 2.0)]
        history.record(rows, file)
    found = history.entries(file.read_text().splitlines())
    assert [entry.value for entry in found["job"]] == [2.0, 100.0, 2.0, 3.0]
    assert history.change(found["job"]) == pytest.approx(1.5)
    assert history.change(found["step"]) == pytest.approx(2.0)
    assert history.change(found["job"][:1]) is None
    assert found["step"][-1].unit == "x"


def test_counts_of_faults_may_be_zero(tmp_path: Path) -> None:
    """None after none is no change; one after none is as bad as can be."""
    file = tmp_path / "history.jsonl"
    for count, change in ((0, None), (0, 1), (1, float("inf"))):
        history.record([Measurement("faults", count, 0, "")], file)
        found = history.entries(file.read_text().splitlines())
        assert history.change(found["faults"]) == change


def test_databases_are_not_compared(tmp_path: Path) -> None:
    """A slower one makes nothing worse."""
    file = tmp_path / "history.jsonl"
    for database, seconds in (("SQLite", 1.0), ("Postgres", 3.0)):
        history.record([Measurement("submit", seconds, 6.0, "s")], file, database=database)
    found = history.entries(file.read_text().splitlines())
    assert history.change(found["submit"]) is None


def test_rows_without_a_number_are_left_out(tmp_path: Path) -> None:
    """As of a peer that is not here."""
    file = tmp_path / "history.jsonl"
    history.record([limit("a", float("nan"), "s", 1.0, 0.5), limit("b", 0.5, "s", 1.0, 0.5)], file)
    assert [*history.entries(file.read_text().splitlines())] == ["b"]


def test_a_rate_should_not_fall(tmp_path: Path) -> None:
    """Its limit is the least that it may be, and half of it is twice as bad."""
    assert not least("pictures", 10.0, 10.0, "1/s").missed
    assert least("pictures", 9.9, 10.0, "1/s").missed
    file = tmp_path / "history.jsonl"
    for rate in (12.0, 6.0):
        history.record([least("pictures", rate, 10.0, "1/s")], file)
    found = history.entries(file.read_text().splitlines())
    assert history.change(found["pictures"]) == pytest.approx(2.0)
    assert "| pictures | 6 1/s | ≥ 10 |" in history.table(found)


def test_the_documented_numbers_are_the_last_ones() -> None:
    """docs/performance.md has the table that `python -m benchmarks.history --table` prints."""
    found = history.entries(history.FILE.read_text(encoding="utf-8").splitlines())
    assert history.table(found) in PAGE.read_text(encoding="utf-8")
