"""The result file: what VTK reads is what was written, and damage is noticed."""

import sys

import h5py
import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
from vtkmodules.vtkIOHDF import vtkHDFReader

from morph_engine.config import MorphConfig
from morph_engine.errors import DamagedError, ResultError
from morph_engine.geometry.mesh import Mesh
from morph_engine.geometry.placement import Placement
from morph_engine.geometry.sampling import Similarity
from morph_engine.results.run_record import RunRecord
from morph_engine.results.spool import Spool
from morph_engine.results.trajectory import Trajectory, write_result

N, T = 500, 4
GENERATOR = np.random.default_rng(11)
POSITIONS = GENERATOR.normal(size=(T, N, 3)).astype(np.float32)
DET_F = GENERATOR.uniform(0.5, 2, size=(T, N)).astype(np.float32)
TARGET = GENERATOR.normal(size=(300, 3)).astype(np.float32)
CLOUD = GENERATOR.normal(size=(200, 3))
METRICS = [{"s2t": 1 / (t + 3), "det_f_min": -1e-40 * t} for t in range(T)]
METRICS[2]["hausdorff"] = 0.7
EVENTS = [{"frame": 1, "kind": "halved", "message": "CFL η > 1", "data": {"step": 1}}]
MESH = Mesh(np.eye(4)[:, :3], np.array([[0, 1, 2], [0, 3, 1]], np.int32), "wedge", "ab12")
TO_GRID = Similarity(2.0, (5.0, 6.0, 7.0)).inverse()
RUN = RunRecord(
    config=MorphConfig(preset="x" * 100_000),
    source=MESH,
    target=CLOUD,
    source_points=POSITIONS[0],
    target_points=TARGET,
    placement=Placement(source=TO_GRID, target=TO_GRID),
    preset="fast",
    preset_version=2,
    seeds={"run": 2**63},
)


def write(path, *, frame_count=T, status="complete", det_f=DET_F):
    """A result file of some frames."""
    with Spool.create(path, RUN, replace=True) as spool:
        for t in range(frame_count):
            spool.append(t, POSITIONS[t], METRICS[t], EVENTS if t == 1 else [], det_f[t])
        write_result(spool, status=status)
        spool.remove()
    return path


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """One complete result file."""
    return write(tmp_path_factory.mktemp("result") / "r.vtkhdf")


def vtk_reader(path):
    """VTK's own reader of a file it accepts."""
    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    assert reader.CanReadFile(str(path))
    reader.UpdateInformation()
    return reader


def test_vtk_reads_every_step(result):
    """VTK shows the points of each frame bit for bit, a vertex each, det F and the metrics."""
    reader = vtk_reader(result)
    assert reader.GetNumberOfSteps() == T
    times = reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    assert times == (0, 1, 2, 3)
    for t in (*range(T), 1):  # and back again
        reader.SetStep(t)
        reader.Update()
        cloud = reader.GetOutput()
        assert cloud.IsA("vtkPolyData")
        np.testing.assert_array_equal(vtk_to_numpy(cloud.GetPoints().GetData()), POSITIONS[t])
        shown = vtk_to_numpy(cloud.GetPointData().GetArray("det_f"))
        np.testing.assert_array_equal(shown, DET_F[t], strict=True)
        verts = cloud.GetVerts()
        np.testing.assert_array_equal(vtk_to_numpy(verts.GetConnectivityArray()), np.arange(N))
        np.testing.assert_array_equal(vtk_to_numpy(verts.GetOffsetsArray()), np.arange(N + 1))
        assert cloud.GetNumberOfCells() == N
        fields = cloud.GetFieldData()
        for name in ("s2t", "det_f_min", "hausdorff"):
            value = vtk_to_numpy(fields.GetArray(name))
            np.testing.assert_array_equal(value, [METRICS[t].get(name, np.nan)], strict=True)


@pytest.mark.parametrize("frame_count", [0, 1])
def test_vtk_reads_a_run_stopped_early(tmp_path, frame_count):
    """A run stopped in its first or second frame leaves a file that VTK and we can read."""
    path = write(tmp_path / "r.vtkhdf", frame_count=frame_count, status="partial")
    reader = vtk_reader(path)
    errors = []
    reader.GetExecutive().AddObserver("ErrorEvent", lambda *event: errors.append(event))
    reader.Update()
    assert not errors
    assert reader.GetOutput().GetNumberOfPoints() == frame_count * N
    with Trajectory(path) as trajectory:
        assert (trajectory.status, len(trajectory)) == ("partial", frame_count)
        assert trajectory.particle_count == N
        np.testing.assert_array_equal(trajectory.run.source_points, POSITIONS[0])


def test_reader_gives_back_all(result):
    """Frames, metrics, events and the run record come back exactly."""
    with Trajectory(result) as trajectory:
        assert trajectory.status == "complete"
        assert (trajectory.frame_count, trajectory.particle_count) == (T, N)
        np.testing.assert_array_equal(trajectory.times, np.arange(T))
        np.testing.assert_array_equal(np.stack(list(trajectory)), POSITIONS, strict=True)
        np.testing.assert_array_equal(trajectory.positions(-1), POSITIONS[-1])
        np.testing.assert_array_equal(trajectory.det_f(-1), DET_F[-1], strict=True)
        assert [trajectory.metrics_at(t) for t in range(T)] == METRICS
        np.testing.assert_array_equal(
            trajectory.metrics["hausdorff"], [np.nan, np.nan, 0.7, np.nan]
        )
        assert trajectory.events == EVENTS
        assert trajectory.config == RUN.config
        assert trajectory.software == RUN.software
        assert trajectory.run.document() == RUN.document()
        assert trajectory.source.name == "wedge"
        np.testing.assert_array_equal(trajectory.source.faces, MESH.faces, strict=True)
        np.testing.assert_array_equal(trajectory.target, CLOUD, strict=True)
        np.testing.assert_array_equal(trajectory.target_points, TARGET, strict=True)
        # float64 arithmetic on both sides, in another order
        np.testing.assert_allclose(
            trajectory.positions_in_user_units(2), 2.0 * POSITIONS[2] + [5, 6, 7], rtol=1e-14
        )


def test_result_without_det_f(tmp_path):
    """A method that deforms nothing stores no det F; VTK and we read the rest."""
    path = write(tmp_path / "r.vtkhdf", det_f=[None] * T)
    reader = vtk_reader(path)
    reader.Update()
    assert reader.GetOutput().GetPointData().GetNumberOfArrays() == 0
    with Trajectory(path) as trajectory:
        assert trajectory.det_f(0) is None
        np.testing.assert_array_equal(trajectory.positions(0), POSITIONS[0])


def test_partial_result_and_continued_run_agree(tmp_path):
    """A result may be written in the middle of a run, and again at its end."""
    path = tmp_path / "r.vtkhdf"
    with Spool.create(path, RUN) as spool:
        for t in range(T):
            spool.append(t, POSITIONS[t], METRICS[t])
            write_result(spool, status="complete" if t == T - 1 else "partial")
            with Trajectory(path) as trajectory:
                np.testing.assert_array_equal(np.stack(list(trajectory)), POSITIONS[: t + 1])
    assert {file.name for file in tmp_path.iterdir()} == {"r.vtkhdf", "r.vtkhdf.spool"}


def test_flipped_bit_costs_one_frame(result, tmp_path):
    """A frame with a flipped bit is refused by name; all other frames still read."""
    data = bytearray(result.read_bytes())
    data[data.index(POSITIONS[2].tobytes()) + 1000] ^= 4
    damaged = tmp_path / "damaged.vtkhdf"
    damaged.write_bytes(data)
    with Trajectory(damaged) as trajectory:
        with pytest.raises(ResultError, match="frame 2"):
            trajectory.positions(2)
        for t in (0, 1, 3):
            np.testing.assert_array_equal(trajectory.positions(t), POSITIONS[t])


def test_flipped_bit_in_det_f_is_noticed(result, tmp_path):
    """det F has a checksum of its own; the positions of that frame still read."""
    data = bytearray(result.read_bytes())
    data[data.index(DET_F[2].tobytes()) + 1000] ^= 4
    damaged = tmp_path / "damaged.vtkhdf"
    damaged.write_bytes(data)
    with Trajectory(damaged) as trajectory:
        with pytest.raises(ResultError, match="det F of frame 2"):
            trajectory.det_f(2)
        np.testing.assert_array_equal(trajectory.det_f(1), DET_F[1])
        np.testing.assert_array_equal(trajectory.positions(2), POSITIONS[2])


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.999])
def test_truncated_file_is_refused(result, tmp_path, share):
    """A file cut short is an error with cause and remedy."""
    data = result.read_bytes()
    cut = tmp_path / "cut.vtkhdf"
    cut.write_bytes(data[: int(share * len(data))])
    with pytest.raises(ResultError, match=r"cut\.vtkhdf") as caught:
        Trajectory(cut)
    assert caught.value.remedy


def test_other_files_are_refused(tmp_path):
    """A missing file, a mesh and another program's HDF5 file are errors, not tracebacks."""
    with pytest.raises(ResultError, match="no result file"):
        Trajectory(tmp_path / "missing.vtkhdf")
    (tmp_path / "mesh.obj").write_text("v 0 0 0\n")
    with pytest.raises(ResultError, match="not a result file"):
        Trajectory(tmp_path / "mesh.obj")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = 1
    with pytest.raises(ResultError, match="not a result file"):
        Trajectory(tmp_path / "other.h5")


def test_frame_out_of_range(result):
    """Asking for a frame that is not there says how many there are."""
    with Trajectory(result) as trajectory, pytest.raises(ResultError, match="4 frames"):
        trajectory.positions(T)


@pytest.mark.parametrize("frame", [1.0, "1", None, slice(2)])
@pytest.mark.parametrize(
    "read", ["positions", "positions_in_user_units", "det_f", "metrics_at", "leg_of", "index"]
)
def test_a_frame_that_is_no_integer_is_not_called_damage(result, read, frame):
    """The caller is told that the index is wrong, not that the file is."""
    with Trajectory(result) as trajectory:
        with pytest.raises(ResultError, match="is not the index of a frame") as info:
            getattr(trajectory, read)(frame)
        assert not isinstance(info.value, DamagedError)
        np.testing.assert_array_equal(trajectory.positions(np.int64(1)), POSITIONS[1])


def test_a_closed_result_is_not_called_damaged(result):
    """After closing, all that reads the file says that it is closed; what was read stays."""
    trajectory = Trajectory(result)
    times = trajectory.times
    trajectory.close()
    for read in (
        lambda: trajectory.positions(0), lambda: trajectory.det_f(0), lambda: list(trajectory),
        lambda: trajectory.metrics, lambda: trajectory.run, lambda: trajectory.events,
    ):  # fmt: skip
        with pytest.raises(ResultError, match="has been closed") as info:
            read()
        assert not isinstance(info.value, DamagedError)
    assert trajectory.times is times


def test_same_run_gives_the_same_bytes(result, tmp_path):
    """Nothing of the time or place of writing enters the file."""
    assert write(tmp_path / "again.vtkhdf").read_bytes() == result.read_bytes()


def test_write_error_has_a_remedy(tmp_path):
    """A result that cannot be written says where the frames are safe."""
    with Spool.create(tmp_path / "r.vtkhdf", RUN) as spool:
        spool.append(0, POSITIONS[0], METRICS[0])
        with pytest.raises(ResultError, match="safe in"):
            write_result(spool, tmp_path / "missing" / "r.vtkhdf", status="complete")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of the size of files")
@pytest.mark.parametrize("most_bytes", [0, 1, 100, 5000])
def test_a_disk_that_takes_no_more(result, tmp_path, most_bytes):
    """Wherever a file ends, the error says where the frames are, and nothing is left."""
    import resource

    assert most_bytes < result.stat().st_size
    path = tmp_path / "half.vtkhdf"
    with Spool.create(tmp_path / "r.vtkhdf", RUN) as spool:
        for t in range(T):
            spool.append(t, POSITIONS[t], METRICS[t])
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, hard))
        try:
            with pytest.raises(ResultError, match=r"File too large.*safe in"):
                write_result(spool, path, status="complete")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert not list(tmp_path.glob("half*"))
        write_result(spool, path, status="complete")
    with Trajectory(path) as trajectory:
        assert trajectory.frame_count == T
