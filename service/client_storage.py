"""Calls of the client about what is kept: usage, collection, pins, and why work waits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from matiere.errors import MatiereError


class StorageCalls:
    """The part of `Client` about storage."""

    if TYPE_CHECKING:

        def _request(self, method: str, url: str, **more: Any) -> Any: ...

    def holdup(self) -> str:
        """Return why the service begins no new work now (`disk_low`, ...), or ""."""
        facts = self._request("GET", "/v1/status").json()
        if facts.get("disk_low"):
            return f"disk_low, {facts['disk_free_bytes'] / 1e9:.1f} GB free: no new work is begun"
        if facts.get("disk_full"):
            return "disk_full: waiting for space"
        return ""

    def storage(self) -> dict[str, Any]:
        """Return what is kept, in bytes and files, and the limits."""
        return dict(self._request("GET", "/v1/storage").json())

    def collect(self, *, dry_run: bool = False) -> dict[str, Any]:
        """Remove what may go (or only tell what would); return what went."""
        params = {"dry_run": "true" if dry_run else "false"}
        answer = self._request("POST", "/v1/storage:collect", params=params, timeout=3600.0)
        return dict(answer.json())

    def keys(self) -> list[dict[str, Any]]:
        """Return all API keys, without their secrets."""
        return list(self._request("GET", "/v1/keys").json()["keys"])

    def create_key(self, name: str, scope: str, days: float | None = None) -> dict[str, Any]:
        """Make an API key; the answer's `key` is shown this once."""
        body = {"name": name, "scope": scope, "days": days}
        return dict(self._request("POST", "/v1/keys", json=body).json())

    def rotate_key(
        self, key_id: str, *, days: float | None = None, overlap_hours: float = 24.0
    ) -> dict[str, Any]:
        """Make the successor of a key; the old one ends after `overlap_hours`."""
        body = {"days": days, "overlap_hours": overlap_hours}
        return dict(self._request("POST", f"/v1/keys/{key_id}:rotate", json=body).json())

    def revoke_key(self, key_id: str) -> dict[str, Any]:
        """End a key at once."""
        return dict(self._request("DELETE", f"/v1/keys/{key_id}").json())

    def pin(self, name: str, pinned: bool = True) -> str:
        """Keep a job or a sweep whatever its age (or no more); return which it is."""
        verb = "pin" if pinned else "unpin"
        try:
            self._request("POST", f"/v1/jobs/{name}:{verb}")
        except MatiereError as error:
            if error.code != "job_not_found":
                raise
            self._request("POST", f"/v1/sweeps/{name}:{verb}")
            return "sweep"
        return "job"

    def delete(self, job_id: str) -> None:
        """Remove a job with its results; a live one is cancelled."""
        self._request("DELETE", f"/v1/jobs/{job_id}")

    def delete_sweep(self, sweep_id: str) -> None:
        """Remove a sweep with its cells, results and night."""
        self._request("DELETE", f"/v1/sweeps/{sweep_id}")
