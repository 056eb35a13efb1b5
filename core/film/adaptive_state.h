// What an adaptive film knows beside its sums: how many ranges every strip (tile and half of the
// replicates) has, what its base is worth, and how far the order of chunks is decided. Everything
// follows from the samples that were added, so two films of equal samples decide alike.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "film/allocation.h"

namespace matiere {

class Film;

class AdaptiveState {
 public:
    explicit AdaptiveState(const Plan& plan)
        : allocation_(plan),
          ranges_(std::size_t(plan.strips()), 0),
          rays_(std::size_t(plan.strips()), 0) {}

    const Allocation& allocation() const { return allocation_; }
    std::uint64_t ranges(int strip) const { return ranges_[std::size_t(strip)]; }
    /// Chunks without a gap from the start of the order.
    std::size_t done() const { return done_; }
    std::uint64_t rounds() const { return allocation_.rounds(done_); }
    bool wants(std::uint32_t index, const Plan& plan) const;
    /// Whether a chunk is the next one of the order, none of those before it missing.
    bool is_next(std::uint32_t index) const {
        return done_ < allocation_.order().size() && allocation_.order()[done_] == index;
    }
    /// Chunks that are decided, lie below the boundary `k` and are not in the film.
    std::vector<std::uint32_t> missing(std::uint64_t k, const Plan& plan) const;

    /// Takes note of a chunk whose sums are in the film, and decides what is due.
    void note(const Film& film, const Chunk& chunk, std::uint64_t rays);

    /// What is stored beside sums and counts.
    struct Record {
        std::array<double, 2> floors{};   ///< of S^2, per half, see measure.h
        std::vector<double> worth;        ///< [level][half][tile]
        std::vector<std::uint64_t> rays;  ///< [half][tile]
    };
    Record record() const { return {floors_, worth_, rays_}; }
    /// Takes over what was stored, and decides again; false if it does not fit the counts.
    bool restore(const Film& film, const std::vector<std::uint64_t>& ranges, Record record);

 private:
    void advance(const Plan& plan);
    void measure(const Film& film, int strip, int level);
    void take_pilot(const Film& film);
    double* worth(int level);

    Allocation allocation_;
    std::vector<std::uint64_t> ranges_;
    std::vector<std::uint64_t> rays_;
    std::array<double, 2> floors_{};
    std::vector<double> worth_;
    std::size_t done_ = 0;
};

}  // namespace matiere
