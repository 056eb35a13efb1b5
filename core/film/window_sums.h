// Sums of a film's pixel means and their variances over square windows of any size, in constant
// time (summed-area table, Crow 1984). 48 bytes per pixel while an error is estimated.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

#include "film/film_rows.h"

namespace matiere {

class WindowSums {
 public:
    static constexpr std::size_t kC = 3;

    struct Window {
        double n = 0.0;                     ///< pixels that exist
        std::array<double, kC> mean{};      ///< sum over the window of the pixel means
        std::array<double, kC> variance{};  ///< sum of their variances
    };

    WindowSums(int width, int height)
        : width_(width),
          height_(height),
          table_(std::size_t(width + 1) * std::size_t(height + 1)) {}

    /// Rows are added in order, `rows` standing at row y.
    void add_row(const FilmRows& rows, int y) {
        Entry run{};
        for (int x = 0; x < width_; ++x) {
            for (std::size_t m = 0; m < run.size(); ++m)
                run[m] += m < kC ? rows.mean(x)[m] : rows.variance(x)[m - kC];
            for (std::size_t m = 0; m < run.size(); ++m)
                table_[at(x + 1, y + 1)][m] = table_[at(x + 1, y)][m] + run[m];
        }
    }

    Window around(int x, int y, int radius) const {
        const int x0 = std::max(x - radius, 0), x1 = std::min(x + radius + 1, width_);
        const int y0 = std::max(y - radius, 0), y1 = std::min(y + radius + 1, height_);
        const Entry &a = table_[at(x0, y0)], &b = table_[at(x1, y0)];
        const Entry &c = table_[at(x0, y1)], &d = table_[at(x1, y1)];
        Window w;
        w.n = double(x1 - x0) * double(y1 - y0);
        for (std::size_t i = 0; i < kC; ++i) {
            w.mean[i] = d[i] - b[i] - c[i] + a[i];
            w.variance[i] = std::max(d[i + kC] - b[i + kC] - c[i + kC] + a[i + kC], 0.0);
        }
        return w;
    }

    bool covers(int x, int y, int radius) const {
        return x - radius <= 0 && y - radius <= 0 && x + radius >= width_ - 1 &&
               y + radius >= height_ - 1;
    }

 private:
    using Entry = std::array<double, 2 * kC>;

    std::size_t at(int x, int y) const {
        return std::size_t(y) * std::size_t(width_ + 1) + std::size_t(x);
    }

    int width_, height_;
    std::vector<Entry> table_;
};

}  // namespace matiere
