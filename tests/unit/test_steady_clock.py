"""Jobs are not deleted for their age by a clock that has jumped."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from chamfer_morph.worker.retention.steady_clock import ABSENCE_SECONDS, TRUST_SECONDS, SteadyClock

DAY = 86400.0


class Time:
    """A wall clock and the time that passes."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.wall, self.passed = 1.8e9, 100.0
        patch.setattr(time, "time", lambda: self.wall)
        patch.setattr(time, "monotonic", lambda: self.passed)

    def go_on(self, seconds: float) -> None:
        """Both go on."""
        self.wall += seconds
        self.passed += seconds


@pytest.mark.parametrize("jump", [9 * DAY, -9 * DAY, 3600.0])
def test_a_jump_is_doubted_for_a_day(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jump: float
) -> None:
    """Forward, back, and forward again by who sets it right."""
    now = Time(monkeypatch)
    clock = SteadyClock(tmp_path / "clock")
    assert clock.is_steady()
    now.go_on(60)
    assert clock.is_steady()
    now.wall += jump
    now.go_on(60)
    assert not clock.is_steady()
    now.go_on(TRUST_SECONDS - 120)
    assert not clock.is_steady()
    now.go_on(180)
    assert clock.is_steady()


def test_a_restart_does_not_hide_a_jump(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither while it is doubted nor while nobody looked; a short absence is no jump."""
    now = Time(monkeypatch)
    assert SteadyClock(tmp_path / "clock").is_steady()
    now.go_on(ABSENCE_SECONDS / 2)
    assert SteadyClock(tmp_path / "clock").is_steady()
    now.wall += 9 * DAY
    for _ in range(2):
        assert not SteadyClock(tmp_path / "clock").is_steady()
        now.go_on(60)


def test_a_machine_without_its_file_knows_the_last_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A new one whose clock is nine days ahead, or behind, is doubted, too; another is not."""
    now = Time(monkeypatch)
    for number, (finished, steady) in enumerate(
        [(now.wall - 3600, True), (now.wall - 9 * DAY, False), (now.wall + DAY, False)]
    ):
        clock = SteadyClock(tmp_path / f"clock{number}", lambda finished=finished: finished)
        assert clock.is_steady() is steady
    assert SteadyClock(tmp_path / "clock").is_steady()  # no job has finished yet
