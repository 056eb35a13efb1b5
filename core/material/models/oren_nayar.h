// Rough diffuse reflection, energy preserving (EON): the Oren-Nayar shape of Fujii plus a multiple
// scattering term that returns exactly what the single scattering loses, so that albedo 1 reflects
// everything at every roughness and angle. roughness = 0 is Lambert's law.
// Sources: Portsmouth, Kutz & Hill 2025, "EON: A practical energy-preserving rough diffuse BRDF",
// JCGT 14(1), eqs 5-21 (model) and section 4 (clipped linearly transformed cosines); Oren & Nayar
// 1994. The albedo of single scattering is the exact one, not its polynomial fit. With it
//   1 - E(mu) = A r g(mu),  g = c1 - G / pi,  1 - <E> = A r (c1 - c2),
// written without the differences, so r -> 0 and grazing angles keep their digits.
#pragma once

#include "material/model.h"
#include "sampling/warp.h"

namespace matiere {

/// The clipped linearly transformed cosine that follows EON for one wo, in the frame where wo has
/// azimuth 0, and the share of uniform directions beside it.
template <class R>
struct EonLobe {
    R a, b, c, d;      ///< M = [[a, 0, b], [0, c, 0], [d, 0, 1]]
    R share;           ///< of the lobe above the horizon: its normalisation
    R uniform;         ///< probability of a uniform direction
    R turn_x, turn_y;  ///< azimuth of wo

    static EonLobe make(Vec3<R> wo, R r, R tenth_root_of_r) {
        const R mu = std::min(wo.z, R(1));
        EonLobe t;
        t.a = R(1) + r * (R(0.303392) + (R(-0.518982) + R(0.111709) * mu) * mu +
                          (R(-0.276266) + R(0.335918) * mu) * r);
        t.b = r * (R(-1.16407) + R(1.15859) * mu + (R(0.150815) - R(0.150105) * mu) * r) /
              (mu * mu * mu - R(1.43545));
        t.c = R(1) + (R(0.20013) + (R(-0.506373) + R(0.261777) * mu) * mu) * r;
        t.d = r * (R(0.540852) + (R(-1.01625) + R(0.475392) * mu) * mu) /
              (R(-1.0743) + mu * (R(0.0725628) + mu));
        t.share = R(0.5) * (R(1) + R(1) / std::sqrt(t.d * t.d + R(1)));
        t.uniform = tenth_root_of_r *
                    (R(0.162925) + mu * (R(-0.372058) + (R(0.538233) - R(0.290822) * mu) * mu));
        const R s = std::sqrt(wo.x * wo.x + wo.y * wo.y);
        t.turn_x = s > R(0) ? wo.x / s : R(1);
        t.turn_y = s > R(0) ? wo.y / s : R(0);
        return t;
    }

    R pdf(Vec3<R> wi) const {
        const R x = turn_x * wi.x + turn_y * wi.y;
        const R y = turn_x * wi.y - turn_y * wi.x;
        const Vec3<R> w{c * (x - b * wi.z), (a - b * d) * y, c * (a * wi.z - d * x)};
        const R det = c * (a - b * d);
        const R lobe = sqr(det / length_squared(w)) * std::max(w.z, R(0)) / (kPi<R> * share);
        return uniform / kTwoPi<R> + (R(1) - uniform) * lobe;
    }

    Vec3<R> sample(Vec3<R> u) const {
        if (u.x < uniform) {
            const R s = std::sqrt(u.y * (R(2) - u.y));
            const R phi = kTwoPi<R> * u.z;
            return {s * std::cos(phi), s * std::sin(phi), R(1) - u.y};
        }
        const Vec2<R> disk = square_to_disk(u.y, u.z);
        const R y = disk.y;
        const R x = -lerp(share, safe_sqrt(R(1) - y * y), disk.x);
        const R z = safe_sqrt(R(1) - x * x - y * y);
        const Vec3<R> w = normalize(Vec3<R>{a * x + b * z, c * y, d * x + z});
        return {turn_x * w.x - turn_y * w.y, turn_x * w.y + turn_y * w.x, w.z};
    }
};

template <class R>
struct OrenNayar {
    static constexpr std::string_view kName = "oren_nayar";
    static constexpr std::string_view kDoc = "Rough diffuse reflection that preserves energy.";
    static constexpr std::string_view kSource =
        "Portsmouth, Kutz & Hill 2025 (EON); Fujii; Oren & Nayar 1994";
    static constexpr std::uint32_t kFeatures = kFeatureReflection;

    struct Params {
        Value<Spectrum<R>> albedo;
        Value<R> roughness;

        static constexpr auto table() {
            return std::array{
                color("albedo", &Params::albedo, "Share of light reflected at each scattering.")
                    .range(0, 1)
                    .initially(0.5),
                scalar("roughness", &Params::roughness, "r of EON; 0 is Lambert's law.")
                    .range(0, 1)
                    .initially(0.5)};
        }
        static constexpr std::array<Rule, 0> rules() { return {}; }
    };

    static constexpr R kC1 = R(0.5) - R(2) / (R(3) * kPi<R>);
    static constexpr R kC2 = R(2) / R(3) - R(28) / (R(15) * kPi<R>);

    R r{};
    R tenth_root_of_r{};
    Spectrum<R> single;    ///< albedo A
    Spectrum<R> multiple;  ///< rho_ms A r / (c1 - c2)

    static OrenNayar prepare(const Params& p) {
        const R r = p.roughness.v;
        const R A = R(1) / (R(1) + kC1 * r);
        const R lost = A * r * (kC1 - kC2);  // 1 - <E>
        OrenNayar m{r, std::pow(r, R(0.1)), p.albedo.v * A, {}};
        m.multiple = p.albedo.v.map([&](R rho) {
            return rho * rho * (R(1) - lost) / (R(1) - rho * lost) * A * r / (kC1 - kC2);
        });
        return m;
    }

    /// g(mu) = (1 - E(mu)) / (A r); falls to 0 as mu does.
    static R lost_share(Vec3<R> w) {
        const R mu = w.z;
        const R S = std::sqrt(w.x * w.x + w.y * w.y);
        constexpr R kHalf = kPi<R> / R(2) - R(2) / R(3);
        const R bracket =
            kHalf * mu / (R(1) + S) + S * S - R(2) / R(3) * S * (R(1) + S + S * S) / (R(1) + S);
        return kInvPi<R> * (mu * bracket + S * std::atan2(mu, S));
    }

    std::uint8_t lobes() const { return kDiffuse | kReflection; }

    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        if (!(wo.z > R(0)) || !(wi.z > R(0))) return {};
        return {value(wo, wi), EonLobe<R>::make(wo, r, tenth_root_of_r).pdf(wi)};
    }

    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        const auto lobe = EonLobe<R>::make(wo, r, tenth_root_of_r);
        const Vec3<R> wi = lobe.sample(u);
        if (!(wi.z > R(0))) return {};
        const R pdf = lobe.pdf(wi);
        if (!(pdf > R(0))) return {};
        return BsdfSample<R>{wi, value(wo, wi) * (R(1) / pdf), pdf, kDiffuse | kReflection};
    }

 private:
    /// f cos. `across` is o.i without the product of the cosines.
    Spectrum<R> value(Vec3<R> wo, Vec3<R> wi) const {
        const R across = wo.x * wi.x + wo.y * wi.y;
        const R t = across > R(0) ? std::max(wo.z, wi.z) : R(1);
        const R cosine = wi.z * kInvPi<R>;
        return single * ((R(1) + r * across / t) * cosine) +
               multiple * (lost_share(wo) * lost_share(wi) * cosine);
    }
};

}  // namespace matiere
