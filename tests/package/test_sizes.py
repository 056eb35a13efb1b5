"""Files stay under 600 lines, functions under 80: a reader can take in one thing at a time."""

import ast
import itertools
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ["core", "bindings", "service", "jobs", "tests", "examples"]
MOST_FILE_LINES = 600
MOST_FUNCTION_LINES = 80


def _sources(*endings: str) -> list[Path]:
    found = [
        path
        for folder in FOLDERS
        for ending in endings
        for path in (ROOT / folder).rglob(f"*{ending}")
    ]
    assert found
    return sorted(found)


def test_no_file_is_longer_than_600_lines() -> None:
    long = {}
    for path in _sources(".py", ".pyi", ".h", ".cpp"):
        count = len(path.read_text(encoding="utf-8").splitlines())
        if count > MOST_FILE_LINES:
            long[str(path.relative_to(ROOT))] = count
    assert not long, long


def test_no_python_function_is_longer_than_80_lines() -> None:
    long = []
    for path in _sources(".py"):
        if "versions" in path.parts:
            continue  # a migration is a frozen list of tables, not logic
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lines = (node.end_lineno or node.lineno) - node.lineno + 1
                if lines > MOST_FUNCTION_LINES:
                    long.append(f"{path.relative_to(ROOT)}:{node.lineno}: {node.name}: {lines}")
    assert not long, "\n".join(long)


def _cxx_functions(text: str) -> list[tuple[int, int]]:
    """(first line, lines) of every block in braces that opens after a parameter list."""
    functions, stack = [], []
    before = ""
    for number, line in enumerate(text.splitlines(), 1):
        code = line.split("//")[0]
        for piece in itertools.chain(code, "\n"):
            if piece == "{":
                stack.append((number, _opens_function(before)))
                before = ""
            elif piece == "}" and stack:
                begin, is_function = stack.pop()
                if is_function:
                    functions.append((begin, number - begin + 1))
                before = ""
            elif piece == ";":
                before = ""
            else:
                before += piece
    return functions


def _opens_function(before: str) -> bool:
    words = before.split()
    heads = {"namespace", "class", "struct", "enum", "union", "extern"}
    return ")" in before and not heads & set(words[:3]) and "PYBIND11_MODULE" not in before


def test_no_cxx_function_is_longer_than_80_lines() -> None:
    long = [
        f"{path.relative_to(ROOT)}:{begin}: {lines} lines"
        for path in _sources(".h", ".cpp")
        for begin, lines in _cxx_functions(path.read_text(encoding="utf-8"))
        if lines > MOST_FUNCTION_LINES
    ]
    assert not long, "\n".join(long)


@pytest.mark.parametrize("word", ["TODO", "FIXME", "XXX"])
def test_no_loose_ends(word: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}"
        for path in _sources(".py", ".h", ".cpp")
        if path != Path(__file__) and word in path.read_text(encoding="utf-8")
    ]
    assert not found, found
