// Plastic or varnish: a dielectric surface (GGX or Beckmann, alpha = 0 smooth) over an absorbing
// diffuse interior. Light that enters is scattered by the interior and reflected back by the
// surface any number of times; the closed sum is exact for a smooth surface and uses the tabulated
// directional albedo of a rough one. A white interior gives albedo 1 at every alpha and angle.
// Sources: Weidlich & Wilkie 2007 corrected by 1/eta^2 and internal reflection; Kulla & Conty 2017.
// Left out: blur of the interior's light by the surface, absorption inside the varnish. eta >= 1.
#pragma once

#include "material/coated_diffuse.h"
#include "material/model.h"

namespace matiere {

template <class R>
struct Plastic {
    static constexpr std::string_view kName = "plastic";
    static constexpr std::string_view kDoc =
        "Smooth or rough dielectric surface over a diffuse body.";
    static constexpr std::string_view kSource =
        "Weidlich & Wilkie 2007 with internal reflection; Kulla & Conty 2017; Walter et al. 2007";
    static constexpr std::uint32_t kFeatures =
        kFeatureReflection | kFeatureDelta | kFeatureAnisotropic;

    struct Params : AlphaParams<R> {
        Value<Spectrum<R>> albedo;
        Value<R> eta;
        CoatTables<R> tables;

        static constexpr auto table() {
            return join(std::array{color("albedo", &Params::albedo,
                                         "Share of light the body reflects at each scattering.")
                                       .range(0, 1)
                                       .initially(0.5),
                                   scalar("eta", &Params::eta, "Index of refraction of the body.")
                                       .range(1, 1000)
                                       .initially(1.5)
                                       .constant_only()},
                        AlphaParams<R>::template rows<Params>());
        }
        static constexpr auto rules() { return AlphaParams<R>::rules(); }
        FresnelTerm<R> fresnel() const { return FresnelTerm<R>::dielectric(Spectrum<R>(eta.v)); }
    };

    CoatedDiffuse<R> layers;

    static ParamError check(const Params& p) { return check_coat_textures(p); }
    static void tabulate(Params& p, TableStore<R>& store) {
        p.tables = tabulate_coat(p, p.fresnel(), store);
    }
    static Plastic prepare(const Params& p) {
        const MicrofacetLobe<R> coat{p.microfacet(), p.fresnel()};
        return {CoatedDiffuse<R>::make(coat, p.tables.view(p), p.albedo.v, p.eta.v * p.eta.v)};
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
