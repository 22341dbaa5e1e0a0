"""The run directory: nothing finished is ever lost, and a resumed run continues exactly."""

import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest

from morph_engine.errors import DamagedError, ResultError
from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.placement import Placement
from morph_engine.geometry.sampling import Similarity
from morph_engine.presets import configure
from morph_engine.results.run_record import RunRecord
from morph_engine.results.spool import Spool, spool_path

N = 7


def record(**changes) -> RunRecord:
    """A small run between a mesh and a bare point cloud."""
    points = np.arange(3 * N, dtype=np.float32).reshape(N, 3)
    mesh = Mesh(np.eye(4)[:, :3], np.array([[0, 1, 2], [0, 3, 1]], np.int32), "wedge", "ab12")
    values = {
        "config": configure("published", {"seed": 3}),
        "source": mesh,
        "target": points + 0.5,
        "source_points": points,
        "target_points": points + 1,
        "preset": "published",
        "preset_version": 1,
        "seeds": {"run": 3},
    }
    return RunRecord(**(values | changes))


def positions(frame: int) -> np.ndarray:
    """Positions that tell frames apart."""
    return record().source_points + np.float32(frame / 3)


def fill(spool: Spool, count: int) -> None:
    """Append frames up to a count, with a checkpoint after each."""
    for frame in range(spool.frame_count, count):
        spool.append(frame, positions(frame), {"s2t": 1 / (frame + 1)})
        spool.save_checkpoint(frame, {"x": positions(frame)}, {"frame": frame})


def test_frames_come_back_as_they_went_in(tmp_path):
    """Positions, metrics and events of a closed spool are read exactly, NumPy values included."""
    event = {"frame": 0, "kind": "escaped", "message": "one", "data": {"at": np.float32(0.5)}}
    with Spool.create(tmp_path / "r.vtkhdf", record()) as spool:
        spool.append(0, positions(0), {"s2t": np.float64(0.1), "t2s": np.nan}, [event])
        spool.append(1, positions(1), {})
    with Spool.open(tmp_path / "r.vtkhdf", record()) as spool:
        assert spool.frame_count == 2
        np.testing.assert_array_equal(spool.positions(1), positions(1), strict=True)
        assert spool.metrics(0)["s2t"] == 0.1
        assert np.isnan(spool.metrics(0)["t2s"])
        assert spool.metrics(1) == {}
        assert spool.events == [event | {"data": {"at": 0.5}}]


def test_record_comes_back(tmp_path):
    """The run record survives, mesh and point cloud alike."""
    Spool.create(tmp_path / "r.vtkhdf", record()).close()
    with Spool.open(tmp_path / "r.vtkhdf") as spool:
        assert spool.run.document() == record().document()
        for name, array in record().arrays().items():
            np.testing.assert_array_equal(spool.run.arrays()[name], array, strict=True)


def test_checkpoint_is_exact(tmp_path):
    """Every dtype, shape, float and large integer comes back bit for bit."""
    generator = np.random.default_rng(5)
    arrays = {
        "F": generator.normal(size=(N, 3, 3)).astype(np.float32),
        "odd": np.array([np.nan, -0.0, np.inf, 5e-324]),
        "flags": np.array([True, False]),
        "empty": np.zeros((0, 3), np.int64),
        "step": np.array(3, np.int32),
    }
    scalars = {"alpha": 0.1 + 0.2, "rng": generator.bit_generator.state, "none": None}
    with Spool.create(tmp_path / "r.vtkhdf", record()) as spool:
        assert spool.load_checkpoint() is None
        spool.append(0, positions(0), {})
        spool.save_checkpoint(0, arrays, scalars)
    with Spool.open(tmp_path / "r.vtkhdf") as spool:
        checkpoint = spool.load_checkpoint()
    assert checkpoint.frame == 0
    assert checkpoint.scalars == scalars
    assert checkpoint.arrays.keys() == arrays.keys()
    for name, array in arrays.items():
        assert checkpoint.arrays[name].dtype == array.dtype
        assert checkpoint.arrays[name].shape == array.shape
        assert checkpoint.arrays[name].tobytes() == array.tobytes()


def test_checkpoint_decides(tmp_path):
    """A frame written without its checkpoint is forgotten and computed again."""
    with Spool.create(tmp_path / "r.vtkhdf", record()) as spool:
        fill(spool, 3)
        spool.append(3, positions(99), {"s2t": 99.0})
    with Spool.open(tmp_path / "r.vtkhdf", record()) as spool:
        assert spool.frame_count == 4
        spool.truncate_after(spool.load_checkpoint().frame)
        assert spool.frame_count == 3
        fill(spool, 4)
    with Spool.open(tmp_path / "r.vtkhdf", record()) as spool:
        np.testing.assert_array_equal(spool.positions(3), positions(3))
        assert spool.metrics(3) == {"s2t": 0.25}
        spool.truncate_after(-1)
        assert spool.frame_count == 0
        assert not list(spool.path.glob("frame-*"))


def test_half_written_frame_is_no_frame(tmp_path):
    """What a kill leaves of a frame being written does not count, and the run goes on over it."""
    with Spool.create(tmp_path / "r.vtkhdf", record()) as spool:
        fill(spool, 2)
    whole = (spool.path / "frame-000001.npz").read_bytes()
    (spool.path / "frame-000002.npz.tmp").write_bytes(whole[: len(whole) // 2])
    with Spool.open(tmp_path / "r.vtkhdf") as spool:
        assert spool.frame_count == 2
        fill(spool, 3)
        np.testing.assert_array_equal(spool.positions(2), positions(2))


def test_kill_leaves_a_spool_to_resume(tmp_path):
    """A process killed while it writes frees its lock and leaves whole frames and a checkpoint."""
    script = (
        "import numpy, sys\n"
        "from morph_engine.config import MorphConfig\n"
        "from morph_engine.results.run_record import RunRecord\n"
        "from morph_engine.results.spool import Spool\n"
        "p = numpy.ones((2000, 3), numpy.float32)\n"
        "spool = Spool.create(sys.argv[1], RunRecord(MorphConfig(), p, p, p, p), replace=True)\n"
        "for frame in range(10**6):\n"
        "    spool.append(frame, p * frame, {'s2t': frame})\n"
        "    spool.save_checkpoint(frame, {'x': p * frame}, {})\n"
        "    print(frame, flush=True)\n"
    )
    result = tmp_path / "r.vtkhdf"
    command = [sys.executable, "-c", script, str(result)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        for line in child.stdout:
            if int(line) == 20:
                with pytest.raises(ResultError, match="Another process"):
                    Spool.open(result)
                child.kill()
                break
    assert child.returncode != 0
    with Spool.open(result) as spool:
        checkpoint = spool.load_checkpoint()
        assert 20 <= checkpoint.frame <= spool.frame_count - 1
        assert checkpoint.arrays["x"][0, 0] == checkpoint.frame
        for frame in range(spool.frame_count):
            assert spool.positions(frame)[0, 0] == frame
            assert spool.metrics(frame) == {"s2t": frame}


def test_one_process_writes(tmp_path):
    """A second writer is refused, a reader is not."""
    with Spool.create(tmp_path / "r.vtkhdf", record()) as spool:
        fill(spool, 1)
        for attempt in (Spool.open, lambda path: Spool.create(path, record(), replace=True)):
            with pytest.raises(ResultError, match="Another process"):
                attempt(tmp_path / "r.vtkhdf")
        with Spool.open(tmp_path / "r.vtkhdf", writable=False) as reader:
            assert reader.frame_count == 1


def test_unfinished_run_is_not_overwritten(tmp_path):
    """Starting anew where an unfinished run stands is refused unless asked for."""
    with Spool.create(tmp_path / "r.vtkhdf", record()) as spool:
        fill(spool, 2)
    with pytest.raises(ResultError, match="unfinished run"):
        Spool.create(tmp_path / "r.vtkhdf", record())
    with Spool.create(tmp_path / "r.vtkhdf", record(), replace=True) as spool:
        assert spool.frame_count == 0
        assert spool.load_checkpoint() is None


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"config": configure("published", {"frames": 41, "seed": 3})}, "config.frames"),
        ({"target": positions(1)}, "target.sha256"),
        ({"placement": Placement(source=Similarity(2.0))}, "placement.source.scale"),
        ({"software": {"taichi": "0"}}, "software"),
        ({"preset": "fast"}, "'published', now 'fast'"),
    ],
)
def test_other_run_is_not_resumed(tmp_path, changes, named):
    """Resuming with other inputs is refused and the difference named."""
    Spool.create(tmp_path / "r.vtkhdf", record()).close()
    with pytest.raises(ResultError, match=named):
        Spool.open(tmp_path / "r.vtkhdf", record(**changes))
    Spool.open(tmp_path / "r.vtkhdf", record()).close()  # the refusal freed the lock


def test_nothing_to_resume(tmp_path):
    """Resuming where no run stands says so and leaves nothing behind."""
    with pytest.raises(ResultError, match="no unfinished run"):
        Spool.open(tmp_path / "r.vtkhdf")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["frame-000000.npz", "checkpoint.npz", "run.npz"])
@pytest.mark.parametrize("damage", ["flip", "cut", "empty"])
def test_damage_is_noticed(tmp_path, name, damage):
    """A flipped bit or a cut file is an error that names the file."""
    with Spool.create(tmp_path / "r.vtkhdf", record()) as spool:
        fill(spool, 1)
    file = spool.path / name
    data = bytearray(file.read_bytes())
    data[data.index(b"\x93NUMPY") + 130] ^= 1  # in the array behind the 128-byte header
    file.write_bytes({"flip": data, "cut": data[: len(data) // 2], "empty": b""}[damage])
    with (
        pytest.raises(ResultError, match=name),
        Spool.open(tmp_path / "r.vtkhdf", writable=False) as spool,
    ):
        spool.load_checkpoint()
        spool.positions(0)


def test_a_file_called_encrypted_is_damaged(tmp_path):
    """One flipped bit for each file in an archive says so."""
    with Spool.create(tmp_path / "r.vtkhdf", record()) as spool:
        fill(spool, 1)
        file = spool.path / "frame-000000.npz"
        data = bytearray(file.read_bytes())
        for entry in re.finditer(rb"PK\x01\x02", data):
            data[entry.start() + 8] ^= 1
        file.write_bytes(data)
        with pytest.raises(DamagedError, match=r"frame-000000\.npz"):
            spool.positions(0)


def test_full_disk_keeps_the_last_checkpoint(tmp_path, monkeypatch):
    """A disk that refuses is an error with a remedy; what stood before still stands."""
    with Spool.create(tmp_path / "r.vtkhdf", record()) as spool:
        fill(spool, 2)
        with monkeypatch.context() as patch:

            def full(descriptor: int) -> None:
                raise OSError(28, "No space left on device")

            patch.setattr(os, "fsync", full)
            with pytest.raises(ResultError, match="No space left") as caught:
                spool.append(2, positions(2), {})
            with pytest.raises(ResultError, match="No space left"):
                spool.save_checkpoint(1, {}, {})
        assert "disk space" in caught.value.remedy
        assert spool.frame_count == 2
        assert spool.load_checkpoint().frame == 1
        fill(spool, 3)
        assert not list(spool.path.glob("*.tmp"))
    with Spool.open(tmp_path / "r.vtkhdf") as spool:
        np.testing.assert_array_equal(spool.positions(2), positions(2))


def test_remove(tmp_path):
    """Nothing stays of a removed spool."""
    spool = Spool.create(tmp_path / "r.vtkhdf", record())
    fill(spool, 2)
    spool.remove()
    assert not spool_path(tmp_path / "r.vtkhdf").exists()


def test_wrong_frame_is_refused(tmp_path):
    """Frames come in order and in the shape of the run; a checkpoint needs its frame."""
    with Spool.create(tmp_path / "r.vtkhdf", record()) as spool:
        with pytest.raises(ValueError, match="frame 1 after 0"):
            spool.append(1, positions(1), {})
        with pytest.raises(ValueError, match="shape"):
            spool.append(0, positions(0)[1:], {})
        with pytest.raises(ValueError, match="checkpoint"):
            spool.save_checkpoint(0, {}, {})


def test_run_json_is_for_people(tmp_path):
    """The record beside the frames is plain JSON with names and hashes."""
    with Spool.create(tmp_path / "r.vtkhdf", record()) as spool:
        document = json.loads((spool.path / "run.json").read_text())
    assert document["source"]["name"] == "wedge"
    assert len(document["target_points"]["sha256"]) == 64
    assert document["software"]["numpy"] == np.__version__
