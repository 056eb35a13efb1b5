// Finds out, before a render, where lights reach diffuse surfaces by way of mirrors and lenses: the
// paths that a camera path meets only by luck. The result only guides: it changes no mean.
#pragma once

#include "material/bsdf.h"
#include "sampling/photon_guide.h"

namespace matiere {

class Scene;

/// Whether directions on a surface with these lobes (Lobe bits) may be guided.
inline bool guided(std::uint8_t lobes) {
    return (lobes & kDiffuse) != 0 && (lobes & (kTransmission | kNull)) == 0;
}

/// Photons from the lights through sharp surfaces to diffuse ones. Empty where the scene has no
/// such surfaces or no light that is hard to find that way. The same for any number of threads.
PhotonGuide trace_caustics(const Scene& scene, int threads);

}  // namespace matiere
