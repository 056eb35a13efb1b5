// What a render counts instead of hiding: rays, rejected samples by cause and material, guards hit.
#pragma once

#include <array>
#include <cstdint>
#include <string_view>
#include <vector>

namespace matiere {

/// Why a sample, or a part of it, did not count.
enum class Reject : std::uint8_t {
    kNonFiniteSample,    ///< a model sampled a direction or weight that is NaN or infinite
    kNonFiniteEval,      ///< a model evaluated to NaN or infinity
    kNonFiniteEmission,  ///< light radiance that is NaN or infinite
    kNonFiniteRadiance,  ///< the finished path sum is NaN or infinite
    kNegativeRadiance,   ///< the finished path sum is below zero
    kSideMismatch,       ///< a sample above the shading but below the geometric horizon (absorbed)
    kCount
};

inline constexpr int kRejectCauses = int(Reject::kCount);
inline constexpr std::array<std::string_view, kRejectCauses> kRejectNames = {
    "non_finite_sample",   "non_finite_eval",   "non_finite_emission",
    "non_finite_radiance", "negative_radiance", "side_mismatch"};

/// What cut a path that had light to find, other than chance.
enum class Cut : std::uint8_t { kNone, kDepth, kThreshold };
inline constexpr int kCutCauses = 2;

/// Plain counters of one chunk; summed when chunks are merged. Never touched by two threads.
struct Counters {
    std::uint64_t samples = 0;
    std::uint64_t rays = 0;         ///< closest-hit queries
    std::uint64_t shadow_rays = 0;  ///< occlusion queries
    std::uint64_t depth_guard = 0;  ///< paths cut by the guard of 10,000 events, or kMediumGuard
    std::uint64_t interior_overflow = 0;  ///< entries that found the interior stack full
    std::uint64_t unmatched_exits = 0;    ///< exits without an entry, or media that end nowhere
    /// [material + 1][cause]; row 0 is "no material" (background, whole path).
    std::vector<std::array<std::uint64_t, kRejectCauses>> rejected;

    void reject(Reject cause, int material) {
        const auto row = std::size_t(material + 1);
        if (row >= rejected.size()) rejected.resize(row + 1);
        ++rejected[row][std::size_t(cause)];
    }

    std::uint64_t rejected_total() const {
        std::uint64_t total = 0;
        for (const auto& row : rejected)
            for (const auto n : row) total += n;
        return total;
    }

    Counters& operator+=(const Counters& b) {
        samples += b.samples;
        rays += b.rays;
        shadow_rays += b.shadow_rays;
        depth_guard += b.depth_guard;
        interior_overflow += b.interior_overflow;
        unmatched_exits += b.unmatched_exits;
        if (rejected.size() < b.rejected.size()) rejected.resize(b.rejected.size());
        for (std::size_t m = 0; m < b.rejected.size(); ++m)
            for (std::size_t c = 0; c < b.rejected[m].size(); ++c)
                rejected[m][c] += b.rejected[m][c];
        return *this;
    }
};

}  // namespace matiere
