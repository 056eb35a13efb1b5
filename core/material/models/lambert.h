// Ideal diffuse reflection (Lambert 1760): f = albedo / pi for every pair of directions above the
// surface. Reciprocal; directional albedo = albedo at every angle. Valid for albedo in [0, 1].
#pragma once

#include "material/model.h"
#include "sampling/warp.h"

namespace matiere {

template <class R>
struct Lambert {
    static constexpr std::string_view kName = "lambert";
    static constexpr std::string_view kDoc = "Ideal diffuse reflection.";
    static constexpr std::string_view kSource = "Lambert, Photometria, 1760";
    static constexpr std::uint32_t kFeatures = kFeatureReflection;

    struct Params {
        Value<Spectrum<R>> albedo;

        static constexpr auto table() {
            return std::array{
                color("albedo", &Params::albedo, "Share of light reflected, per channel.")
                    .range(0, 1)
                    .initially(0.5)};
        }
        static constexpr std::array<Rule, 0> rules() { return {}; }
    };

    Spectrum<R> albedo;

    static Lambert prepare(const Params& p) { return {p.albedo.v}; }

    std::uint8_t lobes() const { return kDiffuse | kReflection; }

    BsdfEval<R> eval(Vec3<R>, Vec3<R> wi) const {
        if (!(wi.z > R(0))) return {};
        const R pdf = cosine_hemisphere_pdf(wi.z);
        return {albedo * pdf, pdf};
    }

    std::optional<BsdfSample<R>> sample(Vec3<R>, Vec3<R> u) const {
        const Vec3<R> wi = square_to_cosine_hemisphere(u.y, u.z);
        if (!(wi.z > R(0))) return {};
        return BsdfSample<R>{wi, albedo, cosine_hemisphere_pdf(wi.z), kDiffuse | kReflection};
    }
};

}  // namespace matiere
