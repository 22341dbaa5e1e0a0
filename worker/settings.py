"""Settings of the service, from MORPH_* environment variables or a .env file."""

from __future__ import annotations

import difflib
import ipaddress
import os
from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field, SecretStr, ValidationError, field_validator
from pydantic_settings import BaseSettings, DotEnvSettingsSource, SettingsConfigDict

from morph_engine.errors import ConfigError
from morph_engine.machine_memory import total_memory

Network = ipaddress.IPv4Network | ipaddress.IPv6Network

MIB = 1 << 20
GIB = 1 << 30

SHORTEST_SECRET = 32
"""Characters of a secret that somebody chose."""

OTHER_VARIABLES = ("SERVER", "KEY", "URL", "MESHES", "CHROMIUM")
"""What MORPH_* means to others than the service: the client, the page, and the tests."""


class Settings(BaseSettings):
    """Every setting, its default and its meaning; `docs/settings.md` lists them."""

    model_config: ClassVar[SettingsConfigDict] = SettingsConfigDict(
        env_prefix="MORPH_", env_file=".env", extra="ignore"
    )

    data_dir: Path = Field(
        Path.home() / ".local/share/morph", description="Meshes, jobs, results and locks."
    )
    database_url: str = Field(
        "", description="postgresql://... to spread over machines; SQLite in data_dir if empty."
    )
    database_pooler_url: str = Field(
        "",
        description="postgresql://... of a pooler such as PgBouncer before it, which shares a few "
        "connections out by transaction. Locks keep one each at `MORPH_DATABASE_URL`.",
    )
    object_store: str = Field(
        "",
        description="s3://bucket/prefix for hosts that share no folder; files in data_dir if "
        "empty. Keys and endpoint come from the AWS_* variables.",
    )
    object_store_seconds: float = Field(
        600,
        ge=0,
        description="How long a worker waits for an object store before its job fails [s].",
    )
    object_store_cache_bytes: int = Field(
        20 * GIB,
        gt=0,
        description="Disk for copies of what is in the object store, for each process [bytes].",
    )
    host: str = Field(
        "127.0.0.1", description="Address to listen on; others than loopback need keys."
    )
    admin_key: SecretStr = Field(
        SecretStr(""),
        description="Secret of the key `admin`, which is made or changed when the service starts.",
    )
    admin_key_file: Path | None = Field(None, description="A file that holds it instead.")
    metrics_key: SecretStr = Field(
        SecretStr(""),
        description="Secret that Prometheus may send for `/metrics`, as its bearer token.",
    )
    log_format: Literal["text", "json"] = Field(
        "text",
        description="Lines of the log of all processes: to be read, or JSON objects with the ids "
        "of jobs, which also tell when a job is begun and done.",
    )
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on; 0 takes a free one.")
    workers: int = Field(1, ge=0, le=256, description="Worker slots that `morph serve` starts.")
    threads: int = Field(
        0, ge=0, description="CPU threads of a job; 0 shares the cores out evenly."
    )
    warm_engines: bool = Field(
        True,
        description="Keep a process ready for the next job of each slot, with kernels loaded; it "
        "takes some 450 MB.",
    )
    poll_seconds: float = Field(
        0,
        ge=0,
        description="How often an idle worker looks for a job that it is not told of; 0: every "
        "0.25 s on SQLite, and every 10 s on Postgres, which tells workers [s].",
    )
    job_memory_bytes: int = Field(
        0,
        ge=0,
        description="Jobs that would need more memory are refused, and stopped if they take more; "
        "0: than this machine has, shared out evenly to its workers [bytes].",
    )
    job_timeout_seconds: float = Field(
        86400, gt=0, description="Longest running time of a job [s]."
    )
    attempts: int = Field(3, ge=1, description="Attempts of a job whose engine crashes or hangs.")
    retry_seconds: float = Field(
        1.0, ge=0, description="Pause before the second attempt, doubled for each further one [s]."
    )
    stall_seconds: float = Field(
        900, gt=0, description="A job that finishes no frame for so long counts as hung [s]."
    )
    adoption_seconds: float = Field(
        2.0, gt=0, description="How often the janitor looks for jobs of dead workers [s]."
    )
    upload_bytes: int = Field(256 * MIB, gt=0, description="Largest upload [bytes].")
    body_bytes: int = Field(1 * MIB, gt=0, description="Largest JSON request body [bytes].")
    upload_timeout_seconds: float = Field(
        60, gt=0, description="An upload that sends nothing for so long is dropped [s]."
    )
    upload_deadline_seconds: float = Field(
        3600, gt=0, description="An upload that takes longer is dropped [s]."
    )
    inspect_memory_bytes: int = Field(2 * GIB, gt=0, description="Memory to parse a mesh [bytes].")
    inspect_cpu_seconds: int = Field(60, gt=0, description="CPU time to parse a mesh [s].")
    export_memory_bytes: int = Field(
        4 * GIB, gt=0, description="Memory to make a surface or an export [bytes]."
    )
    export_cpu_seconds: int = Field(
        3600, gt=0, description="CPU time to make a surface or an export [s]."
    )
    sandbox_processes: int = Field(
        6, ge=1, description="Meshes, surfaces, results and exports computed at the same time."
    )
    sandbox_memory_bytes: int = Field(
        0,
        ge=0,
        description="Memory that all of these may take together, over all API processes of a "
        "machine; 0: what it has [bytes].",
    )
    meshes_per_key: int = Field(1000, gt=0, description="Meshes that a key may keep.")
    queued_jobs_per_key: int = Field(1000, gt=0, description="Unfinished jobs that a key may have.")
    disk_bytes_per_key: int = Field(
        100 * GIB, gt=0, description="Disk that a key may fill [bytes]."
    )
    retention_days: float = Field(
        0, ge=0, description="Finished jobs are deleted after so long; 0 never."
    )
    retention_bytes: int = Field(
        0, ge=0, description="Oldest finished jobs are deleted beyond this size; 0 never [bytes]."
    )
    webhooks_per_key: int = Field(10, gt=0, description="Webhooks that a key may have.")
    webhook_networks: str = Field(
        "",
        description="Networks that webhooks may reach although they are not public, as "
        "127.0.0.0/8,10.1.0.0/16.",
    )
    webhook_attempts: int = Field(
        10, ge=1, description="Attempts to deliver a message to a webhook before it is given up."
    )
    webhook_retry_seconds: float = Field(
        5.0,
        gt=0,
        description="Pause before the second attempt, about tripled for each further one [s].",
    )
    watchers: int = Field(1000, gt=0, description="Event streams served at the same time.")
    watchers_per_key: int = Field(
        200,
        gt=0,
        description="Event streams of one key among them, with those by share links to its jobs.",
    )

    @property
    def system_database_url(self) -> str:
        """The database in use, as SQLAlchemy spells it."""
        return self.database_url or f"sqlite:///{self.data_dir.absolute() / 'morph.sqlite'}"

    def read_admin_key(self) -> str:
        """The secret of the key `admin` from its variable or file; empty if there is neither.

        Raises:
            ConfigError: The file cannot be read, or the secret is so short that it may be guessed.
        """
        secret = self.admin_key.get_secret_value()
        if self.admin_key_file is not None:
            try:
                secret = self.admin_key_file.read_text(encoding="utf-8").strip()
            except (OSError, UnicodeDecodeError) as error:
                raise ConfigError(
                    f"MORPH_ADMIN_KEY_FILE cannot be read: {error}.", "Name a file with a secret."
                ) from None
        elif not secret:
            return ""
        if len(secret) < SHORTEST_SECRET:
            raise ConfigError(
                f"The key `admin` has fewer than {SHORTEST_SECRET} characters.",
                "Make a longer one: openssl rand -hex 32.",
            )
        return secret

    @field_validator("metrics_key")
    @classmethod
    def _check_length(cls, secret: SecretStr) -> SecretStr:
        if 0 < len(secret.get_secret_value()) < SHORTEST_SECRET:
            raise ValueError(f"it has fewer than {SHORTEST_SECRET} characters")
        return secret

    @field_validator("webhook_networks")
    @classmethod
    def _read_networks(cls, text: str) -> str:
        _networks(text)
        return text

    @property
    def allowed_webhook_networks(self) -> tuple[Network, ...]:
        """Networks that webhooks may reach although they are not public."""
        return _networks(self.webhook_networks)

    @property
    def memory_per_job(self) -> int:
        """Memory that a job may take: as set, or an even share of what there is [bytes]."""
        return self.job_memory_bytes or total_memory() // max(1, self.workers)

    @property
    def queue_poll_seconds(self) -> float:
        """How often an idle worker looks for a job [s]."""
        return self.poll_seconds or (10.0 if self.on_postgres else 0.25)

    @property
    def on_postgres(self) -> bool:
        """Whether the queue spans machines."""
        return self.system_database_url.startswith("postgres")


def _networks(text: str) -> tuple[Network, ...]:
    return tuple(ipaddress.ip_network(part.strip()) for part in text.split(",") if part.strip())


def load_settings() -> Settings:
    """The settings of this process.

    Raises:
        ConfigError: A variable of the environment or of .env is unknown, or its value cannot be
            used.
    """
    known = [f"MORPH_{name.upper()}" for name in Settings.model_fields]
    others = {f"MORPH_{name}" for name in OTHER_VARIABLES}
    in_file = DotEnvSettingsSource(Settings).env_vars  # in lower case, as names have none here
    for name in sorted({*os.environ, *map(str.upper, in_file)}):
        if name.startswith("MORPH_") and name not in {*known, *others}:
            closest = difflib.get_close_matches(name, known, 1, 0.0)[0]
            raise ConfigError(
                f"There is no variable {name}.",
                f"Did you mean {closest}? All of them are in docs/settings.md.",
            )
    try:
        settings = Settings()
    except ValidationError as error:
        fault = error.errors()[0]
        name = "MORPH_" + "_".join(str(part) for part in fault["loc"]).upper()
        raise ConfigError(f"{name}: {fault['msg']}.", "See docs/settings.md.") from None
    if settings.database_url and not settings.on_postgres:
        raise ConfigError(
            "MORPH_DATABASE_URL is no address of a Postgres database.",
            "Write postgresql://user:word@host:5432/name, or leave it out for SQLite.",
        )
    if settings.database_pooler_url and not settings.on_postgres:
        raise ConfigError(
            "MORPH_DATABASE_POOLER_URL is there, and no Postgres database behind it.",
            "Name the database itself in MORPH_DATABASE_URL.",
        )
    return settings
