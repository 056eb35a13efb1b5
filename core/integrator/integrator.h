// Unidirectional path tracing with next-event estimation (Kajiya 1986; Veach 1997 ch. 9-10).
#pragma once

#include <cstdint>

#include "base/guard.h"
#include "base/spectrum.h"

namespace matiere {

class Scene;

/// Which techniques find light; all three have the same mean, the tests compare them.
enum class Strategy { kMis, kLightOnly, kBsdfOnly };

struct PathSettings {
    std::uint64_t seed = 0;
    int max_depth = -1;  ///< scattering events; 0 = emission seen directly, -1 = roulette only
    Strategy strategy = Strategy::kMis;
    bool transparent_background = false;
    bool guide_caustics = true;  ///< where the scene has hidden light; the tests compare both
};

struct PathResult {
    Spectrumf L;      ///< W/m^2/sr
    float alpha = 1;  ///< 0 where a camera path left a transparent background uncovered
};

class PathIntegrator {
 public:
    PathIntegrator(const Scene& scene, const PathSettings& settings)
        : scene_(&scene), settings_(settings) {}

    /// One sample of pixel (x, y) of the whole film: a pure function of its arguments.
    PathResult sample(int x, int y, std::uint32_t replicate, std::uint64_t index,
                      Counters& counters) const;

 private:
    const Scene* scene_;
    PathSettings settings_;
};

}  // namespace matiere
