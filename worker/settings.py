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
        Path.home() / ".local/share/morph",
        description="Folder for meshes, jobs, results and locks.",
    )
    database_url: str = Field(
        "", description="postgresql://... to use several machines; default: SQLite in data_dir."
    )
    database_pooler_url: str = Field(
        "",
        description="postgresql://... of a pooler in front of it, such as PgBouncer in transaction "
        "mode. Locks still take one connection each to `MORPH_DATABASE_URL`.",
    )
    object_store: str = Field(
        "",
        description="s3://bucket/prefix for machines that share no folder; default: files in "
        "data_dir. Keys and endpoint come from the AWS_* variables.",
    )
    object_store_seconds: float = Field(
        600,
        ge=0,
        description="How long a worker waits for an object store before its job fails [s].",
    )
    object_store_cache_bytes: int = Field(
        20 * GIB,
        gt=0,
        description="Disk space for copies of files in the object store, for each process [bytes].",
    )
    host: str = Field(
        "127.0.0.1", description="Address to listen on; any but a loopback address requires keys."
    )
    admin_key: SecretStr = Field(
        SecretStr(""),
        description="Secret of the key `admin`, which is made or updated when the service starts.",
    )
    admin_key_file: Path | None = Field(
        None, description="File with the secret, instead of `MORPH_ADMIN_KEY`."
    )
    metrics_key: SecretStr = Field(
        SecretStr(""),
        description="Secret that Prometheus may send as a bearer token for `/metrics`.",
    )
    log_format: Literal["text", "json"] = Field(
        "text",
        description="Log format of all processes: text, or JSON objects with job ids, which also "
        "tell when a job starts and ends.",
    )
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on; 0 picks a free one.")
    workers: int = Field(1, ge=0, le=256, description="Worker slots that `morph serve` starts.")
    threads: int = Field(
        0, ge=0, description="CPU threads of a job; 0 divides the cores evenly among workers."
    )
    warm_engines: bool = Field(
        True,
        description="Keep a process ready for the next job of each slot, with kernels loaded; it "
        "takes about 450 MB.",
    )
    poll_seconds: float = Field(
        0,
        ge=0,
        description="How often an idle worker polls for jobs [s]; 0: every 0.25 s on SQLite, and "
        "every 10 s on Postgres, which notifies workers of new jobs.",
    )
    job_memory_bytes: int = Field(
        0,
        ge=0,
        description="Memory limit per job [bytes]: jobs that would need more are refused, and "
        "those that take more are stopped; 0: the memory of this machine, divided evenly among its "
        "workers.",
    )
    job_timeout_seconds: float = Field(
        86400, gt=0, description="Longest running time of a job [s]."
    )
    attempts: int = Field(3, ge=1, description="Attempts of a job whose engine crashes or hangs.")
    retry_seconds: float = Field(
        1.0, ge=0, description="Pause before the second attempt [s], doubled for each further one."
    )
    stall_seconds: float = Field(
        900, gt=0, description="A job that finishes no frame within this time counts as hung [s]."
    )
    adoption_seconds: float = Field(
        2.0, gt=0, description="How often the janitor checks for jobs of dead workers [s]."
    )
    upload_bytes: int = Field(256 * MIB, gt=0, description="Largest upload [bytes].")
    body_bytes: int = Field(1 * MIB, gt=0, description="Largest JSON request body [bytes].")
    upload_timeout_seconds: float = Field(
        60, gt=0, description="An upload that sends no data for this long is dropped [s]."
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
        6, ge=1, description="Meshes, surfaces, results and exports processed at the same time."
    )
    sandbox_memory_bytes: int = Field(
        0,
        ge=0,
        description="Memory limit for all of these together, over all API processes of a machine "
        "[bytes]; 0: the memory of the machine.",
    )
    meshes_per_key: int = Field(1000, gt=0, description="Meshes that a key may keep.")
    queued_jobs_per_key: int = Field(1000, gt=0, description="Unfinished jobs that a key may have.")
    disk_bytes_per_key: int = Field(100 * GIB, gt=0, description="Disk quota of a key [bytes].")
    retention_days: float = Field(
        0, ge=0, description="Finished jobs are deleted after this many days; 0: never."
    )
    retention_bytes: int = Field(
        0,
        ge=0,
        description="Oldest finished jobs are deleted beyond this total size [bytes]; 0: never.",
    )
    webhooks_per_key: int = Field(10, gt=0, description="Webhooks that a key may have.")
    webhook_networks: str = Field(
        "",
        description="Networks that webhooks may reach although they are not public, such as "
        "127.0.0.0/8,10.1.0.0/16.",
    )
    webhook_attempts: int = Field(
        10, ge=1, description="Attempts to deliver a message to a webhook before giving up."
    )
    webhook_retry_seconds: float = Field(
        5.0,
        gt=0,
        description="Pause before the second attempt [s], about tripled for each further one.",
    )
    watchers: int = Field(1000, gt=0, description="Event streams served at the same time.")
    watchers_per_key: int = Field(
        200,
        gt=0,
        description="Event streams of one key among them, including those of share links to its "
        "jobs.",
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
                    f"MORPH_ADMIN_KEY_FILE cannot be read: {error}.",
                    "Name a file that contains a secret.",
                ) from None
        elif not secret:
            return ""
        if len(secret) < SHORTEST_SECRET:
            raise ConfigError(
                f"The key `admin` has fewer than {SHORTEST_SECRET} characters.",
                "Make a longer one: openssl rand -hex 32.",
            )
        return secret

    @field_validator("data_dir", "admin_key_file")
    @classmethod
    def _expand_home(cls, path: Path | None) -> Path | None:
        try:
            return path and path.expanduser()
        except RuntimeError:
            raise ValueError(f"there is no home directory for {path}") from None

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
                f"There is no setting {name}.",
                f"Did you mean {closest}? docs/settings.md lists all settings.",
            )
    try:
        settings = Settings()
    except ValidationError as error:
        fault = error.errors()[0]
        name = "MORPH_" + "_".join(str(part) for part in fault["loc"]).upper()
        raise ConfigError(f"{name}: {fault['msg']}.", "See docs/settings.md.") from None
    if settings.database_url and not settings.on_postgres:
        raise ConfigError(
            "MORPH_DATABASE_URL is not the URL of a Postgres database.",
            "Use the form postgresql://user:password@host:5432/name, or unset it for SQLite.",
        )
    if settings.database_pooler_url and not settings.on_postgres:
        raise ConfigError(
            "MORPH_DATABASE_POOLER_URL is set, but there is no Postgres database behind it.",
            "Name the database itself in MORPH_DATABASE_URL.",
        )
    return settings
