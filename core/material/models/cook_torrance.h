// Cook-Torrance microfacet reflection with a choice of distribution, masking and Fresnel term, and
// an optional diffuse body under it.
// f = F D G / (4 cos_o cos_i) with D normalised to integral D cos = 1: the 1/pi printed in 1982
// belongs to a D normalised to pi, and taken literally gives four times too much light.
// Sources: Cook & Torrance 1982; Torrance & Sparrow 1967; Walter et al. 2007; Heitz 2014; Heitz &
// d'Eon 2014; Schlick 1994; Hoffman 2019 and Kutz et al. 2021 (F82 tint); Kulla & Conty 2017.
// The diffuse body is coupled by energy: it gets what the surface lets through in and out, with no
// refraction (eta^2 = 1 in coated_diffuse.h), so `diffuse` is the colour seen where F is small.
#pragma once

#include "material/coated_diffuse.h"
#include "material/compensated_lobe.h"
#include "material/coupling.h"
#include "material/model.h"

namespace matiere {

template <class R>
struct CookTorrance {
    static constexpr std::string_view kName = "cook_torrance";
    static constexpr std::string_view kDoc =
        "Microfacet reflection, any Fresnel term, optional diffuse body.";
    static constexpr std::string_view kSource =
        "Cook & Torrance 1982 with normalised D; Heitz & d'Eon 2014; Kutz et al. 2021";
    static constexpr std::uint32_t kFeatures =
        kFeatureReflection | kFeatureDelta | kFeatureAnisotropic;

    struct Params : AlphaParams<R> {
        Value<Spectrum<R>> F0, F82_tint, eta, k, diffuse;
        Value<int> coupling;
        CoatTables<R> tables;

        static constexpr auto table() {
            return join(
                std::array{
                    color("F0", &Params::F0, "Reflectance at normal incidence.")
                        .range(0, 1)
                        .initially(0.04),
                    color("F82_tint", &Params::F82_tint,
                          "Tint of the reflectance near 82 degrees; 1 is Schlick's.")
                        .range(0, 1),
                    color("eta", &Params::eta, "Index of refraction, instead of F0.")
                        .above(0, 1000)
                        .constant_only(),
                    color("k", &Params::k, "Extinction coefficient: makes eta a metal's.")
                        .range(0, 1000)
                        .constant_only(),
                    color("diffuse", &Params::diffuse, "Albedo of the body under the surface.")
                        .range(0, 1)
                        .initially(0),
                    choice<Params, R>(
                        "coupling", &Params::coupling, kPlainCouplingNames,
                        "energy: diffuse gets what the surface lets through; add: as it is.")
                        .initially(0)},
                join(AlphaParams<R>::template rows<Params>(),
                     AlphaParams<R>::template multiscatter_row<Params>()));
        }
        static constexpr auto rules() {
            return join(std::array{exclusive("F0", "eta"), requires_param("F82_tint", "F0"),
                                   requires_param("k", "eta")},
                        AlphaParams<R>::rules());
        }
        FresnelTerm<R> fresnel() const {
            if (k.given) return FresnelTerm<R>::conductor(eta.v, k.v);
            if (eta.given) return FresnelTerm<R>::dielectric(eta.v);
            if (F82_tint.given) return FresnelTerm<R>::f82(F0.v, F82_tint.v);
            return FresnelTerm<R>::schlick(F0.v);
        }
        bool has_body() const { return diffuse.textured || !diffuse.v.is_black(); }
    };

    CoatedDiffuse<R, CompensatedLobe<R>> layers;

    static ParamError check(const Params& p) {
        if (!p.has_body() && !p.multiscatter.v) return p.check_shape();
        if (Coupling(p.coupling.v) == Coupling::kAdd && p.has_body()) {
            if (p.multiscatter.v)
                return {"coupling",
                        "add does not know the light that multiscatter returns; take energy"};
            const ParamError gain =
                check_sum(Coupling::kAdd, p.diffuse.v, largest_coat_albedo(p, p.fresnel()));
            if (!gain.message.empty()) return gain;
        }
        return check_coat_textures(p);
    }
    static void tabulate(Params& p, TableStore<R>& store) {
        if (p.has_body()) p.tables = tabulate_coat(p, p.fresnel(), store);
        if (p.multiscatter.v) p.tables.white = tabulate_white(p, store);
    }
    static CookTorrance prepare(const Params& p) {
        const auto coat =
            CompensatedLobe<R>::make({p.microfacet(), p.fresnel()}, p.tables.white_view(p));
        CoatAlbedo<R> albedo = p.tables.view(p);
        albedo.white = p.tables.white;
        albedo.returned = coat.share;
        return {couple(coat, albedo, p.diffuse.v, Coupling(p.coupling.v), true)};
    }

    bool is_anisotropic() const { return layers.coat.surface.is_anisotropic(); }
    std::uint8_t lobes() const { return layers.lobes(); }
    Spectrum<R> diffuse(Vec3<R> wo, Vec3<R> wi) const { return layers.diffuse(wo, wi); }
    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const { return layers.eval(wo, wi); }
    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        return layers.sample(wo, u);
    }
};

}  // namespace matiere
