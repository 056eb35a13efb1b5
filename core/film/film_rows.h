// Row by row: the replicate means of a film, their mean I and its variance, and the 5 x 5 box
// average S of I with its variance. Holds a few rows, never the image.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

#include "base/numeric.h"
#include "film/film.h"

namespace matiere {

inline constexpr int kSmoothRadius = 2;  ///< S averages 5 x 5 pixels
inline constexpr double kSmoothSide = 2 * kSmoothRadius + 1;

class FilmRows {
 public:
    explicit FilmRows(const Film& film) : film_(film), width_(std::size_t(film.width())) {
        for (Row& row : ring_) {
            row.replicates.resize(std::size_t(film.replicates()) * width_ * kC);
            row.moments.resize(width_ * kMoments);
            if (film.has_light_layer()) {
                row.light.resize(row.replicates.size());
                row.light_variance.resize(width_ * kC);
            }
        }
        column_.resize(width_ * kMoments);
        smooth_.resize(width_ * kMoments);
        window_.resize(width_);
    }

    /// Moves to row y; rows are visited in order from 0.
    void advance(int y) {
        for (; loaded_ <= std::min(y + kRadius, film_.height() - 1); ++loaded_) load(loaded_);
        y_ = y;
        average();
    }

    /// R, G, B of pixel x of the current row: mean of replicate r, mean of all, its variance.
    const double* replicate(int r, int x) const {
        return &row(y_).replicates[(std::size_t(r) * width_ + std::size_t(x)) * kC];
    }
    const double* mean(int x) const { return &row(y_).moments[std::size_t(x) * kMoments]; }
    const double* variance(int x) const { return mean(x) + kC; }
    /// The light layer's part of replicate(r, x); null without one.
    const double* light(int r, int x) const {
        if (row(y_).light.empty()) return nullptr;
        return &row(y_).light[(std::size_t(r) * width_ + std::size_t(x)) * kC];
    }
    /// S, its variance, and the number of pixels it averages.
    const double* smooth(int x) const { return &smooth_[std::size_t(x) * kMoments]; }
    const double* smooth_variance(int x) const { return smooth(x) + kC; }
    double window(int x) const { return window_[std::size_t(x)]; }

 private:
    static constexpr int kRadius = kSmoothRadius;
    static constexpr int kRows = 2 * kRadius + 1;
    static constexpr std::size_t kC = 3;
    static constexpr std::size_t kMoments = 2 * kC;

    struct Row {
        std::vector<double> replicates;             ///< [r][x][c]
        std::vector<double> moments;                ///< [x][mean R, G, B, variance R, G, B]
        std::vector<double> light, light_variance;  ///< of the light layer: [r][x][c], [x][c]
    };
    const Row& row(int y) const { return ring_[std::size_t(y % kRows)]; }

    void load(int y) {
        Row& to = ring_[std::size_t(y % kRows)];
        const int r_count = film_.replicates();
        const std::size_t first = std::size_t(y) * width_;
        for (std::size_t x = 0; x < width_; ++x)
            for (std::size_t c = 0; c < kC; ++c) {
                double sum = 0.0, squares = 0.0;
                for (int r = 0; r < r_count; ++r) {
                    const double m = film_.mean(first + x, int(c), r);
                    to.replicates[(std::size_t(r) * width_ + x) * kC + c] = m;
                    sum += m;
                }
                const double mean = sum / double(r_count);
                for (int r = 0; r < r_count; ++r) {
                    const double d = to.replicates[(std::size_t(r) * width_ + x) * kC + c] - mean;
                    squares += d * d;
                }
                if (film_.has_light_layer()) load_light(to, x, c, first + x);
                to.moments[x * kMoments + c] = mean;
                to.moments[x * kMoments + kC + c] =
                    r_count > 1 ? squares / (double(r_count) * double(r_count - 1)) : 0.0;
            }
    }

    /// Variance of the mean of replicates that f(r) gives.
    template <class F>
    double spread(F&& f) const {
        const auto n = double(film_.replicates());
        double sum = 0.0, squares = 0.0;
        for (int r = 0; r < film_.replicates(); ++r) sum += f(r);
        for (int r = 0; r < film_.replicates(); ++r) squares += sqr(f(r) - sum / n);
        return n > 1.0 ? squares / (n * (n - 1.0)) : 0.0;
    }

    void load_light(Row& to, std::size_t x, std::size_t c, std::size_t pixel) {
        const auto at = [&](int r) -> double& {
            return to.light[(std::size_t(r) * width_ + x) * kC + c];
        };
        for (int r = 0; r < film_.replicates(); ++r) at(r) = film_.light_mean(pixel, int(c), r);
        to.light_variance[x * kC + c] = spread(at);
    }

    /// Pixels share their light paths: how much noise is common is told by the replicates of the
    /// whole window, not by its pixels.
    void average_light(int x0, int x1, int y0, int y1, int x) {
        for (std::size_t c = 0; c < kC; ++c) {
            double single = 0.0;
            for (int y = y0; y <= y1; ++y)
                for (int u = x0; u <= x1; ++u)
                    single += row(y).light_variance[std::size_t(u) * kC + c];
            const double n = window_[std::size_t(x)];
            const double common = spread([&](int r) {
                double sum = 0.0;
                for (int y = y0; y <= y1; ++y)
                    for (int u = x0; u <= x1; ++u)
                        sum += row(y).light[(std::size_t(r) * width_ + std::size_t(u)) * kC + c];
                return sum / n;
            });
            double& variance = smooth_[std::size_t(x) * kMoments + kC + c];
            variance = std::max(variance - single / (n * n), 0.0) + common;
        }
    }

    void average() {
        const int y0 = std::max(y_ - kRadius, 0), y1 = std::min(y_ + kRadius, film_.height() - 1);
        std::fill(column_.begin(), column_.end(), 0.0);
        for (int y = y0; y <= y1; ++y)
            for (std::size_t i = 0; i < column_.size(); ++i) column_[i] += row(y).moments[i];
        for (int x = 0; x < film_.width(); ++x) {
            const int x0 = std::max(x - kRadius, 0), x1 = std::min(x + kRadius, film_.width() - 1);
            const double n = double((y1 - y0 + 1) * (x1 - x0 + 1));
            window_[std::size_t(x)] = n;
            for (std::size_t m = 0; m < kMoments; ++m) {
                double sum = 0.0;
                for (int u = x0; u <= x1; ++u) sum += column_[std::size_t(u) * kMoments + m];
                smooth_[std::size_t(x) * kMoments + m] = sum / (m < kC ? n : n * n);
            }
            if (film_.has_light_layer()) average_light(x0, x1, y0, y1, x);
        }
    }

    const Film& film_;
    std::size_t width_;
    std::array<Row, kRows> ring_;
    std::vector<double> column_, smooth_, window_;
    int loaded_ = 0, y_ = 0;
};

}  // namespace matiere
