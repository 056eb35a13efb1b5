// Blinn-Phong: a power of the cosine between normal and half vector, over a diffuse body.
//   f = specular N(m) (n.h)^m
// exact:  N = (m+2)(m+4) / (8 pi (2^(-m/2) + m)), albedo 1 at normal incidence and less elsewhere;
//         m = 0 is Lambert's law.
// course: N = (m+2) / (2 pi), the norm of a distribution of normals, kept for comparison: up to
// four
//         times too much light.
// Sources: Blinn 1977; Akenine-Moller, Haines & Hoffman 2008, section 7.6 (N); Giesen 2009 (its
// exact value). Directions are drawn through the half vector, a share 2^(-m/2) of them by cosine.
#pragma once

#include "material/coupling.h"
#include "material/half_vector_lobe.h"
#include "material/model.h"
#include "material/phong_shape.h"

namespace matiere {

template <class R>
struct BlinnPhongShape {
    PhongHalf<R> half;
    R norm_ratio{};  ///< 8 pi N / (m + 1)
    R by_cosine{};

    static BlinnPhongShape make(R m, Normalization normalization) {
        BlinnPhongShape s{{m, m}, R(0), std::exp2(R(-0.5) * m)};
        s.norm_ratio = normalization == Normalization::kCourse
                           ? R(4) * (m + R(2)) / (m + R(1))
                           : (m + R(2)) / (m + R(1)) * ((m + R(4)) / (s.by_cosine + m));
        return s;
    }

    static constexpr bool is_delta() { return false; }
    R cosine_share() const { return by_cosine; }
    R density(Vec3<R> h) const { return half.density(h); }
    Vec3<R> sample(R u1, R u2) const { return half.half_vector(half.azimuth(u1), u2); }
    R weight(Vec3<R>, Vec3<R> wi, const HalfVector<R>& half_way) const {
        return norm_ratio * half_way.oh * wi.z;
    }

    Vec2<R> azimuth(R u) const { return half.azimuth(u); }
    R azimuth_variate(Vec2<R> d) const { return half.azimuth_variate(d); }
    Vec3<R> half_vector(Vec2<R> phi, R u) const { return half.half_vector(phi, u); }
    R share_within(Vec2<R> phi, R theta) const { return half.share_within(phi, theta); }
};

template <class R>
struct BlinnPhong {
    static constexpr std::string_view kName = "blinn_phong";
    static constexpr std::string_view kDoc = "Blinn-Phong lobe over a diffuse body.";
    static constexpr std::string_view kSource = "Blinn 1977; Giesen 2009 (normalization)";
    static constexpr std::uint32_t kFeatures = kFeatureReflection;

    struct Params {
        Value<Spectrum<R>> diffuse, specular;
        Value<R> exponent;
        Value<int> normalization, coupling;
        CoatTables<R> tables;

        static constexpr auto table() {
            return std::array{
                color("diffuse", &Params::diffuse, "Albedo of the body.")
                    .range(0, 1)
                    .initially(0.5),
                color("specular", &Params::specular, "Colour of the lobe.")
                    .range(0, 1)
                    .initially(0.1),
                scalar("exponent", &Params::exponent, "Power of the cosine; higher is glossier.")
                    .range(0, kMaxLobeExponent)
                    .initially(100),
                choice<Params, R>("normalization", &Params::normalization, kNormalizationNames,
                                  "exact never gains energy; course is (m+2)/(2 pi), which does.")
                    .initially(0),
                choice<Params, R>("coupling", &Params::coupling, kPlainCouplingNames,
                                  "energy: diffuse gets what specular leaves; add: as it is.")
                    .initially(0)};
        }
        static constexpr std::array<Rule, 0> rules() { return {}; }

        bool has_body() const { return diffuse.textured || !diffuse.v.is_black(); }
        Vec2<R> widths() const {
            const R a = alpha_from_exponent(exponent.v);
            return {a, a};
        }
    };

    CoatedDiffuse<R, HalfVectorLobe<R, BlinnPhongShape<R>>> layers;

    static ParamError check(const Params& p) {
        return check_sum(Coupling(p.coupling.v), p.diffuse.v, p.specular.v);
    }
    static void tabulate(Params& p, TableStore<R>& store) {
        if (!p.has_body()) return;
        const auto N = Normalization(p.normalization.v);
        const double m = double(p.exponent.v);
        const bool textured = p.exponent.textured;
        const MakeAlbedoRow row = [&](double alpha, double, double azimuth) {
            const auto shape =
                BlinnPhongShape<double>::make(textured ? exponent_of_alpha(alpha) : m, N);
            return AlbedoRow{alpha, azimuth,
                             [shape](Vec3d wo) { return half_vector_albedo(shape, wo); }};
        };
        p.tables.table = tabulate_lobe(p.widths(), textured, row, store, kGainCeiling);
    }
    static BlinnPhong prepare(const Params& p) {
        const auto N = Normalization(p.normalization.v);
        return {
            couple(HalfVectorLobe<R, BlinnPhongShape<R>>{BlinnPhongShape<R>::make(p.exponent.v, N),
                                                         FresnelTerm<R>::constant(p.specular.v)},
                   p.tables.view(p.widths(), p.exponent.textured), p.diffuse.v,
                   Coupling(p.coupling.v), N == Normalization::kExact)};
    }

    std::uint8_t lobes() const { return layers.lobes(); }
    Spectrum<R> diffuse(Vec3<R> wo, Vec3<R> wi) const { return layers.diffuse(wo, wi); }
    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const { return layers.eval(wo, wi); }
    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        return layers.sample(wo, u);
    }
};

}  // namespace matiere
