// A reflecting microfacet surface with a Fresnel term: the lobe that several models share. Value,
// density and sample follow one rule for the smooth limit, where the lobe is a delta.
#pragma once

#include <optional>

#include "material/bsdf.h"
#include "material/half_vector.h"
#include "optics/fresnel_term.h"
#include "optics/microfacet.h"

namespace matiere {

template <class R>
struct MicrofacetLobe {
    Microfacet<R> surface;
    FresnelTerm<R> fresnel;

    bool is_delta() const { return surface.is_delta(); }
    std::uint8_t lobe() const {
        return std::uint8_t((is_delta() ? kSpecular : kGlossy) | kReflection);
    }

    /// f cos and pdf: f = F D G2 / (4 cos_o cos_i) (Torrance & Sparrow 1967).
    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        if (is_delta() || !(wo.z > R(0)) || !(wi.z > R(0))) return {};
        const auto half = HalfVector<R>::between(wo, wi);
        if (!(half.oh > R(0))) return {};
        const R D = surface.D(half.h);
        const auto r = surface.reflection(wo, wi, half.h);
        return {fresnel(half.oh, half.versed) * (D * r.visibility), D * r.density};
    }

    /// Weight F G2 / G1, at most 1; nothing where the reflected direction is below the horizon.
    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        if (is_delta()) return BsdfSample<R>{{-wo.x, -wo.y, wo.z}, fresnel(wo.z), R(1), lobe()};
        const Vec3<R> h = surface.sample_for_reflection(wo, u);
        const R oh = dot(wo, h);
        if (!(oh > R(0))) return {};
        const Vec3<R> wi = reflect(wo, h);
        if (!(wi.z > R(0))) return {};
        const auto r = surface.reflection(wo, wi, h);
        const R versed = HalfVector<R>::versed_between(wo, wi, oh);
        return BsdfSample<R>{wi, fresnel(oh, versed) * r.weight, surface.D(h) * r.density, lobe()};
    }
};

}  // namespace matiere
