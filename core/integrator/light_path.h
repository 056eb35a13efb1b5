// One path from a light: by way of at least one mirror or lens, then to every surface that the
// camera sees and that is neither; there it is seen (Dutre, Lafortune & Willems 1993; Veach 1997,
// sections 5.2 and 5.3 for what changes against a path from the camera).
#pragma once

#include <cstdint>

#include "film/cut_energy.h"
#include "film/splats.h"
#include "integrator/integrator.h"

namespace matiere {

/// Which light path of a film, beside the seed.
struct LightPathId {
    std::uint32_t replicate = 0;
    std::uint64_t index = 0;  ///< inside the replicate
};

/// Where the light of a path goes: added here, in the order of the paths. The mean over many paths
/// is the light of the layer in W/m^2/sr.
struct LightPathSums {
    const SplatWindow& window;
    SplatSums& light;
    SplatSums *diffuse, *transmission;  ///< what of it came by these lobes; null: nobody asks
    CutSums& cut;                       ///< what the limit of depth cuts off
    Counters& counters;
};

/// A pure function of everything but the sums.
void trace_light_path(const Scene& scene, const LightLayer& layer, const PathSettings& settings,
                      const LightPathId& id, const LightPathSums& sums);

}  // namespace matiere
