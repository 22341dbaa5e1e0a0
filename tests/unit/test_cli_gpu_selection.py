"""Which GPUs get a worker."""

import pytest

from chamfer_morph.cli.gpu_selection import chosen_gpus
from morph_engine.errors import ConfigError, DeviceError


def test_gpus_are_chosen_by_index():
    """Each once, in the order given."""
    assert chosen_gpus("2,0,2") == ["2", "0"]


def test_all_gpus_are_those_that_the_user_can_see(monkeypatch):
    """As for any CUDA program."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "1,3")
    assert chosen_gpus("all") == ["1", "3"]


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
