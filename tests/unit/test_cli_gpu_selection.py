"""Which GPUs get a worker."""

import pytest

from chamfer_morph.cli.gpu_selection import chosen_gpus, slots_of
from morph_engine.errors import ConfigError, DeviceError


def test_gpus_are_chosen_by_index():
    """Each once, in the order given."""
    assert chosen_gpus("2,0,2") == ["2", "0"]


@pytest.mark.parametrize(
    ("visible", "chosen"),
    [
        ("1,3", ["1", "3"]),
        ("GPU-8932f937,MIG-5c89", ["GPU-8932f937", "MIG-5c89"]),
        ("2,-1,1", ["2"]),
    ],
)
def test_all_gpus_are_those_that_the_user_can_see(monkeypatch, visible, chosen):
    """As for any CUDA program, by index or UUID, up to one that is not there."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    assert chosen_gpus("all") == chosen


@pytest.mark.parametrize(
    ("gpus", "slots"),
    [
        (["0", "2"], {4: "0", 6: "2"}),
        (["2"], {6: "2"}),
        (["GPU-8932f937", "MIG-5c89"], {4: "GPU-8932f937", 5: "MIG-5c89"}),
        (["1", "GPU-8932f937"], {4: "1", 5: "GPU-8932f937"}),
    ],
)
def test_each_gpu_has_a_slot_of_its_own(gpus, slots):
    """By its index, from the first slot on, so that the others do not matter."""
    assert slots_of(gpus, 4) == slots


@pytest.mark.parametrize("visible", ["", "-1", "NoDevFiles"])
def test_a_user_who_can_see_no_gpu_gets_none(monkeypatch, visible):
    """Not those of others; the message says why."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    with pytest.raises(DeviceError, match="CUDA_VISIBLE_DEVICES"):
        chosen_gpus("all")


@pytest.mark.parametrize("text", ["", "first", "0,", "-1"])
def test_what_names_no_gpu_is_refused(text):
    """The remedy shows how to write it."""
    with pytest.raises(ConfigError, match="0,2"):
        chosen_gpus(text)


def test_without_a_gpu_the_cpu_is_proposed(monkeypatch, tmp_path):
    """No nvidia-smi, no GPU."""
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DeviceError, match="--slots"):
        chosen_gpus("all")
