"""The service's log: plain lines, or JSON objects with the ids of job, chunk and attempt."""

from __future__ import annotations

import json
import logging
import logging.handlers
import time
from pathlib import Path
from typing import Any, Literal

LOG_BYTES, LOG_FILES = 10 * 2**20, 5
# What a line may name beside its text; `job` is a list, `chunk` is [first, last].
IDS = ("job", "sweep", "film", "attempt", "chunk", "child", "webhook", "incident")


class JsonFormatter(logging.Formatter):
    """One JSON object a line: time (RFC 3339), level, logger, message, ids, traceback."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record."""
        seconds = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        line: dict[str, Any] = {
            "time": f"{seconds}.{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        line |= {name: value for name in IDS if (value := getattr(record, name, None)) is not None}
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def _plain() -> logging.Formatter:
    formatter = logging.Formatter("%(asctime)s %(levelname)s %(name)s %(message)s")
    formatter.converter = time.gmtime
    formatter.default_time_format = "%Y-%m-%dT%H:%M:%S"
    formatter.default_msec_format = "%s.%03dZ"
    return formatter


def open_log(data: Path, level: str, form: Literal["text", "json"] = "text") -> Path:
    """Write this process's log to `<data>/logs/serve.log`, rotated; return its path."""
    folder = data / "logs"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    path = folder / "serve.log"
    handler = logging.handlers.RotatingFileHandler(
        path, maxBytes=LOG_BYTES, backupCount=LOG_FILES, encoding="utf-8"
    )
    handler.setFormatter(JsonFormatter() if form == "json" else _plain())
    root = logging.getLogger()
    root.addHandler(handler)
    root.setLevel(level.upper())
    for name in ("httpx", "httpcore", "matplotlib"):  # they tell every step at INFO
        logging.getLogger(name).setLevel(logging.WARNING)
    return path
