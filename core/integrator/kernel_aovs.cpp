#include "integrator/walk.h"

namespace matiere {

AovResult sample_aovs(const Scene& scene, const PathSettings& settings, const SampleId& id,
                      Counters& counters) {
    AovLayers layers;
    const PathResult light =
        trace_path<kEveryFeature | kCollects>(scene, settings, id, counters, &layers);
    return {light, layers.finish(light)};
}

}  // namespace matiere
