"""What paths from the lights gain: relMSE x CPU seconds of a ball under a small lamp, by road.

    ./dev bench light_layer [--size 64] [--spp 64] [--seeds 5]

Roads: the light layer; camera paths with the guide of photons; camera paths alone. Each film is
measured against one long reference of another seed, whose own noise is taken off; the worst 0.1 %
of the pixels are left out, the same share on every road, as one speck of luck would be all that a
mean sees. The gain is the ratio of relMSE x CPU seconds, in one run.
"""

import argparse

import numpy as np

from matiere import _core

FLOOR = ([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]], [[0, 2, 1], [0, 3, 2]])
ROADS = {"light layer": ("on", True), "guide": ("off", True), "camera alone": ("off", False)}
BALLS = {
    "smooth glass": ("dielectric", {"eta": 1.5}),
    "smooth metal": ("mirror", {"F0": 0.9}),
    "glass, alpha 0.1": ("dielectric", {"eta": 1.5, "alpha": 0.1}),
}
LEFT_OUT = 0.001
REFERENCE_SEED = 99


def ball(size: int, material: str, lamp: float) -> _core.Scene:
    """Return a ball on a floor under a lamp of `lamp` metres and a dim sky."""
    name, params = BALLS[material]
    d = _core.RenderDescription()
    d.set_film(size, size)
    d.set_camera("pinhole", (0, 3, 5), (0.2, 0.3, 0), (0, 1, 0), 40)
    d.add_mesh(*FLOOR, material=d.add_material("lambert", {"albedo": 0.6}))
    d.add_sphere((0, 0.8, 0), 0.8, d.add_material(name, params))
    radiance = [5 / lamp**2] * 3
    d.add_rectangle_light((1.4, 3.5, 0.2), (lamp, 0, 0), (0, 0, lamp), radiance)
    d.set_constant_environment((0.02, 0.02, 0.02))
    return _core.Scene(d, 2)


def render(scene: _core.Scene, road: str, size: int, spp: int, seed: int) -> _core.Film:
    """Return a film by one road."""
    light, guide = ROADS[road]
    film = _core.Film(size, size, 4)
    settings = _core.Settings(seed, 24, guide_caustics=guide, light_tracing=light)
    _core.render(scene, settings, film, {"spp": spp}, 2)
    return film


def costs(scene: _core.Scene, size: int, spp: int, seeds: int) -> dict[str, float]:
    """Return relMSE x CPU seconds of every road."""
    reference = render(scene, "light layer", size, 32 * spp, REFERENCE_SEED)
    weights, noise, truth = (
        reference.error_weights(), reference.mean_variance(), reference.mean()[..., :3]
    )  # fmt: skip
    found = {}
    for road in ROADS:
        errors, seconds = [], []
        for seed in range(1, seeds + 1):
            film = render(scene, road, size, spp, seed)
            gap = weights * ((film.mean()[..., :3] - truth) ** 2 - noise)
            kept = np.sort(gap.mean(-1).ravel())[: -max(int(LEFT_OUT * size * size), 1)]
            errors.append(kept.mean())
            seconds.append(film.counters["cpu_s"])
        found[road] = float(np.mean(errors) * np.mean(seconds))
        print(f"  {road}: relMSE {np.mean(errors):.3g} in {np.mean(seconds):.3g} s", flush=True)
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    for name, default in (("size", 64), ("spp", 64), ("seeds", 5)):
        parser.add_argument(f"--{name}", type=int, default=default)
    asked = parser.parse_args()
    rows = []
    for material in BALLS:
        for lamp in (0.03, 0.1, 0.3):
            print(f"{material}, lamp of {lamp} m", flush=True)
            cost = costs(ball(asked.size, material, lamp), asked.size, asked.spp, asked.seeds)
            ours = cost["light layer"]
            rows.append(f"| {material} | {lamp} | {cost['camera alone'] / ours:.1f} | "
                        f"{cost['guide'] / ours:.1f} |")  # fmt: skip
    print("\n| ball | lamp [m] | gain over camera paths alone | gain over the guide |")
    print("|---|---|---|---|")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
