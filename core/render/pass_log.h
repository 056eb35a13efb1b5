// Error against run time: one row per look.
#pragma once

#include <cstdint>
#include <vector>

#include "film/estimate.h"

namespace matiere {

/// Totals of the film at one look, whatever number of calls it took to get there.
struct PassRow {
    std::uint64_t spp = 0;
    double wall_s = 0.0;
    double cpu_s = 0.0;  ///< sum over threads of their CPU clocks
    ErrorEstimate error;
    std::uint64_t rays = 0;      ///< closest-hit and shadow rays
    std::uint64_t rejected = 0;  ///< samples or parts of samples, see diagnostics.h

    /// 1 / (relMSE x wall seconds); 0 where the error is unknown or zero.
    double efficiency() const {
        return error.known && error.relmse > 0.0 && wall_s > 0.0 ? 1.0 / (error.relmse * wall_s)
                                                                 : 0.0;
    }
};

using PassLog = std::vector<PassRow>;

}  // namespace matiere
