// What happens to light along a straight segment: absorption in the media it crosses, occlusion.
#pragma once

#include "scene/scene.h"

namespace matiere {

/// Beer-Lambert over `distance` metres of the current medium; zero times infinity is no absorption.
Spectrumf absorb(const Scene& scene, const InteriorStack& inside, float distance);

/// Updates the media of a path that passes through the boundary `s` of its material's interior.
void move_through(const Scene& scene, const SurfaceHit& s, bool entering, InteriorStack& inside,
                  Counters& counters);

/// The part of a light sample that reaches the surface point, 0 where it is blocked. `inside` are
/// the media on the light's side of the surface.
Spectrumf transmittance(const Scene& scene, const SurfaceHit& s, const LightSample& light,
                        InteriorStack inside, Counters& counters);

}  // namespace matiere
