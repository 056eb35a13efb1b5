#include "integrator/kernels.h"

#include <array>
#include <string>

#include "base/error.h"

namespace matiere {

/// Each made in a translation unit of its own.
template <Features F>
PathResult sample_path(const Scene& scene, const PathSettings& settings, const SampleId& id,
                       Counters& counters);
template <>
PathResult sample_path<kDiffuseKernel>(const Scene& scene, const PathSettings& settings,
                                       const SampleId& id, Counters& counters);

namespace {

constexpr std::array<Kernel, 5> kKernels = {{
    {"diffuse", kDiffuseKernel, &sample_path<kDiffuseKernel>},
    {"opaque", kOpaqueKernel, &sample_path<kOpaqueKernel>},
    {"textured", kTexturedKernel, &sample_path<kTexturedKernel>},
    {"clear", kClearKernel, &sample_path<kClearKernel>},
    {"full", kEveryFeature, &sample_path<kEveryFeature>},
}};

}  // namespace

std::span<const Kernel> kernels() { return kKernels; }

Features needed(Features of_scene, const PathSettings& settings) {
    Features f = of_scene & kKernelFeatures;
    if (!settings.guide_caustics) f &= ~kNeedsGuide;
    if (settings.light_tracing == LightTracing::kOff) f &= ~kNeedsLightLayer;
    if (settings.light_tracing == LightTracing::kOn) f |= kNeedsLightLayer;
    return f;
}

const Kernel& kernel_for(Features of_scene, const PathSettings& settings) {
    const Features wanted = needed(of_scene, settings);
    if (settings.kernel >= 0) {
        const Kernel& kernel = kKernels.at(std::size_t(settings.kernel));
        if ((wanted & ~kernel.features) != 0)
            throw SceneError("kernel", "the kernel " + std::string(kernel.name) +
                                           " lacks what this scene needs");
        return kernel;
    }
    if (settings.aovs != 0) return kKernels.back();
    for (const Kernel& kernel : kKernels)
        if ((wanted & ~kernel.features) == 0) return kernel;
    return kKernels.back();
}

}  // namespace matiere
