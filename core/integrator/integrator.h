// Unidirectional path tracing with next-event estimation (Kajiya 1986; Veach 1997 ch. 9-10).
#pragma once

#include <cstdint>

#include "base/features.h"
#include "base/guard.h"
#include "base/spectrum.h"
#include "film/aov.h"

namespace matiere {

class LightLayer;
class Scene;

/// Which techniques find light; all three have the same mean, the tests compare them.
enum class Strategy { kMis, kLightOnly, kBsdfOnly };

/// Whether paths from the lights find light that paths from the camera find badly or not at all.
enum class LightTracing {
    kOff,
    kAuto,  ///< points, directions, and small lamps where they are hard to find
    kOn     ///< every lamp
};

struct PathSettings {
    std::uint64_t seed = 0;
    int max_depth = -1;  ///< scattering events; 0 = emission seen directly, -1 = roulette only
    Strategy strategy = Strategy::kMis;
    bool transparent_background = false;
    bool guide_caustics = true;  ///< where the scene has hidden light; the tests compare both
    /// A path ends where its throughput, without what roulette put on it, falls below this.
    float threshold = 0;
    int kernel = -1;  ///< index in `kernels()`; -1: the smallest that covers the scene
    AovSet aovs = 0;  ///< layers of the film beside its light
    LightTracing light_tracing = LightTracing::kOff;
};

/// What paths from the lights are to find; null where there are none.
const LightLayer* light_layer(const Scene& scene, const PathSettings& settings);

struct PathResult {
    Spectrumf L;      ///< W/m^2/sr
    float alpha = 1;  ///< 0 where a camera path left a transparent background uncovered
    Cut cut = Cut::kNone;
    bool followed = false;  ///< cut, and picked to tell what was cut off
    Spectrumf lost{};       ///< of one that was followed: the rest, for kCutStride paths
};

/// One in so many cut paths is followed to its end.
inline constexpr int kCutStride = 16;

/// The same with what it says of the layers.
struct AovResult : PathResult {
    AovSample aovs;
};

/// Which sample of a film, beside the seed: a pixel of the whole film, and the index inside the
/// replicate.
struct SampleId {
    int x = 0, y = 0;
    std::uint32_t replicate = 0;
    std::uint64_t index = 0;
};

struct Kernel;

/// One sample by the full kernel with code for layers: the light has the bits of any other kernel.
AovResult sample_aovs(const Scene& scene, const PathSettings& settings, const SampleId& id,
                      Counters& counters);

class PathIntegrator {
 public:
    /// Throws SceneError where the settings name a kernel that lacks what the scene needs.
    PathIntegrator(const Scene& scene, const PathSettings& settings);

    /// One sample: a pure function of its arguments. Where it was cut, it may be followed to its
    /// end beside the image.
    PathResult sample(const SampleId& id, Counters& counters) const;
    /// The same with what it says of the layers of `settings.aovs`.
    AovResult sample_layers(const SampleId& id, Counters& counters) const;
    const Kernel& kernel() const { return *kernel_; }

 private:
    void follow(const SampleId& id, PathResult& cut, Counters& counters) const;

    const Scene* scene_;
    PathSettings settings_, unlimited_;
    const Kernel* kernel_;
};

}  // namespace matiere
