// One pixel's pairs of replicates: their differences, and the weight that turns a squared error
// into a relative one without holding any sample of the pair.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "base/numeric.h"
#include "film/film_rows.h"

namespace matiere {

/// 1 / (S^2 + floor) from an estimate of S of known variance v, without the bias of the reciprocal:
/// to second order E[1 / (s^2 + floor)] = f + v (4 S^2 f - 1) f^2, which adding v (4 s^2 f - 1) to
/// the denominator takes off. Bounded and positive for any noise.
inline double reciprocal_scale(double s, double v, double floor) {
    const double scale = s * s + floor;
    if (!(scale > 0.0)) return 0.0;
    const double slope = 4.0 * s * s / scale - 1.0;  // -1 in the dark, 3 in the light
    return 1.0 / (scale + std::max(slope, 0.0) * v);
}

class PixelPairs {
 public:
    static constexpr std::size_t kC = 3;

    struct Pair {
        int i, j;
        std::array<double, kC> difference, weight, root_weight;
        double scale_noise;  ///< see scale_noise() below
    };

    explicit PixelPairs(int replicates) : replicates_(replicates) {
        for (int i = 0; i < replicates; ++i)
            for (int j = i + 1; j < replicates; ++j) pairs_.push_back({i, j, {}, {}, {}, 0.0});
    }

    const std::vector<Pair>& pairs() const { return pairs_; }

    void set(const FilmRows& rows, int x, double floor) {
        for (Pair& p : pairs_) {
            p.scale_noise = 0.0;
            for (std::size_t c = 0; c < kC; ++c) {
                const double a = rows.replicate(p.i, x)[c], b = rows.replicate(p.j, x)[c];
                p.difference[c] = a - b;
                const double s = scale_without(rows, x, c, a + b);
                const double v = scale_variance(rows, x, c);
                p.weight[c] = reciprocal_scale(s, v, floor);
                p.root_weight[c] = std::sqrt(p.weight[c]);
                p.scale_noise += p.weight[c] * sqr(p.difference[c]) * 2.0 * std::abs(s) *
                                 p.weight[c] * std::sqrt(v);
            }
        }
    }

    bool all_equal() const {
        return std::all_of(pairs_.begin(), pairs_.end(),
                           [](const Pair& p) { return p.difference == std::array<double, kC>{}; });
    }

    /// Sum over channels of weight times the unbiased variance of the pixel mean.
    double weighted_variance() const {
        double sum = 0.0;
        for (const Pair& p : pairs_)
            for (std::size_t c = 0; c < kC; ++c)
                sum += p.weight[c] * p.difference[c] * p.difference[c];
        return sum / normalisation();
    }

    /// Standard deviation that the noise of S gives to weighted_variance: |dw/dS| sqrt(v) times the
    /// variance, all channels together.
    double scale_noise() const {
        double sum = 0.0;
        for (const Pair& p : pairs_) sum += p.scale_noise;
        return sum / normalisation();
    }

 private:
    double normalisation() const {
        const double r = replicates_;
        return r * r * (r - 1.0);
    }

    /// S where the pixel's own share comes from the other replicates only, so that a bright outlier
    /// cannot hide itself; with R = 2 there are none and the pixel is left out.
    double scale_without(const FilmRows& rows, int x, std::size_t c, double pair_sum) const {
        const double r = replicates_, n = rows.window(x);
        const double s = rows.smooth(x)[c], own = rows.mean(x)[c];
        if (replicates_ > 2) return s + ((r * own - pair_sum) / (r - 2.0) - own) / n;
        return n > 1.0 ? (n * s - own) / (n - 1.0) : s;
    }

    /// Variance of that estimate from the neighbours alone, for the same reason.
    double scale_variance(const FilmRows& rows, int x, std::size_t c) const {
        const double n = rows.window(x);
        if (n <= 1.0) return 0.0;
        const double others = n * n * rows.smooth_variance(x)[c] - rows.variance(x)[c];
        return std::max(others, 0.0) / (n * (n - 1.0));
    }

    int replicates_;
    std::vector<Pair> pairs_;
};

/// Sum over channels c, c' of w_c w_c' C_cc'^2 without bias from two independent estimates of the
/// covariance C, each half the outer product of one pair's difference.
inline double covariance_product(const PixelPairs::Pair& a, const PixelPairs::Pair& b) {
    double dot = 0.0;
    for (std::size_t c = 0; c < PixelPairs::kC; ++c)
        dot += a.root_weight[c] * b.root_weight[c] * a.difference[c] * b.difference[c];
    return 0.25 * dot * dot;
}

/// Indices of pairs of pairs that share no replicate. Up to R = 8 all of them; above, those inside
/// each cyclic block of four neighbouring replicates, 3 R in all.
std::vector<std::array<std::size_t, 2>> disjoint_pairs(const PixelPairs& pixel, int replicates);

}  // namespace matiere
