"""Places of jobs in the queue."""

from __future__ import annotations

import pytest

from chamfer_morph.worker.places import apart, in_own_order, next_place, rank_in_front


@pytest.mark.parametrize(
    ("own", "started", "waiting", "place"),
    [
        (None, None, None, 1),  # an empty queue
        (5, None, 3, 6),  # behind the owner's own, whatever others wait for
        (None, 7, None, 8),  # an owner who comes anew has no credit for the past
        (None, 7, 4, 8),
        (9, 7, 4, 10),
        (2, 7, 4, 8),
        (None, None, 4, 4),  # nothing runs: level with who waits longest
        (None, None, 1, 1),
        (None, 0, 4, 1),
        (0, None, None, 1),
    ],
)
def test_next_place(own: int | None, started: int | None, waiting: int | None, place: int) -> None:
    """One more than the last job of the owner, and than that started last."""
    assert next_place(own, started, waiting) == place


@pytest.mark.parametrize(
    ("places", "moved"),
    [([], []), ([4, 2, 9], [2, 4, 9]), ([3, 3, 3, 4, 9], [3, 4, 5, 6, 9]), ([5, 5, 6], [5, 6, 7])],
)
def test_no_two_places_are_the_same(places: list[int], moved: list[int]) -> None:
    """Equal ones move behind each other, and those behind them make room."""
    assert apart(places) == moved


def test_own_order() -> None:
    """What was moved to the front last is first; then priorities; then age."""
    jobs = [
        ("old", 1, 100, None),
        ("urgent", 2, 1, None),
        ("young", 3, 100, None),
        ("moved", 4, 500, "7"),
        ("moved later", 5, 100, "10"),
        ("of an older version", 6, None, None),
    ]
    order = [job for job, *_ in in_own_order(jobs)]
    assert order == ["moved later", "moved", "of an older version", "urgent", "old", "young"]


def test_rank_in_front() -> None:
    """The time, or one more than all others where the clock was set back."""
    assert rank_in_front([], 1000) == 1000
    assert rank_in_front([("a", 1, 100, None), ("b", 2, 100, "900")], 1000) == 1000
    assert rank_in_front([("a", 1, 100, "2000"), ("b", 2, 100, "1500")], 1000) == 2001
