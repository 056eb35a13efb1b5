// Reconstruction filters, sampled in proportion to their value: every sample then has weight 1 and
// pixels stay independent of each other, as the error bar needs (Shirley et al., Ernst et al.
// 2006).
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>
#include <vector>

#include "base/vec.h"

namespace matiere {

enum class FilterKind { kBox, kTent, kGaussian, kBlackmanHarris };

inline constexpr std::array<std::string_view, 4> kFilterNames = {"box", "tent", "gaussian",
                                                                 "blackman_harris"};

/// A separable, positive, symmetric filter of half width `radius` pixels.
class Filter {
 public:
    static constexpr float kMaxRadius = 16.0F;

    /// `radius` <= 0 takes the usual one: box 0.5, tent 1, gaussian 1.5 (sigma = radius / 3),
    /// blackman_harris 1.5 pixels. Throws SceneError for an unknown name or a radius above 16.
    explicit Filter(std::string_view name = "gaussian", float radius = 0.0F);

    FilterKind kind() const { return kind_; }
    float radius() const { return radius_; }

    /// Offset from the pixel centre, in pixels, for uniform u in [0,1)^2; monotone in each u.
    Vec2f sample(Vec2f u) const { return {sample_1d(u.x), sample_1d(u.y)}; }

    /// Density of one axis of `sample` at offset x, per pixel: what a light path that arrives there
    /// gives to the pixel. Constant inside a cell of the table, as the samples are.
    float weight(float x) const {
        const float t = std::abs(x) / radius_;
        if (!(t < 1.0F)) return 0.0F;
        if (kind_ == FilterKind::kBox) return 0.5F / radius_;
        if (kind_ == FilterKind::kTent) return (1.0F - t) / radius_;
        const float cells = float(cdf_.size() - 1);
        const auto cell = std::size_t(t * cells);
        return (cdf_[cell + 1] - cdf_[cell]) * cells * 0.5F / radius_;
    }

    /// Normalised density of one axis at offset x, per pixel.
    double density(double x) const;

 private:
    float sample_1d(float u) const;
    void tabulate();

    FilterKind kind_;
    float radius_;
    double norm_ = 1.0;
    std::vector<float> cdf_;  ///< of |x| / radius at kCells + 1 even steps; empty for box and tent
    std::vector<std::uint16_t> first_;  ///< the first cell whose end lies above bin / kBins
};

}  // namespace matiere
