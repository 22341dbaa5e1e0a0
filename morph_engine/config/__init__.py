"""The configuration of a morph: nested, frozen models with units and bounds.

Every number that shapes a result is here, and every result stores the configuration that made it.
Presets (`morph_engine.presets`) are complete configurations; `configure` picks one and overrides
fields by path, as in `configure("fast", {"chamfer.weight": 5})`.
"""

from morph_engine.config.morph_config import MorphConfig
from morph_engine.config.settings import override, overrides_of, setting_fields, validated
from morph_engine.config.stored import stored_config

__all__ = [
    "MorphConfig",
    "override",
    "overrides_of",
    "setting_fields",
    "stored_config",
    "validated",
]
