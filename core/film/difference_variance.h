// The variance of the difference D between realised and estimated squared error (film/estimate.h),
// pixel by pixel, and what the noise of the scale S adds to it.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "film/pixel_pairs.h"

namespace matiere {

/// Indices of pairs of pairs that share no replicate, inside each cyclic block of four neighbouring
/// replicates: all three for R = 4, 3 R of them above.
inline std::vector<std::array<std::size_t, 2>> disjoint_pairs(const PixelPairs& pixel,
                                                              int replicates) {
    const auto& pairs = pixel.pairs();
    const auto in_block = [&](int start, int r) {
        return (r - start + replicates) % replicates < 4;
    };
    const auto share_a_block = [&](const PixelPairs::Pair& a, const PixelPairs::Pair& b) {
        for (int s = 0; s < replicates; ++s)
            if (in_block(s, a.i) && in_block(s, a.j) && in_block(s, b.i) && in_block(s, b.j))
                return true;
        return false;
    };
    std::vector<std::array<std::size_t, 2>> result;
    for (std::size_t p = 0; p < pairs.size(); ++p)
        for (std::size_t q = p + 1; q < pairs.size(); ++q) {
            const auto &a = pairs[p], &b = pairs[q];
            const bool disjoint = a.i != b.i && a.i != b.j && a.j != b.i && a.j != b.j;
            if (disjoint && share_a_block(a, b)) result.push_back({p, q});
        }
    return result;
}

/// Variances summed over pixels, and the sum of squares that tells how many carry them.
class VarianceSum {
 public:
    void add(double v) {
        sum_ += v;
        squares_ += v * v;
    }
    double sum() const { return sum_; }
    double effective_pixels() const { return squares_ > 0.0 ? sum_ * sum_ / squares_ : 0.0; }

 private:
    double sum_ = 0.0, squares_ = 0.0;
};

/// The variance of D of one pixel after another, without bias from products of independent
/// estimates of the covariance of its channels.
class DifferenceVariance {
 public:
    DifferenceVariance(const PixelPairs& pixel, int replicates, int width)
        : replicates_(replicates), disjoint_(disjoint_pairs(pixel, replicates)) {
        if (disjoint_.empty()) above_.resize(std::size_t(width), pixel);
    }

    /// Of the relative squared error and of the absolute one; pixels come row by row.
    struct Both {
        double relative = 0.0, absolute = 0.0;
    };
    Both of(const PixelPairs& pixel, int x, int y) {
        return disjoint_.empty() ? by_neighbours(pixel, x, y) : by_pairs(pixel);
    }

 private:
    double factor() const { return 2.0 / (double(replicates_) * (replicates_ - 1.0)); }

    static void add_product(Both& sum, const PixelPairs::Pair& a, const PixelPairs::Pair& b) {
        sum.relative += covariance_product(a, b);
        sum.absolute += plain_covariance_product(a, b);
    }
    Both scaled(const Both& sum, std::size_t n) const {
        const double f = n == 0 ? 0.0 : factor() / double(n);
        return {f * sum.relative, f * sum.absolute};
    }

    Both by_pairs(const PixelPairs& pixel) const {
        Both sum;
        for (const auto& [p, q] : disjoint_) add_product(sum, pixel.pairs()[p], pixel.pairs()[q]);
        return scaled(sum, disjoint_.size());
    }

    /// R < 4 has no disjoint pairs: the product of two neighbours stands for the square of one.
    Both by_neighbours(const PixelPairs& pixel, int x, int y) {
        const auto column = std::size_t(x);
        Both sum;
        std::size_t n = 0;
        const auto with = [&](const PixelPairs& other) {
            for (const auto& a : pixel.pairs())
                for (const auto& b : other.pairs()) add_product(sum, a, b);
            n += pixel.pairs().size() * other.pairs().size();
        };
        if (y > 0) with(above_[column]);      // still the row above: this column comes next
        if (x > 0) with(above_[column - 1]);  // already this row
        above_[column] = pixel;
        return scaled(sum, n);
    }

    int replicates_;
    std::vector<std::array<std::size_t, 2>> disjoint_;
    std::vector<PixelPairs> above_;
};

/// The variance that the noise of S adds to the estimate. S is shared within 5 x 5 pixels: inside
/// blocks of that size its noise is taken as common, between them as independent, which has the
/// same sum of covariances as the sliding window. Blocks begin anew at every region of `edge`
/// pixels.
class ScaleNoise {
 public:
    ScaleNoise(int width, int edge)
        : edge_(edge),
          per_region_((edge + kBlock - 1) / kBlock),
          blocks_(std::size_t(per_region_) * std::size_t(width / edge + 1), 0.0) {}

    void add(const PixelPairs& pixel, int x) {
        const int block = x / edge_ * per_region_ + x % edge_ / kBlock;
        blocks_[std::size_t(block)] += pixel.scale_noise();
    }
    /// After every row, y counted in its region: f(x, variance) for each finished block.
    template <class F>
    void end_row(int y, bool last, F&& f) {
        if ((y + 1) % kBlock != 0 && !last) return;
        for (std::size_t b = 0; b < blocks_.size(); ++b) {
            const int block = int(b);
            if (blocks_[b] > 0.0)
                f(block / per_region_ * edge_ + block % per_region_ * kBlock, sqr(blocks_[b]));
            blocks_[b] = 0.0;
        }
    }

 private:
    static constexpr int kBlock = 2 * kSmoothRadius + 1;
    int edge_, per_region_;
    std::vector<double> blocks_;
};

}  // namespace matiere
