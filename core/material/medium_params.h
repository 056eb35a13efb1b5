// The parameters of what fills a closed shape, shared by every model that bounds a medium: how much
// it absorbs and scatters per metre, stated in one of several ways.
#pragma once

#include "material/param.h"
#include "optics/absorption.h"
#include "optics/phase.h"

namespace matiere {

/// The medium inside an interface.
template <class R>
struct Interior {
    Spectrum<R> eta{R(1)};         ///< per lane; unequal: the medium disperses light
    Spectrum<R> sigma_a, sigma_s;  ///< absorption and scattering [1/m]
    R g{};                         ///< mean cosine of scattering
    bool matched = false;          ///< has no index of its own but that of what surrounds it
};

template <class R>
struct MediumParams {
    Value<Spectrum<R>> sigma_a, transmittance, attenuation_per_metre;
    Value<Spectrum<R>> sigma_s, scattering_albedo, mean_free_path;
    Value<R> at_distance, g;

    /// Densest and thinnest medium whose distances float can tell apart.
    static constexpr double kDensest = 1e12;

    /// Rows for a parameter struct P that derives from this one.
    template <class P>
    static constexpr auto absorption_rows() {
        return std::array{
            color<P, R>("sigma_a", &P::sigma_a, "Absorption coefficient of the interior.")
                .range(0, kUnlimited)
                .initially(0)
                .unit("1/m")
                .constant_only(),
            color<P, R>("transmittance", &P::transmittance,
                        "Share of light left after at_distance, without scattering.")
                .range(0, 1)
                .constant_only(),
            scalar<P, R>("at_distance", &P::at_distance, "Way after which transmittance is left.")
                .above(0, kUnlimited)
                .unit("m")
                .constant_only(),
            color<P, R>(
                "attenuation_per_metre", &P::attenuation_per_metre,
                "Factor a of the law a^d: what light is multiplied by in each metre, without "
                "scattering.")
                .range(0, 1)
                .unit("1/m")
                .constant_only()};
    }
    template <class P>
    static constexpr auto scattering_rows() {
        return std::array{
            color<P, R>("sigma_s", &P::sigma_s, "Scattering coefficient of the interior.")
                .range(0, kDensest)
                .initially(0)
                .unit("1/m")
                .constant_only(),
            color<P, R>("scattering_albedo", &P::scattering_albedo,
                        "Instead of both coefficients: share of light that goes on where the "
                        "interior scatters it, sigma_s / (sigma_a + sigma_s).")
                .range(0, 1)
                .constant_only(),
            color<P, R>("mean_free_path", &P::mean_free_path,
                        "Mean way between two events inside, 1 / (sigma_a + sigma_s).")
                .range(1 / kDensest, kDensest)
                .unit("m")
                .constant_only(),
            scalar<P, R>("g", &P::g,
                         "Mean cosine of scattering inside (Henyey-Greenstein): 0 even, towards 1 "
                         "forward, towards -1 back.")
                .range(-kMaxPhaseG, kMaxPhaseG)
                .initially(0)
                .constant_only()};
    }
    static constexpr auto rules() {
        return std::array{
            exclusive("sigma_a", "transmittance", "attenuation_per_metre", "scattering_albedo"),
            exclusive("sigma_s", "scattering_albedo"), together("transmittance", "at_distance"),
            together("scattering_albedo", "mean_free_path")};
    }

    /// Any of the parameters is given.
    bool given() const {
        return sigma_a.given || transmittance.given || attenuation_per_metre.given ||
               sigma_s.given || scattering_albedo.given;
    }
    Interior<R> interior(const Spectrum<R>& eta) const {
        Interior<R> inside{eta, absorption(), sigma_s.v, g.v, false};
        if (scattering_albedo.given)
            for (int i = 0; i < kActiveLanes; ++i) {
                inside.sigma_s[i] = scattering_albedo.v[i] / mean_free_path.v[i];
                inside.sigma_a[i] = (R(1) - scattering_albedo.v[i]) / mean_free_path.v[i];
            }
        return inside;
    }

 private:
    Spectrum<R> absorption() const {
        if (transmittance.given) return sigma_a_from_transmittance(transmittance.v, at_distance.v);
        if (attenuation_per_metre.given)
            return sigma_a_from_transmittance(attenuation_per_metre.v, R(1));
        return sigma_a.v;
    }
};

}  // namespace matiere
