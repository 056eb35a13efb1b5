// The short list of path kernels, each the same path tracer with code for other features. One is
// chosen per render: the first of the list that has all that the scene needs.
#pragma once

#include <span>
#include <string_view>

#include "base/features.h"
#include "integrator/integrator.h"

namespace matiere {

struct Kernel {
    std::string_view name;
    Features features;
    PathResult (*sample)(const Scene&, const PathSettings&, const SampleId&, Counters&);
};

inline constexpr Features kDiffuseKernel = 0;
inline constexpr Features kOpaqueKernel = kNeedsModels | kNeedsGuide | kNeedsLights;
inline constexpr Features kTexturedKernel =
    kOpaqueKernel | kNeedsTangents | kNeedsTextures | kNeedsMaps;

inline constexpr Features kClearKernel = kEveryFeature & ~kNeedsScattering;

/// From the smallest to the full one.
std::span<const Kernel> kernels();

/// What a render of a scene with these features needs of its kernel.
Features needed(Features of_scene, const PathSettings& settings);

/// Throws SceneError where `settings.kernel` lacks something that is needed.
const Kernel& kernel_for(Features of_scene, const PathSettings& settings);

}  // namespace matiere
