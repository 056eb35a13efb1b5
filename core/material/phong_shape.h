// Half vectors of Phong lobes with one exponent (Blinn 1977) or two (Ashikhmin & Shirley 2000):
//
//   p_h(h) = sqrt((nu + 1)(nv + 1)) / (2 pi) (n.h)^e,  e = (nu h_x^2 + nv h_y^2) / (1 - h_z^2)
//
// whose integral over the hemisphere is 1 (no cosine). The power is taken as
// exp(e/2 log(1 - s)) with s = h_x^2 + h_y^2, which keeps its digits for exponents up to 1e8.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <string_view>

#include "base/numeric.h"
#include "base/vec.h"
#include "optics/roughness.h"

namespace matiere {

/// Largest exponent of a lobe: a width of about 1.4e-4.
inline constexpr double kMaxLobeExponent = 1e8;

/// The norm of a lobe: the one that conserves energy, or the one of the course, which gains.
enum class Normalization : unsigned char { kExact, kCourse };
inline constexpr std::array<std::string_view, 2> kNormalizationNames{"exact", "course"};

template <class R>
struct PhongHalf {
    R nu{}, nv{};

    R norm() const { return std::sqrt((nu + R(1)) * (nv + R(1))) / kTwoPi<R>; }

    R density(Vec3<R> h) const {
        const R s = h.x * h.x + h.y * h.y;
        const R weighted = nu * h.x * h.x + nv * h.y * h.y;
        return norm() * std::exp(weighted * half_log_over(s, h.z));
    }

    /// Cosine and sine of the azimuth of h for u in [0, 1): all four quadrants at once.
    Vec2<R> azimuth(R u) const {
        const R phi = kTwoPi<R> * u;
        const R x = std::sqrt(nv + R(1)) * std::cos(phi);
        const R y = std::sqrt(nu + R(1)) * std::sin(phi);
        const R scale = R(1) / std::sqrt(x * x + y * y);
        return {x * scale, y * scale};
    }

    /// The u whose azimuth a direction has.
    R azimuth_variate(Vec2<R> d) const {
        return std::atan2(d.y * std::sqrt(nv + R(1)), d.x * std::sqrt(nu + R(1))) / kTwoPi<R>;
    }

    /// Exponent plus 1 along an azimuth.
    R power(Vec2<R> phi) const { return nu * phi.x * phi.x + nv * phi.y * phi.y + R(1); }

    /// The h below which lies the share u of the half vectors of this azimuth.
    Vec3<R> half_vector(Vec2<R> phi, R u) const {
        const R log_cos = std::log1p(-u) / power(phi);
        const R sine = safe_sqrt(-std::expm1(R(2) * log_cos));
        return {sine * phi.x, sine * phi.y, std::exp(log_cos)};
    }

    R share_within(Vec2<R> phi, R theta) const {
        return -std::expm1(power(phi) * std::log(std::cos(theta)));
    }

 private:
    /// log(h_z) / s for unit h: -1/2 at the pole.
    static R half_log_over(R s, R h_z) {
        if (s < R(1e-3)) return R(-0.5) * (R(1) + s * (R(0.5) + s * (R(1) / R(3) + s * R(0.25))));
        return (s < R(0.5) ? R(0.5) * std::log1p(-s) : std::log(h_z)) / s;
    }
};

/// The inverse of alpha_from_exponent, within the range of exponents.
inline double exponent_of_alpha(double alpha) {
    const double n = 2.0 / std::max(alpha * alpha, 1e-30) - 2.0;
    return std::clamp(n, 0.0, kMaxLobeExponent);
}

}  // namespace matiere
