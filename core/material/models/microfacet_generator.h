// Reflection from facets of any distribution p(h): Ashikhmin, Premoze, Shirley 2000, "A
// Microfacet-based BRDF Generator", with uncorrelated shadowing.
//
//   rho = p(h) P(k1) P(k2) F(k.h) / (4 k1n k2n <hn>),   P(k) = min(1, kn <hn> / g(k))
//
// g(k) = integral of p max(k.h, 0), <hn> = integral of p cos; both by quadrature into a table. The
// clamp P <= 1 matters for slanted facets only: without it they would gain energy. (The shorter
// rho = p <hn> F / (4 g g) is the same where the clamp is idle; p P F / (4 g g), which mixes the
// two, counts shadowing twice.) With D = p / <hn> and S(k) = max(kn, g(k) / <hn>):
// f cos = F D kn_i / (4 S(o) S(i)). Valid widths: 0.01 and above (the densities are tabulated).
#pragma once

#include <array>
#include <memory>

#include "material/facet_shapes.h"
#include "material/model.h"
#include "optics/facet_table.h"
#include "optics/fresnel.h"
#include "optics/microfacet.h"

namespace matiere {

/// What the material's tables hold; shared by its hits.
struct GeneratedFacets {
    FacetShape shape;
    FacetTable table;
};

template <class R>
struct MicrofacetGenerator {
    static constexpr std::string_view kName = "microfacet_generator";
    static constexpr std::string_view kDoc =
        "Facets of any distribution: gaussian, satin, velvet, grooves, two colours, an image.";
    static constexpr std::string_view kSource = "Ashikhmin, Premoze & Shirley 2000; Schlick 1994";
    static constexpr std::uint32_t kFeatures = kFeatureReflection | kFeatureAnisotropic;

    struct Params {
        Value<int> distribution;
        Value<R> sigma, sigma_x, sigma_y, tilt_deg;
        Value<Spectrum<R>> F0, F0_second;
        Value<R> p;
        const ImageTexture* image = nullptr;  ///< of p; read by tabulate, gone afterwards
        const GeneratedFacets* facets = nullptr;
        static constexpr std::string_view kImageParam = "p";

        static constexpr auto table() {
            return std::array{
                choice<Params, R>("distribution", &Params::distribution, kFacetKindNames,
                                  "Density p(h) of facet normals per solid angle.")
                    .initially(0),
                scalar("p", &Params::p,
                       "Instead: p as an image, azimuth to the right from the tangent, the normal "
                       "on top, the horizon at the bottom; any scale.")
                    .range(0, kUnlimited),
                scalar("sigma", &Params::sigma,
                       "Width of p; by default gaussian 0.3, velvet 0.5, grooves 0.1.")
                    .range(kNarrowest, 10)
                    .constant_only(),
                scalar("sigma_x", &Params::sigma_x, "Width along the tangent; satin 0.1.")
                    .range(kNarrowest, 10)
                    .constant_only(),
                scalar("sigma_y", &Params::sigma_y, "Width across the tangent; satin 1.")
                    .range(kNarrowest, 10)
                    .constant_only(),
                scalar("tilt_deg", &Params::tilt_deg,
                       "How far facets lean along the tangent; grooves: to both sides, 30.")
                    .range(0, 89)
                    .unit("deg")
                    .constant_only(),
                color("F0", &Params::F0, "Reflectance of a facet at normal incidence.")
                    .range(0, 1)
                    .initially(0.8),
                color("F0_second", &Params::F0_second,
                      "two_color: of the facets that lean the other way.")
                    .range(0, 1)
                    .initially(0.2)};
        }
        static constexpr auto rules() {
            return std::array{exclusive("p", "distribution"), exclusive("p", "tilt_deg"),
                              exclusive("p", "sigma", "sigma_x"),
                              exclusive("p", "sigma", "sigma_y"), together("sigma_x", "sigma_y")};
        }

        FacetShape shape() const {
            FacetShape s;
            if (image) s.image = *image;
            if (p.given && !image) s.constant = double(p.v);
            if (p.given) s.sigma_x = s.sigma_y = kImageWidth;
            if (p.given) return s;
            s.kind = FacetKind(distribution.v);
            constexpr std::array<double, 5> kWidths{0.3, 0.1, 0.5, 0.1, 0.1};
            const double width = sigma.given ? double(sigma.v) : kWidths[std::size_t(s.kind)];
            s.sigma_x = sigma_x.given ? double(sigma_x.v) : width;
            s.sigma_y = sigma_y.given ? double(sigma_y.v) : width;
            if (s.kind == FacetKind::kSatin && !sigma.given && !sigma_y.given) s.sigma_y = 1.0;
            const double degrees = tilt_deg.given   ? double(tilt_deg.v)
                                   : s.is_grooved() ? 30.0
                                                    : 0.0;
            s.tilt = degrees * kPi<double> / 180.0;
            return s;
        }
    };

    const GeneratedFacets* facets = nullptr;
    Spectrum<R> F0, F0_second;

    static void tabulate(Params& p, TableStore<R>& store) {
        const FacetShape shape = p.shape();
        const double narrow = std::min({shape.sigma_x, shape.sigma_y, 1.0});
        FacetTable table([&](Vec3d h) { return shape.density(h); }, narrow);
        p.image = nullptr;
        p.facets = store.keep(
            std::make_shared<const GeneratedFacets>(GeneratedFacets{shape, std::move(table)}));
    }
    static MicrofacetGenerator prepare(const Params& p) {
        const bool two = FacetKind(p.distribution.v) == FacetKind::kTwoColor;
        return {p.facets, p.F0.v, two ? p.F0_second.v : p.F0.v};
    }

    std::uint8_t lobes() const { return kGlossy | kReflection; }

    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        if (!(wo.z > R(0)) || !(wi.z > R(0))) return {};
        return value(normalize(vec_cast<double>(wo)), normalize(vec_cast<double>(wi)));
    }

    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        const Vec3d o = normalize(vec_cast<double>(wo));
        if (!(facets->table.projected() > 0.0)) return {};
        const Vec3d h = facets->table.sample(o, vec_cast<double>(u));
        if (!(dot(o, h) > 0.0)) return {};
        const Vec3<R> wi = vec_cast<R>(reflect(o, h));
        const BsdfEval<R> e = eval(wo, wi);
        if (!(e.pdf > R(0))) return {};
        return BsdfSample<R>{wi, e.f * (R(1) / e.pdf), e.pdf, lobes()};
    }

 private:
    static constexpr double kNarrowest = 0.01;
    static constexpr double kTooSmall = 1e-30;
    static constexpr double kImageWidth = 0.05;  ///< of the finest detail that is looked for

    BsdfEval<R> value(Vec3d o, Vec3d i) const {
        const FacetTable& table = facets->table;
        const Vec3d h = normalize(o + i);
        const double oh = dot(o, h);
        if (!(table.projected() > 0.0) || !(oh > 0.0)) return {};
        const double areas = std::max(o.z, table.sigma(o)) * std::max(i.z, table.sigma(i));
        const double scale = 1.0 / (4.0 * areas * table.projected());
        const R cosine = R(oh);
        Spectrum<R> f = fresnel_schlick(cosine, F0) * R(facets->shape.first(h) * scale);
        const double second = facets->shape.second(h);
        if (second > 0.0) f += fresnel_schlick(cosine, F0_second) * R(second * scale);
        // Before the cosine, so that both directions agree on what is too small for float.
        f = f.map([](R x) { return x < R(kTooSmall) ? R(0) : x; }) * R(i.z);
        return {f, R(table.pdf(o, h) / (4.0 * oh))};
    }
};

}  // namespace matiere
