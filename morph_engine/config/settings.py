"""Settings by dotted path: `grid.dx` of all methods, `chamfer.weight` of the chosen one.

A path names a setting that all methods share, or else one of the method's options, which may also
be written with `method.` before it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from morph_engine.config.morph_config import MorphConfig
from morph_engine.config.version_0_1 import renamed
from morph_engine.errors import ConfigError, MorphError, unknown_name
from morph_engine.methods.registry import names, options_of
from morph_engine.sections import SharedConfig

_PREFIX = "method."


def setting_fields(method: str) -> dict[str, FieldInfo]:
    """The dotted path and the field of every setting that a method honours.

    Raises:
        ConfigError: There is no such method.
    """
    return {
        **shared_fields(),
        "method": MorphConfig.model_fields["method"],
        **option_fields(method),
    }


def shared_fields() -> dict[str, FieldInfo]:
    """The dotted path and the field of every setting that all methods share."""
    return _fields(SharedConfig)


def option_fields(method: str) -> dict[str, FieldInfo]:
    """The dotted path and the field of every option of a method.

    Raises:
        ConfigError: There is no such method.
    """
    fields = _fields(options_of(method))
    del fields["name"]
    return fields


def override(config: MorphConfig, values: Mapping[str, Any]) -> MorphConfig:
    """Replace settings named by dotted path.

    Values may be text, as typed on a command line, and numbers and arrays of NumPy.

    Paths of version 0.1.0 are understood, too.

    Raises:
        ConfigError: An unknown path, with the nearest known one, one of another method, or a value
            out of range.
    """
    tree = config.model_dump()
    fields = setting_fields(config.method.name)
    for path, given in values.items():
        value = _without_arrays(given)
        location = _location(path, config.method.name) if isinstance(path, str) else None
        if location is None:
            raise _unknown(str(path), config.method.name)
        *sections, leaf = location.split(".")
        node = tree
        for section in sections:
            node = node[section]
        choices = get_args(fields[location.removeprefix(_PREFIX)].annotation)
        parsed = value if value in choices else _parsed(value)  # "none" may be one of them
        is_series = isinstance(node[leaf], tuple) and not isinstance(parsed, tuple | list)
        node[leaf] = (parsed,) if is_series else parsed
    return validated(tree)


def overrides_of(
    method: str, overrides: Mapping[str, Any], methods: Iterable[str]
) -> dict[str, Any]:
    """What of the overrides that are given for several methods is meant for one of them.

    An override that none of them has is kept, so that it is refused.

    Raises:
        ConfigError: There is no such method.
    """
    return {
        path: value
        for path, value in overrides.items()
        if _location(path, method) or not any(_location(path, other) for other in methods)
    }


def validated(tree: Mapping[str, Any]) -> MorphConfig:
    """A configuration from nested data.

    Raises:
        ConfigError: The first fault, with the permitted range.
    """
    try:
        return MorphConfig.model_validate(tree)
    except ValidationError as error:
        first = error.errors()[0]
        path = ".".join(str(part) for part in first["loc"]).removeprefix(_PREFIX)
        if first["type"] == "extra_forbidden":
            method = tree.get("method", {})
            raise _unknown(path, method["name"] if "name" in method else str(method)) from None
        message = first["msg"].removeprefix("Value error, ")
        is_group = isinstance(first["input"], Mapping | BaseModel) or not path
        if first["type"] == "missing":
            given = f"{path}: "
        else:
            given = "" if is_group else f"{path} = {first['input']!r}: "
        raise ConfigError(
            f"The configuration is not valid: {given}{message[0].lower()}{message[1:]}.",
            _remedy(first),
        ) from None


def _fields(section: type[BaseModel]) -> dict[str, FieldInfo]:
    """Dotted path and field of all that is below a section."""
    fields: dict[str, FieldInfo] = {}
    for name, field in section.model_fields.items():
        kind = field.annotation
        if get_origin(kind) is None and isinstance(kind, type) and issubclass(kind, BaseModel):
            fields |= {f"{name}.{path}": inner for path, inner in _fields(kind).items()}
        else:
            fields[name] = field
    return fields


def _location(path: str, method: str) -> str | None:
    """Where a setting stands in the tree of a configuration; None if the method lacks it."""
    shared, options = shared_fields(), option_fields(method)
    for candidate in (path, renamed(path, method) or path):
        if candidate in shared:
            return candidate
        short = candidate.removeprefix(_PREFIX)
        if short in options:
            return _PREFIX + short
    return None


def _unknown(path: str, method: str) -> MorphError:
    """Why a method has no setting of this name, and what to do."""
    short = path.removeprefix(_PREFIX)
    if path == "method.name":
        return ConfigError("The method is not an option of a method.", "Set it with `method`.")
    elsewhere = {other: option_fields(other) for other in names() if other != method}
    owners = [
        other
        for other, fields in elsewhere.items()
        if {short, renamed(short, other)} & fields.keys()
    ]
    if owners:
        return ConfigError(
            f"The method {method!r} has no setting called {short!r}.",
            f"It belongs to {', '.join(owners)}: choose such a method, or omit the setting.",
        )
    own = setting_fields(method)
    known = [*own, *(path for fields in elsewhere.values() for path in fields)]
    likely = [each for each in known if each.rsplit(".", 1)[-1] == short] or known
    return unknown_name("setting", path, likely, list_known=False)


def _parsed(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    text = value.strip()
    if text.lower() in ("none", "null"):
        return None
    if "," in text:
        return tuple(_parsed(part) for part in text.split(",") if part.strip())
    return text


def _without_arrays(value: Any) -> Any:
    """A value with plain numbers and lists in place of NumPy's, also in what it contains."""
    if isinstance(value, Mapping):
        return {name: _without_arrays(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return tuple(map(_without_arrays, value))
    return value.tolist() if hasattr(value, "tolist") else value


def _remedy(error: Any) -> str:
    if "grid.margin" in error["msg"]:
        return "Lower grid.margin, or raise grid.half_extent."
    if "time.dt" in error["msg"]:
        return "Lower time.dt, soften the material, or coarsen the grid."
    if "expected" in error.get("ctx", {}):
        return f"Choose one of {error['ctx']['expected']}."
    return "See `morph presets fast` for the meaning and range of every setting."
