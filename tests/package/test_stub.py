"""`_core.pyi` says what the compiled module holds: the same names, members and arguments."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import pytest

from matiere import _core

STUB = Path(__file__).resolve().parents[2] / "bindings" / "matiere" / "_core.pyi"
# Members that pybind11 or the stub add on their own.
IGNORED = {"__init__", "__doc__", "__module__", "__new__", "__repr__"}


def stub() -> dict[str, ast.stmt]:
    names: dict[str, ast.stmt] = {}
    for node in ast.parse(STUB.read_text()).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names[node.name] = node
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names[node.target.id] = node
    return names


def real() -> dict[str, Any]:
    return {name: getattr(_core, name) for name in dir(_core) if not name.startswith("_")}


def arguments_of_stub(node: ast.FunctionDef) -> list[str]:
    names = [a.arg for a in (*node.args.args, *node.args.kwonlyargs)]
    return names[1:] if names[:1] == ["self"] else names


def arguments_of_real(function: Any) -> list[str] | None:
    """Return the argument names of a bound function, by the first line of its docstring."""
    lines = (function.__doc__ or "").splitlines()
    match = re.match(r"\w+\((.*)\) -> ", lines[0]) if lines else None
    if match is None:
        return None
    depth, parts, current = 0, [], ""
    for letter in match[1]:
        depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and depth == 0:
            parts.append(current)
            current = ""
        else:
            current += letter
    given = [p.strip() for p in [*parts, current] if p.strip() not in ("", "*")]
    names = [p.split(":")[0].split("=")[0].strip() for p in given]
    return names[1:] if names[:1] == ["self"] else names


def test_names_are_the_same() -> None:
    said = {name for name in stub() if not name.startswith("_")} - {"Triple"}
    assert said == set(real())


@pytest.mark.parametrize("name", sorted(real()))
def test_members_and_arguments_are_the_same(name: str) -> None:
    said, held = stub()[name], real()[name]
    if isinstance(said, ast.FunctionDef):
        assert arguments_of_real(held) in (None, arguments_of_stub(said))
    if not isinstance(said, ast.ClassDef) or issubclass(held, Exception | tuple):
        return
    members = {m.name: m for m in said.body if isinstance(m, ast.FunctionDef)}
    wanted = {m for m in vars(held) if not m.startswith("_pybind")} - IGNORED
    assert set(members) - IGNORED == {m for m in wanted if not m.startswith("__")}
    for member, node in members.items():
        bound = getattr(held, member)
        if isinstance(bound, property):
            assert [d.id for d in node.decorator_list if isinstance(d, ast.Name)] == ["property"]
        elif (names := arguments_of_real(bound)) is not None:
            assert names == arguments_of_stub(node), f"{name}.{member}"
