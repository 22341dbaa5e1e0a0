"""Job files in an object store: what one host publishes is what another one finds."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from chamfer_morph.cli.doctor import check_object_store
from chamfer_morph.worker.liveness import get_on, gets_on
from chamfer_morph.worker.object_store.bucket import Bucket, ObjectChangedError
from chamfer_morph.worker.object_store.job_mirror import JobMirror
from chamfer_morph.worker.object_store.manifest import Manifest
from chamfer_morph.worker.object_store.shared_storage import SharedStorage
from chamfer_morph.worker.settings import Settings
from chamfer_morph.worker.storage import (
    OwnershipLostError,
    StoreUnavailableError,
    open_storage,
)
from morph_engine.errors import ConfigError
from tests.object_store import BUCKET, Link, s3_server


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of an S3 server."""
    with s3_server(tmp_path_factory.mktemp("s3") / "log") as (host, port):
        yield f"http://{host}:{port}"


@pytest.fixture
def bucket(address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bucket:
    """A bucket of the test's own, below a prefix."""
    set_credentials(monkeypatch, address)
    return Bucket.open(f"s3://{BUCKET}/{tmp_path.name}")


def set_credentials(monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    """What every client of S3 looks for."""
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "id")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("AWS_REGION", "us-east-1")
    monkeypatch.setenv("AWS_ENDPOINT_URL", address)


@pytest.fixture
def host(bucket: Bucket, tmp_path: Path) -> Callable[[str], JobMirror]:
    """Makes the mirror of the one job on a host."""
    return lambda name: JobMirror(bucket, "job", tmp_path / name / "jobs" / "job")


def write(mirror: JobMirror, files: dict[str, str]) -> None:
    """Write files as an engine would."""
    for name, text in files.items():
        path = mirror.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def files(mirror: JobMirror) -> dict[str, str]:
    """The files of a folder but for those that are its own."""
    paths = [path for path in mirror.folder.rglob("*") if path.is_file()]
    return {
        path.relative_to(mirror.folder).as_posix(): path.read_text()
        for path in paths
        if not path.name.startswith(".mirror") and path.name != "lock"
    }


def manifest(bucket: Bucket) -> Manifest:
    """The manifest of the job."""
    return Manifest.model_validate_json(bucket.get("jobs/job/manifest.json"))


def test_objects_change_only_for_those_who_know_them(bucket: Bucket) -> None:
    """An object is made once, and replaced by who has its last ETag."""
    first = bucket.replace("a/one", b"1", None)
    with pytest.raises(ObjectChangedError):
        bucket.replace("a/one", b"2", None)
    second = bucket.replace("a/one", b"2", first)
    with pytest.raises(ObjectChangedError):
        bucket.replace("a/one", b"3", first)
    assert bucket.get_unless("a/one", second) is None
    assert bucket.get_unless("a/one", first) == (b"2", second)
    bucket.put("a/two", b"")
    assert bucket.keys("a/") == ["a/one", "a/two"]
    bucket.delete(["a/one", "a/two", "a/never"])
    assert bucket.keys("a/") == []
    with pytest.raises(FileNotFoundError):
        bucket.get("a/one")
    with pytest.raises(ObjectChangedError):
        bucket.replace("a/one", b"4", second)


def test_address_that_cannot_be_used() -> None:
    """An address that is none of S3, and a store that is not there."""
    with pytest.raises(ConfigError, match="MORPH_OBJECT_STORE"):
        Bucket.open("ftp://somewhere")


def test_service_whose_store_does_not_answer(tmp_path: Path) -> None:
    """It does not start, and says why."""
    environment = os.environ | {
        "MORPH_DATA_DIR": str(tmp_path),
        "MORPH_OBJECT_STORE": f"s3://{BUCKET}",
        "AWS_ACCESS_KEY_ID": "id",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_ENDPOINT_URL": "http://127.0.0.1:9",
    }
    command = [sys.executable, "-m", "chamfer_morph.server", "serve"]
    outcome = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert outcome.returncode == 2
    assert "object store does not answer" in outcome.stderr and "127.0.0.1:9" in outcome.stderr


@pytest.mark.parametrize("fault", ["no replacement", "If-Match", "If-None-Match"])
def test_the_doctor_notices_stores_without_conditional_writes(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    """Each kind by itself; a real store is fine."""
    settings = Settings(
        _env_file=None, data_dir=tmp_path, object_store=f"s3://{BUCKET}/{tmp_path.name}"
    )
    assert check_object_store(settings).verdict == "ok"
    replace = Bucket.replace

    def careless(self: Bucket, key: str, data: bytes, etag: str | None) -> str:
        if fault == "no replacement" and etag is not None:
            raise ObjectChangedError(key)
        if fault == ("If-Match" if etag is not None else "If-None-Match"):
            self.put(key, data)
            return self.get_unless(key, None)[1]  # type: ignore[index]
        return replace(self, key, data, etag)

    monkeypatch.setattr(Bucket, "replace", careless)
    found = check_object_store(settings)
    assert found.verdict == "fault"
    assert ("ETag" if fault == "no replacement" else fault) in found.text
    assert bucket.keys("probe/") == []


def test_processes_of_a_shared_store_show_that_they_live(bucket: Bucket, tmp_path: Path) -> None:
    """Where nothing has made their folder yet, as in a container of their own."""
    settings = Settings(
        _env_file=None, data_dir=tmp_path / "data", object_store=f"s3://{BUCKET}/{tmp_path.name}"
    )
    open_storage(settings, "janitor")
    assert not gets_on(settings, "janitor")
    get_on(settings, "janitor")
    assert gets_on(settings, "janitor")


def test_store_that_does_not_answer(bucket: Bucket, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is asked says so."""
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    absent = Bucket.open(f"s3://{BUCKET}")
    for ask in (
        lambda: absent.get("a"),
        lambda: absent.get_unless("a", None),
        lambda: absent.put("a", b""),
        lambda: absent.replace("a", b"", None),
        lambda: absent.keys("a/"),
        lambda: absent.delete(["a"]),
    ):
        with pytest.raises(StoreUnavailableError, match="does not answer"):
            ask()


def test_a_job_as_it_grows(host: Callable[[str], JobMirror], bucket: Bucket) -> None:
    """A reader finds what was published, each time; what grows is published in pieces."""
    worker, reader = host("worker"), host("reader")
    worker.claim(0)
    written = {"spec.json": "{}", "events.jsonl": "one\n", "run/frame-0.npz": "zero"}
    write(worker, written)
    worker.publish()
    reader.fetch(log_only=True)
    assert files(reader) == {"events.jsonl": "one\n"}
    reader.fetch()
    assert files(reader) == written

    before = manifest(bucket).files
    write(worker, {"events.jsonl": "one\ntwo\n", "run/frame-1.npz": "1"})
    worker.publish()
    after = manifest(bucket).files
    assert after["run/frame-0.npz"] == before["run/frame-0.npz"]
    assert after["events.jsonl"][:1] == before["events.jsonl"]
    assert [piece.size for piece in after["events.jsonl"]] == [4, 4]
    reader.fetch()
    assert files(reader) == files(worker)
    assert reader.size() == sum(map(len, files(worker).values()))

    (worker.folder / "run/frame-0.npz").unlink()
    (worker.folder / "run/frame-1.npz").unlink()
    write(worker, {"result": "all"})
    worker.publish()
    reader.fetch()
    assert files(reader) == files(worker) == {
        "spec.json": "{}", "events.jsonl": "one\ntwo\n", "result": "all"
    }  # fmt: skip
    pieces = [piece.key for name in manifest(bucket).files.values() for piece in name]
    assert len(bucket.keys("jobs/job/files/")) == len(pieces)


def test_nothing_new_is_nothing_written(host: Callable[[str], JobMirror], bucket: Bucket) -> None:
    """Publishing again leaves manifest and objects as they are."""
    worker = host("worker")
    worker.claim(0)
    write(worker, {"spec.json": "{}"})
    worker.publish()
    _, etag = bucket.get_unless("jobs/job/manifest.json", None)
    worker.publish()
    assert bucket.get_unless("jobs/job/manifest.json", etag) is None


def test_worker_that_was_cut_off_is_fenced_out(host: Callable[[str], JobMirror]) -> None:
    """Once another worker has claimed the job, the first one publishes nothing any more."""
    first, second, reader = host("first"), host("second"), host("reader")
    first.claim(0)
    write(first, {"events.jsonl": "one\n", "run/frame-0.npz": "zero"})
    first.publish()
    write(first, {"run/frame-1.npz": "of the first"})
    second.claim(0)
    assert files(second) == {"events.jsonl": "one\n", "run/frame-0.npz": "zero"}
    with pytest.raises(OwnershipLostError):
        first.publish()
    write(second, {"run/frame-1.npz": "of the second"})
    second.publish()
    reader.fetch()
    assert files(reader) == files(second)

    first.claim(0)
    assert files(first) == files(second)
    with pytest.raises(OwnershipLostError):
        write(second, {"run/frame-2.npz": "too late"})
        second.publish()


def test_worker_that_comes_back_goes_on_with_its_own(host: Callable[[str], JobMirror]) -> None:
    """What it had not published yet is still there, if nobody else had the job meanwhile."""
    worker = host("worker")
    worker.claim(0)
    write(worker, {"run/frame-0.npz": "zero"})
    worker.publish()
    write(worker, {"run/frame-1.npz": "one"})
    again = host("worker")
    again.claim(0)
    assert set(files(again)) == {"run/frame-0.npz", "run/frame-1.npz"}
    again.publish()
    reader = host("reader")
    reader.fetch()
    assert files(reader) == files(again)


class ForgetfulBucket(Bucket):
    """Its answer to a write is lost, and the write is sent again."""

    def replace(self, key: str, data: bytes, etag: str | None) -> str:
        """Write, then find that somebody has written."""
        super().replace(key, data, etag)
        return super().replace(key, data, etag)


def small_parts(monkeypatch: pytest.MonkeyPatch, size: int) -> None:
    """Let nothing larger be sent or asked for at once."""
    monkeypatch.setattr("chamfer_morph.worker.object_store.bucket.PART_BYTES", size)
    monkeypatch.setattr("chamfer_morph.worker.object_store.job_mirror.PART_BYTES", size)


def test_large_files_over_a_slow_link(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What takes longer than one request may take goes in parts, there and back."""
    link = Link(("127.0.0.1", int(address.rpartition(":")[2])))
    link.rate = 1 << 17
    set_credentials(monkeypatch, f"http://127.0.0.1:{link.port}")
    small_parts(monkeypatch, 1 << 15)
    monkeypatch.setattr("chamfer_morph.worker.object_store.bucket.REQUEST_SECONDS", 3)
    bucket = Bucket.open(f"s3://{BUCKET}/{tmp_path.name}")
    large = os.urandom((1 << 19) + 1)  # four seconds
    worker, reader = (JobMirror(bucket, "job", tmp_path / name / "job") for name in "ab")
    worker.claim(0)
    (worker.folder / "result").write_bytes(large)
    worker.publish()
    reader.fetch()
    assert (reader.folder / "result").read_bytes() == large

    upload = tmp_path / "upload"
    upload.write_bytes(large)
    storage_of(tmp_path / "c", bucket).add_mesh(upload, "digest", "stl", {"name": "x.stl"})
    found = storage_of(tmp_path / "d", bucket).mesh_file("digest")
    assert found is not None and found.read_bytes() == large
    link.close()


class BreakingBucket(Bucket):
    """Does not answer every third write."""

    def __init__(self, bucket: Bucket) -> None:
        super().__init__(bucket._store)
        self.writes = 0

    def put(self, key: str, data: bytes) -> None:
        """Write, and tell nothing of it sometimes."""
        super().put(key, data)
        self.writes += 1
        if self.writes % 3 == 0:
            raise StoreUnavailableError("The object store does not answer.", "")


def test_what_breaks_off_goes_on_and_leaves_nothing(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Parts that have arrived are not sent again, and those that nobody needs go."""
    small_parts(monkeypatch, 4)
    breaking = BreakingBucket(bucket)
    worker = JobMirror(breaking, "job", tmp_path / "job")
    worker.claim(0)
    write(worker, {"result": "0123456789" * 4})
    for _ in range(4):
        with pytest.raises(StoreUnavailableError):
            worker.publish()
    worker.publish()
    reader = JobMirror(bucket, "job", tmp_path / "reader")
    reader.fetch()
    assert files(reader) == files(worker)
    assert breaking.writes == 14  # ten parts, four of them twice
    assert len(bucket.keys("jobs/job/files/")) == 10


def test_what_a_killed_worker_has_sent_goes_with_the_next_claim(
    host: Callable[[str], JobMirror], bucket: Bucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody else knows of it; what was published stays."""
    small_parts(monkeypatch, 4)
    first, second = host("first"), host("second")
    first.claim(0)
    write(first, {"spec.json": "{}"})
    first.publish()
    write(first, {"result": "0123456789"})
    first._send("result", (0, 10), [])  # and then the machine stops
    assert len(bucket.keys("jobs/job/files/")) == 4
    second.claim(0)
    assert len(bucket.keys("jobs/job/files/")) == 1
    assert files(second) == {"spec.json": "{}"}


def test_lost_answers(bucket: Bucket, tmp_path: Path) -> None:
    """A manifest that was written although the answer was lost is one's own."""
    worker = JobMirror(ForgetfulBucket(bucket._store), "job", tmp_path / "worker/jobs/job")
    worker.claim(0)
    write(worker, {"spec.json": "{}"})
    worker.publish()
    write(worker, {"result": "all"})
    worker.publish()
    reader = JobMirror(bucket, "job", tmp_path / "reader/jobs/job")
    reader.fetch()
    assert files(reader) == {"spec.json": "{}", "result": "all"}


def test_discarded_job(host: Callable[[str], JobMirror], bucket: Bucket) -> None:
    """Nothing is left of it, here or there; who works on it is fenced out; it may begin again."""
    worker, reader, other = host("worker"), host("reader"), host("other")
    worker.claim(0)
    write(worker, {"result": "old", "events.jsonl": "one\n"})
    worker.publish()
    reader.fetch()
    write(reader, {"derived/surface.npz": "of the old result"})
    other.discard()
    assert bucket.keys("jobs/job/") == []
    reader.fetch()
    assert files(reader) == {}
    write(worker, {"result": "late"})
    with pytest.raises(OwnershipLostError):
        worker.publish()
    assert bucket.keys("jobs/job/") == []
    other.claim(0)
    write(other, {"events.jsonl": "anew\n"})
    other.publish()
    reader.fetch()
    worker.claim(0)
    assert files(reader) == files(worker) == {"events.jsonl": "anew\n"}


def test_what_was_discarded_between_two_looks(host: Callable[[str], JobMirror]) -> None:
    """What a reader has made of the old frames does not outlive them."""
    worker, reader = host("worker"), host("reader")
    worker.claim(0)
    write(worker, {"result": "old"})
    worker.publish()
    reader.fetch()
    write(reader, {"derived/surface.npz": "of the old result"})
    worker.discard()
    worker.claim(0)
    write(worker, {"result": "new"})
    worker.publish()
    reader.fetch()
    assert files(reader) == {"result": "new"}


def storage_of(folder: Path, bucket: Bucket, cache_bytes: int = 1 << 30) -> SharedStorage:
    """The storage of a host."""
    return SharedStorage(folder, folder / "uploads", bucket, cache_bytes)


def test_meshes(bucket: Bucket, tmp_path: Path) -> None:
    """A mesh that one host was given is found by another, until it is removed."""
    hosts = [storage_of(tmp_path / name, bucket) for name in ("a", "b")]
    upload = hosts[0].uploads / "upload"
    upload.write_bytes(b"solid")
    assert hosts[1].mesh_file("digest") is None
    hosts[0].add_mesh(upload, "digest", "stl", {"name": "x.stl"})
    found = hosts[1].mesh_file("digest")
    assert found is not None and found.name == "mesh.stl" and found.read_bytes() == b"solid"
    assert hosts[1].mesh_report("digest") == {"name": "x.stl"}
    hosts[1].remove_mesh("digest")
    assert bucket.keys("meshes/") == []


def test_marks(bucket: Bucket, tmp_path: Path) -> None:
    """What a job has left goes once it is marked, whichever host sees to that."""
    a, b = (storage_of(tmp_path / name, bucket) for name in "ab")
    a.claim("job", 0)
    (a.job_dir("job") / "result").write_text("all")
    a.publish("job")
    mark, other = b.mark_for_discard("job"), b.mark_for_discard("job")
    b.unmark("job", mark)
    a.discard_if_marked("job", wait_seconds=0)
    assert b.job_bytes("job") == 0 and bucket.keys("jobs/") == []
    assert other.startswith("jobs/job/")
    b.mark_for_discard("job")
    a.unmark("job")
    assert bucket.keys("jobs/") == []


def test_copies_take_no_more_disk_than_they_may(bucket: Bucket, tmp_path: Path) -> None:
    """Those asked for longest ago go, and come back when they are asked for again."""
    worker = storage_of(tmp_path / "worker", bucket)
    jobs = ["first", "second", "third"]
    for job in jobs:
        worker.claim(job, 0)
        (worker.job_dir(job) / "result").write_bytes(bytes(1000))
        worker.publish(job)
    reader = storage_of(tmp_path / "reader", bucket, cache_bytes=3000)
    for age, job in enumerate(jobs):
        reader.fetch(job, "settled")
        os.utime(reader.job_dir(job), (age, age))
    reader.evict(unused_seconds=1e12)
    assert all((reader.job_dir(job) / "result").is_file() for job in jobs)
    reader.evict(unused_seconds=0)
    assert [(reader.job_dir(job) / "result").is_file() for job in jobs] == [False, True, True]
    reader.fetch("first", "settled")
    assert (reader.job_dir("first") / "result").read_bytes() == bytes(1000)
