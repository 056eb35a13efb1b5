"""A stand-in for `matiere.jobs.work`: deterministic numpy chunks, no engine.

Tests of kills, fences and resumption use it so that they run in milliseconds. It has the same plan
rule (doubling, then steps of 4R) and folds in double, so bit-equality means something.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from matiere.errors import AssetChanged, Cancelled, Fault, SceneValidationError

OPEN_ENDED_SPP = 2**20
TILE = 8
JsonDict = dict[str, Any]


class FakePlan:
    def __init__(self, width: int, height: int, replicates: int) -> None:
        self.width, self.height, self.replicates = width, height, replicates
        self.columns, self.rows = -(-width // TILE), -(-height // TILE)
        self.tiles = self.columns * self.rows

    def boundary(self, k: int) -> int:
        r = self.replicates
        return 0 if k == 0 else r * 2 ** (k - 1) if k <= 4 else 8 * r + 4 * r * (k - 4)

    def ranges(self, spp: int) -> int:
        k = 0
        while self.boundary(k) < spp:
            k += 1 if k < 4 else max(1, (spp - self.boundary(k)) // (4 * self.replicates))
        return k

    def round_up(self, spp: int) -> int:
        return self.boundary(self.ranges(spp))

    def chunk_count(self, spp: int) -> int:
        return self.ranges(spp) * self.tiles

    def chunk(self, index: int) -> dict[str, int]:
        k, tile = divmod(index, self.tiles)
        row, column = divmod(tile, self.columns)
        x0, y0 = column * TILE, row * TILE
        return {"x0": x0, "y0": y0, "x1": min(x0 + TILE, self.width),
                "y1": min(y0 + TILE, self.height), "s0": self.boundary(k),
                "s1": self.boundary(k + 1)}  # fmt: skip


def plan(width: int, height: int, replicates: int, adaptive: bool = False) -> FakePlan:
    assert not adaptive
    return FakePlan(width, height, replicates)


@dataclass(frozen=True)
class Folder:
    root: Path
    pins: dict[str, str]


def asset_folder(root: Path, pins: Any) -> Folder:
    return Folder(Path(root), dict(pins))


def file_names(scene: Any) -> list[str]:
    return list(scene.get("files", []))


def inspect(scene: JsonDict, files: Folder) -> JsonDict:
    faults = [
        Fault(f"/{key}", "out_of_range", f"{key} must be positive, not {scene[key]!r}")
        for key in ("width", "height", "value")
        if key in scene and not (isinstance(scene[key], int | float) and scene[key] > 0)
    ]
    for i, name in enumerate(file_names(scene)):
        if not (files.root / name).is_file():
            faults.append(Fault(f"/files/{i}", "asset_missing", f"no file {name}"))
    if faults:
        raise SceneValidationError(faults)
    pins = {name: _sha(files.root / name) for name in file_names(scene)}
    render = scene.get("render", {})
    stop = {key: render.get(key) for key in ("spp", "seconds", "target_error")}
    if not any(stop.values()):
        stop["spp"] = 16
    core = {k: v for k, v in scene.items() if k not in ("output", "render")}
    core["seed"] = render.get("seed", 0)
    key = hashlib.sha256(json.dumps([core, pins], sort_keys=True).encode()).hexdigest()
    return {"film_key": key, "geometry_key": str(scene.get("geometry", "")), "scene": core,
            "files_key": str([pins, scene.get("mesh")]),
            "pins": pins, "width": scene["width"], "height": scene["height"], "replicates": 2,
            "stop": stop, "output": scene.get("output", {})}  # fmt: skip


def check_files(scene: JsonDict, assets: JsonDict) -> None:
    if scene.get("mesh") == "broken":
        raise SceneValidationError([Fault("/mesh", "asset_unreadable", "not a mesh")])
    if scene.get("mesh") == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if scene.get("mesh") == "endless":
        time.sleep(1e6)


def check_material(material: JsonDict, seed: int, plots: bool, root: str) -> JsonDict:
    if material.get("type") == "slow":
        time.sleep(material["seconds"])
    if material.get("type") == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    return {"verdict": "pass", "material": material, "seed": seed}


def _sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def warm_up() -> None:
    """Nothing is heavy here."""


def cancel_token() -> Any:
    event = threading.Event()
    event.cancel = event.set  # type: ignore[attr-defined]
    return event


class FakeScene:
    def __init__(self, scene: JsonDict, replicates: int) -> None:
        self.scene = scene
        self.plan = FakePlan(scene["width"], scene["height"], replicates)

    def render_chunk(self, index: int, flag: threading.Event) -> bytes | None:
        misdeed(self.scene, index)
        if flag.wait(self.scene.get("chunk_s", 0.0)):
            return None
        c = self.plan.chunk(index)
        seed = [int(self.scene.get("seed", 0)), index, int(1000 * self.scene["value"])]
        shape = (self.plan.replicates, c["y1"] - c["y0"], c["x1"] - c["x0"])
        rng = np.random.default_rng(seed)
        sums = rng.random(shape) * (c["s1"] - c["s0"]) / self.plan.replicates
        sums *= self.scene.get("hard", 1)  # as many times the error of others
        return index.to_bytes(4, "little") + sums.tobytes()

    render_part = render_chunk


def misdeed(scene: JsonDict, index: int) -> None:
    """Do what the scene asks for at a chunk: raise, crash, or hang; once or always."""
    wanted = scene.get("misdeed")
    if wanted is None or index != wanted.get("chunk", 0):
        return
    if Path(wanted.get("unless", "/nowhere")).exists():
        return
    flag = wanted.get("once")
    if flag is not None:
        try:
            Path(flag).touch(exist_ok=False)
        except FileExistsError:
            return
    if wanted["kind"] == "raise":
        raise RuntimeError("told to raise")
    if wanted["kind"] == "hang":
        time.sleep(1e6)
    if wanted["kind"] == "spin":
        while True:
            pass
    if wanted["kind"] == "deaf":  # a loop in C that holds the interpreter: no other thread runs
        sum(range(10**15))
    if wanted["kind"] == "hog":
        hoard = [np.zeros(2**23) for _ in range(10**4)]  # 64 MiB each
        raise AssertionError(f"{len(hoard)} pieces fit")
    if wanted["kind"] == "whisper":  # with what a terminal would obey
        os.write(2, b"a strange \x1bnormal line\n")
        return
    if wanted["kind"] == "chatter":  # a gigabyte of log
        line = b"x" * (2**20 - 1) + b"\n"
        for _ in range(1024):
            os.write(2, line)
        return
    signal.raise_signal(getattr(signal, wanted["kind"]))  # in this thread, as a real crash comes


def open_scene(
    scene: JsonDict,
    assets: JsonDict,
    replicates: int,
    threads: int,
    flag: Any = None,
    on_read: Callable[[], None] | None = None,
    like: Any = None,
) -> FakeScene:
    time.sleep(scene.get("read_s", 0.0))
    if on_read is not None:
        on_read()
    if flag is not None and flag.wait(scene.get("build_s", 0.0)):
        raise Cancelled("cancelled while building")
    for name, digest in assets["pins"].items():
        if _sha(Path(assets["root"]) / name) != digest:
            raise AssetChanged([Fault("/files", "asset_changed", f"{name} changed")])
    return FakeScene(scene, replicates)


class FakeFold:
    def __init__(self, plan: FakePlan, stored: memoryview | None) -> None:
        self.plan = plan
        shape = (plan.replicates, plan.height, plan.width)
        self.sums = np.zeros(shape)
        self.counts = np.zeros((plan.height, plan.width), np.int64)
        if stored is not None:
            split = self.sums.nbytes
            self.sums = np.frombuffer(stored[:split]).reshape(shape).copy()
            self.counts = np.frombuffer(stored[split:], np.int64).reshape(shape[1:]).copy()

    def add(self, data: memoryview) -> None:
        c = self.plan.chunk(int.from_bytes(data[:4], "little"))
        rows, columns = slice(c["y0"], c["y1"]), slice(c["x0"], c["x1"])
        assert (self.counts[rows, columns] == c["s0"]).all(), "chunks out of order"
        part = np.frombuffer(data[4:]).reshape(self.sums[:, rows, columns].shape)
        self.sums[:, rows, columns] += part
        self.counts[rows, columns] += c["s1"] - c["s0"]

    def add_part(self, part: bytes) -> None:
        self.add(memoryview(part))

    def look(self, spp: int, seconds: float) -> JsonDict:
        hard = max(1, round(2 * self.sums.sum() / self.counts.sum()))
        error = hard / spp
        return {"spp": spp, "seconds": seconds, "relmse": error, "lower": 0.9 * error,
                "upper": 1.1 * error}  # fmt: skip

    def to_bytes(self) -> bytes:
        return self.sums.tobytes() + self.counts.tobytes()


def sign(fold: FakeFold, scene: FakeScene, film_key: str) -> bytes:
    return _signature(fold, scene.scene, int(fold.counts.max()))


def open_fold(plan: FakePlan, stored: memoryview | None) -> FakeFold:
    return FakeFold(plan, stored)


def look_due(plan: FakePlan, stop: JsonDict, spp: int) -> bool:
    ranges = plan.ranges(spp)
    if stop.get("target_error"):
        return spp > 0
    return spp > 0 and (ranges <= 4 or (ranges & (ranges - 1)) == 0)


def stop_reason(
    plan: FakePlan, stop: JsonDict, spp: int, seconds: float, newest: JsonDict | None
) -> str | None:
    target = (stop.get("target_error") or {}).get("relmse")
    if target and newest and newest["spp"] == spp and newest["upper"] <= target:
        return "target_error"
    if stop.get("spp") and spp >= plan.round_up(stop["spp"]):
        return "spp"
    if stop.get("seconds") and seconds >= stop["seconds"]:
        return "seconds"
    return None


def target_share(stop: JsonDict, newest: JsonDict) -> float | None:
    target = (stop.get("target_error") or {}).get("relmse")
    return target / newest["upper"] if target and newest.get("upper") else None


def make_images(stored: memoryview, header: JsonDict, request: JsonDict) -> dict[str, bytes]:
    fold = FakeFold(FakePlan(request["width"], request["height"], request["replicates"]), stored)
    digest = hashlib.sha256(fold.sums.tobytes()).hexdigest()
    report = {"spp": header["spp"], "sums": digest, "min_count": int(fold.counts.min()),
              "max_count": int(fold.counts.max()), "log": header["log"]}  # fmt: skip
    misdeed(request["scene"], -1)
    return {"image.png": b"png " + digest.encode(), "image.exr": fold.sums.tobytes(),
            "report.json": json.dumps(report).encode(), "error.svg": b"<svg/>",
            "thumbnail.jpg": b"jpg " + digest.encode(),
            "signature": _signature(fold, request["scene"], header["spp"])}  # fmt: skip


def _signature(fold: FakeFold, scene: JsonDict, spp: int) -> bytes:
    from matiere.signature import Signature, _grouped

    means = scene.get("brightness", 1.0) * fold.sums * fold.plan.replicates / fold.counts
    pixels = np.repeat(means[..., None], 3, axis=3)
    digest = hashlib.sha256(pixels.tobytes()).hexdigest()
    seeds = (int(scene.get("seed", 0)),)
    height, width = fold.counts.shape
    return Signature(width, height, spp, _grouped(pixels), False, digest, seeds).to_bytes()


def engines() -> JsonDict:
    return {"fake": {"matiere": os.environ.get("FAKE_ENGINE", "fake")}}


def make_picture(stored: memoryview, header: JsonDict, request: JsonDict) -> bytes:
    return make_images(stored, header, request)["image.png"]


def make_sheet(cells: list[JsonDict], request: JsonDict) -> bytes:
    return json.dumps([[c["label"], bool(c["image"])] for c in cells]).encode()


if "FAKE_CRASH" in os.environ:  # see crash_points.py
    import crash_points

    crash_points.install()
