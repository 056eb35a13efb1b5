"""Make the shader ball and its stage: surfaces of revolution and a cyclorama, written as GLB.

    python examples/make_shader_ball.py DIRECTORY [--level 2]

`shader_ball.glb` holds three closed solids with outward faces, each with a material of its own
name:

- `Shell`: a bowl of radius 1 and thickness 0.16 with a groove round its belly, opening towards the
  camera;
- `Inner`: a sphere of radius 0.8 that the opening shows;
- `Base`: a turned foot with a dish. It stays 0.03 away from the shell, so that a glass shell
  touches nothing and its inside is well defined.

`glass_ball.glb` has a smaller sphere, `Pearl`, of the shell's material instead of `Inner`: in glass
the wall bends the view gently, the rim gathers light and the pearl turns the view upside down.

`stage.glb` holds `Ground` and `Tile`: the light and dark squares of a studio sweep (a floor that
curves up into a back wall).  Lengths in metres, y up, the camera looks along -z; vertex normals are
exact, uv is (turn, share of the profile's length).  Level n uses 24 * 2^n segments a turn.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Triangles = npt.NDArray[np.int64]

SHELL_RADIUS = 1.0
SHELL_THICKNESS = 0.16
SHELL_OPENING_DEG = 42.0  # half angle of the opening, seen from the centre
GROOVE_DEG = 117.0  # where the groove runs, from the pole opposite the opening
GROOVE_HALF_WIDTH_DEG = 2.6
GROOVE_DEPTH = 0.045
INNER_RADIUS = 0.8
PEARL_RADIUS = 0.5
DISH_GAP = 0.03  # between base and shell
TILT_DEG = (52.0, -24.0)  # opening: towards +z about x, then about y
LEVELS = range(5)


@dataclass(frozen=True)
class Profile:
    """A smooth curve in (r, y): points (N, 2) and unit tangents (N, 2); outside is on its right."""

    points: Array
    tangents: Array


@dataclass(frozen=True)
class Part:
    """One named triangle mesh: positions, unit normals (N, 3), uv (N, 2), triangles (M, 3)."""

    name: str
    material: str
    positions: Array
    normals: Array
    uv: Array
    triangles: Triangles


def arc(center: tuple[float, float], radius: float, start: float, stop: float, n: int) -> Profile:
    """Return n + 1 points of a circle from angle start to stop (degrees, from +r towards +y)."""
    a = np.deg2rad(np.linspace(start, stop, n + 1))
    turn = np.sign(stop - start)
    direction = np.stack([np.cos(a), np.sin(a)], axis=1)
    tangents = turn * np.stack([-np.sin(a), np.cos(a)], axis=1)
    return Profile(np.asarray(center) + radius * direction, tangents)


def line(start: tuple[float, float], stop: tuple[float, float], n: int) -> Profile:
    """Return n + 1 points of a straight piece."""
    a, b = np.asarray(start, dtype=float), np.asarray(stop, dtype=float)
    points = a + (b - a) * np.linspace(0.0, 1.0, n + 1)[:, None]
    return Profile(points, np.tile((b - a) / np.linalg.norm(b - a), (n + 1, 1)))


def join(pieces: Sequence[Profile]) -> Profile:
    """Chain pieces that meet end to end, dropping the doubled points."""
    points = [pieces[0].points, *(p.points[1:] for p in pieces[1:])]
    tangents = [pieces[0].tangents, *(p.tangents[1:] for p in pieces[1:])]
    return Profile(np.concatenate(points), np.concatenate(tangents))


def grooved_sphere(stop_deg: float, n: int) -> Profile:
    """Return the shell's outside from its pole (bottom) to stop_deg, with the groove cut in."""
    center, width = np.deg2rad(GROOVE_DEG), np.deg2rad(GROOVE_HALF_WIDTH_DEG)
    fine = np.linspace(0.0, np.deg2rad(stop_deg), 4001)
    density = 1.0 + 5.0 * np.exp(-(((fine - center) / (1.7 * width)) ** 4))
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    a = np.interp(np.linspace(0.0, cumulative[-1], n + 1), cumulative, fine)
    x = (a - center) / width
    bump = np.exp(-(x**4))
    radius = SHELL_RADIUS - GROOVE_DEPTH * bump
    slope = GROOVE_DEPTH * bump * 4.0 * x**3 / width
    out = np.stack([np.sin(a), -np.cos(a)], axis=1)
    along = np.stack([np.cos(a), np.sin(a)], axis=1)
    tangents = slope[:, None] * out + radius[:, None] * along
    return Profile(
        radius[:, None] * out, tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
    )


def shell_profile(n: int) -> Profile:
    """Return the closed outline of the shell: outside, rounded rim, inside."""
    edge = 180.0 - SHELL_OPENING_DEG
    middle = SHELL_RADIUS - 0.5 * SHELL_THICKNESS
    at = np.deg2rad(edge - 90.0)
    rim_center = (middle * float(np.cos(at)), middle * float(np.sin(at)))
    return join(
        [
            grooved_sphere(edge, n),
            arc(rim_center, 0.5 * SHELL_THICKNESS, edge - 90.0, edge + 90.0, max(6, n // 6)),
            arc((0.0, 0.0), SHELL_RADIUS - SHELL_THICKNESS, edge - 90.0, -90.0, n // 2),
        ]
    )


def ball_height() -> float:
    """Return the height of the ball's centre above the ground."""
    reach = SHELL_RADIUS + DISH_GAP + 0.03
    return 0.26 + reach * float(np.sqrt(1.0 - (0.47 / reach) ** 2))


def base_profile(n: int) -> Profile:
    """Return the outline of the foot: torus edge, hollow, lip, dish (all arcs tangent)."""
    dish = SHELL_RADIUS + DISH_GAP
    psi = float(np.rad2deg(np.arcsin(0.47 / (dish + 0.03))))
    small = max(4, n // 6)
    dish_arc = arc((0.0, ball_height()), dish, -90.0 + psi, -90.0, n // 3)
    return join(
        [
            line((0.0, 0.0), (0.78, 0.0), 4),
            arc((0.78, 0.045), 0.045, -90.0, 90.0, 2 * small),
            line((0.78, 0.09), (0.61, 0.09), 2),
            arc((0.61, 0.20), 0.11, 270.0, 180.0, 2 * small),
            line((0.50, 0.20), (0.50, 0.26), 2),
            arc((0.47, 0.26), 0.03, 0.0, 90.0 + psi, small),
            dish_arc,
        ]
    )


def revolve(name: str, profile: Profile, segments: int) -> Part:
    """Turn a profile that starts and ends on the axis into a closed surface."""
    r = np.where(profile.points[:, 0] < 1e-12, 0.0, profile.points[:, 0])
    y, rows, columns = profile.points[:, 1], r.size, segments + 1
    turn = np.linspace(0.0, 1.0, columns)
    c, s = np.cos(2.0 * np.pi * turn), np.sin(2.0 * np.pi * turn)
    c[-1], s[-1] = c[0], s[0]  # the seam meets to the last bit
    ring = np.stack([c, np.zeros(columns), s], axis=1)
    positions = r[:, None, None] * ring + y[:, None, None] * np.array([0.0, 1.0, 0.0])
    normal_r, normal_y = profile.tangents[:, 1].copy(), -profile.tangents[:, 0]
    normal_r[r == 0.0] = 0.0
    normals = normal_r[:, None, None] * ring + normal_y[:, None, None] * np.array([0.0, 1.0, 0.0])
    step = np.linalg.norm(np.diff(profile.points, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(step)]) / step.sum()
    uv = np.stack(np.broadcast_arrays(turn[None, :], length[:, None]), axis=2)
    return Part(
        name,
        name,
        positions.reshape(-1, 3),
        unit(normals.reshape(-1, 3)),
        uv.reshape(-1, 2),
        grid_triangles(r == 0.0, rows, columns),
    )


def grid_triangles(on_axis: npt.NDArray[np.bool_], rows: int, columns: int) -> Triangles:
    """Triangulate a grid of vertices, leaving out the triangles collapsed on the axis."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = i * columns + j
    lower = np.stack([a, a + columns + 1, a + 1], axis=2)[~on_axis[:-1]]
    upper = np.stack([a, a + columns, a + columns + 1], axis=2)[~on_axis[1:]]
    return np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)])


def unit(v: Array) -> Array:
    """Normalise rows."""
    result: Array = v / np.linalg.norm(v, axis=1, keepdims=True)
    return result


def tilt() -> Array:
    """Return the rotation that turns the opening from +y towards the camera."""
    a, b = np.deg2rad(TILT_DEG)
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    rotation: Array = about_y @ about_x
    return rotation


def tilted(part: Part) -> Part:
    """Turn a part's axis towards the camera and lift it to the ball's height."""
    rotation = tilt()
    positions = part.positions @ rotation.T + np.array([0.0, ball_height(), 0.0])
    return replace(part, positions=positions, normals=part.normals @ rotation.T)


def shader_ball(level: int = 2) -> list[Part]:
    """Return Shell, Inner and Base at a smoothness level 0 to 4.

    Raises:
        ValueError: if the level is not one of 0 to 4.
    """
    if level not in LEVELS:
        raise ValueError(f"level must be 0 to {LEVELS[-1]}, got {level}")
    segments = 24 * 2**level
    return [
        tilted(revolve("Shell", shell_profile(segments), segments)),
        tilted(revolve("Inner", sphere_profile(INNER_RADIUS, segments), segments)),
        revolve("Base", base_profile(segments // 2), segments),
    ]


def glass_ball(level: int = 2) -> list[Part]:
    """Return Shell, Pearl (of the shell's material) and Base; levels as for `shader_ball`."""
    shell, _, base = shader_ball(level)
    segments = 24 * 2**level
    pearl = tilted(revolve("Pearl", sphere_profile(PEARL_RADIUS, segments), segments))
    return [shell, replace(pearl, material="Shell"), base]


def sphere_profile(radius: float, segments: int) -> Profile:
    """Return a half circle from the lower to the upper pole."""
    return arc((0.0, 0.0), radius, -90.0, 90.0, segments // 2)


def stage(
    half_width: float = 9.0,
    front: float = 9.0,
    back: float = 3.6,
    bend: float = 2.4,
    wall: float = 4.2,
    tile: float = 0.5,
) -> list[Part]:
    """Return Ground and Tile: the two colours of a floor that bends up into a back wall (metres).

    Strips across the bend are half a tile high, so that it looks round; squares are true in arc
    length.
    """
    quarter = bend * np.pi / 2.0
    floor = front + back - bend
    total = floor + quarter + max(wall - bend, 0.0)
    strips = 6 * int(np.ceil(total / tile))
    s = np.linspace(0.0, total, strips + 1)
    angle = np.clip((s - floor) / bend, 0.0, np.pi / 2.0)
    z = np.where(s < floor, front - s, bend - back - bend * np.sin(angle))
    y = bend * (1.0 - np.cos(angle)) + np.maximum(s - floor - quarter, 0.0)
    across = 2 * int(np.ceil(half_width / tile))
    x = np.linspace(-half_width, half_width, across + 1)
    normal = np.stack([np.zeros_like(s), np.cos(angle), np.sin(angle)], axis=1)
    dark = (np.arange(strips)[:, None] // 6 + np.arange(across)[None, :]) % 2 == 1
    positions = np.stack(np.broadcast_arrays(x[None, :], y[:, None], z[:, None]), axis=2)
    normals = np.broadcast_to(normal[:, None, :], positions.shape)
    uv = np.stack(np.broadcast_arrays(x[None, :] / tile, s[:, None] / tile), axis=2)
    grids = (positions.reshape(-1, 3), normals.reshape(-1, 3), uv.reshape(-1, 2))
    return [
        used_only(name, *grids, square_triangles(mask))
        for name, mask in (("Ground", ~dark), ("Tile", dark))
    ]


def floor(half_width: float = 2.5, tile: float = 0.5) -> list[Part]:
    """Return Ground and Tile: a flat square floor in two colours, so that the light is seen."""
    count = 2 * int(np.ceil(half_width / tile))
    x = np.linspace(-half_width, half_width, count + 1)
    flat = np.zeros((count + 1, count + 1, 1))
    positions = np.stack(np.broadcast_arrays(x[None, :], 0.0, -x[:, None]), axis=2)
    normals = np.concatenate([flat, flat + 1.0, flat], axis=2)
    dark = (np.arange(count)[:, None] + np.arange(count)[None, :]) % 2 == 1
    grids = (positions.reshape(-1, 3), normals.reshape(-1, 3), positions[..., ::2].reshape(-1, 2))
    return [
        used_only(name, *grids, square_triangles(mask))
        for name, mask in (("Ground", ~dark), ("Tile", dark))
    ]


def square_triangles(mask: npt.NDArray[np.bool_]) -> Triangles:
    """Triangulate the chosen cells of a grid (rows go away from the viewer, columns to +x)."""
    columns = mask.shape[1]
    i, j = np.nonzero(mask)
    a = i * (columns + 1) + j
    b = a + columns + 1
    return np.concatenate([np.stack([a, a + 1, b + 1], 1), np.stack([a, b + 1, b], 1)])


def used_only(name: str, positions: Array, normals: Array, uv: Array, faces: Triangles) -> Part:
    """Drop the vertices that no triangle uses."""
    used, index = np.unique(faces, return_inverse=True)
    triangles = index.reshape(-1, 3)
    return Part(name, name, positions[used], normals[used], uv[used], triangles)


def write_glb(path: Path, parts: Sequence[Part]) -> Path:
    """Write parts as one GLB with their geometry and material names."""
    import trimesh

    visual: Any = trimesh.visual  # trimesh is only partly typed
    scene: Any = trimesh.Scene()
    for part in parts:
        mesh = trimesh.Trimesh(
            vertices=part.positions,
            faces=part.triangles,
            vertex_normals=part.normals,
            visual=visual.TextureVisuals(
                uv=part.uv, material=visual.material.PBRMaterial(name=part.material)
            ),
            process=False,
        )
        scene.add_geometry(mesh, geom_name=part.name, node_name=part.name)
    path.write_bytes(scene.export(file_type="glb", include_normals=True))
    return path


def write(directory: Path, level: int = 2) -> list[Path]:
    """Write shader_ball.glb, glass_ball.glb and stage.glb and return their paths."""
    directory.mkdir(parents=True, exist_ok=True)
    return [
        write_glb(directory / "shader_ball.glb", shader_ball(level)),
        write_glb(directory / "glass_ball.glb", glass_ball(level)),
        write_glb(directory / "stage.glb", stage()),
    ]


def main() -> None:
    """Write the files and say where they are."""
    parser = argparse.ArgumentParser(description="Make the shader ball and its stage (GLB).")
    parser.add_argument("directory", type=Path)
    parser.add_argument("--level", type=int, default=2, choices=list(LEVELS), help="smoothness")
    options = parser.parse_args()
    for path in write(options.directory, options.level):
        print(f"{path}  {path.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
