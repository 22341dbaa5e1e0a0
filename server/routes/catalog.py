"""What there is to choose from: presets, methods, built-in shapes, and the schema of settings."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query

from chamfer_morph.schemas import Resource
from chamfer_morph.server.auth import AuthenticatedRoute, Reader
from chamfer_morph.server.http.problems import not_found
from morph_engine import methods, presets
from morph_engine.config import MorphConfig
from morph_engine.geometry import shapes

router: APIRouter = APIRouter(tags=["catalog"], route_class=AuthenticatedRoute)

TEXT_SHAPE = Resource(name="text:WORD", description="Extruded letters of any text.")


@router.get("/presets", operation_id="listPresets", summary="List presets")
def list_presets(caller: Reader) -> list[Resource]:
    """Configurations to start from, the default first."""
    return [Resource(name=name, description=presets.describe(name)) for name in presets.names()]


@router.get("/presets/{name}", operation_id="getPreset", summary="Show a preset")
def get_preset(
    name: str,
    caller: Reader,
    method: Annotated[
        str | None,
        Query(description="Show the options of this method instead of those of the preset's own."),
    ] = None,
) -> Resource:
    """A preset with all its settings."""
    if name not in presets.names():
        raise not_found("preset", name)
    chosen = {} if method is None else {"method": method}
    config = presets.configure(name, chosen).model_dump(mode="json")
    return Resource(name=name, description=presets.describe(name), config=config)


@router.get("/methods", operation_id="listMethods", summary="List methods")
def list_methods(caller: Reader) -> list[Resource]:
    """Methods to move the particles, the default first."""
    return [
        Resource(name=name, description=methods.options_of(name).summary())
        for name in methods.names()
    ]


@router.get("/shapes", operation_id="listShapes", summary="List built-in shapes")
def list_shapes(caller: Reader) -> list[Resource]:
    """Shapes that need no file; all hold about the same number of particles."""
    named = [Resource(name=name, description=f"A built-in {name}.") for name in shapes.names()]
    return [*named, TEXT_SHAPE]


@router.get(
    "/schemas/config", operation_id="getConfigSchema", summary="JSON schema of the settings"
)
def get_config_schema(caller: Reader) -> dict[str, Any]:
    """Every setting with its unit, range and meaning, as JSON Schema."""
    return MorphConfig.model_json_schema()
