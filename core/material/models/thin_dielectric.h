// A sheet of clear or tinted glass much thinner than the scene: light leaves where it entered, in
// the mirrored or the same direction, after any number of reflections inside. With F the exact
// Fresnel reflectance of one face and t the share that one crossing leaves,
//
//   R = F + (1-F)^2 F t^2 / (1 - F^2 t^2),   T = (1-F)^2 t / (1 - F^2 t^2)
//
// (Stokes 1862, "On the intensity of the light reflected from or transmitted through a pile of
// plates"). The way through the sheet grows with the angle inside: t = transmittance^(1/cos_t).
// Left out: interference, and the sideways shift of the refracted ray. Smooth only. The two faces
// see the same sheet, so there is no inside and no refraction.
#pragma once

#include "material/model.h"
#include "optics/fresnel.h"

namespace matiere {

template <class R>
struct ThinDielectric {
    static constexpr std::string_view kName = "thin_dielectric";
    static constexpr std::string_view kDoc =
        "Thin sheet of glass: all internal reflections, no refraction.";
    static constexpr std::string_view kSource = "Stokes 1862; Fresnel; Beer-Lambert";
    static constexpr std::uint32_t kFeatures =
        kFeatureReflection | kFeatureTransmission | kFeatureDelta;

    struct Params {
        Value<Spectrum<R>> eta, transmittance;

        static constexpr auto table() {
            return std::array{
                color("eta", &Params::eta, "Index of refraction of the sheet.")
                    .above(0, 1000)
                    .initially(1.5),
                color("transmittance", &Params::transmittance,
                      "Share of light left after one crossing straight through, without the faces.")
                    .range(0, 1)
                    .initially(1)};
        }
        static constexpr std::array<Rule, 0> rules() { return {}; }
    };

    Spectrum<R> eta, transmittance;

    static ThinDielectric prepare(const Params& p) { return {p.eta.v, p.transmittance.v}; }

    std::uint8_t lobes() const { return kSpecular | kReflection | kTransmission; }

    BsdfEval<R> eval(Vec3<R>, Vec3<R>) const { return {}; }

    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        Spectrum<R> reflected, passed;
        for (int i = 0; i < kActiveLanes; ++i) {
            const Share s = shares(wo.z, i);
            reflected[i] = s.reflected;
            passed[i] = s.passed;
        }
        const R r = reflected.average();
        const R t = passed.average();
        if (!(r + t > R(0))) return {};
        const R p = r / (r + t);
        if (u.x < p)
            return BsdfSample<R>{
                {-wo.x, -wo.y, wo.z}, reflected * (R(1) / p), p, kSpecular | kReflection};
        const R q = t / (r + t);
        return BsdfSample<R>{
            {-wo.x, -wo.y, -wo.z}, passed * (R(1) / q), q, kSpecular | kTransmission};
    }

 private:
    struct Share {
        R reflected{}, passed{};
    };

    Share shares(R cos_theta, int lane) const {
        const FresnelTerms<R> F = fresnel_dielectric(cos_theta, eta[lane]);
        // Beyond the critical angle of a sheet thinner than its surroundings nothing passes.
        if (!(F.transmittance > R(0))) return {R(1), R(0)};
        const R t = crossing(transmittance[lane], F.cos_theta_t);
        const R r = F.reflectance * t;
        const R T = F.transmittance;
        // 1 - r^2 = (1 - r)(1 + r), and 1 - r = T + F (1 - t): no difference of close numbers.
        const R rest = (T + F.reflectance * (R(1) - t)) * (R(1) + r);
        return {F.reflectance + T * (T / rest) * r * t, T * (T / rest) * t};
    }

    static R crossing(R straight, R cos_t) {
        if (straight == R(1)) return R(1);
        return straight > R(0) ? std::pow(straight, R(1) / cos_t) : R(0);
    }
};

}  // namespace matiere
