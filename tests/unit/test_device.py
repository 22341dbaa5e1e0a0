"""The contract of the API names the devices of the engine."""

from typing import get_args

from chamfer_morph import schemas
from morph_engine.device import Device


def test_the_contract_names_every_device() -> None:
    """The schemas depend on nothing, so that they repeat the list."""
    assert get_args(schemas.Device) == get_args(Device)
