#include "optics/warp2d.h"

#include <algorithm>
#include <cmath>

namespace matiere {
namespace {

/// Where the integral of the line from a to b over [0, x] reaches `part` of the whole.
double invert_line(double a, double b, double part) {
    const double target = part * 0.5 * (a + b);
    const double root = std::sqrt(std::max(a * a + 2.0 * (b - a) * target, 0.0));
    const double sum = a + root;  // the form of the quadratic's root that cannot cancel
    return sum > 0.0 ? std::clamp(2.0 * target / sum, 0.0, 1.0) : part;
}

double line_integral(double a, double b, double x) { return x * (a + 0.5 * x * (b - a)); }

struct Cell {
    int index;
    double rest;
};

Cell cell_of(double at, int nodes) {
    const double x = std::clamp(at, 0.0, 1.0) * (nodes - 1);
    const int i = std::min(int(x), nodes - 2);
    return {i, x - i};
}

/// Largest i in [0, nodes - 2] with cumulated(i) <= target.
template <class F>
int find_cell(int nodes, double target, F&& cumulated) {
    int low = 0, high = nodes - 1;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        (cumulated(middle) <= target ? low : high) = middle;
    }
    return low;
}

}  // namespace

Warp2D::Warp2D(const float* values, int slices, int height, int width, bool normalized)
    : width_(width),
      height_(height),
      values_(values, values + std::size_t(slices) * std::size_t(height) * std::size_t(width)),
      conditional_(normalized ? values_.size() : 0),
      marginal_(normalized ? std::size_t(slices) * std::size_t(height) : 0) {
    for (double& v : values_) v = std::max(v, 0.0);
    if (!normalized) return;
    const auto w = std::size_t(width), h = std::size_t(height);
    for (std::size_t s = 0; s < std::size_t(slices); ++s) {
        double* value = &values_[s * w * h];
        double* row = &conditional_[s * w * h];
        double* column = &marginal_[s * h];
        const auto cumulate = [&] {
            for (std::size_t y = 0; y < h; ++y) {
                row[y * w] = 0.0;
                for (std::size_t x = 1; x < w; ++x)
                    row[y * w + x] =
                        row[y * w + x - 1] +
                        0.5 * (value[y * w + x - 1] + value[y * w + x]) / double(width - 1);
            }
            column[0] = 0.0;
            for (std::size_t y = 1; y < h; ++y)
                column[y] = column[y - 1] +
                            0.5 * (row[y * w - 1] + row[(y + 1) * w - 1]) / double(height - 1);
        };
        cumulate();
        const double scale = column[h - 1] > 0.0 ? 1.0 / column[h - 1] : 0.0;
        for (std::size_t i = 0; i < w * h; ++i) value[i] *= scale;
        cumulate();
    }
}

double Warp2D::mixed(const std::vector<double>& table, std::size_t stride, std::size_t offset,
                     const SliceBlend& blend) const {
    double sum = 0.0;
    for (std::size_t k = 0; k < blend.slice.size(); ++k)
        if (blend.share[k] > 0.0)
            sum += blend.share[k] * table[std::size_t(blend.slice[k]) * stride + offset];
    return sum;
}

double Warp2D::value(int x, int y, const SliceBlend& blend) const {
    return mixed(values_, std::size_t(width_) * std::size_t(height_),
                 std::size_t(y) * std::size_t(width_) + std::size_t(x), blend);
}
double Warp2D::row_part(int x, int y, const SliceBlend& blend) const {
    return mixed(conditional_, std::size_t(width_) * std::size_t(height_),
                 std::size_t(y) * std::size_t(width_) + std::size_t(x), blend);
}
double Warp2D::row_sum(int y, const SliceBlend& blend) const {
    return row_part(width_ - 1, y, blend);
}
double Warp2D::rows_below(int y, const SliceBlend& blend) const {
    return mixed(marginal_, std::size_t(height_), std::size_t(y), blend);
}

double Warp2D::eval(Vec2<double> at, const SliceBlend& blend) const {
    const Cell x = cell_of(at.x, width_), y = cell_of(at.y, height_);
    const double low =
        std::lerp(value(x.index, y.index, blend), value(x.index + 1, y.index, blend), x.rest);
    const double high = std::lerp(value(x.index, y.index + 1, blend),
                                  value(x.index + 1, y.index + 1, blend), x.rest);
    return std::lerp(low, high, y.rest);
}

Warp2D::Result Warp2D::sample(Vec2<double> u, const SliceBlend& blend) const {
    const int y = find_cell(height_, u.y, [&](int i) { return rows_below(i, blend); });
    const double below = rows_below(y, blend), above = rows_below(y + 1, blend);
    const double part = above > below ? std::clamp((u.y - below) / (above - below), 0.0, 1.0) : 0.5;
    const double v = invert_line(row_sum(y, blend), row_sum(y + 1, blend), part);

    const auto along = [&](int i) {
        return std::lerp(row_part(i, y, blend), row_part(i, y + 1, blend), v);
    };
    const double target = u.x * along(width_ - 1);
    const int x = find_cell(width_, target, along);
    const double left = along(x), right = along(x + 1);
    const double share =
        right > left ? std::clamp((target - left) / (right - left), 0.0, 1.0) : 0.5;
    const double c0 = std::lerp(value(x, y, blend), value(x, y + 1, blend), v);
    const double c1 = std::lerp(value(x + 1, y, blend), value(x + 1, y + 1, blend), v);
    const double w = invert_line(c0, c1, share);
    return {{(x + w) / (width_ - 1), (y + v) / (height_ - 1)}, std::lerp(c0, c1, w)};
}

Warp2D::Result Warp2D::invert(Vec2<double> at, const SliceBlend& blend) const {
    const Cell x = cell_of(at.x, width_), y = cell_of(at.y, height_);
    const double c0 =
        std::lerp(value(x.index, y.index, blend), value(x.index, y.index + 1, blend), y.rest);
    const double c1 = std::lerp(value(x.index + 1, y.index, blend),
                                value(x.index + 1, y.index + 1, blend), y.rest);
    const auto along = [&](int i) {
        return std::lerp(row_part(i, y.index, blend), row_part(i, y.index + 1, blend), y.rest);
    };
    const double whole = along(width_ - 1);
    const double left = along(x.index) + line_integral(c0, c1, x.rest) / (width_ - 1);
    const double below =
        rows_below(y.index, blend) +
        line_integral(row_sum(y.index, blend), row_sum(y.index + 1, blend), y.rest) / (height_ - 1);
    return {{whole > 0.0 ? std::min(left / whole, 1.0) : 0.0, std::min(below, 1.0)},
            std::lerp(c0, c1, x.rest)};
}

}  // namespace matiere
