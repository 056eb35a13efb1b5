#include "film/estimate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "base/student.h"
#include "film/difference_variance.h"
#include "film/film_rows.h"
#include "film/pixel_pairs.h"

namespace matiere {
namespace {

constexpr int kC = kColorChannels;

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

/// Sums of one region (the image or a tile) while the rows of the film pass.
struct RegionSums {
    double pixels = 0.0, unknown = 0.0;
    double relative = 0.0, absolute = 0.0, classic = 0.0;
    VarianceSum relative_variance, absolute_variance;
    double scale_noise = 0.0;
    std::array<double, kC> mean{}, variance{};  ///< of the radiance; variance: of the camera's part
    LayerVariance layer;
    std::vector<std::array<double, kC>> light;  ///< of the light layer, by replicate

    void add(const FilmRows& rows, const PixelPairs& pixel, int x) {
        pixels += 1.0;
        if (pixel.all_equal()) unknown += 1.0;
        relative += pixel.weighted_variance();
        for (std::size_t c = 0; c < kC; ++c) {
            const double v = rows.variance(x)[c], m = rows.mean(x)[c];
            absolute += v;
            classic += v / (m * m + kClassicFloor);
            mean[c] += m;
            variance[c] += v;
        }
    }

    void add_light(const FilmRows& rows, const PixelPairs& pixel,
                   const DifferenceVariance& difference, const Film& film, int x) {
        layer.add(pixel, difference.disjoint());
        const int r_count = film.replicates();
        light.resize(std::size_t(r_count));
        for (std::size_t c = 0; c < kC; ++c) {
            double camera = 0.0, squares = 0.0;
            const auto of = [&](int r) { return rows.replicate(r, x)[c] - rows.light(r, x)[c]; };
            for (int r = 0; r < r_count; ++r) camera += of(r) / r_count;
            for (int r = 0; r < r_count; ++r) squares += sqr(of(r) - camera);
            variance[c] += squares / (double(r_count) * (r_count - 1.0)) - rows.variance(x)[c];
            for (int r = 0; r < r_count; ++r) light[std::size_t(r)][c] += rows.light(r, x)[c];
        }
    }

    /// Takes in what the light layer adds to the variances.
    void close() {
        const auto n = int(light.size());
        if (n < 2) return;
        const double freedom = LayerVariance::freedom(n);
        relative_variance.add_shared(layer.relative(n), freedom);
        absolute_variance.add_shared(layer.absolute(n), freedom);
        for (std::size_t c = 0; c < kC; ++c) {
            double all = 0.0, squares = 0.0;
            for (const auto& l : light) all += l[c] / n;
            for (const auto& l : light) squares += sqr(l[c] - all);
            variance[c] = std::max(variance[c], 0.0) + squares / (double(n) * (n - 1.0));
        }
    }
};

double ratio(double a, double b) { return b > 0.0 ? a / b : 0.0; }

/// The logarithm of an estimate with relative variance v has this standard deviation: an interval
/// in log space suits a squared error, which is positive and skewed.
double log_deviation(double v) { return std::sqrt(std::log1p(v)); }

ErrorEstimate finish(const RegionSums& s, double log_average, std::uint64_t look) {
    ErrorEstimate e;
    const double n = s.pixels * kC;
    e.log_average = log_average;
    e.look = look;
    e.unknown_share = s.unknown / s.pixels;
    e.known = s.unknown < s.pixels && s.relative > 0.0;
    e.relmse = s.relative / n;
    e.rmse = std::sqrt(s.absolute / n);
    e.relmse_classic = s.classic / n;
    double mean = 0.0, mean_deviation = 0.0;
    for (std::size_t c = 0; c < kC; ++c) {
        e.mean[c] = s.mean[c] / s.pixels;
        e.mean_standard_error[c] = std::sqrt(s.variance[c]) / s.pixels;
        mean += e.mean[c] / kC;
        mean_deviation += e.mean_standard_error[c] / kC;  // as if the channels were one
    }
    e.rmse_percent = mean > 0.0 ? 100.0 * e.rmse / mean : 0.0;
    const double relative_variance = s.relative_variance.sum() + s.scale_noise;
    e.log_deviation = log_deviation(ratio(relative_variance, sqr(s.relative)));
    e.effective_pixels = s.relative_variance.effective_pixels();
    const double absolute = log_deviation(ratio(s.absolute_variance.sum(), sqr(s.absolute)));
    e.rmse_log_deviation = std::hypot(0.5 * absolute, ratio(mean_deviation, mean));
    if (!s.light.empty())
        e.least_freedom = std::min(e.least_freedom, LayerVariance::freedom(int(s.light.size())));
    e.rmse_effective_pixels = s.absolute_variance.effective_pixels();
    return e;
}

/// All regions of a film cut into squares of `edge` pixels, row by row.
class Regions {
 public:
    Regions(const Film& film, int edge)
        : width_(film.width()),
          height_(film.height()),
          edge_(edge),
          columns_((width_ + edge - 1) / edge),
          sums_(std::size_t(columns_) * std::size_t((height_ + edge - 1) / edge)),
          noise_(width_, edge) {}

    RegionSums& at(int x, int y) { return sums_[index(x, y)]; }
    const std::vector<RegionSums>& sums() const { return sums_; }
    ScaleNoise& noise() { return noise_; }
    void close() {
        for (RegionSums& s : sums_) s.close();
    }
    void end_row(int y) {
        const bool last = y + 1 == height_ || (y + 1) % edge_ == 0;
        noise_.end_row(y % edge_, last,
                       [&](int x, double v) { at(std::min(x, width_ - 1), y).scale_noise += v; });
    }
    TileEstimate tile(std::size_t i, double log_average, std::uint64_t look) const {
        const int x0 = int(i % std::size_t(columns_)) * edge_;
        const int y0 = int(i / std::size_t(columns_)) * edge_;
        return {x0, y0, std::min(x0 + edge_, width_), std::min(y0 + edge_, height_),
                finish(sums_[i], log_average, look)};
    }

 private:
    std::size_t index(int x, int y) const {
        return std::size_t(y / edge_) * std::size_t(columns_) + std::size_t(x / edge_);
    }
    int width_, height_, edge_, columns_;
    std::vector<RegionSums> sums_;
    ScaleNoise noise_;
};

/// Two-sided interval of a positive figure whose logarithm has this deviation; Student's t widens
/// it where few pixels carry the variance.
Interval log_interval(double value, double deviation, double freedom, double confidence) {
    const double t = student_quantile(0.5 * (1.0 - confidence), freedom);
    return {value * std::exp(-deviation * t), value * std::exp(deviation * t)};
}

}  // namespace

double look_confidence(std::uint64_t look) {
    const double k = double(std::max<std::uint64_t>(look, 1));
    return 1.0 - (1.0 - kConfidence) / (k * (k + 1.0));
}

Interval relmse_interval(const ErrorEstimate& e, double confidence) {
    return log_interval(e.relmse, e.log_deviation, std::max(e.effective_pixels, e.least_freedom),
                        confidence);
}

Interval rmse_percent_interval(const ErrorEstimate& e, double confidence) {
    return log_interval(e.rmse_percent, e.rmse_log_deviation,
                        std::max(e.rmse_effective_pixels, e.least_freedom), confidence);
}

std::vector<TileEstimate> estimate_tiles(const Film& film, int edge) {
    Regions regions(film, edge);
    WindowPyramid windows(film.width(), film.height());
    const double m = log_average(film, &windows);
    windows.finish();
    const int r_count = film.replicates();
    const bool possible = r_count >= 2 && film.spp() > 0;
    const double floor = kRelativeFloor * m * m;
    FilmRows rows(film);
    PixelPairs pixel(r_count);
    DifferenceVariance difference(pixel, r_count, film.width(), film.has_light_layer());
    for (int y = 0; y < film.height() && possible; ++y) {
        rows.advance(y);
        for (int x = 0; x < film.width(); ++x) {
            pixel.set(rows, windows, {x, y}, floor);
            RegionSums& region = regions.at(x, y);
            region.add(rows, pixel, x);
            if (film.has_light_layer()) region.add_light(rows, pixel, difference, film, x);
            const auto [relative, absolute] = difference.of(pixel, x, y);
            region.relative_variance.add(relative);
            region.absolute_variance.add(absolute);
            regions.noise().add(pixel, x);
        }
        regions.end_row(y);
    }
    regions.close();
    std::vector<TileEstimate> result;
    const std::uint64_t look = possible ? film.plan().look_number(film.spp()) : 0;
    for (std::size_t i = 0; i < regions.sums().size(); ++i) {
        result.push_back(regions.tile(i, m, look));
        if (!possible) result.back().error = ErrorEstimate{.log_average = m};
    }
    return result;
}

ErrorEstimate estimate_error(const Film& film) {
    return estimate_tiles(film, std::max(film.width(), film.height())).front().error;
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
                    sum > 0.0 ? std::sqrt(sum / n) : std::numeric_limits<double>::quiet_NaN();
            }
    return result;
}

}  // namespace matiere
