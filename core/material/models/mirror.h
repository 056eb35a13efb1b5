// Ideal mirror: one reflected direction, weighted by Fresnel reflectance. With F0 measured the
// angular rise is Schlick's (1994); with eta, or on request, it is the exact dielectric one, the
// index then being the one whose normal reflectance is F0 (Cook & Torrance 1982, section 5).
// What is refracted is absorbed. For metals given by eta and k use `conductor` with alpha 0.
#pragma once

#include "material/model.h"
#include "optics/fresnel.h"

namespace matiere {

template <class R>
struct Mirror {
    static constexpr std::string_view kName = "mirror";
    static constexpr std::string_view kDoc = "Ideal mirror with Fresnel reflectance.";
    static constexpr std::string_view kSource =
        "Schlick 1994, eq. 15; Cook & Torrance 1982, sec. 5";
    static constexpr std::uint32_t kFeatures = kFeatureReflection | kFeatureDelta;

    enum Fresnel { kSchlick, kExact };
    static constexpr std::array<std::string_view, 2> kFresnelNames{"schlick", "exact"};

    struct Params {
        Value<Spectrum<R>> F0, eta;
        Value<int> fresnel;

        static constexpr auto table() {
            return std::array{
                color("F0", &Params::F0, "Reflectance at normal incidence.")
                    .range(0, 1)
                    .initially(1),
                color("eta", &Params::eta, "Index of refraction; F0 = ((eta-1)/(eta+1))^2.")
                    .above(0, 1000),
                choice<Params, R>(
                    "fresnel", &Params::fresnel, kFresnelNames,
                    "Rise towards grazing; by default schlick with F0, exact with eta.")};
        }
        static constexpr std::array<Rule, 1> rules() { return {exclusive("F0", "eta")}; }
    };

    Spectrum<R> F0;
    Spectrum<R> eta;
    bool exact = false;

    static Mirror prepare(const Params& p) {
        Mirror m;
        m.exact = p.fresnel.given ? p.fresnel.v == kExact : p.eta.given;
        m.F0 = p.eta.given ? p.eta.v.map([](R n) { return F0_from_eta(n); }) : p.F0.v;
        m.eta = p.eta.given ? p.eta.v : p.F0.v.map([](R f) { return eta_from_F0(f); });
        return m;
    }

    Spectrum<R> reflectance(R cos_theta) const {
        if (!exact) return fresnel_schlick(cos_theta, F0);
        const auto F = [cos_theta](R n) {
            return std::isinf(n) ? R(1) : fresnel_dielectric(cos_theta, n).reflectance;
        };
        return eta.map(F);
    }

    std::uint8_t lobes() const { return kSpecular | kReflection; }

    BsdfEval<R> eval(Vec3<R>, Vec3<R>) const { return {}; }

    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R>) const {
        return BsdfSample<R>{
            {-wo.x, -wo.y, wo.z}, reflectance(wo.z), R(1), kSpecular | kReflection};
    }
};

}  // namespace matiere
