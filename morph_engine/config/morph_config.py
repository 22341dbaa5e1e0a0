"""The whole configuration of a morph: what all methods share, and the options of one method."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Union

from pydantic import (
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    SerializeAsAny,
    TypeAdapter,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from morph_engine.methods.options import MethodConfig, MethodOptions
from morph_engine.methods.registry import DEFAULT_METHOD, names, options_of


class _AnyMethod:
    """A union of the options of all methods that are known when it is used, told apart by name."""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return handler(source)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        union: Any = Union[tuple(options_of(name) for name in names())]  # noqa: UP007
        annotated: Any = Annotated[union, Field(discriminator="name")]
        return handler(TypeAdapter(annotated).core_schema)


def _chosen(value: Any) -> Any:
    """Options of the method that a mapping, or a bare name, is about."""
    if isinstance(value, str):
        value = {"name": value}
    if isinstance(value, Mapping) and "name" in value:
        return options_of(str(value["name"])).model_validate(value)
    return value


class MorphConfig(MethodConfig):
    """Everything that determines a morph, given its source and target."""

    method: Annotated[SerializeAsAny[MethodOptions], BeforeValidator(_chosen), _AnyMethod()] = (
        Field(
            default_factory=lambda: options_of(DEFAULT_METHOD).model_validate({}),
            description="The method and its options, see `morph methods`.",
        )
    )
