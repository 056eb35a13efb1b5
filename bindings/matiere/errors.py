"""The errors matiere raises.

    MatiereError                 root: code, message, pointer
    +-- SceneValidationError     a scene or one of its files is wrong; .errors lists every fault
    |   +-- AssetChanged         a pinned file no longer has the pinned digest
    +-- ColourError              unknown OCIO config, colour space, display or view
    +-- ImageError               an image file cannot be read or written
    +-- FilmError                a film file cannot be read, or two films do not belong together
    +-- MemoryLimitError         a render would need more memory than it may use
    +-- ProbeError               directions or random numbers given to a probe are no use
    +-- RenderError              a render could not start or go on
    +-- Cancelled                a render was stopped from outside

`code` is a short stable word for programs, `message` a sentence for people, `pointer` the JSON
pointer (RFC 6901) of the bad value, empty when there is none.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass


class MatiereError(Exception):
    """Root of every error raised on purpose by matiere."""

    default_code = "error"

    def __init__(self, message: str, *, code: str | None = None, pointer: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.code = code or self.default_code
        self.pointer = pointer

    def __str__(self) -> str:
        return f"{self.pointer}: {self.message}" if self.pointer else self.message

    def __reduce__(self) -> tuple[object, ...]:
        return (_rebuild, (type(self), self.args, self.__dict__.copy()))


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing wrong with a scene: where, which kind, and what to do about it."""

    pointer: str
    code: str
    message: str
    suggestion: str | None = None

    def as_dict(self) -> dict[str, str]:
        """Return the fault as the JSON object that HTTP problem bodies carry."""
        plain = {"pointer": self.pointer, "code": self.code, "message": self.message}
        if self.suggestion is not None:
            plain["suggestion"] = self.suggestion
        return plain


class SceneValidationError(MatiereError):
    """A scene is refused; `faults` holds every reason, in the order of the document."""

    default_code = "invalid_scene"

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults: Sequence[Fault] = tuple(faults)
        first = self.faults[0]
        lines = [f"{f.pointer}: {f.message}" if f.pointer else f.message for f in self.faults]
        super().__init__("\n".join(lines), code=self.default_code, pointer=first.pointer)

    @property
    def errors(self) -> list[dict[str, str]]:
        """All faults as a list of `{"pointer", "code", "message"[, "suggestion"]}`."""
        return [fault.as_dict() for fault in self.faults]

    def __str__(self) -> str:
        return self.message


class AssetChanged(SceneValidationError):
    """A file does not have the digest it was pinned to when the scene was submitted."""

    default_code = "asset_changed"


class ColourError(MatiereError):
    """An OCIO config, colour space, display or view is not known."""

    default_code = "unknown_view"


class ImageError(MatiereError):
    """An image file cannot be read or written."""

    default_code = "image_error"


class FilmError(MatiereError):
    """A film file cannot be read, or two films do not belong together."""

    default_code = "film_error"


class MemoryLimitError(MatiereError):
    """A render would need more memory than the limit allows."""

    default_code = "memory_limit"


class ProbeError(MatiereError, ValueError):
    """Directions or random numbers given to `Bsdf` have the wrong shape, length or range."""

    default_code = "invalid_array"


class RenderError(MatiereError):
    """A render could not start or go on."""

    default_code = "render_error"


class Cancelled(MatiereError):
    """A render was stopped from outside before it reached its goal."""

    default_code = "cancelled"


def pointer(*parts: str | int) -> str:
    """Return the JSON pointer (RFC 6901) made of `parts`."""
    return "".join("/" + str(part).replace("~", "~0").replace("/", "~1") for part in parts)


@contextmanager
def pointed(prefix: str) -> Iterator[None]:
    """Put `prefix` before the pointers of the faults that arise inside."""
    try:
        yield
    except SceneValidationError as error:
        faults = [Fault(prefix + f.pointer, f.code, f.message, f.suggestion) for f in error.faults]
        raise type(error)(faults) from None


def _rebuild(
    kind: type[MatiereError], args: tuple[object, ...], state: dict[str, object]
) -> MatiereError:
    error = kind.__new__(kind, *args)
    error.args = args
    error.__dict__.update(state)
    return error
