"""The Python client of the HTTP API, `matiere.Client`; the commands use it too.

    import matiere as mt

    with mt.Client("http://127.0.0.1:8470") as client:
        job = client.submit("scene.json", stop={"spp": 64})
        job = client.wait(job.id)
        client.fetch(job.id, "image.png", "out.png")

Every submission carries an Idempotency-Key, so that a request whose answer was lost on the way is
sent again without making a second job. Lost connections and 503 are retried for `patience_s`
seconds, so that a client outlives a restart of the service.

Every call may raise `ServiceError`, when the service refuses it, and `Unreachable`, when no service
answers.
"""

from __future__ import annotations

import contextlib
import os
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, TypeVar

import httpx

from matiere.service import client_watch
from matiere.service.client_files import files_of_sweep, local_files, read_scene
from matiere.service.client_storage import StorageCalls
from matiere.service.client_upload import RETRIED, UploadCalls
from matiere.service.client_views import (
    JobStatus,
    ServiceError,
    ServiceEvent,
    SweepStatus,
    Unreachable,
    refusal,
)
from matiere.service.credentials import key_of_environment, place_of

__all__ = [
    "DEFAULT_URL",
    "Client",
    "FileKind",
    "JobStatus",
    "ServiceError",
    "ServiceEvent",
    "SweepStatus",
    "Unreachable",
    "local_files",
]

DEFAULT_URL = "http://127.0.0.1:8470"
POLL_S = (0.05, 1.0)  # first and longest pause between two looks at a job
SUBMIT_TIMEOUT_S = 600.0  # every cell of a large sweep is checked before the answer

FileKind = Literal["image.png", "image.exr", "report.json", "error.svg", "thumbnail.jpg"]
_URL_OF_KIND = {"report.json": "report", "error.svg": "error-plot.svg"}
_Status = TypeVar("_Status", JobStatus, SweepStatus)


class Client(StorageCalls, UploadCalls):
    """Talks to one service; close it, or use it in a `with` block.

    It is for one thread at a time. Every call may raise `ServiceError`, with the `code` of
    docs/http.md, and `Unreachable` after `patience_s` seconds without an answer.
    """

    def __init__(
        self,
        url: str = DEFAULT_URL,
        *,
        socket_path: str | None = None,
        key: str | None = None,
        timeout_s: float = 30.0,
        patience_s: float = 30.0,
    ) -> None:
        """Connect to `url`, which may be `unix:/path`, or through the Unix socket `socket_path`.

        `key` is an API key; by default that of the environment (MATIERE_API_KEY). `timeout_s`
        limits the wait for one answer, `patience_s` how long a service that does not answer is
        asked again. Nothing is sent before the first call.
        """
        key = key or key_of_environment()
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        base, path = place_of(url)
        transport = httpx.HTTPTransport(uds=socket_path or path) if socket_path or path else None
        self.url = url.rstrip("/")
        self.patience_s = patience_s
        self._reached = False  # a service that was there may be restarting; one that never was, no
        self._http = httpx.Client(
            base_url=base, headers=headers, timeout=timeout_s, transport=transport, trust_env=False
        )

    def __enter__(self) -> Client:
        """Return self."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the connections."""
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    # -- jobs ---------------------------------------------------------------------------------
    def submit(
        self,
        scene: str | os.PathLike[str] | Mapping[str, Any],
        *,
        stop: Mapping[str, Any] | None = None,
        priority: int | None = None,
        label: str = "",
        deadline: float | str | None = None,
        after: Sequence[str] = (),
        asset_root: str | os.PathLike[str] | None = None,
        idempotency_key: str | None = None,
        on_upload: Callable[[str, int, int], None] | None = None,
    ) -> JobStatus:
        """Submit a scene file or dict, uploading the files that the service lacks.

        Files are looked up in the scene's folder, or in `asset_root`; names not found there are
        left to the service. `deadline` is in seconds from now or a moment in RFC 3339; the job
        waits until all that `after` names (ids of jobs and sweeps) have succeeded.
        `on_upload(name, bytes_sent, bytes_all)` reports progress.
        Raises `ServiceError`, `Unreachable`, and `SceneValidationError` for a file that is no JSON.
        """
        document, root = read_scene(scene, asset_root)
        body: dict[str, Any] = {"scene": document, "label": label, **_when(deadline, after)}
        answer = self._submit(
            "/v1/jobs", body, document, root, stop, priority, idempotency_key, on_upload
        )
        return JobStatus.model_validate(answer)

    def submit_sweep(
        self,
        base: str | os.PathLike[str] | Mapping[str, Any],
        axes: Sequence[Mapping[str, Any]],
        *,
        mode: str = "grid",
        columns: int | None = None,
        stop: Mapping[str, Any] | None = None,
        priority: int | None = None,
        label: str = "",
        deadline: float | str | None = None,
        after: Sequence[str] = (),
        asset_root: str | os.PathLike[str] | None = None,
        idempotency_key: str | None = None,
        on_upload: Callable[[str, int, int], None] | None = None,
        **language: Any,
    ) -> SweepStatus:
        """Submit a sweep: a base scene and its axes; otherwise like `submit`.

        `language` is the rest of docs/sweep.md: `where`, `overrides`, `baseline`, ...
        """
        document, root = read_scene(base, asset_root)
        body: dict[str, Any] = {
            "base": document,
            "axes": [dict(axis) for axis in axes],
            "mode": mode,
            "columns": columns,
            "label": label,
            **_when(deadline, after),
            **language,
        }
        answer = self._submit(
            "/v1/sweeps", body, document, root, stop, priority, idempotency_key, on_upload
        )
        return SweepStatus.model_validate(answer)

    def _submit(
        self,
        path: str,
        body: dict[str, Any],
        document: Mapping[str, Any],
        root: Path,
        stop: Mapping[str, Any] | None,
        priority: int | None,
        key: str | None,
        on_upload: Callable[[str, int, int], None] | None,
    ) -> Any:
        files = local_files(document, root)
        files |= files_of_sweep(body, root)
        body["assets"] = {name: digest for name, (digest, _) in files.items()}
        if stop:
            body["stop"] = dict(stop)
        if priority is not None:
            body["priority"] = priority
        headers = {"Idempotency-Key": key or uuid.uuid4().hex}
        self.upload_missing(files, on_upload)
        for _ in range(3):  # another client may remove what we uploaded a moment ago
            try:
                answer = self._request(
                    "POST", path, json=body, headers=headers, timeout=SUBMIT_TIMEOUT_S
                )
                return answer.json()
            except ServiceError as error:
                missing = [str(item["name"]) for item in error.problem.get("missing", [])]
                if error.code != "asset_missing" or not set(missing) & set(files):
                    raise
                for name in missing:
                    self.upload(files[name][1], files[name][0], name=name, on_upload=on_upload)
        raise ServiceError({"code": "asset_missing", "detail": "uploads do not stay"}, 422)

    def job(self, job_id: str) -> JobStatus:
        """Return a job."""
        return JobStatus.model_validate(self._request("GET", f"/v1/jobs/{job_id}").json())

    def jobs(
        self, *, state: str | None = None, sweep: str | None = None, page: int = 500
    ) -> Iterator[JobStatus]:
        """Yield jobs, newest first; the cells of `sweep` in order."""
        params = {"limit": str(page)}
        params |= {k: v for k, v in (("state", state), ("sweep", sweep)) if v is not None}
        while True:
            answer = self._request("GET", "/v1/jobs", params=params).json()
            for job in answer["jobs"]:
                yield JobStatus.model_validate(job)
            if answer["next_cursor"] is None:
                return
            params["cursor"] = answer["next_cursor"]

    def cancel(self, job_id: str) -> JobStatus:
        """Cancel a job."""
        return self.steer(job_id, "cancel")

    def steer(self, job_id: str, step: str) -> JobStatus:
        """Ask a job to `cancel`, `pause`, `resume` or `requeue`."""
        return JobStatus.model_validate(self._request("POST", f"/v1/jobs/{job_id}:{step}").json())

    def set_priority(self, job_id: str, priority: int) -> JobStatus:
        """Change the priority of a job that has not ended."""
        change = {"priority": priority}
        answer = self._request("PATCH", f"/v1/jobs/{job_id}", json=change).json()
        return JobStatus.model_validate(answer)

    def watch(
        self,
        job_or_sweep: str | JobStatus | SweepStatus,
        *,
        after: int | None = None,
        on_lost: Callable[[str], None] | None = None,
    ) -> Iterator[ServiceEvent]:
        """Yield what happens to a job or a sweep, until it has ended.

        The first event is a `snapshot` with its `status`; with `after`, the `seq` of an event seen
        before, the events since then come first instead. A connection that breaks is made again
        for `patience_s` seconds, and goes on without gap or repeat, also after a restart of the
        service; `on_lost(why)` is called once each time. Leaving the loop leaves the job alone.
        Raises `ServiceError` `not_found` for an unknown id.
        """
        status = job_or_sweep
        if isinstance(status, str):
            status = client_watch.find(self, status)
        return client_watch.Follower(self, status, after=after, on_lost=on_lost).events()

    def wait(
        self,
        job_id: str,
        *,
        timeout_s: float | None = None,
        on_change: Callable[[JobStatus], None] | None = None,
    ) -> JobStatus:
        """Return the job once it has ended, however it did; see its `state` and `rendered`.

        `on_change` is called with the job every second or oftener. Raises TimeoutError when
        `timeout_s` seconds are over; the job goes on.
        """
        return _awaited(lambda: self.job(job_id), f"job {job_id}", timeout_s, on_change)

    # -- sweeps -------------------------------------------------------------------------------
    def sweep(self, sweep_id: str) -> SweepStatus:
        """Return a sweep."""
        return SweepStatus.model_validate(self._request("GET", f"/v1/sweeps/{sweep_id}").json())

    def wait_sweep(
        self,
        sweep_id: str,
        *,
        timeout_s: float | None = None,
        on_change: Callable[[SweepStatus], None] | None = None,
    ) -> SweepStatus:
        """Return the sweep once all its cells have ended; otherwise like `wait`."""
        return _awaited(lambda: self.sweep(sweep_id), f"sweep {sweep_id}", timeout_s, on_change)

    def cancel_sweep(self, sweep_id: str) -> SweepStatus:
        """Cancel every live cell of a sweep."""
        return self.steer_sweep(sweep_id, "cancel")

    def steer_sweep(self, sweep_id: str, step: str) -> SweepStatus:
        """Ask the cells of a sweep to `cancel`, `pause`, `resume` or `requeue`."""
        answer = self._request("POST", f"/v1/sweeps/{sweep_id}:{step}").json()
        return SweepStatus.model_validate(answer)

    def set_sweep_priority(self, sweep_id: str, priority: int) -> SweepStatus:
        """Change the priority of the cells of a sweep that have not ended."""
        change = {"priority": priority}
        answer = self._request("PATCH", f"/v1/sweeps/{sweep_id}", json=change).json()
        return SweepStatus.model_validate(answer)

    # -- nights -------------------------------------------------------------------------------
    def night(self, sweep_id: str) -> dict[str, Any]:
        """Return what a finished sweep's night is called, and the URLs of its pages."""
        found: dict[str, Any] = self._request("GET", f"/v1/sweeps/{sweep_id}/night").json()
        return found

    def night_page(self, url: str) -> bytes:
        """Return the bytes of one page."""
        return self._request("GET", url).content

    def compare_sweeps(self, a: str, b: str, **options: Any) -> dict[str, Any]:
        """Compare the nights of two sweeps in the service; waits while it has no time."""
        body = {"a": a, "b": b, **options}
        for pause in _pauses(self.patience_s * 10):
            try:
                answer = self._request("POST", "/v1/compare", json=body, timeout=SUBMIT_TIMEOUT_S)
            except ServiceError as error:
                if error.code != "too_many_comparisons":
                    raise
                time.sleep(pause)
            else:
                report: dict[str, Any] = answer.json()
                return report
        raise TimeoutError("the service had no time to compare the nights")

    # -- results ------------------------------------------------------------------------------
    def fetch(self, job_id: str, kind: FileKind, path: str | os.PathLike[str]) -> Path:
        """Write a file of a job that has ended to `path`, whole or not at all, and return the path.

        Raises `ServiceError`: `job_not_finished`, or `job_not_succeeded` where there is no image.
        """
        return self._download(f"/v1/jobs/{job_id}/{_URL_OF_KIND.get(kind, kind)}", Path(path))

    def image(
        self,
        job_id: str,
        kind: Literal["png", "jpg", "exr"] = "png",
        *,
        exposure: float | None = None,
        view: str | None = None,
        display: str | None = None,
    ) -> bytes:
        """Return the image of a job that has ended, through another view if one is named.

        `exposure` is in stops, in place of the scene's own. Nothing is rendered again.
        """
        given = {"exposure": exposure, "view": view, "display": display}
        params = {name: str(value) for name, value in given.items() if value is not None}
        return self._request("GET", f"/v1/jobs/{job_id}/image.{kind}", params=params).content

    def preview(self, job_id: str) -> bytes:
        """Return the samples so far as JPEG. Raises `ServiceError` while there are none."""
        return self._request("GET", f"/v1/jobs/{job_id}/preview").content

    def fetch_contact_sheet(self, sweep_id: str, path: str | os.PathLike[str]) -> Path:
        """Write the contact sheet of a sweep to `path`, waiting until it is drawn."""
        for pause in _pauses(self.patience_s):
            try:
                return self._download(f"/v1/sweeps/{sweep_id}/contact-sheet.png", Path(path))
            except ServiceError as error:
                if error.code != "sweep_not_finished":
                    raise
            time.sleep(pause)
        raise TimeoutError(f"the contact sheet of {sweep_id} was not drawn in time")

    def fetch_difference(self, sweep_id: str, cell: int, path: str | os.PathLike[str]) -> Path:
        """Write how a cell of a sweep differs from its baseline, as a PNG."""
        return self._download(f"/v1/sweeps/{sweep_id}/cells/{cell}/difference.png", Path(path))

    def report(self, job_id: str) -> dict[str, Any]:
        """Return the report of a job."""
        report: dict[str, Any] = self._request("GET", f"/v1/jobs/{job_id}/report").json()
        return report

    def check(self, material: Mapping[str, Any]) -> str:
        """Return the stability verdict of a material: pass, warn or fail (docs/check.md).

        Waits for its turn, as the service tests one material at a time. Raises `ServiceError` 422
        for one that cannot be tested, `too_many_checks` for one that takes too long.
        """
        for pause in _pauses(self.patience_s):
            try:
                answer = self._request("POST", "/v1/checks", json={"material": dict(material)})
                return str(answer.json()["verdict"])
            except ServiceError as error:
                if error.code != "too_many_checks":
                    raise
                last = error
            time.sleep(pause)
        raise last

    def ready(self) -> bool:
        """Tell whether the service takes and does work."""
        with contextlib.suppress(httpx.HTTPError):
            return self._http.get("/readyz").status_code == 200
        return False

    # -- plumbing -----------------------------------------------------------------------------
    def _download(self, url: str, path: Path) -> Path:
        """Write beside `path`, then rename: a cut download leaves nothing behind."""
        answer = self._request("GET", url)
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            part.write_bytes(answer.content)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
        return path

    def _request(
        self,
        method: str,
        url: str,
        **more: Any,
    ) -> httpx.Response:
        """Send a request, again while the service is unreachable or asks to wait."""
        deadline = time.monotonic() + self.patience_s
        pause = 0.1
        while True:
            try:
                answer = self._http.request(method, url, **more)
            except RETRIED as error:
                never = isinstance(error, httpx.ConnectError) and not self._reached
                if never or time.monotonic() > deadline:
                    raise Unreachable(
                        f"no service answers at {self.url} ({error}); "
                        "start one with `matiere serve`"
                    ) from None
            except httpx.TimeoutException:
                if time.monotonic() > deadline:
                    raise Unreachable(f"the service at {self.url} answers too slowly") from None
            else:
                self._reached = True
                waiting = answer.status_code == 503 or _code(answer) == "idempotency_in_flight"
                if not waiting or time.monotonic() > deadline:
                    if answer.status_code >= 400:
                        raise refusal(answer)
                    return answer
                pause = float(answer.headers.get("retry-after", pause))
            time.sleep(min(pause, 5.0))
            pause *= 2


def _when(deadline: float | str | None, after: Sequence[str]) -> dict[str, Any]:
    """Return what was given of these two: an older service knows neither."""
    given = {"deadline": deadline, "after": list(after)}
    return {key: value for key, value in given.items() if value not in (None, [])}


def _pauses(timeout_s: float | None) -> Iterator[float]:
    begin = time.monotonic()
    pause, longest = POLL_S
    while timeout_s is None or time.monotonic() - begin < timeout_s:
        yield pause
        pause = min(longest, pause * 1.3)


def _awaited(
    look: Callable[[], _Status],
    name: str,
    timeout_s: float | None,
    on_change: Callable[[_Status], None] | None,
) -> _Status:
    for pause in _pauses(timeout_s):
        status = look()
        if on_change is not None:
            on_change(status)
        if status.ended:
            return status
        time.sleep(pause)
    raise TimeoutError(f"{name} did not end within {timeout_s:g} s")


def _code(answer: httpx.Response) -> str:
    if answer.status_code != 409:
        return ""
    with contextlib.suppress(ValueError, AttributeError):
        return str(answer.json().get("code"))
    return ""
