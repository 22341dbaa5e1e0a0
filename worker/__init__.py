"""Durable execution of morph jobs: queue, engine processes, storage, adoption of lost work."""

from morph_engine.optional_packages import require

require("dbos", "sqlalchemy", "pydantic_settings", extra="service", purpose="The service")
