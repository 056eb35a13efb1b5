// What a depth limit or a threshold cuts off paths: counted, and estimated from the few of them
// that go on for this alone.
#pragma once

#include <array>
#include <cstdint>

#include "base/guard.h"

namespace matiere {

/// Sums over the samples of a chunk or of a tile; of the light, over those that were followed, each
/// weighed for the others.
struct CutSums {
    std::uint64_t paths = 0, followed = 0;
    std::array<double, 3> light{}, squares{};

    void add(const std::array<double, 3>& lost) {
        ++followed;
        for (std::size_t c = 0; c < 3; ++c) {
            light[c] += lost[c];
            squares[c] += lost[c] * lost[c];
        }
    }
    CutSums& operator+=(const CutSums& b) {
        paths += b.paths;
        followed += b.followed;
        for (std::size_t c = 0; c < 3; ++c) {
            light[c] += b.light[c];
            squares[c] += b.squares[c];
        }
        return *this;
    }
};

/// By cause: element i is of Cut(i + 1).
using Cuts = std::array<CutSums, kCutCauses>;

/// Mean over a film's pixels of the radiance that was cut, and its standard error.
struct CutEnergy {
    std::uint64_t paths = 0, followed = 0;
    std::array<double, 3> radiance{}, standard_error{};
};

}  // namespace matiere
