#include "film/estimate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "film/film_rows.h"
#include "film/pixel_pairs.h"

namespace matiere {
namespace {

constexpr int kC = kColorChannels;
constexpr double kNormal975 = 1.959963984540054;

double luminance(const double* rgb) { return 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]; }

/// Log-average luminance of the non-zero pixels of S; 0 for a black image. The logarithm of a noisy
/// value is too low by v / (2 S^2) on average, which is put back (bounded for any noise).
double log_average(const Film& film, WindowPyramid* windows = nullptr) {
    FilmRows rows(film);
    double sum = 0.0;
    std::size_t n = 0;
    for (int y = 0; y < film.height(); ++y) {
        rows.advance(y);
        if (windows != nullptr) windows->add_row(rows, y);
        for (int x = 0; x < film.width(); ++x) {
            const double lum = luminance(rows.smooth(x));
            if (!(lum > 0.0)) continue;
            const double* v = rows.smooth_variance(x);
            const double deviations[] = {std::sqrt(v[0]), std::sqrt(v[1]), std::sqrt(v[2])};
            const double relative = luminance(deviations) / lum;
            sum += std::log(lum) + 0.5 * std::log1p(relative * relative);
            ++n;
        }
    }
    return n == 0 ? 0.0 : std::exp(sum / double(n));
}

/// Indices of pairs of pairs that share no replicate, inside each cyclic block of four neighbouring
/// replicates: all three for R = 4, 3 R of them above.
std::vector<std::array<std::size_t, 2>> disjoint_pairs(const PixelPairs& pixel, int replicates) {
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

/// The variance of D summed over pixels, and the sum of squares that tells how many carry it.
class DifferenceVariance {
 public:
    DifferenceVariance(const PixelPairs& pixel, int replicates, int width)
        : replicates_(replicates), disjoint_(disjoint_pairs(pixel, replicates)) {
        if (disjoint_.empty()) above_.resize(std::size_t(width), pixel);
    }

    void add(const PixelPairs& pixel, int x, int y) {
        const double v = disjoint_.empty() ? by_neighbours(pixel, x, y) : by_pairs(pixel);
        sum_ += v;
        squares_ += v * v;
    }
    double sum() const { return sum_; }
    double effective_pixels() const { return squares_ > 0.0 ? sum_ * sum_ / squares_ : 0.0; }

 private:
    double factor() const { return 2.0 / (double(replicates_) * (replicates_ - 1.0)); }

    double by_pairs(const PixelPairs& pixel) const {
        double sum = 0.0;
        for (const auto& [p, q] : disjoint_)
            sum += covariance_product(pixel.pairs()[p], pixel.pairs()[q]);
        return factor() * sum / double(disjoint_.size());
    }

    /// R < 4 has no disjoint pairs: the product of two neighbours stands for the square of one.
    double by_neighbours(const PixelPairs& pixel, int x, int y) {
        const auto column = std::size_t(x);
        double sum = 0.0;
        int n = 0;
        const auto with = [&](const PixelPairs& other) {
            for (const auto& a : pixel.pairs())
                for (const auto& b : other.pairs()) sum += covariance_product(a, b);
            n += int(pixel.pairs().size() * other.pairs().size());
        };
        if (y > 0) with(above_[column]);      // still the row above: this column comes next
        if (x > 0) with(above_[column - 1]);  // already this row
        above_[column] = pixel;
        return n == 0 ? 0.0 : factor() * sum / double(n);
    }

    int replicates_;
    std::vector<std::array<std::size_t, 2>> disjoint_;
    std::vector<PixelPairs> above_;
    double sum_ = 0.0, squares_ = 0.0;
};

/// The variance that the noise of S adds to the estimate. S is shared within 5 x 5 pixels: inside
/// blocks of that size its noise is taken as common, between them as independent, which has the
/// same sum of covariances as the sliding window.
class ScaleNoise {
 public:
    explicit ScaleNoise(int width) : blocks_(std::size_t(width / kBlock) + 1, 0.0) {}

    void add(const PixelPairs& pixel, int x) {
        blocks_[std::size_t(x / kBlock)] += pixel.scale_noise();
    }
    /// To be called after every row.
    void end_row(int y, bool last) {
        if ((y + 1) % kBlock != 0 && !last) return;
        for (double& b : blocks_) sum_ += sqr(b);
        std::fill(blocks_.begin(), blocks_.end(), 0.0);
    }
    double sum() const { return sum_; }

 private:
    static constexpr int kBlock = 2 * kSmoothRadius + 1;
    std::vector<double> blocks_;
    double sum_ = 0.0;
};

/// 97.5 % point of Student's t (Cornish-Fisher expansion, Abramowitz & Stegun 26.7.5), exact to 1 %
/// from 3 degrees of freedom up.
double student_975(double dof) {
    const double z = kNormal975, n = std::max(dof, 3.0);
    const double g1 = (std::pow(z, 3) + z) / 4;
    const double g2 = (5 * std::pow(z, 5) + 16 * std::pow(z, 3) + 3 * z) / 96;
    const double g3 =
        (3 * std::pow(z, 7) + 19 * std::pow(z, 5) + 17 * std::pow(z, 3) - 15 * z) / 384;
    return z + g1 / n + g2 / (n * n) + g3 / (n * n * n);
}

/// The interval is laid out in log space (a squared error is positive and skewed), with the same
/// mean and variance as the prediction, and widened where few pixels carry the variance.
void set_interval(ErrorEstimate& e, double relative_variance, double effective_pixels) {
    const double spread = std::sqrt(std::log1p(relative_variance)) * student_975(effective_pixels);
    e.lower = e.relmse * std::exp(-spread);
    e.upper = e.relmse * std::exp(spread);
    e.effective_pixels = effective_pixels;
}

}  // namespace

ErrorEstimate estimate_error(const Film& film) {
    ErrorEstimate e;
    WindowPyramid windows(film.width(), film.height());
    e.log_average = log_average(film, &windows);
    windows.finish();
    const int r_count = film.replicates();
    if (r_count < 2 || film.spp() == 0) return e;
    const double floor = kRelativeFloor * e.log_average * e.log_average;
    const double n = double(film.pixels()) * kC;
    FilmRows rows(film);
    PixelPairs pixel(r_count);
    DifferenceVariance difference(pixel, r_count, film.width());
    ScaleNoise scale_noise(film.width());
    double relative = 0.0, absolute = 0.0, classic = 0.0;
    std::size_t unknown = 0;
    for (int y = 0; y < film.height(); ++y) {
        rows.advance(y);
        for (int x = 0; x < film.width(); ++x) {
            pixel.set(rows, windows, {x, y}, floor);
            if (pixel.all_equal()) ++unknown;
            relative += pixel.weighted_variance();
            for (std::size_t c = 0; c < kC; ++c) {
                const double v = rows.variance(x)[c], mean = rows.mean(x)[c];
                absolute += v;
                classic += v / (mean * mean + kClassicFloor);
            }
            difference.add(pixel, x, y);
            scale_noise.add(pixel, x);
        }
        scale_noise.end_row(y, y + 1 == film.height());
    }
    e.unknown_share = double(unknown) / double(film.pixels());
    e.known = unknown < film.pixels() && relative > 0.0;
    e.relmse = relative / n;
    e.rmse = std::sqrt(absolute / n);
    e.relmse_classic = classic / n;
    if (e.known)
        set_interval(e, (difference.sum() + scale_noise.sum()) / sqr(relative),
                     difference.effective_pixels());
    return e;
}

std::vector<double> error_weights(const Film& film) {
    const double m = log_average(film), floor = kRelativeFloor * m * m;
    std::vector<double> weights;
    weights.reserve(film.pixels() * kC);
    FilmRows rows(film);
    for (int y = 0; y < film.height(); ++y) {
        rows.advance(y);
        for (int x = 0; x < film.width(); ++x)
            for (std::size_t c = 0; c < kC; ++c)
                weights.push_back(
                    reciprocal_scale(rows.smooth(x)[c], rows.smooth_variance(x)[c], floor));
    }
    return weights;
}

std::vector<double> mean_variance(const Film& film) {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const double r_count = film.replicates();
    std::vector<double> result(film.pixels() * kC, nan);
    if (film.replicates() < 2) return result;
    for (std::size_t p = 0; p < film.pixels(); ++p) {
        if (film.counts()[p] == 0) continue;
        for (int c = 0; c < kC; ++c) {
            double mean = 0.0, squares = 0.0;
            for (int r = 0; r < film.replicates(); ++r) mean += film.mean(p, c, r) / r_count;
            for (int r = 0; r < film.replicates(); ++r) {
                const double d = film.mean(p, c, r) - mean;
                squares += d * d;
            }
            result[p * kC + std::size_t(c)] = squares / (r_count * (r_count - 1.0));
        }
    }
    return result;
}

std::vector<double> standard_error(const Film& film) {
    const std::vector<double> variance = mean_variance(film);
    const int w = film.width(), h = film.height();
    const auto at = [&](int x, int y, int c) {
        return (std::size_t(y) * std::size_t(w) + std::size_t(x)) * kC + std::size_t(c);
    };
    std::vector<double> result(variance.size());
    for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; ++x)
            for (int c = 0; c < kC; ++c) {
                double sum = 0.0;
                int n = 0;
                for (int v = std::max(y - kSmoothRadius, 0);
                     v <= std::min(y + kSmoothRadius, h - 1); ++v)
                    for (int u = std::max(x - kSmoothRadius, 0);
                         u <= std::min(x + kSmoothRadius, w - 1); ++u)
                        if (const double one = variance[at(u, v, c)]; !std::isnan(one)) {
                            sum += one;
                            ++n;
                        }
                result[at(x, y, c)] =
                    n == 0 ? std::numeric_limits<double>::quiet_NaN() : std::sqrt(sum / n);
            }
    return result;
}

}  // namespace matiere
