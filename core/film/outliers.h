// The samples that brought most light: where the brightest specks of an image come from. A set
// under a total order, so that it is the same however chunks and films are put together.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <tuple>
#include <vector>

#include "base/features.h"

namespace matiere {

/// One sample, as what `PathIntegrator::sample` takes and gives.
struct Outlier {
    std::uint64_t seed = 0, index = 0;  ///< index inside the replicate
    std::uint32_t replicate = 0;
    std::int32_t x = 0, y = 0;  ///< pixel of the whole film
    std::array<float, 3> value{};

    float luminance() const { return 0.2126F * value[0] + 0.7152F * value[1] + 0.0722F * value[2]; }
    /// Brighter ones first; the rest only makes the order total.
    bool before(const Outlier& b) const {
        const auto key = [](const Outlier& o) {
            return std::tuple(-o.luminance(), o.y, o.x, o.replicate, o.index, o.seed);
        };
        return key(*this) < key(b);
    }
};

class Outliers {
 public:
    static constexpr std::size_t kMost = 16;

    void offer(const Outlier& sample) {
        if (!(sample.luminance() >= floor_)) return;
        list_.insert(std::upper_bound(list_.begin(), list_.end(), sample,
                                      [](const auto& a, const auto& b) { return a.before(b); }),
                     sample);
        if (list_.size() > kMost) list_.pop_back();
        if (list_.size() == kMost) floor_ = list_.back().luminance();
    }
    Outliers& operator+=(const Outliers& b) {
        for (const Outlier& sample : b.list_) offer(sample);
        return *this;
    }
    /// Brightest first.
    const std::vector<Outlier>& list() const { return list_; }

 private:
    static constexpr float kNothing = 1e-37F;  // black samples are no outliers
    std::vector<Outlier> list_;
    float floor_ = kNothing;
};

/// What samples of a film were made of and by.
struct Provenance {
    Features found = 0;         ///< features of the scene
    std::uint32_t kernels = 0;  ///< bit i: kernel i of `kernels()` rendered some of it
    Outliers outliers;

    Provenance& operator+=(const Provenance& b) {
        found |= b.found;
        kernels |= b.kernels;
        outliers += b.outliers;
        return *this;
    }
};

}  // namespace matiere
