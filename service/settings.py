"""The settings of the service, and where each value came from.

    flags  >  environment  >  files  >  defaults

Environment variables are `MATIERE_` plus the name in capitals (`MATIERE_PORT`); the data directory
also comes from systemd's `STATE_DIRECTORY`. Files are TOML with the same names, read in the order
`--config` (or `MATIERE_CONFIG`), `$XDG_CONFIG_HOME/matiere/config.toml`,
`/etc/matiere/config.toml`; a value set in an earlier file hides the same value in a later one.
"""

from __future__ import annotations

import difflib
import ipaddress
import os
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import platformdirs
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from matiere.errors import MatiereError

if TYPE_CHECKING:
    from matiere.jobs.limits import Limits
    from matiere.jobs.rules import Rules

ENVIRONMENT_PREFIX = "MATIERE_"
SYSTEM_CONFIG = Path("/etc/matiere/config.toml")
# Read by other parts of the package; not settings of the service.
OTHER_ENVIRONMENT = frozenset(
    {"MATIERE_CONFIG", "MATIERE_API_KEY", "MATIERE_API_KEY_FILE", "MATIERE_URL"}
)


class SettingsError(MatiereError):
    """A setting is unknown, misspelt or out of range; the message says where it was set."""

    default_code = "invalid_setting"


def default_data_dir() -> Path:
    """Return `$XDG_DATA_HOME/matiere`."""
    return Path(platformdirs.user_data_path("matiere"))


class Settings(BaseModel):
    """All settings; frozen, unknown names refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)

    data: Path = Field(
        default_factory=default_data_dir,
        description="data directory: store, artifacts, assets, logs",
    )
    host: str = Field(
        "127.0.0.1", description="address to listen on; beyond loopback only with API keys"
    )
    uds: Path | None = Field(
        None,
        description="Unix socket to listen on instead of an address; only its owner may use it",
    )
    require_key: bool = Field(
        False, description="ask for an API key also on loopback, before there is one"
    )
    port: int = Field(8470, ge=0, le=65535, description="TCP port; 0 takes any free one")
    allowed_hosts: tuple[str, ...] = Field(
        (), description="more names a Host header may carry, besides the loopback names"
    )
    children: int | None = Field(
        None,
        ge=1,
        le=1024,
        description="render processes; none: usable cores / threads_per_child, of this machine or"
        " of every node",
    )
    threads_per_child: int = Field(1, ge=1, le=1024, description="render threads of each process")
    executor: Literal["local", "ray"] = Field(
        "local",
        description="where is rendered: local (processes of this machine) or ray (a cluster)",
    )
    ray_address: str | None = Field(
        None, description="address of the Ray cluster; none: the one this machine is part of"
    )
    child_memory_bytes: int | None = Field(
        None,
        ge=64 * 2**20,
        description="memory a render process may use, in bytes; none: three quarters of the"
        " machine's for all together",
    )
    claim_limit_s: float = Field(
        3600.0, gt=0, description="longest work on one claim (about a second), in seconds"
    )
    database_url: str | None = Field(None, description="job store; none: SQLite below `data`")
    artifacts_url: str | None = Field(
        None, description="object store of results (s3://bucket/prefix); none: below `data`"
    )
    result_days: float = Field(30.0, gt=0, description="days that results are kept")
    film_bytes: int | None = Field(
        None, ge=0, description="space for stored films; none: 50 GB or half the free disk"
    )
    gc_grace_hours: float = Field(
        24.0, ge=0, description="age from which a file that nobody names is removed, in hours"
    )
    events_kept: int = Field(
        500_000, ge=1000, description="events kept for clients that resume a stream of them"
    )
    max_body_bytes: int = Field(
        8 * 2**20, ge=2**10, le=2**30, description="largest JSON body in bytes"
    )
    max_asset_bytes: int = Field(
        2 * 2**30, ge=2**10, le=2**40, description="largest uploaded asset in bytes"
    )
    max_pixels: int = Field(2**26, ge=1, description="largest film in pixels")
    max_spp: int = Field(2**24, ge=1, description="most samples per pixel of a job")
    max_depth: int = Field(10_000, ge=0, description="longest paths that a scene may ask for")
    max_seconds: float = Field(
        7 * 86_400.0, gt=0, description="longest render time that a job may ask for, in seconds"
    )
    max_triangles: int = Field(50_000_000, ge=1, description="most triangles of a scene")
    max_texture_bytes: int = Field(
        4 * 2**30, ge=1, description="all images of a scene together, decoded, in bytes"
    )
    max_film_bytes: int | None = Field(
        None, ge=2**10, description="largest film in bytes; none: an eighth of the memory"
    )
    max_job_bytes: int | None = Field(
        None,
        ge=2**10,
        description="film, textures and triangles of a job by estimate, in bytes; none: half of"
        " the memory",
    )
    max_queued_jobs: int = Field(
        1_000_000, ge=1, description="jobs and cells that have not ended; more are refused"
    )
    max_queued_jobs_per_key: int = Field(
        200_000, ge=1, description="of them, those of one API key; more are refused"
    )
    max_queued_megasamples_per_key: float | None = Field(
        None, gt=0, description="millions of pixel samples that jobs of one API key may ask for"
    )
    webhooks: bool = Field(False, description="tell webhooks of events; an admin registers them")
    webhook_http: bool = Field(False, description="let webhooks have http addresses, without TLS")
    webhook_hosts: tuple[str, ...] = Field(
        (), description="hosts that webhooks may have although they lead to no public address"
    )
    min_free_bytes: int = Field(
        2 * 10**9, ge=0, description="free disk space below which no new work is taken, in bytes"
    )
    body_timeout_s: float = Field(
        30.0, gt=0, le=3600, description="longest pause within a request body, in seconds"
    )
    drain_timeout_s: float = Field(
        8.0, ge=0, le=3600, description="time given to running chunks at SIGTERM, in seconds"
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info", description="least severe line written to the log"
    )
    log_format: Literal["text", "json"] = Field(
        "text", description="lines of the log: text, or one JSON object each"
    )
    tracing: bool = Field(
        False, description="send spans to OpenTelemetry, where OTEL_EXPORTER_OTLP_ENDPOINT says"
    )

    @property
    def loopback(self) -> bool:
        """Tell whether only this machine can reach the service."""
        try:
            return self.host == "localhost" or ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def asks_for_keys(self) -> bool:
        """Tell whether keys are asked for even before one was made."""
        return self.require_key or (self.uds is None and not self.loopback)

    def engine_options(self) -> dict[str, Any]:
        """Return the arguments of `open_engine` that every process with a queue of its own has."""
        return {
            "children": self.children,
            "threads_per_child": self.threads_per_child,
            "database_url": self.database_url,
            "artifacts_url": self.artifacts_url,
            "min_free_bytes": self.min_free_bytes,
            "rules": self.rules(),
            "child_memory_bytes": self.child_memory_bytes,
            "claim_limit_s": self.claim_limit_s,
            "executor": self.executor,
            "ray_address": self.ray_address,
        }

    def rules(self) -> Rules:
        """Return how long things are kept."""
        from matiere.jobs.rules import Rules

        return Rules(
            self.result_days,
            self.film_bytes,
            self.gc_grace_hours,
            self.min_free_bytes,
            self.events_kept,
        )

    def limits(self) -> Limits:
        """Return how large a job may be, and how many may wait."""
        from matiere.jobs.limits import Limits

        samples = self.max_queued_megasamples_per_key
        return Limits(
            film_bytes=self.max_film_bytes or 0,
            job_bytes=self.max_job_bytes or 0,
            pixels=self.max_pixels,
            spp=self.max_spp,
            depth=self.max_depth,
            seconds=self.max_seconds,
            triangles=self.max_triangles,
            texture_bytes=self.max_texture_bytes,
            queued=self.max_queued_jobs,
            key_queued=self.max_queued_jobs_per_key,
            key_samples=samples and 1e6 * samples,
        )

    @field_validator("data")
    @classmethod
    def _expand(cls, value: Path) -> Path:
        return value.expanduser().absolute()

    @field_validator("uds")
    @classmethod
    def _expand_socket(cls, value: Path | None) -> Path | None:
        return value and value.expanduser().absolute()


@dataclass(frozen=True)
class Resolved:
    """Settings with the origin of each value, for `matiere config` and error messages."""

    settings: Settings
    origins: Mapping[str, str]
    files: tuple[Path, ...]  # configuration files that were read
    unknown: tuple[str, ...]  # MATIERE_* variables that are no setting


def resolve(
    flags: Mapping[str, Any] | None = None,
    *,
    config: str | Path | None = None,
    environ: Mapping[str, str] | None = None,
) -> Resolved:
    """Gather settings from flags (None = not given), environment, files and defaults.

    Raises `SettingsError` for an unknown name, a bad value or an unreadable file.
    """
    environ = os.environ if environ is None else environ
    values: dict[str, Any] = {}
    origins: dict[str, str] = {}
    files: list[Path] = []

    def take(name: str, value: Any, origin: str) -> None:
        if name not in values and value is not None:
            values[name], origins[name] = value, origin

    for name, value in (flags or {}).items():
        take(name, value, f"flag --{name.replace('_', '-')}")
    for name, variable, text in _from_environment(environ):
        take(name, text, f"environment {variable}")
    for path, must_exist in _candidates(config, environ):
        content = _read(path, must_exist)
        if content is None:
            continue
        files.append(path)
        for name, value in content.items():
            take(name, value, f"file {path}")
    try:
        settings = Settings.model_validate(values)
    except ValidationError as error:
        raise SettingsError(_explain(error, values, origins)) from None
    for name in Settings.model_fields:
        origins.setdefault(name, "default")
    return Resolved(settings, origins, tuple(files), _unknown(environ))


def _from_environment(environ: Mapping[str, str]) -> Iterator[tuple[str, str, Any]]:
    for name in Settings.model_fields:
        text = environ.get(variable := ENVIRONMENT_PREFIX + name.upper(), "")
        if text and name in ("allowed_hosts", "webhook_hosts"):
            yield name, variable, [part.strip() for part in text.split(",") if part.strip()]
        elif text:
            yield name, variable, text
    if state := environ.get("STATE_DIRECTORY", ""):  # systemd: may be a colon-separated list
        yield "data", "STATE_DIRECTORY", state.split(":")[0]


def _candidates(
    config: str | Path | None, environ: Mapping[str, str]
) -> Iterator[tuple[Path, bool]]:
    if given := config or environ.get("MATIERE_CONFIG"):
        yield Path(given).expanduser().absolute(), True
    home = environ.get("XDG_CONFIG_HOME") or Path(environ.get("HOME", "~"), ".config")
    yield Path(home, "matiere", "config.toml").expanduser().absolute(), False
    yield SYSTEM_CONFIG, False


def _read(path: Path, must_exist: bool) -> dict[str, Any] | None:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        if must_exist:
            raise SettingsError(f"the configuration file {path} does not exist") from None
        return None
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"cannot read the configuration file {path}: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"{path} is not valid TOML: {error}") from None
    for name in content:
        if name not in Settings.model_fields:
            raise SettingsError(f"{path}: there is no setting {name!r}{_did_you_mean(name)}")
    return content


def _explain(error: ValidationError, values: Mapping[str, Any], origins: Mapping[str, str]) -> str:
    lines = []
    for item in error.errors():
        name = str(item["loc"][0]) if item["loc"] else ""
        if item["type"] == "extra_forbidden":
            lines.append(f"there is no setting {name!r}{_did_you_mean(name)}")
        else:
            lines.append(f"{name} = {values.get(name)!r} ({origins.get(name)}): {item['msg']}")
    return "\n".join(lines)


def _did_you_mean(name: str) -> str:
    close = difflib.get_close_matches(name, Settings.model_fields, n=1)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; the settings are {', '.join(Settings.model_fields)}"


def _unknown(environ: Mapping[str, str]) -> tuple[str, ...]:
    known = {ENVIRONMENT_PREFIX + name.upper() for name in Settings.model_fields}
    mine = {name for name in environ if name.startswith(ENVIRONMENT_PREFIX)}
    return tuple(sorted(mine - known - OTHER_ENVIRONMENT))
