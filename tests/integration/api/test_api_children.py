"""What is computed on request by several API processes: within one budget, and keys take turns."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import httpx
import numpy as np
import psutil
import pytest

from chamfer_morph.server.database.api_keys import ApiKeyStore
from chamfer_morph.worker.dbos_adapter import database
from chamfer_morph.worker.settings import Settings
from morph_engine.results.run_record import RunRecord
from tests.integration.api.conftest import Api, ApiProcess

BOMBS = 100
READS = 200
PROCESSES = 4


@pytest.fixture(scope="module")
def bomb() -> bytes:
    """A mesh file that takes seconds to look through, and is refused: triangles without order."""
    chance = np.random.default_rng(1)
    centres = chance.uniform(0, 10, (20_000, 1, 3))
    points = (centres + chance.normal(0, 0.3, (20_000, 3, 3))).reshape(-1, 3)
    lines = [f"v {x:.3f} {y:.3f} {z:.3f}" for x, y, z in points]
    lines += [f"f {first} {first + 1} {first + 2}" for first in range(1, len(points), 3)]
    return "\n".join([*lines, "#"]).encode()


class Watch:
    """Looks at the children of some API processes, as long as the context lasts.

    Attributes:
        most: The most there were at the same time, and the most memory of them [bytes].
    """

    def __init__(self, apis: list[ApiProcess]) -> None:
        self._apis = apis
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.most = (0, 0)

    def __enter__(self) -> Watch:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(0.05):
            count = memory = 0
            for child in (child for api in self._apis for child in api.children()):
                with suppress(psutil.Error):  # it has ended
                    memory += child.memory_info().rss
                    count += 1
            self.most = max(self.most[0], count), max(self.most[1], memory)


def test_an_upload_overtakes_those_of_another_key(
    start_apis: Callable[..., list[ApiProcess]], tmp_path: Path, bomb: bytes, cube: bytes
) -> None:
    """However many bombs another key has sent before, to whichever process."""
    settings = Settings(_env_file=None, data_dir=tmp_path, port=0, sandbox_processes=PROCESSES)
    apis = start_apis(settings)
    engine = database(settings)
    made = [ApiKeyStore(engine).add(name, ["submit"]) for name in ("ann", "bob")]
    ann, bob = ({"Authorization": f"Bearer {key[1]}"} for key in made if key)
    engine.dispose()

    def upload(http: httpx.Client, content: bytes, headers: dict[str, str]) -> int:
        with suppress(httpx.TransportError):  # the test is over
            query = {"name": "mesh.obj"}
            answer = http.post("/v1/meshes", params=query, content=content, headers=headers)
            return answer.status_code
        return 0

    with ThreadPoolExecutor(BOMBS) as pool, Watch(apis) as watch:
        bombs = [
            pool.submit(upload, apis[index % 2].http, bomb + b"#" * index, ann)
            for index in range(BOMBS)
        ]
        while not all(api.children() for api in apis):
            time.sleep(0.01)
        for api in apis:
            assert upload(api.http, cube + b"#%d" % api.process.pid, bob) == 201
            assert sum(each.done() for each in bombs) < BOMBS / 2
        for api in apis:
            api.process.terminate()
    assert 0 < watch.most[0] <= PROCESSES


def test_reads_stay_within_the_budget(
    api: Api, run: RunRecord, start_apis: Callable[..., list[ApiProcess]]
) -> None:
    """Surfaces, exports, previews and results of killed jobs, all at once; all are answered."""
    finished = [api.finished(run) for _ in range(2)]
    killed = [api.running(run) for _ in range(3)]
    for job in killed:
        assert api.http.post(f"/v1/jobs/{job}/cancel").status_code == 202
    paths = [f"/v1/jobs/{job}/frames/{frame}/surface" for job in finished for frame in (0, 1)]
    paths += [f"/v1/jobs/{job}/result" for job in killed]
    paths += [f"/v1/shapes/star/particles?points_per_cell_edge={n}" for n in (1, 2, 3)]
    settings = api.settings.model_copy(update={"sandbox_processes": PROCESSES})
    apis = start_apis(settings)
    cheap: list[int] = []
    ended = threading.Event()

    def look() -> None:
        while not ended.wait(0.05):
            cheap.append(apis[len(cheap) % 2].http.get("/v1/jobs").status_code)

    with ThreadPoolExecutor(READS + 1) as pool, Watch(apis) as watch:
        looking = pool.submit(look)
        answers = pool.map(
            lambda index: apis[index % 2].http.get(paths[index % len(paths)]).status_code,
            range(READS),
        )
        try:
            assert set(answers) == {200}
        finally:
            ended.set()
            looking.result()
    assert 0 < watch.most[0] <= PROCESSES
    assert set(cheap) == {200}, "the list of jobs is answered meanwhile"
