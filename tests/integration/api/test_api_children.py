"""What is computed on request by several API processes: within one budget, and keys take turns."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import httpx
import pytest

from benchmarks.hostile import bombs
from benchmarks.service.children import ChildrenWatch
from chamfer_morph.server.database.api_keys import ApiKeyStore
from chamfer_morph.worker.dbos_adapter import database
from chamfer_morph.worker.settings import Settings
from morph_engine.results.run_record import RunRecord
from tests.integration.api.conftest import Api, ApiProcess
from tests.patience import until

BOMBS = 100
READS = 200
PROCESSES = 4


@pytest.fixture(scope="module")
def bomb() -> bytes:
    """A mesh file that takes seconds to look through, and is refused."""
    return bombs.bomb()


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

    with ThreadPoolExecutor(BOMBS) as pool, ChildrenWatch([api.process for api in apis]) as watch:
        sent = [
            pool.submit(upload, apis[index % 2].http, bomb + b"#" * index, ann)
            for index in range(BOMBS)
        ]
        until(lambda: all(api.children() for api in apis))
        for api in apis:
            assert upload(api.http, cube + b"#%d" % api.process.pid, bob) == 201
            assert sum(each.done() for each in sent) < BOMBS / 2
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

    with (
        ThreadPoolExecutor(READS + 1) as pool,
        ChildrenWatch([api.process for api in apis]) as watch,
    ):
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
