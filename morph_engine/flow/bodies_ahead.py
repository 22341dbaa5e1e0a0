"""Bodies of a path, the next of which is made while the last one is in use."""

from concurrent.futures import Future, ThreadPoolExecutor

from morph_engine.flow.body import Body, BodyPath
from morph_engine.flow.carrier import Places


class BodiesAhead:
    """Bodies at one share after another, from a thread of their own.

    Args:
        path: Makes the bodies.
    """

    def __init__(self, path: BodyPath) -> None:
        self._path = path
        self._executor = ThreadPoolExecutor(1, "body")
        self._places: dict[float, Future[Places | None]] = {}
        self._bodies: dict[float, Future[Body]] = {}

    def at(self, share: float, following: float, afterwards: float) -> Body:
        """The body at a share of its change; with those at the next two shares is begun."""
        self._bodies = {s: self._bodies.get(s) or self._begin(s) for s in (share, following)}
        self._places = (
            {} if afterwards in self._bodies else {afterwards: self._find_places(afterwards)}
        )
        return self._bodies[share].result()

    def _begin(self, share: float) -> Future[Body]:
        """Begin with a body; a level that a kernel makes is made here, by the thread that may."""
        if not self._path.carried:
            return self._executor.submit(self._path.at, share)
        level = self._path.level(share, self._find_places(share).result())
        return self._executor.submit(self._path.body, share, level)

    def _find_places(self, share: float) -> Future[Places | None]:
        return self._places.get(share) or self._executor.submit(self._path.places, share)
