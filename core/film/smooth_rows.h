// Row by row, the replicate means of a film and their 5 x 5 box averages, in memory of a few rows.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

#include "film/film.h"

namespace matiere {

class SmoothRows {
 public:
    explicit SmoothRows(const Film& film)
        : film_(film), smooth_(line_size(film)), column_(line_size(film)) {
        ring_.fill(std::vector<double>(line_size(film)));
    }

    /// Moves to row y; rows are visited in order from 0.
    void advance(int y) {
        for (; loaded_ <= std::min(y + kRadius, film_.height() - 1); ++loaded_) load(loaded_);
        y_ = y;
        average();
    }

    /// R, G, B of pixel x of the current row in replicate r.
    const double* mean(int r, int x) const { return &row(y_)[at(r, x)]; }
    const double* smooth(int r, int x) const { return &smooth_[at(r, x)]; }

 private:
    static constexpr int kRadius = 2;
    static constexpr int kRows = 2 * kRadius + 1;
    static constexpr int kC = 3;

    static std::size_t line_size(const Film& film) {
        return std::size_t(film.replicates()) * std::size_t(film.width()) * kC;
    }
    std::size_t at(int r, int x) const {
        return (std::size_t(r) * std::size_t(film_.width()) + std::size_t(x)) * kC;
    }
    const std::vector<double>& row(int y) const { return ring_[std::size_t(y % kRows)]; }

    void load(int y) {
        std::vector<double>& to = ring_[std::size_t(y % kRows)];
        const std::size_t first = std::size_t(y) * std::size_t(film_.width());
        for (int r = 0; r < film_.replicates(); ++r)
            for (int x = 0; x < film_.width(); ++x)
                for (int c = 0; c < kC; ++c)
                    to[at(r, x) + std::size_t(c)] = film_.mean(first + std::size_t(x), c, r);
    }

    void average() {
        const int y0 = std::max(y_ - kRadius, 0), y1 = std::min(y_ + kRadius, film_.height() - 1);
        std::fill(column_.begin(), column_.end(), 0.0);
        for (int y = y0; y <= y1; ++y)
            for (std::size_t i = 0; i < column_.size(); ++i) column_[i] += row(y)[i];
        for (int r = 0; r < film_.replicates(); ++r)
            for (int x = 0; x < film_.width(); ++x) {
                const int x0 = std::max(x - kRadius, 0);
                const int x1 = std::min(x + kRadius, film_.width() - 1);
                const double share = 1.0 / double((y1 - y0 + 1) * (x1 - x0 + 1));
                for (std::size_t c = 0; c < kC; ++c) {
                    double sum = 0.0;
                    for (int u = x0; u <= x1; ++u) sum += column_[at(r, u) + c];
                    smooth_[at(r, x) + c] = sum * share;
                }
            }
    }

    const Film& film_;
    std::array<std::vector<double>, kRows> ring_;
    std::vector<double> smooth_, column_;
    int loaded_ = 0, y_ = 0;
};

}  // namespace matiere
