"""Bodies of a path, the next of which is made while the last one is in use."""

from concurrent.futures import Future, ThreadPoolExecutor

from morph_engine.flow.body import Body, BodyPath


class BodiesAhead:
    """Bodies at one share after another, from a thread of their own.

    Args:
        path: Makes the bodies.
    """

    def __init__(self, path: BodyPath) -> None:
        self._path = path
        self._executor = ThreadPoolExecutor(1, "body")
        self._bodies: dict[float, Future[Body]] = {}

    def at(self, share: float, following: float) -> Body:
        """The body at a share of its change; the `following` one is begun with."""
        self._bodies = {s: self._bodies.get(s) or self._begin(s) for s in (share, following)}
        return self._bodies[share].result()

    def _begin(self, share: float) -> Future[Body]:
        if not self._path.carried:
            return self._executor.submit(self._path.at, share)
        level = self._path.level(share)  # by a kernel, which this thread has to launch
        return self._executor.submit(self._path.body, share, level)
