"""Serve the page from the installed wheel, as a person would: run by ./dev test in a clean venv.

The venv holds `matiere[service]`; the checkout is not importable from the empty folder used. Every
view answers with what it names, the examples are there with pictures, and one of them renders.
"""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from html import unescape
from pathlib import Path

MATIERE = str(Path(sys.executable).with_name("matiere"))
VIEWS = ["/", "/sweeps", "/nights", "/materials", "/materials/conductor", "/workers", "/submit"]
EXAMPLES = ["first", "rough_metals", "glass_sphere", "cornell", "caustic", "metals-sweep"]
START_S, RENDER_S = 120, 300


def get(address: str) -> bytes:
    """Return what an address answers."""
    with urllib.request.urlopen(address, timeout=60) as answer:
        return bytes(answer.read())


def check_view(url: str, view: str) -> str:
    """Fetch a view with its style, script and pictures; return its text."""
    text = get(url + view).decode()
    named = {unescape(at) for at in re.findall(r'(?:src|href)="(/static/[^"]+)"', text)}
    assert len(named) >= 2, (view, named)
    for address in named:
        assert get(url + address), address
    return text


def check_examples(url: str) -> None:
    """Each example is offered with its picture, and opens in the editor."""
    shelf = check_view(url, "/submit")
    for name in EXAMPLES:
        assert f"example={name}" in shelf and f"examples/{name}.jpg" in shelf, name
        text = check_view(url, f"/submit?example={name}")
        scene = re.search(r"<textarea[^>]*>(.*?)</textarea>", text, re.DOTALL)
        assert scene and {"camera", "base"} & set(json.loads(unescape(scene[1]))), name


def check_render(url: str) -> None:
    """Render the first example, small, and fetch its picture."""
    text = get(f"{url}/submit?example=first").decode()
    found = re.search(r"<textarea[^>]*>(.*?)</textarea>", text, re.DOTALL)
    assert found
    scene = json.loads(unescape(found[1])) | {"film": {"width": 32, "height": 24}}
    body = json.dumps({"scene": scene, "stop": {"spp": 8}}).encode()
    request = urllib.request.Request(
        f"{url}/v1/jobs", data=body, headers={"Content-Type": "application/json"}
    )
    with urllib.request.urlopen(request, timeout=60) as answer:
        job = url + answer.headers["Location"]
    end = time.monotonic() + RENDER_S
    while (state := json.loads(get(job))["state"]) != "succeeded":
        assert state in ("queued", "running") and time.monotonic() < end, state
        time.sleep(0.2)
    assert get(f"{job}/image.png").startswith(b"\x89PNG")
    assert "relMSE of this image lies between" in check_view(url, job.replace(url + "/v1", ""))


def announced(process: "subprocess.Popen[str]") -> str:
    """Return the URL that the service prints, once it answers."""
    assert process.stdout is not None
    first = process.stdout.readline().split()
    assert first[:1] == ["url"], first
    end = time.monotonic() + START_S
    while time.monotonic() < end:
        try:
            get(f"{first[1]}/readyz")
        except (urllib.error.URLError, ConnectionError):
            time.sleep(0.2)
        else:
            return first[1]
    raise AssertionError("not ready")


def main() -> None:
    """Serve from an empty folder and look at everything."""
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        process = subprocess.Popen(
            [MATIERE, "serve", "--data", "data", "--port", "0", "--children", "1"],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            url = announced(process)
            for view in VIEWS:
                check_view(url, view)
            check_examples(url)
            check_render(url)
            code = "import matiere.service; print(matiere.service.__file__)"
            assert "site-packages" in subprocess.check_output(
                [sys.executable, "-c", code], text=True
            )
        finally:
            process.send_signal(signal.SIGTERM)
            assert process.wait(60) == 0


main()
