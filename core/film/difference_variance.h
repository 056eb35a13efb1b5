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
    /// Something that counts as much as `pixels` of them.
    void add_shared(double v, double pixels) {
        sum_ += v;
        squares_ += v * v / pixels;
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
    DifferenceVariance(const PixelPairs& pixel, int replicates, int width, bool layered)
        : replicates_(replicates), layered_(layered), disjoint_(disjoint_pairs(pixel, replicates)) {
        if (disjoint_.empty()) above_.resize(std::size_t(width), pixel);
    }

    /// Of the relative squared error and of the absolute one; pixels come row by row.
    struct Both {
        double relative = 0.0, absolute = 0.0;
    };
    const std::vector<std::array<std::size_t, 2>>& disjoint() const { return disjoint_; }
    Both of(const PixelPairs& pixel, int x, int y) {
        return disjoint_.empty() ? by_neighbours(pixel, x, y) : by_pairs(pixel);
    }

 private:
    double factor() const { return 2.0 / (double(replicates_) * (replicates_ - 1.0)); }

    /// Without bias for the sum over channels c, c' of w_c w_c' C_cc'^2 from two independent
    /// estimates of the covariance C, each half the outer product of one pair's difference. Of a
    /// film with a light layer all but that of the layer alone: LayerVariance has it.
    void add_product(Both& sum, const PixelPairs::Pair& a, const PixelPairs::Pair& b) const {
        const auto add = [&](FilmLayer of_a, FilmLayer of_b) {
            const PairProduct p = pair_product(a, of_a, b, of_b);
            sum.relative += 0.25 * p.relative * p.relative;
            sum.absolute += 0.25 * p.plain * p.plain;
        };
        if (!layered_) return add(FilmLayer::kAll, FilmLayer::kAll);
        add(FilmLayer::kCamera, FilmLayer::kCamera);
        add(FilmLayer::kCamera, FilmLayer::kLight);
        add(FilmLayer::kLight, FilmLayer::kCamera);
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
    bool layered_;
    std::vector<std::array<std::size_t, 2>> disjoint_;
    std::vector<PixelPairs> above_;
};

/// What the light layer adds to the variance of D of a whole region. Its pixels share their paths,
/// so the inner products of differences over the region are squared, not those of pixels: few, but
/// independent of how the noise hangs together.
class LayerVariance {
 public:
    void add(const PixelPairs& pixel, const std::vector<std::array<std::size_t, 2>>& disjoint) {
        products_.resize(disjoint.size());
        for (std::size_t k = 0; k < disjoint.size(); ++k) {
            const auto& [p, q] = disjoint[k];
            const PairProduct product = pair_product(pixel.pairs()[p], FilmLayer::kLight,
                                                     pixel.pairs()[q], FilmLayer::kLight);
            products_[k].relative += product.relative;
            products_[k].plain += product.plain;
        }
    }
    double relative(int replicates) const {
        return of(replicates, [](const PairProduct& p) { return p.relative; });
    }
    double absolute(int replicates) const {
        return of(replicates, [](const PairProduct& p) { return p.plain; });
    }
    /// Independent products among R replicates.
    static double freedom(int replicates) {
        return std::max(0.5 * replicates * (replicates - 3.0), 1.0);
    }

 private:
    template <class F>
    double of(int replicates, F&& f) const {
        double sum = 0.0;
        for (const PairProduct& p : products_) sum += sqr(f(p));
        const double r = replicates;
        return products_.empty() ? 0.0
                                 : 0.25 * sum / double(products_.size()) * 2.0 / (r * (r - 1.0));
    }

    std::vector<PairProduct> products_;  ///< by pair of pairs
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
