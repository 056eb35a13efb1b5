"""JSON pointers (RFC 6901) into a raw scene: reading, setting, and what is wrong with one."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any


def split_pointer(pointer: str) -> list[str]:
    """Return the unescaped parts of a pointer."""
    return [part.replace("~1", "/").replace("~0", "~") for part in pointer.split("/")[1:]]


def last_part(pointer: str) -> str:
    """Return what the pointer's value is called."""
    return split_pointer(pointer)[-1]


def set_value(scene: Any, pointer: str, value: Any) -> None:
    """Put a value where the pointer says. Raises LookupError or TypeError if it leads nowhere."""
    *parents, last = split_pointer(pointer)
    for part in parents:
        scene = scene[int(part)] if isinstance(scene, list) else scene[part]
    if isinstance(scene, list):
        scene[_index(last, scene)] = value
    else:
        scene[last] = value


def lies_in(pointer: str, outer: str) -> bool:
    """Tell whether `pointer` names what `outer` names or something inside."""
    return pointer == outer or pointer.startswith(outer + "/")


def pointer_fault(pointer: Any, base: Any) -> str | None:
    """Return why nothing can be set there, or None. The last part may name a new key."""
    if not isinstance(pointer, str) or not pointer.startswith("/"):
        return "a pointer starts with '/', for example /materials/ball/alpha"
    parts = split_pointer(pointer)
    for depth, part in enumerate(parts):
        here = "/" + "/".join(parts[:depth])
        if isinstance(base, list):
            if not part.isdigit() or int(part) >= len(base):
                return f"{here} has {len(base)} entries; {part!r} is none of them"
            base = base[int(part)]
        elif isinstance(base, Mapping):
            if part not in base:
                if depth == len(parts) - 1:
                    return None  # a key that the base leaves at its default
                known = ", ".join(map(str, list(base)[:8]))
                return f"the base scene has no {here.rstrip('/')}/{part}; there is: {known}"
            base = base[part]
        else:
            return f"{here} of the base scene is a plain value and has nothing inside"
    return None


def copy_json(value: Any) -> Any:
    """Return a deep copy of plain JSON; an order faster than copy.deepcopy."""
    if isinstance(value, dict):
        return {key: copy_json(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [copy_json(inner) for inner in value]
    if value is None or isinstance(value, str | int | float):
        return value
    return copy.deepcopy(value)


def _index(part: str, entries: list[Any]) -> int:
    if not part.isdigit() or int(part) >= len(entries):
        raise LookupError(part)
    return int(part)
