#include "integrator/kernels.h"
#include "integrator/walk.h"

namespace matiere {

template PathResult sample_path<kClearKernel>(const Scene&, const PathSettings&, const SampleId&,
                                              Counters&);

}  // namespace matiere
