"""Calls of the client about assets: what is missing, and uploads that go on where they were cut."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx

from matiere.service.client_files import file_digest
from matiere.service.client_views import ServiceError, Unreachable, refusal

PIECE = 2**20
ASKED = 5000  # digests in one question
RETRIED = (httpx.ConnectError, httpx.ReadError, httpx.WriteError, httpx.RemoteProtocolError)
# Cut on the way, or by a service that was stopped: what came is kept, so the rest is sent.
_AGAIN = ("upload_busy", "wrong_offset", "request_timeout", "draining", "busy")
_PAUSE_S = 0.2

OnUpload = Callable[[str, int, int], None]


class UploadCalls:
    """The part of `Client` about assets."""

    url: str
    patience_s: float
    _http: httpx.Client

    if TYPE_CHECKING:

        def _request(self, method: str, url: str, **more: Any) -> httpx.Response: ...

    def missing(self, digests: list[str]) -> list[str]:
        """Return those SHA-256 digests whose files the service lacks."""
        found: list[str] = []
        for start in range(0, len(digests), ASKED):
            body = {"sha256": digests[start : start + ASKED]}
            answer = self._request("POST", "/v1/assets:missing", json=body)
            found += map(str, answer.json()["missing"])
        return found

    def upload_missing(
        self, files: Mapping[str, tuple[str, Path]], on_upload: OnUpload | None = None
    ) -> None:
        """Upload those of the files (name -> digest, path) that the service lacks."""
        names = {digest: name for name, (digest, _) in files.items()}
        try:
            lacking = self.missing(list(names)) if names else []
        except ServiceError as error:
            if error.status not in (404, 405):
                raise
            return  # an older service: the answer to the submission tells what it lacks
        for digest in lacking:
            name = names[digest]
            self.upload(files[name][1], digest, name=name, on_upload=on_upload)

    def upload(
        self,
        path: str | os.PathLike[str],
        digest: str | None = None,
        *,
        name: str | None = None,
        on_upload: OnUpload | None = None,
    ) -> str:
        """Upload one file and return its SHA-256; what came of it before is not sent again.

        A lost connection does not end it: the rest is sent once the service answers again. It is
        given up when nothing arrives for `patience_s` seconds.
        """
        path = Path(path)
        digest = digest or file_digest(path)
        upload = _Upload(path, digest, name or path.name, on_upload)
        reached, end, anew = -1, 0.0, True
        while True:
            try:
                offset = self._uploaded(digest)
                if offset is None:
                    return digest
                if offset > reached:  # it gets on
                    reached, end = offset, time.monotonic() + self.patience_s
                _check(self._http.put(**upload.rest(offset)))
                return digest
            except (*RETRIED, httpx.TimeoutException) as error:
                if reached < 0:
                    reached, end = 0, time.monotonic() + self.patience_s
                if time.monotonic() > end:
                    raise Unreachable(f"no service answers at {self.url} ({error})") from None
            except ServiceError as error:
                if error.code == "asset_mismatch" and reached > 0 and anew:
                    anew, reached = False, -1  # what was kept was of no use: all of it again
                elif error.code not in _AGAIN or time.monotonic() > end:
                    raise
            time.sleep(_PAUSE_S)

    def _uploaded(self, digest: str) -> int | None:
        """Return how many bytes of an asset the service keeps; None when it has all of it."""
        answer = self._http.head(f"/v1/assets/{digest}")
        if answer.status_code == 404:
            return int(answer.headers.get("upload-offset", 0))
        _check(answer)
        return None


def _check(answer: httpx.Response) -> None:
    if answer.status_code >= 400:
        raise refusal(answer)


class _Upload:
    """A file on its way."""

    def __init__(self, path: Path, digest: str, name: str, told: OnUpload | None) -> None:
        self.path, self.digest, self.name, self.told = path, digest, name, told
        self.size = path.stat().st_size

    def rest(self, first: int) -> dict[str, Any]:
        """Return the request for the bytes from `first` on, or for all if that is past the end."""
        first = first if first < self.size else 0
        headers = {"Content-Type": "application/octet-stream"}
        headers["Content-Length"] = str(self.size - first)
        if first:
            headers["Content-Range"] = f"bytes {first}-{self.size - 1}/{self.size}"
        url = f"/v1/assets/{self.digest}"
        return {"url": url, "content": self._pieces(first), "headers": headers}

    def _pieces(self, first: int) -> Iterator[bytes]:
        sent = first
        with self.path.open("rb") as file:
            file.seek(first)
            while piece := file.read(PIECE):
                yield piece
                sent += len(piece)
                if self.told is not None:
                    self.told(self.name, sent, self.size)
