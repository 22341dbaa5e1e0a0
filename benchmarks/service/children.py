"""What API processes compute in children, looked at from outside."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress

import psutil

LOOK_SECONDS = 0.05


class ChildrenWatch:
    """Looks at the children of some processes, as long as the context lasts.

    Attributes:
        most: The most there were at the same time, and the most memory of them [bytes].
    """

    def __init__(self, parents: Sequence[psutil.Process]) -> None:
        self._parents = parents
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.most = (0, 0)

    def __enter__(self) -> ChildrenWatch:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(LOOK_SECONDS):
            count = memory = 0
            for child in (child for parent in self._parents for child in children(parent)):
                with suppress(psutil.Error):  # it has ended
                    memory += child.memory_info().rss
                    count += 1
            self.most = max(self.most[0], count), max(self.most[1], memory)


def children(parent: psutil.Process) -> list[psutil.Process]:
    """What a process computes at the moment in processes of their own; none once it has ended."""
    with suppress(psutil.Error):
        return parent.children(recursive=True)
    return []
