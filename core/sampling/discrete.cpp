#include "sampling/discrete.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "base/numeric.h"

namespace matiere {

DiscreteDistribution::DiscreteDistribution(std::span<const double> weights) {
    double total = 0;
    for (const double w : weights) total += w;
    if (!(total > 0)) return;
    end_.resize(weights.size());

    // Round the running sum, giving every positive weight at least one lattice point.
    double running = 0;
    std::uint64_t previous = 0;
    for (std::size_t i = 0; i < weights.size(); ++i) {
        running += weights[i];
        if (weights[i] > 0) {
            const auto rounded = std::uint64_t(std::llround(running / total * double(kTotal)));
            previous = std::max(rounded, previous + 1);
        }
        end_[i] = std::uint32_t(std::min<std::uint64_t>(previous, ~std::uint32_t(0)));
    }

    // The guarantees may have pushed the end past the lattice: pull it back from the right.
    std::uint32_t limit = kTotal;
    for (std::size_t i = weights.size(); i-- > 0;) {
        end_[i] = i + 1 == weights.size() ? limit : std::min(end_[i], limit);
        limit = weights[i] > 0 ? end_[i] - 1 : end_[i];
    }
    // Trailing empty cells own nothing: hand what rounding left there to the last positive one.
    for (std::size_t i = weights.size(); i-- > 0 && !(weights[i] > 0);)
        if (i > 0) end_[i - 1] = kTotal;
    fill_buckets();
}

void DiscreteDistribution::fill_buckets() {
    constexpr std::size_t kCellsPerBucket = 4;
    const std::size_t buckets = std::bit_ceil(end_.size() / kCellsPerBucket + 1);
    shift_ = std::countr_zero(kTotal) - std::countr_zero(buckets);
    first_.resize(buckets + 1);
    std::size_t cell = 0;
    for (std::size_t b = 0; b < buckets; ++b) {
        while (end_[cell] <= b << shift_) ++cell;
        first_[b] = std::uint32_t(cell);
    }
    first_[buckets] = std::uint32_t(end_.size() - 1);
}

DiscreteDistribution::Choice DiscreteDistribution::sample(std::uint32_t u) const {
    const std::uint32_t lattice = u >> 1U;
    const std::uint32_t* bucket = &first_[lattice >> shift_];
    const auto it = std::upper_bound(end_.begin() + bucket[0], end_.begin() + bucket[1], lattice);
    const auto i = std::size_t(it - end_.begin());
    const std::uint32_t first = begin(i), count = end_[i] - first;
    const double remainder =
        (double(lattice - first) + 0.5 * double(1U + (u & 1U)) - 0.25) / double(count);
    return {std::uint32_t(i), float(count) * 0x1p-31F, remainder};
}

}  // namespace matiere
