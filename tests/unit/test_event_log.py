"""The event log: whole lines, ascending ids, nothing that JSON cannot say."""

from __future__ import annotations

import math
from datetime import datetime, timezone

from chamfer_morph.worker.event_log import EventLog


def test_events_come_back(tmp_path):
    """Events have ascending ids, their type, time and data."""
    log = EventLog(tmp_path / "events.jsonl")
    assert log.read() == []
    assert log.tail() == []
    for frame in range(3):
        log.append("frame", {"frame": frame})
    events = log.read()
    assert [(e.id, e.type, e.data["frame"]) for e in events] == [
        (1, "frame", 0),
        (2, "frame", 1),
        (3, "frame", 2),
    ]
    assert abs((datetime.now(timezone.utc) - events[0].at).total_seconds()) < 60
    assert [event.id for event in log.read(after=1, limit=1)] == [2]


def test_a_torn_line_is_no_event(tmp_path):
    """A kill in the middle of a line spoils neither what was there nor what comes."""
    path = tmp_path / "events.jsonl"
    log = EventLog(path)
    log.append("attempt", {"attempt": 1})
    with path.open("ab") as file:
        file.write(b'{"at": "2026-01-01T00:00:00+00:00", "type": "fra')
    assert [event.type for event in log.read()] == ["attempt"]
    log.append("attempt", {"attempt": 2})
    assert [event.data["attempt"] for event in log.read()] == [1, 2]
    assert [event.data["attempt"] for event in log.tail()] == [1, 2]


def test_numbers_that_are_none(tmp_path):
    """NaN and infinity are left out, since JSON has neither."""
    log = EventLog(tmp_path / "events.jsonl")
    log.append("frame", {"metrics": {"s2t": math.nan, "f1": 0.5}, "list": [math.inf, 1.0]})
    assert log.read()[0].data == {"metrics": {"f1": 0.5}, "list": [None, 1.0]}
    assert "NaN" not in log.path.read_text()


def test_the_tail_of_a_long_log(tmp_path):
    """The last events are found without reading all of them."""
    log = EventLog(tmp_path / "events.jsonl")
    for frame in range(2000):
        log.append("frame", {"frame": frame, "filling": "x" * 40})
    tail = log.tail()
    assert tail[-1].data["frame"] == 1999
    assert 0 < len(tail) < 1000
