#include "integrator/kernels.h"
#include "integrator/walk.h"

namespace matiere {

/// The whole path in one function: what it carries stays in registers.
template <>
[[gnu::flatten]] PathResult sample_path<kDiffuseKernel>(const Scene& scene,
                                                        const PathSettings& settings,
                                                        const SampleId& id, Counters& counters) {
    return trace_path<kDiffuseKernel>(scene, settings, id, counters, {});
}

}  // namespace matiere
