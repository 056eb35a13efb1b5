// The named facet distributions of Ashikhmin, Premoze, Shirley 2000, as densities p(h) of any
// scale. All may lean: `tilt` turns their axis from the normal towards the tangent. Or an image.
#pragma once

#include <array>
#include <cmath>
#include <optional>
#include <string_view>

#include "base/numeric.h"
#include "base/vec.h"
#include "texture/texture.h"

namespace matiere {

enum class FacetKind : unsigned char { kGaussian, kSatin, kVelvet, kGrooves, kTwoColor };
inline constexpr std::array<std::string_view, 5> kFacetKindNames{"gaussian", "satin", "velvet",
                                                                 "grooves", "two_color"};

struct FacetShape {
    FacetKind kind = FacetKind::kGaussian;
    double sigma_x = 0.3, sigma_y = 0.3;
    double tilt = 0.0;  ///< rad; grooves: of both sides, one to each
    /// Instead of all that: p over azimuth (columns, from the tangent) and polar angle (rows, the
    /// normal on top, the horizon at the bottom).
    std::optional<ImageTexture> image{};
    double constant = -1.0;  ///< or the same p everywhere, where not negative

    bool is_grooved() const { return kind == FacetKind::kGrooves || kind == FacetKind::kTwoColor; }

    /// The facets that lean towards +x; all of them unless there are grooves.
    double first(Vec3d h) const {
        if (image) return from_image(h);
        return constant >= 0.0 ? constant : one(h, tilt);
    }
    double second(Vec3d h) const { return is_grooved() ? one(h, -tilt) : 0.0; }
    double density(Vec3d h) const { return first(h) + second(h); }

 private:
    double from_image(Vec3d h) const {
        const double turn = std::atan2(h.y, h.x) / kTwoPi<double>;
        const double theta = std::atan2(std::sqrt(h.x * h.x + h.y * h.y), h.z);
        const double half_row = 0.5 / image->height();  // the ends must not wrap into each other
        const double v = std::clamp(1.0 - theta / (kPi<double> / 2), half_row, 1.0 - half_row);
        return double(image->fine_at({float(turn - std::floor(turn)), float(v)})[0]);
    }

    double one(Vec3d h, double angle) const {
        const double c = std::cos(angle), s = std::sin(angle);
        const Vec3d a{c * h.x - s * h.z, h.y, s * h.x + c * h.z};
        if (!(a.z > 0.0)) return 0.0;
        if (kind != FacetKind::kVelvet)
            return bell((sqr(a.x / sigma_x) + sqr(a.y / sigma_y)) / (a.z * a.z));
        // exp(-cot^2 / sigma^2): facets that stand up, none along the axis.
        const double up = sqr(a.x * sigma_x) + sqr(a.y * sigma_y);
        return up > 0.0 ? bell(a.z * a.z / up) : 0.0;
    }

    /// exp(-x), 0 where a float could not carry a value made of it.
    static double bell(double x) { return x < 75.0 ? std::exp(-x) : 0.0; }
};

}  // namespace matiere
