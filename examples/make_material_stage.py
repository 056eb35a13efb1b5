"""Make the stage of the material sweeps: the shader ball in the studio light, as a scene.

    python examples/make_material_stage.py
    matiere sweep examples/materials/oren_nayar.json -o out

Writes the meshes, the light and `ball.json`, the base scene that every sweep in
`examples/materials` names, to `examples/materials/stage`. The material to change is
`/materials/ball`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import demo_sweep

STAGE = Path(__file__).resolve().parent / "materials" / "stage"
SIZE = 160
SPP = 256


def write(folder: Path, size: int = SIZE, spp: int = SPP) -> Path:
    """Write the stage to a folder and return its scene."""
    study = demo_sweep.own_study(folder, size, spp)
    path = folder / "ball.json"
    demo_sweep.write_json(path, study.base)
    return path


def main() -> None:
    """Write the stage."""
    parser = argparse.ArgumentParser(description="Make the stage of the material sweeps.")
    parser.add_argument("folder", type=Path, nargs="?", default=STAGE)
    parser.add_argument("--size", type=int, default=SIZE, help="pixels across")
    parser.add_argument("--spp", type=int, default=SPP)
    arguments = parser.parse_args()
    print(f"wrote {write(arguments.folder, arguments.size, arguments.spp)}")


if __name__ == "__main__":
    main()
