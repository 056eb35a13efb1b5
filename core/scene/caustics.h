// Finds out, before a render, where lights reach diffuse surfaces by way of mirrors and lenses: the
// paths that a camera path meets only by luck. The result only guides: it changes no mean.
#pragma once

#include <cstdint>
#include <vector>

#include "material/bsdf.h"
#include "sampling/photon_guide.h"

namespace matiere {

class CancelToken;
class LightLayer;
class Scene;

/// Whether directions on a surface with these lobes (Lobe bits) may be guided.
inline bool guided(std::uint8_t lobes) {
    return (lobes & kDiffuse) != 0 && (lobes & (kTransmission | kNull)) == 0;
}

/// What the photons say.
struct CausticScan {
    PhotonGuide guide;                 ///< empty where no light is hard to find
    std::vector<std::uint32_t> hard;   ///< by light: photons that are hard to find
    std::vector<GuidePhoton> photons;  ///< those of `guide`,
    std::vector<int> lights;           ///< and the light of each
    double ordinary = 0;
};

/// Photons from the lights through sharp surfaces to diffuse ones. Empty where the scene has no
/// such surfaces or no light that is hard to find that way. The same for any number of threads.
/// Stops early, with nothing of use, once `cancel` (if given) is raised.
CausticScan trace_caustics(const Scene& scene, int threads, const CancelToken* cancel);

/// The guide to what the lights of a light layer leave.
PhotonGuide guide_beside(CausticScan scan, const LightLayer& layer);

}  // namespace matiere
