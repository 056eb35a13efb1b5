// Schlick's model of 1994: one layer (C, r, p) or two, the second seen through the first.
//   one layer:  f = S D                two layers:  f = S D + T S' D'
// with S and S' at the same u = o.h, and D the blend of schlick_layer.h.
// ggx (default): the glossy part is elliptic GGX with Smith masking and visible normals; T is the
//   published 1 - S, but never more than what the first layer leaves, min(1 - E(i), 1 - E(o)) with
//   E its directional albedo, so that nothing is gained.
// schlick94: the published factors with masking bounded at grazing; T = 1 - S, which gains energy
//   where the first layer is a mirror over a bright second one. Loses energy where p < 1.
// Source: Schlick 1994, "An inexpensive BRDF model for physically-based rendering", eqs 15-31.
// p = 0 is refused: scratches without width have no density.
#pragma once

#include "material/coat_albedo.h"
#include "material/model.h"
#include "material/schlick_layer.h"

namespace matiere {

template <class R, int I>
struct SchlickLayerParams {
    Value<Spectrum<R>> C;
    Value<R> r, p;

    template <class P>
    static constexpr auto rows() {
        using L = SchlickLayerParams;
        constexpr bool kFirst = I == 0;
        return std::array{
            color<P, R>(kFirst ? "layers/0/C" : "layers/1/C", &L::C,
                        "Reflectance at normal incidence.")
                .range(0, 1)
                .initially(0.5),
            scalar<P, R>(kFirst ? "layers/0/r" : "layers/1/r", &L::r,
                         "Roughness: 0 mirror, 1 diffuse, glossy in between.")
                .range(0, 1)
                .initially(0.1),
            scalar<P, R>(kFirst ? "layers/0/p" : "layers/1/p", &L::p,
                         "Isotropy: 1 isotropic, small is scratched.")
                .above(0, 1)
                .initially(1)
                .because("p = 0 would be scratches without width, a lobe without density")};
    }
};

template <class R>
struct Schlick {
    static constexpr std::string_view kName = "schlick";
    static constexpr std::string_view kDoc =
        "Schlick's model: one or two layers of a diffuse, glossy and mirror blend.";
    static constexpr std::string_view kSource = "Schlick 1994, eqs 15-31; Heitz 2014 (ggx)";
    static constexpr std::uint32_t kFeatures =
        kFeatureReflection | kFeatureDelta | kFeatureAnisotropic;

    struct Params : SchlickLayerParams<R, 0>, SchlickLayerParams<R, 1> {
        using First = SchlickLayerParams<R, 0>;
        using Second = SchlickLayerParams<R, 1>;
        Value<int> layers, variant;
        CoatTables<R> tables;

        static constexpr auto table() {
            return join(
                std::array{
                    list<Params, R>("layers", &Params::layers, "The layers, the upper one first.")
                        .range(1, 2)
                        .initially(1),
                    choice<Params, R>("variant", &Params::variant, kSchlickVariantNames,
                                      "ggx never gains energy; schlick94 is as published.")
                        .initially(0)},
                join(First::template rows<Params>(), Second::template rows<Params>()));
        }
        static constexpr std::array<Rule, 0> rules() { return {}; }

        SchlickVariant which() const { return SchlickVariant(variant.v); }
        bool is_bounded() const { return layers.v > 1 && which() == SchlickVariant::kGgx; }
        /// Of the first layer, along and across the tangent.
        Vec2<R> first_widths() const { return SchlickLayer<R>::widths(First::r.v, First::p.v); }
        SchlickLayer<R> first() const {
            return SchlickLayer<R>::make(First::C.v, First::r.v, First::p.v, which());
        }
        SchlickLayer<R> second() const {
            if (layers.v < 2) return {};
            return SchlickLayer<R>::make(Second::C.v, Second::r.v, Second::p.v, which());
        }
    };

    SchlickLayer<R> top, base;
    bool two = false;
    bool bounded = false;  ///< T is held below what `albedo` leaves
    CoatAlbedo<R> albedo;  ///< of the top layer

    static ParamError check(const Params& p) {
        if (!p.is_bounded()) return {};
        if (p.First::r.textured) return {"layers/0/r", "r over a second layer takes no texture"};
        if (p.First::p.textured) return {"layers/0/p", "p over a second layer takes no texture"};
        return {};
    }
    static void tabulate(Params& p, TableStore<R>& store) {
        if (!p.is_bounded()) return;
        const auto layer = SchlickLayer<double>::make({}, double(p.First::r.v),
                                                      double(p.First::p.v), SchlickVariant::kGgx);
        const MakeAlbedoRow row = [&](double alpha_x, double alpha_y, double azimuth) {
            const double width =
                std::hypot(alpha_x * std::cos(azimuth), alpha_y * std::sin(azimuth));
            return AlbedoRow{width, azimuth, [layer](Vec3d wo) { return layer_albedo(layer, wo); }};
        };
        p.tables.table = tabulate_lobe(p.first_widths(), false, row, store);
    }
    static Schlick prepare(const Params& p) {
        return {p.first(), p.second(), p.layers.v > 1, p.is_bounded(),
                p.tables.view(p.first_widths(), false)};
    }

    bool is_anisotropic() const {
        return top.facets.is_anisotropic() || (two && base.facets.is_anisotropic());
    }

    std::uint8_t lobes() const {
        const auto any = [&](R a, R b) { return a > R(0) || (two && b > R(0)); };
        return std::uint8_t(kReflection | (any(top.diffuse, base.diffuse) ? kDiffuse : 0) |
                            (any(top.glossy, base.glossy) ? kGlossy : 0) |
                            (any(top.mirror, base.mirror) ? kSpecular : 0));
    }

    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const {
        if (!(wo.z > R(0)) || !(wi.z > R(0))) return {};
        const auto half = HalfVector<R>::between(wo, wi);
        if (!(half.oh > R(0))) return {};
        return eval(wo, wi, half, choices(wo));
    }

    Spectrum<R> diffuse(Vec3<R> wo, Vec3<R> wi) const {
        if (!(wo.z > R(0)) || !(wi.z > R(0))) return {};
        const auto half = HalfVector<R>::between(wo, wi);
        if (!(half.oh > R(0))) return {};
        Spectrum<R> f = top.fresnel(half.oh, half.versed) * top.diffuse;
        if (two)
            f += through(wo, wi, half.versed) * base.fresnel(half.oh, half.versed) * base.diffuse;
        return f * cosine_hemisphere_pdf(wi.z);
    }

    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        const Choices p = choices(wo);
        if (u.x < p.mirror) return sample_mirror(wo, p.mirror);
        Vec3<R> wi;
        const bool diffuse = u.x < p.mirror + p.diffuse;
        if (diffuse) {
            wi = square_to_cosine_hemisphere(u.y, u.z);
        } else {
            const bool upper = !(p.base > R(0)) || u.x < p.mirror + p.diffuse + p.top;
            const Vec3<R> h = (upper ? top : base).sample_glossy(wo, u);
            if (!(dot(wo, h) > R(0))) return {};
            wi = reflect(wo, h);
        }
        if (!(wi.z > R(0))) return {};
        const auto half = HalfVector<R>::between(wo, wi);
        if (!(half.oh > R(0))) return {};
        const BsdfEval<R> e = eval(wo, wi, half, p);
        if (!(e.pdf > R(0))) return {};
        return BsdfSample<R>{wi, e.f * (R(1) / e.pdf), e.pdf,
                             std::uint8_t((diffuse ? kDiffuse : kGlossy) | kReflection)};
    }

 private:
    /// Probabilities of the four ways to sample.
    struct Choices {
        R mirror{}, diffuse{}, top{}, base{};
    };

    /// Shares of the light that wo sees. S averages at least to its share at random facets, so that
    /// nothing that may be lit goes unsampled.
    Choices choices(Vec3<R> wo) const {
        constexpr R kMeanRise = R(1) / R(21);  // cosine average of (1 - u)^5
        const R rise = schlick_weight(wo.z);
        const auto share = [&](const SchlickLayer<R>& layer) {
            const R c = layer.fresnel.a.average();
            return c + (R(1) - c) * std::max(rise, kMeanRise);
        };
        const R s = share(top);
        const R falls = std::max(R(1) - rise, kMeanRise) * (R(1) - top.fresnel.a.average());
        const R t = two ? falls * share(base) : R(0);
        Choices p{s * top.mirror + t * base.mirror, s * top.diffuse + t * base.diffuse,
                  s * top.glossy, t * base.glossy};
        const R sum = p.mirror + p.diffuse + p.top + p.base;
        if (!(sum > R(0))) return {};
        return {p.mirror / sum, p.diffuse / sum, p.top / sum, p.base / sum};
    }

    /// T: (1 - C)(1 - (1-u)^5) is 1 - S, exactly 0 where C = 1.
    Spectrum<R> through(Vec3<R> wo, Vec3<R> wi, R versed) const {
        const R falls = R(1) - sqr(versed * versed) * versed;
        Spectrum<R> t = (Spectrum<R>(R(1)) - top.fresnel.a) * falls;
        if (!bounded) return t;
        const Spectrum<R> E_o = albedo(wo, top.fresnel);
        const Spectrum<R> E_i = albedo(wi, top.fresnel);
        for (int k = 0; k < kActiveLanes; ++k)
            t[k] = std::min(t[k], R(1) - std::max(E_o[k], E_i[k]));
        return t;
    }

    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi, const HalfVector<R>& half, const Choices& p) const {
        const R cosine = cosine_hemisphere_pdf(wi.z);
        BsdfEval<R> e{{}, p.diffuse * cosine};
        const auto add = [&](const SchlickLayer<R>& layer, const Spectrum<R>& tint, R chosen) {
            R value = layer.diffuse * cosine;
            if (layer.glossy > R(0)) {
                const auto glossy = layer.eval_glossy(wo, wi, half);
                value += layer.glossy * glossy.value;
                e.pdf += chosen * glossy.pdf;
            }
            e.f += tint * layer.fresnel(half.oh, half.versed) * value;
        };
        add(top, Spectrum<R>(R(1)), p.top);
        if (two) add(base, through(wo, wi, half.versed), p.base);
        if (!(e.pdf > R(0))) return {};
        return e;
    }

    std::optional<BsdfSample<R>> sample_mirror(Vec3<R> wo, R chosen) const {
        const Vec3<R> wi{-wo.x, -wo.y, wo.z};
        Spectrum<R> weight = top.fresnel(wo.z) * top.mirror;
        if (two) weight += through(wo, wi, R(1) - wo.z) * base.fresnel(wo.z) * base.mirror;
        return BsdfSample<R>{wi, weight * (R(1) / chosen), chosen, kSpecular | kReflection};
    }

    /// Directional albedo of a layer for the terms of its Fresnel term.
    static Spectrumd layer_albedo(const SchlickLayer<double>& layer, Vec3d wo) {
        Spectrumd sum = FresnelTerm<double>::terms(wo.z) * layer.mirror;
        if (layer.glossy > 0.0)
            sum += directional_albedo(layer.facets, wo, FresnelTerm<double>::terms) * layer.glossy;
        if (layer.diffuse > 0.0) sum += diffuse_albedo(wo) * layer.diffuse;
        return sum;
    }

    /// The same of a diffuse lobe whose Fresnel term is taken at the half vector.
    static Spectrumd diffuse_albedo(Vec3d wo) {
        static const GaussLegendre nodes(16);
        constexpr int kAzimuths = 32;
        Spectrumd sum;
        for (std::size_t k = 0; k < nodes.x.size(); ++k)
            for (int j = 0; j < kAzimuths; ++j) {
                const double phi = 2.0 * kPi<double> * (j + 0.5) / kAzimuths;
                const double s = std::sqrt(nodes.x[k]);
                const Vec3d wi{s * std::cos(phi), s * std::sin(phi), std::sqrt(1.0 - nodes.x[k])};
                sum += FresnelTerm<double>::terms(0.5 * length(wo + wi)) * (nodes.w[k] / kAzimuths);
            }
        return sum;
    }
};

}  // namespace matiere
