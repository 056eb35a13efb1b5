// A family of bilinear densities on the unit square, blended over its parameters: what RGL's
// measurements are stored and sampled by (Dupuy & Jakob 2018, section 5.2). Nodes lie on the
// corners and edges: node (x, y) at (x / (width - 1), y / (height - 1)). In double throughout.
#pragma once

#include <array>
#include <vector>

#include "base/vec.h"

namespace matiere {

/// Up to four slices and their shares, which add up to 1.
struct SliceBlend {
    std::array<int, 4> slice{};
    std::array<double, 4> share{};
};

class Warp2D {
 public:
    struct Result {
        Vec2<double> at;
        double pdf = 0.0;
    };

    Warp2D() = default;
    /// `values` holds slices x height x width numbers; below zero counts as zero. `normalized`:
    /// every slice is scaled to integrate to 1 and can be sampled; otherwise it is only
    /// interpolated.
    Warp2D(const float* values, int slices, int height, int width, bool normalized);

    double eval(Vec2<double> at, const SliceBlend& blend) const;
    /// From uniform numbers to a point.
    Result sample(Vec2<double> u, const SliceBlend& blend) const;
    /// From a point back to the uniform numbers that `sample` makes it of.
    Result invert(Vec2<double> at, const SliceBlend& blend) const;

 private:
    double mixed(const std::vector<double>& table, std::size_t stride, std::size_t offset,
                 const SliceBlend& blend) const;
    double value(int x, int y, const SliceBlend& blend) const;
    double row_sum(int y, const SliceBlend& blend) const;
    double row_part(int x, int y, const SliceBlend& blend) const;
    double rows_below(int y, const SliceBlend& blend) const;

    int width_ = 0, height_ = 0;
    std::vector<double> values_;       // [slice][y][x]
    std::vector<double> conditional_;  // [slice][y][x]: integral along the row up to x
    std::vector<double> marginal_;     // [slice][y]: integral of whole rows up to y
};

}  // namespace matiere
