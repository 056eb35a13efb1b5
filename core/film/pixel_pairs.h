// One pixel's pairs of replicates: their differences, and the weight that turns a squared error
// into a relative one without holding any sample of the pair.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "base/numeric.h"
#include "base/vec.h"
#include "film/film_rows.h"
#include "film/window_pyramid.h"

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

/// Relative standard deviation of S above which a larger window is taken.
inline constexpr double kScaleDeviation = 0.3;

class PixelPairs {
 public:
    static constexpr std::size_t kC = 3;

    struct Pair {
        int i, j;
        std::array<double, kC> difference, weight, root_weight;
        std::array<double, kC> light;  ///< the light layer's part of the difference
        double scale_noise;            ///< see scale_noise() below
    };

    explicit PixelPairs(int replicates) : replicates_(replicates) {
        for (int i = 0; i < replicates; ++i)
            for (int j = i + 1; j < replicates; ++j) pairs_.push_back({i, j, {}, {}, {}, {}, 0.0});
    }

    const std::vector<Pair>& pairs() const { return pairs_; }

    void set(const FilmRows& rows, const WindowPyramid& windows, Vec2<int> at, double floor) {
        const int level = choose_level(rows, windows, at, floor);
        std::array<Scale, kC> scales, near;
        for (std::size_t c = 0; c < kC; ++c) scales[c] = local_scale(rows, windows, at, c, level);
        for (std::size_t c = 0; c < kC && level >= 0; ++c)
            near[c] = local_scale(rows, windows, at, c, -1);
        // A larger window has less noise, which more of the 5 x 5 blocks share.
        const double wide = level < 0 ? 1.0 : WindowPyramid::side(level) / kSmoothSide;
        const bool layered = rows.light(0, at.x) != nullptr;
        for (Pair& p : pairs_) {
            p.scale_noise = 0.0;
            for (std::size_t c = 0; c < kC; ++c) {
                const double a = rows.replicate(p.i, at.x)[c], b = rows.replicate(p.j, at.x)[c];
                p.difference[c] = a - b;
                if (layered) p.light[c] = rows.light(p.i, at.x)[c] - rows.light(p.j, at.x)[c];
                double s = scales[c].without_pair(a + b, replicates_);
                double variance = scales[c].variance, shared = wide;
                const double least = level < 0 ? s : near[c].least_without(a + b, replicates_);
                if (least > s) {
                    s = least;
                    variance = near[c].variance;
                    shared = 1.0;
                }
                p.weight[c] = reciprocal_scale(s, scales[c].others_variance, floor);
                p.root_weight[c] = std::sqrt(p.weight[c]);
                p.scale_noise += p.weight[c] * sqr(p.difference[c]) * 2.0 * std::abs(s) *
                                 p.weight[c] * std::sqrt(variance) * shared;
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

    /// S around a pixel in one channel.
    struct Scale {
        double n = 1.0, smooth = 0.0, own = 0.0;
        double variance = 0.0;         ///< of S
        double others_variance = 0.0;  ///< of S, from the neighbours alone

        /// S where the pixel's own share comes from the other replicates only, so that a bright
        /// outlier cannot hide itself; with R = 2 there are none and the pixel is left out.
        double without_pair(double pair_sum, int replicates) const {
            const double r = replicates;
            if (replicates > 2) return smooth + ((r * own - pair_sum) / (r - 2.0) - own) / n;
            return without_pixel();
        }
        /// A standard deviation below that: what the 5 x 5 pixels vouch for where a larger window
        /// is taken. One hit alone vouches for nothing, a small lamp in the dark does: it must not
        /// be measured against a window that hardly sees it.
        double least_without(double pair_sum, int replicates) const {
            return without_pair(pair_sum, replicates) - std::sqrt(others_variance);
        }
        double without_pixel() const { return n > 1.0 ? (n * smooth - own) / (n - 1.0) : smooth; }
    };

    /// The smallest window whose S is expected to be known to kScaleDeviation: -1 for 5 x 5 pixels,
    /// else a level of the pyramid. What to expect is told by the next larger window: to choose by
    /// the small one's own S would prefer the bright ones.
    static int choose_level(const FilmRows& rows, const WindowPyramid& windows, Vec2<int> at,
                            double floor) {
        for (int level = -1; level + 1 < windows.levels(); ++level) {
            const auto& wide = windows.around(at.x, at.y, level + 1);
            const double n = level < 0 ? rows.window(at.x) : windows.around(at.x, at.y, level).n;
            bool known = true;
            for (std::size_t c = 0; c < kC; ++c) {
                const double own = rows.mean(at.x)[c];
                const double s = wide.n > 1.0 ? (wide.mean[c] - own) / (wide.n - 1.0) : own;
                const double expected = wide.variance[c] / wide.n / n;
                known = known && !(expected > sqr(kScaleDeviation) * (sqr(s) + floor));
            }
            if (known) return level;
        }
        return windows.levels() - 1;
    }

    static Scale local_scale(const FilmRows& rows, const WindowPyramid& windows, Vec2<int> at,
                             std::size_t c, int level) {
        Scale s;
        double variance_sum = 0.0;
        if (level < 0) {
            s.n = rows.window(at.x);
            s.smooth = rows.smooth(at.x)[c];
            variance_sum = rows.smooth_variance(at.x)[c] * sqr(s.n);
        } else {
            const auto& w = windows.around(at.x, at.y, level);
            s.n = w.n;
            s.smooth = w.mean[c] / w.n;
            variance_sum = w.variance[c];
        }
        s.own = rows.mean(at.x)[c];
        s.variance = variance_sum / sqr(s.n);
        if (s.n > 1.0)
            s.others_variance =
                std::max(variance_sum - rows.variance(at.x)[c], 0.0) / (s.n * (s.n - 1.0));
        return s;
    }

    int replicates_;
    std::vector<Pair> pairs_;
};

/// Of two pairs of disjoint replicates: relative and plain product of what two layers of them
/// differ by, summed over channels.
struct PairProduct {
    double relative = 0.0, plain = 0.0;
};
enum class FilmLayer { kAll, kCamera, kLight };

inline PairProduct pair_product(const PixelPairs::Pair& a, FilmLayer of_a,
                                const PixelPairs::Pair& b, FilmLayer of_b) {
    const auto part = [](const PixelPairs::Pair& p, FilmLayer layer, std::size_t c) {
        if (layer == FilmLayer::kAll) return p.difference[c];
        return layer == FilmLayer::kLight ? p.light[c] : p.difference[c] - p.light[c];
    };
    PairProduct sum;
    for (std::size_t c = 0; c < PixelPairs::kC; ++c) {
        const double of_first = part(a, of_a, c), of_second = part(b, of_b, c);
        sum.relative += a.root_weight[c] * b.root_weight[c] * of_first * of_second;
        sum.plain += of_first * of_second;
    }
    return sum;
}

}  // namespace matiere
