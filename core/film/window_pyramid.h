// Sums of a film's pixel means and their variances over windows of 20, 40, 80, ... pixels: every
// window is 5 x 5 cells about the cell of the pixel, cells have 4, 8, 16, ... pixels. Only ever
// adds what is positive, so that a dark corner keeps its digits in an image that holds the sun (a
// summed-area table would lose them). About 9 bytes per pixel while an error is estimated.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

#include "film/film_rows.h"

namespace matiere {

class WindowPyramid {
 public:
    static constexpr std::size_t kC = 3;
    static constexpr int kSmallestCell = 4;

    struct Window {
        double n = 0.0;                     ///< pixels that exist
        std::array<double, kC> mean{};      ///< sum over the window of the pixel means
        std::array<double, kC> variance{};  ///< sum of their variances

        void operator+=(const Window& b) {
            n += b.n;
            for (std::size_t c = 0; c < kC; ++c) mean[c] += b.mean[c];
            for (std::size_t c = 0; c < kC; ++c) variance[c] += b.variance[c];
        }
    };

    WindowPyramid(int width, int height) : width_(width) {
        levels_.emplace_back(divide_up(width, kSmallestCell), divide_up(height, kSmallestCell));
    }

    /// Rows are added in order, `rows` standing at row y.
    void add_row(const FilmRows& rows, int y) {
        for (int x = 0; x < width_; ++x) {
            Window& cell = levels_[0].cell(x / kSmallestCell, y / kSmallestCell);
            cell.n += 1.0;
            for (std::size_t c = 0; c < kC; ++c) cell.mean[c] += rows.mean(x)[c];
            for (std::size_t c = 0; c < kC; ++c) cell.variance[c] += rows.variance(x)[c];
        }
    }

    /// After the last row: the larger cells, up to a window that covers the film.
    void finish() {
        while (levels_.back().width > 3 || levels_.back().height > 3) {
            Level next(divide_up(levels_.back().width, 2), divide_up(levels_.back().height, 2));
            for (int y = 0; y < levels_.back().height; ++y)
                for (int x = 0; x < levels_.back().width; ++x)
                    next.cell(x / 2, y / 2) += levels_.back().cell(x, y);
            levels_.push_back(std::move(next));
        }
        for (Level& level : levels_) level.sum_windows();
    }

    int levels() const { return int(levels_.size()); }
    /// Pixels on the side of a whole window.
    static double side(int level) { return 5.0 * kSmallestCell * double(1 << level); }

    const Window& around(int x, int y, int level) const {
        const int shift = level + 2;  // log2 of the cell's side
        const Level& l = levels_[std::size_t(level)];
        return l.windows[l.at(x >> shift, y >> shift)];
    }

 private:
    struct Level {
        int width, height;
        std::vector<Window> cells, windows;

        Level(int w, int h) : width(w), height(h), cells(std::size_t(w) * std::size_t(h)) {}

        std::size_t at(int x, int y) const {
            return std::size_t(y) * std::size_t(width) + std::size_t(x);
        }
        Window& cell(int x, int y) { return cells[at(x, y)]; }

        void sum_windows() {
            windows.resize(cells.size());
            for (int y = 0; y < height; ++y)
                for (int x = 0; x < width; ++x)
                    for (int v = std::max(y - 2, 0); v <= std::min(y + 2, height - 1); ++v)
                        for (int u = std::max(x - 2, 0); u <= std::min(x + 2, width - 1); ++u)
                            windows[at(x, y)] += cells[at(u, v)];
            cells = {};
        }
    };
    static int divide_up(int a, int b) { return (a + b - 1) / b; }

    int width_;
    std::vector<Level> levels_;
};

}  // namespace matiere
