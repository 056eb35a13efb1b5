#include "integrator/integrator.h"

#include "integrator/kernels.h"
#include "scene/scene.h"

namespace matiere {

PathIntegrator::PathIntegrator(const Scene& scene, const PathSettings& settings)
    : scene_(&scene), settings_(settings), kernel_(&kernel_for(scene.features(), settings)) {}

PathResult PathIntegrator::sample(const SampleId& id, Counters& counters) const {
    return kernel_->sample(*scene_, settings_, id, counters);
}

}  // namespace matiere
