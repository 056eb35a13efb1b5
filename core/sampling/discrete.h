// A discrete distribution whose probabilities are exactly those that sampling produces: weights are
// quantised to multiples of 2^-31 of the lattice that the sampler draws from, and `probability`
// returns the quantised value. A float CDF biases cells whose probability is near its rounding
// error.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace matiere {

class DiscreteDistribution {
 public:
    DiscreteDistribution() = default;
    /// Weights >= 0 and finite; every positive weight keeps a positive probability. All-zero
    /// weights give an empty distribution.
    explicit DiscreteDistribution(std::span<const double> weights);

    bool empty() const { return end_.empty(); }
    std::size_t size() const { return end_.size(); }

    struct Choice {
        std::uint32_t index;
        float probability;
        double remainder;  ///< position inside the chosen cell, in [0, 1)
    };
    /// u in 0.32 fixed point. The distribution must not be empty.
    Choice sample(std::uint32_t u) const;

    float probability(std::size_t i) const { return float(end_[i] - begin(i)) * 0x1p-31F; }

    /// Cell i owns the lattice points from ends()[i - 1] up to ends()[i], of 2^31.
    std::span<const std::uint32_t> ends() const { return end_; }

 private:
    static constexpr std::uint32_t kTotal = 1U << 31;
    void fill_buckets();
    std::uint32_t begin(std::size_t i) const { return i == 0 ? 0 : end_[i - 1]; }
    std::vector<std::uint32_t> end_;  // cell i owns the lattice points [end_[i-1], end_[i])
    /// By bucket of 2^shift_ lattice points: the cell of the first one. A cell is found in two
    /// reads of memory far apart, not in log2(size).
    std::vector<std::uint32_t> first_;
    int shift_ = 0;
};

}  // namespace matiere
