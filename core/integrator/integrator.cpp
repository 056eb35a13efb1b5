#include "integrator/integrator.h"

#include "base/rng.h"
#include "integrator/kernels.h"
#include "scene/scene.h"

namespace matiere {

namespace {

/// Apart from the sample's own numbers.
constexpr std::uint64_t kFollowSeed = 0x666f6c6c6f77ULL;

bool picked(const SampleId& id, std::uint64_t seed) {
    const std::uint64_t pixel =
        std::uint64_t(std::uint32_t(id.x)) | (std::uint64_t(std::uint32_t(id.y)) << 32U);
    return hash_words(kFollowSeed ^ seed, id.replicate, pixel, id.index) % kCutStride == 0;
}

}  // namespace

const LightLayer* light_layer(const Scene& scene, const PathSettings& settings) {
    if (settings.light_tracing == LightTracing::kOff) return nullptr;
    if (settings.max_depth == 0 || settings.max_depth == 1) return nullptr;  // its paths have two
    const LightLayer& layer = scene.light_layer(settings.light_tracing == LightTracing::kOn);
    return layer.empty() ? nullptr : &layer;
}

PathIntegrator::PathIntegrator(const Scene& scene, const PathSettings& settings)
    : scene_(&scene),
      settings_(settings),
      unlimited_(settings),
      kernel_(&kernel_for(scene.features(), settings)) {
    unlimited_.max_depth = -1;
    unlimited_.threshold = 0;
    if (light_layer(scene, settings) == nullptr) unlimited_.light_tracing = LightTracing::kOff;
}

PathResult PathIntegrator::sample(const SampleId& id, Counters& counters) const {
    PathResult result = kernel_->sample(*scene_, settings_, id, counters);
    if (result.cut != Cut::kNone && picked(id, settings_.seed)) follow(id, result, counters);
    return result;
}

AovResult PathIntegrator::sample_layers(const SampleId& id, Counters& counters) const {
    AovResult result = sample_aovs(*scene_, settings_, id, counters);
    if (result.cut != Cut::kNone && picked(id, settings_.seed)) follow(id, result, counters);
    return result;
}

/// The same path without limits has the same numbers, so that it is the same up to where it was
/// cut: what it brings more is what was cut off.
void PathIntegrator::follow(const SampleId& id, PathResult& cut, Counters& counters) const {
    Counters beside;
    const PathResult whole = kernel_->sample(*scene_, unlimited_, id, beside);
    counters.rays += beside.rays;
    counters.shadow_rays += beside.shadow_rays;
    cut.followed = true;
    cut.lost = (whole.L - cut.L) * float(kCutStride);
}

}  // namespace matiere
