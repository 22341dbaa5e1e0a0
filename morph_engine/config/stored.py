"""Configurations as results and jobs store them, of this version and of older ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from morph_engine.config.morph_config import MorphConfig
from morph_engine.config.settings import option_fields, shared_fields
from morph_engine.config.version_0_1 import converted, is_old
from morph_engine.methods.options import MethodOptions
from morph_engine.methods.registry import names, options_of


class ForeignOptions(MethodOptions, extra="allow"):
    """Stored options of a method that is not installed, or that is of another version.

    They are shown as they were stored, and cannot be run.
    """


def stored_config(document: Any) -> MorphConfig:
    """A configuration that was stored as JSON.

    Options of a method that this installation does not know, or knows in another way, are kept as
    they are: what they made is shown, and cannot be run again.

    Raises:
        ValidationError: It is no configuration.
    """
    if isinstance(document, MorphConfig) or not isinstance(document, Mapping):
        return MorphConfig.model_validate(document)
    tree = dict(document)
    if is_old(tree):
        method = tree["method"]
        tree = converted(tree, shared_fields(), option_fields(method) if method in names() else {})
    options = tree.get("method")
    if isinstance(options, Mapping) and not _is_known(options):
        tree["method"] = ForeignOptions.model_validate(options)
    return MorphConfig.model_validate(tree)


def _is_known(options: Mapping[str, Any]) -> bool:
    if options.get("name") not in names():
        return False
    try:
        options_of(options["name"]).model_validate(options)
    except ValidationError:
        return False
    return True
