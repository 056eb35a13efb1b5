"""Every snippet of README and docs that says it runs is run, page by page, in an empty folder.

The word after the language of a fenced block says what becomes of it:
`run` (sh or python): run in order, must succeed; `serve`: a command kept running until the page
ends; `NAME.json`: written under that name, and loaded if it is a scene; `dev`: a `./dev` command,
which runs this very test or is run by tests/prove; `manual`: needs root or another machine.
"""

import json
import os
import re
import shlex
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

import matiere as mt

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
# Pages on which every sh, python and json block must say what becomes of it.
TAGGED_PAGES = {"README.md", "index.md", "install.md"}
TAGS = {"run", "serve", "dev", "manual"}
TIMEOUT_S = 300


@dataclass(frozen=True)
class Snippet:
    """A fenced block of a page."""

    line: int
    language: str
    tag: str
    text: str


def snippets(page: Path) -> list[Snippet]:
    """Return the fenced blocks of a page."""
    found, opened, lines = [], None, []
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        if line.startswith("```"):
            if opened is None:
                opened, lines = (number, line[3:].split()), []
            else:
                start, words = opened
                language, tag = [*words, "", ""][:2]
                found.append(Snippet(start, language, tag, "\n".join(lines) + "\n"))
                opened = None
        elif opened is not None:
            lines.append(line)
    assert opened is None, f"{page}: a block is not closed"
    return found


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Reader:
    """Somebody who types in what a page says, in a folder of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = _free_port()
        (folder / "examples").symlink_to(ROOT / "examples")
        binaries = str(Path(sys.executable).parent)
        kept = {k: v for k, v in os.environ.items() if not k.startswith("MATIERE_")}
        self.environment = kept | {
            "PATH": binaries + os.pathsep + kept.get("PATH", ""),
            "HOME": str(folder),
            "XDG_DATA_HOME": str(folder / "data"),
            "MATIERE_PORT": str(self.port),
        }

    def _typed(self, text: str) -> str:
        return text.replace("127.0.0.1:8470", f"127.0.0.1:{self.port}")

    def run(self, snippet: Snippet) -> None:
        """Run a block and fail with its output if it fails; a shell keeps its variables."""
        language = {"sh": ["sh", "-eu"], "python": [sys.executable, "-"]}[snippet.language]
        text = self._typed(snippet.text)
        if snippet.language == "sh":
            kept = shlex.quote(str(self.folder / ".variables"))
            text = f"set -a\n[ ! -f {kept} ] || . {kept}\n{text}\nexport -p >{kept}\n"
        done = subprocess.run(
            language,
            input=text,
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
        assert done.returncode == 0, f"line {snippet.line}: {done.stdout}\n{done.stderr}"

    @contextmanager
    def serve(self, snippet: Snippet) -> Iterator[None]:
        """Keep a command running; it is ready when its port answers."""
        with (self.folder / "serve.log").open("w", encoding="utf-8") as log:
            process = subprocess.Popen(
                shlex.split(self._typed(snippet.text)),
                cwd=self.folder,
                env=self.environment,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        try:
            self._await_port(process)
            yield
        finally:
            process.terminate()
            process.wait(60)

    def _await_port(self, process: "subprocess.Popen[bytes]") -> None:
        """Wait until it has printed its URL: then commands find it by its data directory too."""
        log = self.folder / "serve.log"
        end = time.monotonic() + 120
        while time.monotonic() < end and process.poll() is None:
            with socket.socket() as probe:
                answers = probe.connect_ex(("127.0.0.1", self.port)) == 0
            if answers and "url " in log.read_text(encoding="utf-8"):
                return
            time.sleep(0.1)
        pytest.fail(f"no service: {log.read_text(encoding='utf-8')}")


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_snippets_run(page: Path, tmp_path: Path) -> None:
    reader = Reader(tmp_path)
    with ExitStack() as open_services:
        for snippet in snippets(page):
            if snippet.language == "json" and snippet.tag.endswith(".json"):
                document = json.loads(snippet.text)
                (tmp_path / snippet.tag).write_text(snippet.text, encoding="utf-8")
                if "shapes" in document:
                    mt.load(tmp_path / snippet.tag)
            elif snippet.tag == "serve":
                open_services.enter_context(reader.serve(snippet))
            elif snippet.tag == "run":
                reader.run(snippet)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_blocks_say_what_becomes_of_them(page: Path) -> None:
    for snippet in snippets(page):
        if snippet.tag and not snippet.tag.endswith(".json"):
            assert snippet.tag in TAGS, (page.name, snippet.line, snippet.tag)
        if page.name in TAGGED_PAGES and snippet.language in ("sh", "python", "json"):
            assert snippet.tag, f"{page.name}:{snippet.line}: add one of {sorted(TAGS)}"
        if snippet.tag == "dev":
            commands = re.findall(r"^\./dev (\w+)", snippet.text, re.MULTILINE)
            usage = subprocess.run(
                [ROOT / "dev", "help"], capture_output=True, text=True, check=True
            ).stdout
            assert commands and all(f"\n  {name} " in usage for name in commands), commands


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_pictures_exist(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" not in target and not target.startswith("#"):
            path = page.parent / target.split("#")[0]
            assert path.exists(), f"{page.name}: {target}"


def test_the_index_lists_every_page() -> None:
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    for page in (ROOT / "docs").glob("*.*"):
        assert page.name == "index.md" or f"]({page.name})" in index, page.name


def test_readme_begins_with_a_picture_of_modest_size() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    picture = re.search(r"!\[[^\]]+\]\(([^)]+)\)", text)
    assert picture and text.index(picture[0]) < text.index("```"), "picture first"
    for image in (ROOT / "docs" / "images").iterdir():
        assert image.stat().st_size < 300 * 1024, image


def test_every_command_is_documented() -> None:
    from matiere.service.commands import COMMANDS

    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    missing = [name for name in COMMANDS if f"matiere {name}" not in text]
    assert not missing, missing


def test_platform_is_said_everywhere() -> None:
    for name in ("README.md", "docs/install.md", "pyproject.toml", "dev"):
        assert "Linux x86-64" in (ROOT / name).read_text(encoding="utf-8"), name


def test_no_page_names_a_package_registry() -> None:
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"pypi\.org|deb\.debian\.org|crates\.io", text), page
