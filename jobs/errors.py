"""Errors of the job queue.

MatiereError (matiere.errors)
+- JobsError
   +- JobNotFound          not_found            no such job, sweep or artifact
   +- NotReadyYet          not_ready            the artifact is still being made
   +- AssetMissing         asset_missing        a named asset has not been uploaded
   +- AssetMismatch        asset_mismatch       uploaded bytes do not have the named digest
   +- UploadBusy           upload_busy          another request writes the same upload
   +- WrongOffset          wrong_offset         an upload goes on where it did not end
   +- IdempotencyConflict  idempotency_conflict same key, other request
   +- DataDirLocked        data_dir_locked      another process owns the data directory
   +- StoreError           store_error          the database refuses or is newer than us
   |  +- DiskFull          disk_full            no space for the database or an artifact
   +- Busy                 too_many_checks      no time for a check or a picture now
   +- Draining             draining             the engine is stopping and takes no new work
   +- IllegalTransition    illegal_transition   a state change outside the table in `job.py`
   +- DeletionRefused      pinned, ...          what is not deleted as it stands
"""

from __future__ import annotations

from matiere.errors import MatiereError


class JobsError(MatiereError):
    """Root of all errors raised by `matiere.jobs`."""

    default_code = "jobs_error"


class JobNotFound(JobsError):
    """No job, sweep or artifact has this name."""

    default_code = "not_found"


class NotReadyYet(JobsError):
    """The artifact does not exist yet because its job has not ended."""

    default_code = "not_ready"


class AssetMissing(JobsError):
    """A file named in the scene is not in the store."""

    default_code = "asset_missing"


class AssetMismatch(JobsError):
    """The bytes of an uploaded asset do not hash to the digest it was sent under."""

    default_code = "asset_mismatch"


class IdempotencyConflict(JobsError):
    """An idempotency key was used before with another request."""

    default_code = "idempotency_conflict"


class DataDirLocked(JobsError):
    """Another process owns the data directory; `url` and `pid` name it."""

    default_code = "data_dir_locked"

    def __init__(self, path: str, url: str | None, pid: int | None) -> None:
        """Say which process holds the directory and what to do."""
        who = f"process {pid}" if pid else "another process"
        where = f" serving {url}" if url else ""
        super().__init__(
            f"data directory {path} is in use by {who}{where}; "
            "talk to that server, stop it, or choose another --data"
        )
        self.path, self.url, self.pid = path, url, pid


class StoreError(JobsError):
    """The job database cannot be used."""

    default_code = "store_error"


class DiskFull(StoreError):
    """There is no space left for the database or an artifact."""

    default_code = "disk_full"


class Busy(JobsError):
    """The utility process has no time for a material check or a picture now."""

    default_code = "too_many_checks"


class Draining(JobsError):
    """The engine is stopping and takes no new work."""

    default_code = "draining"


class IllegalTransition(JobsError):
    """A state change that the transition table does not allow."""

    default_code = "illegal_transition"


class DeletionRefused(JobsError):
    """Not to be deleted as it stands: `code` is part_of_sweep, pinned or waited_for."""

    default_code = "pinned"


class UploadBusy(JobsError):
    """Another request is writing to the same unfinished upload."""

    default_code = "upload_busy"


class WrongOffset(JobsError):
    """An upload is to be continued elsewhere: `offset` bytes of it are kept."""

    default_code = "wrong_offset"

    def __init__(self, message: str, offset: int) -> None:
        """Say where it ended."""
        super().__init__(message)
        self.offset = offset
