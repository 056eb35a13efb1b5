// A Fresnel surface over a diffuse body, energy conserving: what the surface does not reflect, by
// its directional albedo E, reaches the body; what leaves the body crosses the surface again.
//
//   f = f_surface + rho (1 - E(i)) (1 - E(o)) / (pi (eta^2 (1 - rho) + rho (1 - E_avg)))
//
// With eta the index of the body's medium this is rho / (pi eta^2 (1 - rho F_in)), F_in =
// 1 - (1 - E_avg) / eta^2 the internal reflectance, all internal bounces summed (Weidlich & Wilkie
// 2007 in its corrected closed form; Kulla & Conty 2017 for the rough E). rho = 1 gives albedo 1.
// The surface may be any lobe that knows its value, samples and Fresnel term.
#pragma once

#include <optional>

#include "material/coat_albedo.h"
#include "material/microfacet_lobe.h"
#include "sampling/warp.h"

namespace matiere {

/// Keeps 0/0 away where a surface reflects everything and its body never shows.
inline constexpr double kMinBodyDenominator = 1e-7;

/// Largest share of samples for a coat over a body that shows at all.
inline constexpr double kMostCoat = 0.99;

/// How a diffuse body goes with the lobe above it.
enum class Coupling : unsigned char {
    kEnergy,  ///< by the directional albedo, as above
    kAdd,     ///< added as it is: the material refuses what could gain energy
    kPaper,   ///< the product (1 - (1 - c/2)^5) of Ashikhmin & Shirley 2000
};
inline constexpr std::array<std::string_view, 3> kCouplingNames{"energy", "add", "paper"};

template <class R, class Coat = MicrofacetLobe<R>>
struct CoatedDiffuse {
    Coat coat;
    CoatAlbedo<R> albedo;
    Spectrum<R> body;  ///< rho / (eta^2 (1 - rho) + rho (1 - E_avg)); black: no body
    R body_share{};    ///< mean over channels of body (1 - E_avg)
    Coupling coupling = Coupling::kEnergy;

    static CoatedDiffuse make(const Coat& coat, const CoatAlbedo<R>& albedo, const Spectrum<R>& rho,
                              R eta2) {
        CoatedDiffuse m{coat, albedo, {}, R(0)};
        if (rho.is_black()) return m;
        const Spectrum<R> through = Spectrum<R>(R(1)) - albedo.average(coat.fresnel);
        for (int i = 0; i < kActiveLanes; ++i) {
            const R denominator = eta2 * (R(1) - rho[i]) + rho[i] * through[i];
            m.body[i] = rho[i] / std::max(denominator, R(kMinBodyDenominator));
        }
        m.body_share = (m.body * through).average();
        return m;
    }

    /// A body scaled by what the coupling lets through, without light between it and the coat: for
    /// couplings that are not by energy, and under coats that gain energy themselves.
    static CoatedDiffuse uncoupled(const Coat& coat, const CoatAlbedo<R>& albedo,
                                   const Spectrum<R>& rho, Coupling coupling) {
        return {coat, albedo, rho, rho.average(), coupling};
    }

    bool has_body() const { return !body.is_black(); }

    std::uint8_t lobes() const { return std::uint8_t(coat.lobe() | (has_body() ? kDiffuse : 0)); }

    /// Share of light that passes between w and the body; E is the coat's albedo at w.
    Spectrum<R> through(Vec3<R> w, const Spectrum<R>& E) const {
        if (coupling == Coupling::kEnergy) return Spectrum<R>(R(1)) - E;
        if (coupling == Coupling::kAdd) return Spectrum<R>(R(1));
        const R x = R(0.5) * w.z;  // 1 - (1 - x)^5 without the difference
        return Spectrum<R>(x * (R(5) - x * (R(10) - x * (R(10) - x * (R(5) - x)))));
    }

    /// Probability of sampling the coat: its share of the light that wo sees, E_o its albedo there.
    R coat_probability(const Spectrum<R>& E_o, const Spectrum<R>& through_o) const {
        const R surface = E_o.average();
        const R below = through_o.average() * body_share;
        if (!(below > R(0))) return R(1);
        return std::min(surface / (surface + below), R(kMostCoat));
    }

    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        if (!has_body()) return coat.eval(wo, wi);
        if (!(wo.z > R(0)) || !(wi.z > R(0))) return {};
        const Spectrum<R> E_o = albedo(wo, coat.fresnel);
        return mixed(coat.eval(wo, wi), wo, E_o, wi);
    }

    /// The body's part of f cos.
    Spectrum<R> diffuse(Vec3<R> wo, Vec3<R> wi) const {
        if (!has_body() || !(wo.z > R(0)) || !(wi.z > R(0))) return {};
        return body * through(wo) * through(wi) * cosine_hemisphere_pdf(wi.z);
    }

    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        if (!has_body()) return coat.sample(wo, u);
        const Spectrum<R> E_o = albedo(wo, coat.fresnel);
        const R p = coat_probability(E_o, through(wo, E_o));
        if (u.x < p) {
            u.x = std::min(u.x / p, kOneMinusEpsilon<R>);
            auto s = coat.sample(wo, u);
            if (!s) return {};
            if (coat.is_delta()) {
                s->weight *= R(1) / p;
                s->pdf = p;
                return s;
            }
            return finish(*s, mixed({s->weight * s->pdf, s->pdf}, wo, E_o, s->wi));
        }
        const Vec3<R> wi = square_to_cosine_hemisphere(u.y, u.z);
        if (!(wi.z > R(0))) return {};
        return finish({wi, {}, R(0), kDiffuse | kReflection},
                      mixed(coat.eval(wo, wi), wo, E_o, wi));
    }

 private:
    Spectrum<R> through(Vec3<R> w) const {
        return through(w, coupling == Coupling::kEnergy ? albedo(w, coat.fresnel) : Spectrum<R>());
    }

    BsdfEval<R> mixed(BsdfEval<R> surface, Vec3<R> wo, const Spectrum<R>& E_o, Vec3<R> wi) const {
        const Spectrum<R> through_o = through(wo, E_o);
        const R p = coat_probability(E_o, through_o);
        const R cosine = cosine_hemisphere_pdf(wi.z);
        surface.f += body * through_o * through(wi) * cosine;
        surface.pdf = p * surface.pdf + (R(1) - p) * cosine;
        return surface;
    }
};

}  // namespace matiere
