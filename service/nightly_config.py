"""The file of `matiere nightly`: which sweeps run every night, and how they are compared.

    folder = "nights"          # where nights and reports are kept, beside this file
    keep = 14                  # nights of each sweep
    [[sweep]]
    file = "metals.json"

docs/nightly.md lists every key.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from matiere.errors import Fault, MatiereError, SceneValidationError, pointer
from matiere.jobs.night_options import Options

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


class NightlySweep(BaseModel):
    """A sweep that runs every night."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: Path = Field(description="sweep file, beside the configuration file")
    name: str = Field("", description="folder of its nights; default: the file's name")

    @field_validator("name")
    @classmethod
    def _plain(cls, value: str) -> str:
        return check_name(value) if value else value

    @property
    def title(self) -> str:
        """The name, or the file's."""
        return self.name or self.file.stem


class NightlyConfig(BaseModel):
    """A checked configuration file; paths are absolute."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    folder: Path = Field(Path("nights"), description="where nights and reports are kept")
    data: Path | None = Field(None, description="data directory; default: that of `matiere serve`")
    url: str | None = Field(None, description="the service; default: the data directory's, if any")
    keep: int = Field(14, ge=2, le=10_000, description="nights kept of each sweep")
    significance: float = Field(0.05, gt=0, lt=0.5, description="as in `matiere compare`")
    method: Literal["holm", "bh", "by"] = Field("holm", description="as in `matiere compare`")
    sweep: list[NightlySweep] = Field(min_length=1, description="the sweeps, in this order")

    def options(self) -> Options:
        """Return how nights are compared."""
        return Options(significance=self.significance, method=self.method)


def check_name(text: str) -> str:
    """Return a name of a night or sweep that can be a folder; raise ValueError otherwise."""
    if not _NAME.fullmatch(text):
        raise ValueError(
            f"{text!r} cannot name a folder: use letters, digits, '.', '_' and '-', at most 64"
        )
    return text


def load_config(path: Path) -> NightlyConfig:
    """Read a configuration file; raises SceneValidationError with pointers, or MatiereError."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MatiereError(f"cannot read {path}: {error.strerror}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise MatiereError(f"{path} is not valid TOML: {error}") from None
    try:
        config = NightlyConfig.model_validate(content)
    except ValidationError as error:
        raise SceneValidationError(
            Fault(pointer(*item["loc"]), item["type"], f"{path.name}: {item['msg']}")
            for item in error.errors(include_url=False)
        ) from None
    return _checked(config, path.resolve().parent)


def _checked(config: NightlyConfig, here: Path) -> NightlyConfig:
    faults, seen = list[Fault](), set[str]()
    for index, sweep in enumerate(config.sweep):
        title = sweep.title
        if not _NAME.fullmatch(title):
            why = f"{title!r} cannot name a folder; give the sweep a plain 'name'"
            faults.append(Fault(f"/sweep/{index}/name", "invalid_name", why))
        if title in seen:
            why = f"two sweeps are called {title!r}; give one of them another 'name'"
            faults.append(Fault(f"/sweep/{index}/name", "duplicate", why))
        seen.add(title)
    if faults:
        raise SceneValidationError(faults)
    changes: dict[str, Any] = {
        "folder": here / config.folder.expanduser(),
        "data": None if config.data is None else here / config.data.expanduser(),
        "sweep": [s.model_copy(update={"file": here / s.file}) for s in config.sweep],
    }
    return config.model_copy(update=changes)
