// Microfacet surfaces: distribution of normals D, masking and shadowing G, and sampling of the
// normals that a viewer sees.
//
// Sources: Walter, Marschner, Li, Torrance 2007 (GGX, Beckmann); Cook & Torrance 1982 (V-cavity);
// Heitz 2014 (Smith); Heitz & d'Eon 2014 (visible normals); Dupuy & Benyoub 2023 (spherical caps);
// Eto & Tokuyoshi 2023 (bounded caps). D obeys: integral of D(h) cos(h) over the hemisphere = 1.
// `blinn_phong` is D = (m + 2) / (2 pi) cos^m with m = 2 / alpha^2 - 2, isotropic (phong_slopes.h).
// `ward` is the exponential of Ward 1992 with the normalisation that makes it a distribution:
// exactly the anisotropic Beckmann.
//
// Everything is written with sigma(w) = |cos| (1 + Lambda(w)), the projected area of the facets
// visible from w: it stays finite at grazing, where G1 and 1/cos do not. Directions may lie on
// either side; |w.z| counts.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <string_view>

#include "base/numeric.h"
#include "base/vec.h"
#include "optics/beckmann_slopes.h"
#include "optics/phong_slopes.h"
#include "optics/roughness.h"

namespace matiere {

enum class Distribution : unsigned char { kGgx, kBeckmann, kWard, kBlinnPhong };
inline constexpr std::array<std::string_view, 4> kDistributionNames{"ggx", "beckmann", "ward",
                                                                    "blinn_phong"};

enum class Masking : unsigned char { kSmith, kSmithSeparable, kVCavity };
inline constexpr std::array<std::string_view, 3> kMaskingNames{"smith", "smith_separable",
                                                               "v_cavity"};

template <class R>
struct Microfacet {
    R alpha_x{}, alpha_y{};
    Distribution distribution = Distribution::kGgx;
    Masking masking = Masking::kSmith;
    PhongSlopes<R> phong{};  ///< of Blinn-Phong only

    /// One axis may not be a delta alone: it is held at the smallest width that float carries.
    static Microfacet make(R alpha_x, R alpha_y, Distribution d, Masking m) {
        if (!is_delta_alpha(alpha_x, alpha_y)) {
            alpha_x = std::max(alpha_x, R(kDeltaAlpha));
            alpha_y = std::max(alpha_y, R(kDeltaAlpha));
        }
        if (d == Distribution::kWard) d = Distribution::kBeckmann;
        if (d != Distribution::kBlinnPhong || !(alpha_x > R(0))) return {alpha_x, alpha_y, d, m};
        return {alpha_x, alpha_y, d, m, PhongSlopes<R>::make(2.0 / sqr(double(alpha_x)))};
    }

    bool is_delta() const { return is_delta_alpha(alpha_x, alpha_y); }
    bool is_anisotropic() const { return alpha_x != alpha_y; }

    /// Density of facet normals per projected area [1/sr], h.z > 0.
    R D(Vec3<R> h) const {
        if (distribution == Distribution::kBlinnPhong) return phong_D(h);
        const R x = h.x / alpha_x;
        const R y = h.y / alpha_y;
        const R z2 = h.z * h.z;
        const R area = kPi<R> * alpha_x * alpha_y;
        if (distribution == Distribution::kGgx) {
            const R d = x * x + y * y + z2;
            return R(1) / (area * d * d);
        }
        const R tan2 = (x * x + y * y) / z2;
        if (!(tan2 < R(kExpUnderflow))) return R(0);
        return std::exp(-tan2) / (area * z2 * z2);
    }

    /// Projected area of the facets visible from w, for Smith masking.
    R sigma(Vec3<R> w) const {
        const R z = std::abs(w.z);
        if (distribution == Distribution::kBlinnPhong)
            return phong.sigma(z, std::sqrt(w.x * w.x + w.y * w.y));
        const R s = std::sqrt(sqr(alpha_x * w.x) + sqr(alpha_y * w.y));
        if (distribution == Distribution::kGgx) return R(0.5) * (z + std::sqrt(s * s + z * z));
        if (!(s > R(0))) return z;
        const R a = z / s;
        constexpr R kInvSqrtPi = R(0.564189583547756286948);
        return R(0.5) * (z * (R(1) + std::erf(a)) + s * kInvSqrtPi * std::exp(-a * a));
    }

    /// Share of the facets of normal h that w sees.
    R G1(Vec3<R> w, Vec3<R> h) const {
        const R z = std::abs(w.z);
        if (masking != Masking::kVCavity) return z / sigma(w);
        return std::min(R(1), R(2) * h.z * z / std::abs(dot(w, h)));
    }

    /// What a reflection needs beside D and F. f cos = F D visibility, pdf = D density and weight =
    /// visibility / density, with what they share cancelled: all stay finite at grazing.
    struct Reflection {
        R visibility{};  ///< G2 / (4 |o.z|)
        R density{};     ///< of the sampled direction, over D(h)
        R weight{};      ///< of a sample before F; at most 1
    };

    /// For directions of sample_for_reflection, or (bounded = false) of sample_visible.
    Reflection reflection(Vec3<R> o, Vec3<R> i, Vec3<R> h, bool bounded = true) const {
        if (masking == Masking::kVCavity) {
            const R per_cos = R(2) * h.z / dot(o, h);
            const R both = std::min(R(1), per_cos * std::min(o.z, i.z));
            const R seen = std::min(R(1), per_cos * o.z);
            return {R(0.25) * both / o.z, std::min(R(0.25) / o.z, R(0.25) * per_cos), both / seen};
        }
        const R sigma_o = sigma(o);
        const R sigma_i = sigma(i);
        const R shadowed = masking == Masking::kSmithSeparable
                               ? sigma_i * sigma_o
                               : sigma_i * o.z + (sigma_o - o.z) * i.z;
        // Of the caps: sigma_o with k |o.z| for |o.z|.
        const R area = bounded && distribution == Distribution::kGgx
                           ? sigma_o - R(0.5) * (R(1) - cap_bound(o)) * o.z
                           : sigma_o;
        return {R(0.25) * i.z / shadowed, R(0.25) / area, i.z * (area / shadowed)};
    }

    /// Density of the visible normals of o over D(h): pdf_h = D * this.
    R visible_over_D(Vec3<R> o, Vec3<R> h) const {
        const R oh = std::max(dot(o, h), R(0));
        if (masking == Masking::kVCavity) return std::min(oh / o.z, R(2) * h.z);
        return oh / sigma(o);
    }

    /// A normal, and what is left of u.x for a further choice.
    struct VisibleNormal {
        Vec3<R> h;
        R u{};
    };

    /// A normal that o sees; u.x picks between the two sides of a V-cavity only.
    VisibleNormal sample_visible(Vec3<R> o, Vec3<R> u) const {
        if (masking == Masking::kVCavity) return sample_cavity(o, u);
        if (distribution == Distribution::kGgx) return {sample_ggx(o, u.y, u.z, R(1)), u.x};
        if (distribution == Distribution::kBlinnPhong) return {sample_phong(o, u.y, u.z), u.x};
        return {sample_beckmann(o, u.y, u.z), u.x};
    }

    /// Factor k of the bounded caps: reflections of the caps of height 1 + k z cover the hemisphere
    /// with fewer below the horizon. 1 where the form does not apply.
    R cap_bound(Vec3<R> o) const {
        if (distribution != Distribution::kGgx || masking == Masking::kVCavity) return R(1);
        const R a = std::min({alpha_x, alpha_y, R(1)});
        const R s2 = sqr(R(1) + std::sqrt(o.x * o.x + o.y * o.y));
        const R a2 = a * a;
        return (R(1) - a2) * s2 / (s2 + a2 * o.z * o.z);
    }

    /// As sample_visible, but for reflections only (bounded caps where they apply).
    Vec3<R> sample_for_reflection(Vec3<R> o, Vec3<R> u) const {
        if (distribution == Distribution::kGgx && masking != Masking::kVCavity)
            return sample_ggx(o, u.y, u.z, cap_bound(o));
        return sample_visible(o, u).h;
    }

    /// G2 / G1(o) for a transmission to i on the other side.
    R transmission_weight(Vec3<R> o, Vec3<R> i, Vec3<R> h) const {
        if (masking == Masking::kVCavity) {
            const R g = G1(o, h);
            return g > R(0) ? std::max(R(0), g + G1(i, h) - R(1)) / g : R(0);
        }
        const R z = std::abs(i.z);
        if (masking == Masking::kSmithSeparable || z == R(0)) return z / sigma(i);
        // Heitz et al. 2016: Beta(1 + Lambda_o, 1 + Lambda_i), here times 1 + Lambda_o.
        const double a = double(sigma(o)) / double(std::abs(o.z));
        const double b = double(sigma(i)) / double(z);
        return R(a * std::exp(std::lgamma(a) + std::lgamma(b) - std::lgamma(a + b)));
    }

 private:
    /// exp(-x) is below the smallest normal number for x above this.
    static constexpr double kExpUnderflow = sizeof(R) == sizeof(float) ? 87.0 : 708.0;

    R phong_D(Vec3<R> h) const {
        const R exponent = R(0.5) * phong.nu - R(1);
        const R x =
            exponent > R(0) ? exponent * std::log1p((h.x * h.x + h.y * h.y) / (h.z * h.z)) : R(0);
        // With room for the small factors that make a value of D.
        if (!(x < R(kExpUnderflow - 10.0))) return R(0);
        return phong.nu * (kInvPi<R> / R(2)) * std::exp(-x);
    }

    /// Slope over alpha of a facet drawn from D cos, beyond which the share `tail` lies.
    R cavity_slope(R tail, R u) const {
        if (distribution == Distribution::kGgx) return std::sqrt(u / tail);
        if (distribution == Distribution::kBeckmann) return std::sqrt(-std::log(tail));
        return std::sqrt(std::expm1(R(-2) / phong.nu * std::log(tail))) / alpha_x;
    }

    Vec3<R> unstretch(Vec3<R> v) const {
        return normalize(Vec3<R>{alpha_x * v.x, alpha_y * v.y, std::max(v.z, R(0))});
    }

    Vec3<R> sample_ggx(Vec3<R> o, R u1, R u2, R k) const {
        const Vec3<R> v = normalize(Vec3<R>{alpha_x * o.x, alpha_y * o.y, o.z});
        // The cap reaches from z = 1 down to z = -bottom; 1 - z, 1 + z and z + v.z are written
        // without differences of close numbers.
        const R bottom = k * v.z;
        const R below = u2 * (R(1) + bottom);           // 1 - z
        const R above = (R(1) - u2) * (R(1) + bottom);  // z + bottom
        const R r = safe_sqrt(below * (above + (R(1) - bottom)));
        const R phi = kTwoPi<R> * u1;
        return unstretch(
            {r * std::cos(phi) + v.x, r * std::sin(phi) + v.y, above + v.z * (R(1) - k)});
    }

    Vec3<R> sample_beckmann(Vec3<R> o, R u1, R u2) const {
        const Vec3<R> v{alpha_x * o.x, alpha_y * o.y, o.z};
        const R s = std::sqrt(v.x * v.x + v.y * v.y);
        // Slopes along and across the view, in the stretched space of unit roughness.
        const R along = s > R(0) ? sample_beckmann_slope(v.z / s, u1) : erf_inv(R(2) * u1 - R(1));
        const R across = erf_inv(R(2) * u2 - R(1));
        const R c = s > R(0) ? v.x / s : R(1);
        const R d = s > R(0) ? v.y / s : R(0);
        // A facet of slope x along the view leans away from it: its normal is (-x, -y, 1).
        const R x = c * along - d * across;
        const R y = d * along + c * across;
        return normalize(Vec3<R>{-alpha_x * x, -alpha_y * y, R(1)});
    }

    Vec3<R> sample_phong(Vec3<R> o, R u1, R u2) const {
        const R s = std::sqrt(o.x * o.x + o.y * o.y);
        const R along = phong.sample_along(o.z, s, u1);
        const R across = phong.across().sample_symmetric(u2);
        const R c = s > R(0) ? o.x / s : R(1);
        const R d = s > R(0) ? o.y / s : R(0);
        // Slopes (tan along, tan across / cos along), whose normal leans the other way.
        const R x = -std::sin(along) * std::cos(across);
        const R y = -std::sin(across);
        return normalize(Vec3<R>{c * x - d * y, d * x + c * y, std::cos(along) * std::cos(across)});
    }

    /// h from D cos, or its mirror image across the cavity, in proportion to what o sees of both.
    VisibleNormal sample_cavity(Vec3<R> o, Vec3<R> u) const {
        const R tail = R(1) - u.z;
        const R r = cavity_slope(tail, u.z);
        const R phi = kTwoPi<R> * u.y;
        const Vec3<R> h =
            normalize(Vec3<R>{alpha_x * r * std::cos(phi), alpha_y * r * std::sin(phi), R(1)});
        const Vec3<R> mirrored{-h.x, -h.y, h.z};
        const R seen = std::max(dot(o, h), R(0));
        const R seen_mirrored = std::max(dot(o, mirrored), R(0));
        const R q = seen_mirrored / (seen + seen_mirrored);
        if (u.x < q) return {mirrored, std::min(u.x / q, kOneMinusEpsilon<R>)};
        return {h, q < R(1) ? std::min((u.x - q) / (R(1) - q), kOneMinusEpsilon<R>) : u.x};
    }
};

/// The mirror image of o about h.
template <class R>
inline Vec3<R> reflect(Vec3<R> o, Vec3<R> h) {
    return h * (R(2) * dot(o, h)) - o;
}

}  // namespace matiere
