// The order of the chunks of an adaptive film, a pure function of the plan and of what its tiles
// are worth. Rounds take the mean number of samples per pixel from one boundary of the plan to the
// next. Up to the first base every tile gets the same; from then on tiles with more noise per ray
// get more, and every tile keeps at least the base, which doubles when the mean is four times the
// base. Only samples of the base decide, and those of one half of the replicates only about the
// other half, so that no mean depends on the number of its own samples (Kirk & Arvo 1991).
// docs/adaptive.md has the whole story.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "film/plan.h"

namespace matiere {

class Allocation {
 public:
    /// Boundary of the first base: 4R samples per pixel.
    static constexpr std::uint64_t kFirstBase = 3;
    /// The base is at least 1 / 4 of the mean.
    static constexpr std::uint64_t kMeanOverBase = 4;
    /// No tile gets more than this many times the mean: what one bright outlier may cost.
    static constexpr double kCeiling = 8.0;
    /// Share of a tile's own worth beside that of the tiles around it.
    static constexpr double kOwnShare = 0.75;

    explicit Allocation(const Plan& plan);

    /// Chunk indices by position, as far as they are decided.
    std::span<const std::uint32_t> order() const { return order_; }
    /// Rounds whose chunks all lie below `position`; boundary(rounds) is their mean spp.
    std::uint64_t rounds(std::size_t position) const;
    /// Position at which the round to the boundary `k` ends, or the end of what is decided.
    std::size_t round_end(std::uint64_t k) const;
    /// Ranges that a strip has at the end of what is decided.
    std::uint64_t planned(int strip) const { return ranges_[std::size_t(strip)]; }

    /// The base that the next decision asks for, and its ranges.
    int level() const { return level_; }
    std::uint64_t base(int level) const;
    /// Goes on by one base. `worth[half * tiles + tile]`, measured on that half's base: the root of
    /// variance over cost; it decides about the other half. False when the cap of spp is reached.
    bool decide(std::span<const double> worth);

 private:
    void add_range(int strip);
    void lift(std::uint64_t ranges);
    void fill(int half, std::uint64_t spp, std::span<const double> wish);
    /// Whether the chunk of one more range has an index.
    bool fits(std::uint64_t ranges) const {
        return (ranges + 1) * std::uint64_t(plan_.strips()) <= UINT32_MAX;
    }
    std::vector<double> smooth(std::span<const double> worth) const;
    /// Samples per pixel of one half after `ranges` ranges.
    double half_spp(std::uint64_t ranges) const { return double(plan_.boundary(ranges)) / 2.0; }

    Plan plan_;
    std::vector<std::uint32_t> order_;
    std::vector<std::size_t> round_ends_;  ///< round_ends_[k - 1]: end of the round to boundary k
    std::vector<std::uint64_t> ranges_;    ///< per strip
    std::vector<double> samples_;          ///< per half, over all pixels
    std::vector<double> pixels_;           ///< per tile
    int level_ = 0;
};

}  // namespace matiere
