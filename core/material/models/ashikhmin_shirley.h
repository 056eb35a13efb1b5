// Anisotropic Phong lobe with Schlick's Fresnel term over a diffuse body, tangent rotated at will.
//   f = F(o.h) sqrt((nu+1)(nv+1)) / (8 pi) (n.h)^e / ((o.h) max(n.i, n.o)),
//   e = (nu h_x^2 + nv h_y^2) / (1 - h_z^2),   F = F0 + (1 - F0)(1 - o.h)^5
// exact:  as above. course: F0 sqrt((nu+1)(nv+1)) (n.h)^e, without the rest: kept for comparison,
// up
//         to 8 pi times too much light.
// coupling paper: the diffuse term of the paper, 28/(23 pi) diffuse (1 - F0)
// (1 - (1 - n.i/2)^5)(1 - (1 - n.o/2)^5), which conserves energy but darkens towards grazing.
// Source: Ashikhmin & Shirley 2000, "An anisotropic Phong BRDF model", eqs 4-10. All four quadrants
// of the azimuth are drawn by one map; half vectors that reflect below the horizon are lost, as the
// paper has it (half of them at grazing).
#pragma once

#include "material/coupling.h"
#include "material/half_vector_lobe.h"
#include "material/model.h"
#include "material/phong_shape.h"
#include "material/tangent_rotation.h"

namespace matiere {

template <class R>
struct AshikhminShirleyShape {
    PhongHalf<R> half;
    Normalization normalization{};

    static constexpr bool is_delta() { return false; }
    static constexpr R cosine_share() { return R(0); }
    R density(Vec3<R> h) const { return half.density(h); }
    Vec3<R> sample(R u1, R u2) const { return half.half_vector(half.azimuth(u1), u2); }
    R weight(Vec3<R> wo, Vec3<R> wi, const HalfVector<R>& half_way) const {
        if (normalization == Normalization::kCourse) return R(8) * kPi<R> * half_way.oh * wi.z;
        return wi.z / std::max(wi.z, wo.z);
    }

    Vec2<R> azimuth(R u) const { return half.azimuth(u); }
    R azimuth_variate(Vec2<R> d) const { return half.azimuth_variate(d); }
    Vec3<R> half_vector(Vec2<R> phi, R u) const { return half.half_vector(phi, u); }
    R share_within(Vec2<R> phi, R theta) const { return half.share_within(phi, theta); }
};

template <class R>
struct AshikhminShirley {
    static constexpr std::string_view kName = "ashikhmin_shirley";
    static constexpr std::string_view kDoc = "Anisotropic Phong lobe over a diffuse body.";
    static constexpr std::string_view kSource = "Ashikhmin & Shirley 2000, eqs 4-10";
    static constexpr std::uint32_t kFeatures = kFeatureReflection | kFeatureAnisotropic;

    struct Params {
        Value<Spectrum<R>> diffuse, F0;
        Value<R> nu, nv, rotation_deg;
        Value<int> normalization, coupling;
        CoatTables<R> tables;

        static constexpr auto table() {
            return std::array{
                color("diffuse", &Params::diffuse, "Albedo of the body.")
                    .range(0, 1)
                    .initially(0.3),
                color("F0", &Params::F0, "Reflectance of the lobe at normal incidence.")
                    .range(0, 1)
                    .initially(0.05),
                scalar("nu", &Params::nu, "Exponent along the tangent.")
                    .range(0, kMaxLobeExponent)
                    .initially(100),
                scalar("nv", &Params::nv, "Exponent across the tangent.")
                    .range(0, kMaxLobeExponent)
                    .initially(100),
                scalar("rotation_deg", &Params::rotation_deg,
                       "Turns the tangent about the normal, counter-clockwise.")
                    .range(-360, 360)
                    .initially(0)
                    .unit("deg"),
                choice<Params, R>(
                    "normalization", &Params::normalization, kNormalizationNames,
                    "exact is the paper's; course lacks 1/(8 pi (o.h) max) and gains.")
                    .initially(0),
                choice<Params, R>("coupling", &Params::coupling, kCouplingNames,
                                  "energy: diffuse gets what the lobe leaves; add: as it is; "
                                  "paper: the paper's own diffuse term.")
                    .initially(0)};
        }
        static constexpr std::array<Rule, 0> rules() { return {}; }

        bool has_body() const { return diffuse.textured || !diffuse.v.is_black(); }
        bool textured() const { return nu.textured || nv.textured; }
        Vec2<R> widths() const { return {alpha_from_exponent(nu.v), alpha_from_exponent(nv.v)}; }
        FresnelTerm<R> fresnel() const {
            // The course's formula has no Fresnel term: F0 is its colour.
            return Normalization(normalization.v) == Normalization::kCourse
                       ? FresnelTerm<R>::constant(F0.v)
                       : FresnelTerm<R>::schlick(F0.v);
        }
        AlbedoRow row(Vec2<double> exponents, double azimuth) const {
            const AshikhminShirleyShape<double> shape{{exponents.x, exponents.y},
                                                      Normalization(normalization.v)};
            const double width = std::hypot(alpha_from_exponent(exponents.x) * std::cos(azimuth),
                                            alpha_from_exponent(exponents.y) * std::sin(azimuth));
            return {width, azimuth, [shape](Vec3d wo) { return half_vector_albedo(shape, wo); }};
        }
    };

    TangentRotation<R> rotation;
    CoatedDiffuse<R, HalfVectorLobe<R, AshikhminShirleyShape<R>>> layers;
    bool anisotropic = false;

    static ParamError check(const Params& p) {
        if (!p.has_body()) return {};
        if (p.textured())
            return {p.nu.textured ? "nu" : "nv",
                    "an exponent over a diffuse body takes no texture; set diffuse to 0"};
        if (Coupling(p.coupling.v) != Coupling::kAdd) return {};
        return check_sum(Coupling::kAdd, p.diffuse.v, largest_albedo(p));
    }
    static void tabulate(Params& p, TableStore<R>& store) {
        if (!p.has_body()) return;
        const Vec2<double> exponents{double(p.nu.v), double(p.nv.v)};
        const MakeAlbedoRow row = [&](double, double, double azimuth) {
            return p.row(exponents, azimuth);
        };
        p.tables.table = tabulate_lobe(p.widths(), false, row, store, kGainCeiling);
    }
    static AshikhminShirley prepare(const Params& p) {
        const auto N = Normalization(p.normalization.v);
        const auto coupling = Coupling(p.coupling.v);
        Spectrum<R> body = p.diffuse.v;
        if (coupling == Coupling::kPaper) body *= (Spectrum<R>(R(1)) - p.F0.v) * (R(28) / R(23));
        const HalfVectorLobe<R, AshikhminShirleyShape<R>> lobe{{{p.nu.v, p.nv.v}, N}, p.fresnel()};
        return {TangentRotation<R>::make(p.rotation_deg.v),
                couple(lobe, p.tables.view(p.widths(), false), body, coupling,
                       N == Normalization::kExact),
                p.nu.v != p.nv.v};
    }

    bool is_anisotropic() const { return anisotropic; }
    std::uint8_t lobes() const { return layers.lobes(); }
    Spectrum<R> diffuse(Vec3<R> wo, Vec3<R> wi) const {
        return layers.diffuse(rotation.to_tangent(wo), rotation.to_tangent(wi));
    }
    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        return layers.eval(rotation.to_tangent(wo), rotation.to_tangent(wi));
    }
    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        auto s = layers.sample(rotation.to_tangent(wo), u);
        if (s) s->wi = rotation.from_tangent(s->wi);
        return s;
    }

 private:
    /// Over all angles of view: Schlick's term rises towards grazing, where half the lobe is lost.
    static Spectrum<R> largest_albedo(const Params& p) {
        constexpr int kAngles = 48, kAzimuths = 4;
        const FresnelTerm<double> F = p.fresnel().template cast<double>();
        const AlbedoRow row = p.row({double(p.nu.v), double(p.nv.v)}, 0.0);
        Spectrum<R> most;
        for (int k = 0; k < kAngles; ++k)
            for (int j = 0; j < kAzimuths; ++j) {
                const double theta = kPi<double> / 2 * (k + 0.5) / kAngles;
                const double phi = kPi<double> / 2 * j / (kAzimuths - 1);
                const double s = std::sin(theta);
                const Spectrumd e =
                    F.combine(row.albedo({s * std::cos(phi), s * std::sin(phi), std::cos(theta)}));
                for (int i = 0; i < kActiveLanes; ++i) most[i] = std::max(most[i], R(e[i]));
            }
        return most;
    }
};

}  // namespace matiere
