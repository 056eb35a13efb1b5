// A microfacet lobe with the light that its facets scatter more than once, as a diffuse lobe that
// fills the furnace (Kulla & Conty 2017, "Revisiting Physically Based Shading at Imageworks"):
//
//   f_ms = F_ms (1 - E(o)) (1 - E(i)) / (pi (1 - E_avg)),
//   F_ms = F_avg^2 E_avg / (1 - F_avg (1 - E_avg))
//
// E is the directional albedo of single scattering with F = 1, averages are cosine-weighted. The
// power of F_avg is 2: light of the second and later bounces has met at least two facets.
#pragma once

#include "material/coat_albedo.h"
#include "material/microfacet_lobe.h"
#include "sampling/warp.h"

namespace matiere {

/// Keeps 0/0 away where nothing is lost and nothing is added.
inline constexpr double kMinLost = 1e-7;

/// Directions for light that leaves in proportion to (1 - E) cos: cosine-weighted where much is
/// lost; where little is, that is at grazing, also even in the stretched cosine of the table.
template <class R>
struct LostLobe {
    Stretch<R> stretch;
    R even{};  ///< share of the latter

    static LostLobe make(const CoatAlbedo<R>& side, R average_lost) {
        constexpr R kNarrow = R(0.02);
        const int row = int(side.alpha_row * R(side.table->rows() - 1));
        return {side.table->stretch[std::size_t(row)], kNarrow / (kNarrow + average_lost)};
    }

    /// For a cosine > 0; integrates to 1 over the hemisphere.
    R pdf(R cos_theta) const {
        return (R(1) - even) * cosine_hemisphere_pdf(cos_theta) +
               even * stretch.slope(cos_theta) / kTwoPi<R>;
    }
    Vec3<R> sample(Vec3<R> u) const {
        if (u.x >= even) return square_to_cosine_hemisphere(u.y, u.z);
        const R z = std::min(stretch.backward(u.y), R(1));
        const R s = safe_sqrt((R(1) - z) * (R(1) + z));
        const R phi = kTwoPi<R> * u.z;
        return {s * std::cos(phi), s * std::sin(phi), z};
    }
};

template <class R>
struct CompensatedLobe : MicrofacetLobe<R> {
    using Single = MicrofacetLobe<R>;

    CoatAlbedo<R> white;   ///< of F = 1; without a table there is no compensation
    Spectrum<R> share;     ///< F_ms: what of the lost light comes back
    R per_lost{};          ///< 1 / (1 - E_avg)
    R single_share{R(1)};  ///< mean of F_avg
    LostLobe<R> lobe_of_lost;

    static CompensatedLobe make(const Single& single, const CoatAlbedo<R>& white) {
        CompensatedLobe m{single, white, {}, R(0), R(1), {}};
        if (!white.table) return m;
        const R E = white.table->lookup_average(white.alpha_row)[0];
        const Spectrum<R> F = single.fresnel.average();
        m.share = F.map([E](R f) { return f * f * E / (R(1) - f * (R(1) - E)); });
        m.per_lost = R(1) / std::max(R(1) - E, R(kMinLost));
        m.single_share = F.average();
        m.lobe_of_lost = LostLobe<R>::make(white, R(1) - E);
        return m;
    }

    bool compensates() const { return white.table != nullptr && !this->is_delta(); }
    std::uint8_t lobe() const {
        return std::uint8_t(Single::lobe() | (compensates() ? kDiffuse : 0));
    }
    R lost(Vec3<R> w) const { return R(1) - white.raw(w)[0]; }

    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        BsdfEval<R> e = Single::eval(wo, wi);
        if (!compensates() || !(wo.z > R(0)) || !(wi.z > R(0))) return e;
        return mixed(e, lost(wo), wi);
    }

    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        if (!compensates()) return Single::sample(wo, u);
        const R lost_o = lost(wo);
        const R p = diffuse_probability(lost_o);
        if (u.x < p) {
            u.x = std::min(u.x / p, kOneMinusEpsilon<R>);
            const Vec3<R> wi = lobe_of_lost.sample(u);
            if (!(wi.z > R(0))) return {};
            return finish({wi, {}, R(0), kDiffuse | kReflection},
                          mixed(Single::eval(wo, wi), lost_o, wi));
        }
        u.x = std::min((u.x - p) / (R(1) - p), kOneMinusEpsilon<R>);
        auto s = Single::sample(wo, u);
        if (!s) return {};
        return finish(*s, mixed({s->weight * s->pdf, s->pdf}, lost_o, s->wi));
    }

 private:
    R diffuse_probability(R lost_o) const {
        const R diffuse = share.average() * lost_o;
        const R single = single_share * (R(1) - lost_o);
        return diffuse > R(0) ? diffuse / (diffuse + single) : R(0);
    }

    BsdfEval<R> mixed(BsdfEval<R> e, R lost_o, Vec3<R> wi) const {
        const R p = diffuse_probability(lost_o);
        e.f += share * (lost_o * lost(wi) * per_lost * cosine_hemisphere_pdf(wi.z));
        e.pdf = (R(1) - p) * e.pdf + p * lobe_of_lost.pdf(wi.z);
        return e;
    }
};

}  // namespace matiere
