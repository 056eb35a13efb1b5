"""A raised flag stops the building of a scene, also in the middle of Embree's hierarchy."""

from __future__ import annotations

import json
import threading
import time

import numpy as np
import pytest

import matiere as mt
from matiere import _core

EDGE = 900  # 1.6 million triangles: the hierarchy takes half a second


def bumpy() -> _core.RenderDescription:
    """Return a scene of one large mesh."""
    x, y = np.meshgrid(*(2 * [np.linspace(-1, 1, EDGE + 1, dtype=np.float32)]))
    positions = np.stack([x, y, 0.05 * np.sin(40 * x) * np.cos(37 * y)], -1).reshape(-1, 3)
    i = np.arange(EDGE * (EDGE + 1)).reshape(EDGE, EDGE + 1)[:, :-1].ravel()
    right, up = i + 1, i + EDGE + 2
    triangles = np.concatenate([np.stack([i, right, up], 1), np.stack([i, up, up - 1], 1)])
    made = _core.RenderDescription()
    made.set_film(8, 8)
    made.set_camera("pinhole", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    made.add_material("lambert", {"albedo": (0.5, 0.5, 0.5)})
    made.add_mesh(positions, triangles.astype(np.uint32))
    made.add_rectangle_light((-0.5, -0.5, 2.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (5.0, 5.0, 5.0))
    return made


@pytest.mark.parametrize("threads", [1, 2])
def test_a_build_is_stopped_in_the_middle(threads: int) -> None:
    description = bumpy()
    begin = time.monotonic()
    whole = _core.Scene(description, threads)
    seconds = time.monotonic() - begin
    assert whole.stats()["triangles"] == 2 * EDGE**2 + 2
    codes = []
    for share in (0.3, 0.5, 0.7):
        flag, ended = _core.CancelToken(), list[object]()

        def build(flag: _core.CancelToken = flag, ended: list[object] = ended) -> None:
            try:
                ended.append(_core.Scene(description, threads, flag))
            except _core.SceneError as error:
                ended.append(error.code)

        thread = threading.Thread(target=build)
        thread.start()
        time.sleep(share * seconds)
        begin = time.monotonic()
        flag.cancel()
        thread.join()
        print(f"{threads} threads, {seconds:.2f} s in all: "
              f"stopped {1000 * (time.monotonic() - begin):.1f} ms after the cancel")  # fmt: skip
        codes.append(ended[0])
    assert "cancelled" in codes, "all three were built before the cancel came"
    assert all(code == "cancelled" or isinstance(code, _core.Scene) for code in codes)


def test_a_cancelled_scene_can_be_built_again() -> None:
    document = json.loads(mt.load("examples/scenes/first.json").to_json())
    scene, flag, read = mt.load(document), _core.CancelToken(), list[bool]()
    flag.cancel()
    with pytest.raises(mt.Cancelled) as caught:
        scene.build(1, flag, lambda: read.append(True))
    assert (caught.value.code, read) == ("cancelled", [True])
    assert scene.build(1) is scene.build(1)
