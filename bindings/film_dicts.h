// Error estimates, counters and provenance as Python dicts, shared by the film and render bindings.
#pragma once

#include <pybind11/pybind11.h>

#include <string>
#include <vector>

#include "film/aov.h"
#include "film/estimate.h"
#include "render/diagnostics.h"

namespace matiere {

/// Layers by name; ValueError for another name.
AovSet aov_set(const std::vector<std::string>& names);
pybind11::dict counters_dict(const Work& work);
pybind11::list feature_names(Features features);
/// `kernels`, `found`, `left_out` (features by name) and `outliers`, the brightest first.
pybind11::dict provenance_dict(const Provenance& provenance);
/// Unknown figures are None, never 0.
pybind11::dict error_dict(const ErrorEstimate& error);

}  // namespace matiere
