"""Bodies of a path, the next of which is made while the last one is in use."""

from concurrent.futures import Future, ThreadPoolExecutor

from morph_engine.flow.body import Body, BodyPath


class BodiesAhead:
    """Bodies at one share after another, from a thread of their own.

    Where the path is carried, kernels make the bodies, which one thread alone may launch: then each
    is made when it is wanted.

    Args:
        path: Makes the bodies.
    """

    def __init__(self, path: BodyPath) -> None:
        self._path = path
        self._executor = None if path.carried else ThreadPoolExecutor(1, "body")
        self._bodies: dict[float, Future[Body]] = {}

    def at(self, share: float, following: float) -> Body:
        """The body at a share of its change; the `following` one is begun with."""
        wanted = [share, following] if self._executor else [share]
        self._bodies = {s: self._bodies.get(s) or self._begin(s) for s in wanted}
        return self._bodies[share].result()

    def _begin(self, share: float) -> Future[Body]:
        if self._executor:
            return self._executor.submit(self._path.at, share)
        body: Future[Body] = Future()
        body.set_result(self._path.at(share))
        return body
