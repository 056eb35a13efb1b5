// What a render is asked for: how paths are made, and when to stop.
#pragma once

#include <cstdint>

#include "integrator/integrator.h"

namespace matiere {

/// Default replicate count, chosen by the table in docs/error.md.
inline constexpr int kDefaultReplicates = 4;

/// Everything that decides the value of a sample, beside the scene.
using Settings = PathSettings;

/// Whichever comes first ends the render; zero = not asked for.
struct Stop {
    std::uint64_t spp = 0;  ///< rounded up to a boundary of the plan; absent = Plan::kOpenEndedSpp
    double seconds = 0.0;   ///< wall time of this call
    /// Error targets, at most one: reached when the upper end of the any-time interval is below it.
    double relmse = 0.0;
    double rmse_percent = 0.0;
    bool measured = false;  ///< a target that the caller measures at every look (the display)

    bool has_target() const { return relmse > 0.0 || rmse_percent > 0.0 || measured; }
};

}  // namespace matiere
