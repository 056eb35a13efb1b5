// Metal: exact Fresnel reflectance of a complex index eta + i k per channel over a GGX or Beckmann
// surface; alpha = 0 is a perfect mirror of that metal.
// Sources: Torrance & Sparrow 1967; Walter et al. 2007; Heitz 2014; Born & Wolf 1999, sec. 14.2.
// Single scattering between facets, as in those papers, loses energy at high alpha; multiscatter
// adds the rest (Kulla & Conty 2017). eta, k relative to the outside.
#pragma once

#include "material/alpha_params.h"
#include "material/compensated_lobe.h"
#include "material/model.h"

namespace matiere {

template <class R>
struct Conductor {
    static constexpr std::string_view kName = "conductor";
    static constexpr std::string_view kDoc =
        "Metal with complex index of refraction, smooth or rough.";
    static constexpr std::string_view kSource =
        "Torrance & Sparrow 1967; Walter et al. 2007; Heitz & d'Eon 2014; Heitz 2014; Kulla & "
        "Conty "
        "2017";
    static constexpr std::uint32_t kFeatures =
        kFeatureReflection | kFeatureDelta | kFeatureAnisotropic;

    struct Params : AlphaParams<R> {
        Value<Spectrum<R>> eta, k;
        CoatTables<R> tables;

        static constexpr auto table() {
            return join(
                std::array{metal<Params, R>("metal", "Symbol of a metal, for example Au."),
                           color("eta", &Params::eta, "Index of refraction.").range(0, 1000),
                           color("k", &Params::k, "Extinction coefficient.").range(0, 1000)},
                join(AlphaParams<R>::template rows<Params>(),
                     AlphaParams<R>::template multiscatter_row<Params>()));
        }
        static constexpr auto rules() {
            return join(std::array{one_of("metal", "eta"), exclusive("metal", "eta"),
                                   exclusive("metal", "k"), together("eta", "k")},
                        AlphaParams<R>::rules());
        }
    };

    CompensatedLobe<R> surface;

    static ParamError check(const Params& p) {
        return p.multiscatter.v ? check_coat_textures(p) : p.check_shape();
    }
    static void tabulate(Params& p, TableStore<R>& store) {
        if (p.multiscatter.v) p.tables.white = tabulate_white(p, store);
    }
    static Conductor prepare(const Params& p) {
        return {CompensatedLobe<R>::make(
            {p.microfacet(), FresnelTerm<R>::conductor(p.eta.v, p.k.v)}, p.tables.white_view(p))};
    }

    bool is_anisotropic() const { return surface.surface.is_anisotropic(); }
    std::uint8_t lobes() const { return surface.lobe(); }
    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const { return surface.eval(wo, wi); }
    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const {
        return surface.sample(wo, u);
    }
};

}  // namespace matiere
