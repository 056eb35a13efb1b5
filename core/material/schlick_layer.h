// One layer of Schlick's model of 1994: a Fresnel reflectance S(u) = C + (1 - C)(1 - u)^5 over a
// blend of a diffuse, a glossy and a mirror part, made from one roughness r in [0, 1] and one
// isotropy p in (0, 1]:
//   g = 4 r (1 - r);   r < 1/2: glossy g, mirror 1 - g;   r >= 1/2: glossy g, diffuse 1 - g
// The glossy part has Z(t) = r / (1 + r t^2 - t^2)^2, which is GGX of alpha^2 = r, and
// A(w) = sqrt(p / (p^2 - p^2 w^2 + w^2)), w the cosine between projected half vector and tangent:
// p < 1 are scratches along the tangent, which stretch the highlight across them.
#pragma once

#include "material/half_vector_lobe.h"
#include "optics/microfacet.h"

namespace matiere {

enum class SchlickVariant : unsigned char { kGgx, kSchlick94 };
inline constexpr std::array<std::string_view, 2> kSchlickVariantNames{"ggx", "schlick94"};

/// The glossy part as published, but bounded: Z A m(o) m(i) / (4 pi n.o n.i) with m the smaller of
/// Schlick's G(v) = v / (r - r v + v) and Smith's masking of GGX, which G exceeds at grazing. The
/// azimuth is drawn from A^2 / (2 pi), which unlike A is normalised; the weight makes up for it.
template <class R>
struct Schlick94Shape {
    R r{R(1)}, p{R(1)};

    static constexpr bool is_delta() { return false; }
    static constexpr R cosine_share() { return R(0); }

    /// Z t A^2 / pi
    R density(Vec3<R> h) const {
        const R s2 = h.x * h.x + h.y * h.y;
        const R d = r * h.z * h.z + s2;
        return r / d / d * h.z * squared_A(h, s2) * kInvPi<R>;
    }
    Vec3<R> sample(R u1, R u2) const {
        const R phi = kTwoPi<R> * u1;
        const R x = p * std::sin(phi), y = std::cos(phi);
        const R rest = R(1) - u2;  // share of half vectors farther from the normal
        const R scale = R(1) / std::sqrt(r * u2 + rest);
        const R sine = std::sqrt(r * u2) * scale / std::sqrt(x * x + y * y);
        return {sine * x, sine * y, std::sqrt(rest) * scale};
    }
    R weight(Vec3<R> wo, Vec3<R> wi, const HalfVector<R>& half) const {
        const Vec3<R> h = half.h;
        const R A = std::sqrt(squared_A(h, h.x * h.x + h.y * h.y));
        return mask_over_cos(wo.z) * mask_over_cos(wi.z) * wi.z * half.oh / (A * h.z);
    }

 private:
    R squared_A(Vec3<R> h, R s2) const {
        return s2 > R(0) ? p * s2 / (p * p * h.y * h.y + h.x * h.x) : R(1);
    }
    R mask_over_cos(R v) const {
        return std::min(R(1) / (r * (R(1) - v) + v),
                        R(2) / (v + std::sqrt(r * (R(1) - v) * (R(1) + v) + v * v)));
    }
};

template <class R>
struct SchlickLayer {
    FresnelTerm<R> fresnel;
    R diffuse{}, glossy{}, mirror{};  ///< shares, together 1
    Microfacet<R> facets;             ///< of the variant ggx
    Schlick94Shape<R> shape;          ///< of the variant schlick94
    SchlickVariant variant{};

    /// p is held where its square leaves float.
    static constexpr double kSmallestP = 1e-30;

    /// Widths along and across the tangent of the elliptic GGX whose azimuths follow A^2.
    static Vec2<R> widths(R r, R p) {
        p = std::max(p, R(kSmallestP));
        return {std::sqrt(r * p), std::sqrt(r / p)};
    }

    static SchlickLayer make(const Spectrum<R>& C, R r, R p, SchlickVariant variant) {
        SchlickLayer layer;
        layer.fresnel = FresnelTerm<R>::schlick(C);
        layer.variant = variant;
        const R g = R(4) * r * (R(1) - r);
        const Vec2<R> a = widths(r, p);
        const bool sharp = is_delta_alpha(a.x, a.y);
        layer.glossy = sharp ? R(0) : g;
        // (1 - 2r)^2 = 1 - g without the difference; a lobe too narrow for float joins the mirror.
        (r < R(0.5) ? layer.mirror : layer.diffuse) = sqr(R(1) - R(2) * r) + (sharp ? g : R(0));
        layer.facets = Microfacet<R>::make(a.x, a.y, Distribution::kGgx, Masking::kSmith);
        layer.shape = {r, std::max(p, R(kSmallestP))};
        return layer;
    }

    /// f cos of the glossy part without S, and its density.
    struct Glossy {
        R value{}, pdf{};
    };
    Glossy eval_glossy(Vec3<R> wo, Vec3<R> wi, const HalfVector<R>& half) const {
        if (variant == SchlickVariant::kSchlick94) {
            const R reflected = shape.density(half.h) / (R(4) * half.oh);
            return {reflected * shape.weight(wo, wi, half), reflected};
        }
        const R D = facets.D(half.h);
        const auto reflection = facets.reflection(wo, wi, half.h);
        return {D * reflection.visibility, D * reflection.density};
    }
    Vec3<R> sample_glossy(Vec3<R> wo, Vec3<R> u) const {
        return variant == SchlickVariant::kSchlick94 ? shape.sample(u.y, u.z)
                                                     : facets.sample_for_reflection(wo, u);
    }
};

}  // namespace matiere
