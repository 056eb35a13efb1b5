// The parameters of a rough surface, shared by every microfacet model: width, shape and masking.
#pragma once

#include "material/width_params.h"
#include "optics/microfacet.h"

namespace matiere {

inline constexpr double kDefaultAlpha = 0.1;

template <class R>
struct AlphaParams : WidthParams<R> {
    Value<R> exponent;
    Value<int> distribution, masking;
    Value<int> multiscatter;  ///< read by models that list its row

    /// Rows for a parameter struct P that derives from this one; `initial` is alpha's default.
    template <class P>
    static constexpr auto rows(double initial = kDefaultAlpha) {
        return join(
            WidthParams<R>::template rows<P>(initial),
            std::array{
                scalar<P, R>(
                    "exponent", &P::exponent,
                    "Alternative to alpha, as of Blinn-Phong: alpha^2 = 2 / (exponent + 2).")
                    .range(0, kMaxExponent),
                choice<P, R>("distribution", &P::distribution, kDistributionNames,
                             "Distribution of the facet normals; ward is the anisotropic beckmann.")
                    .initially(0),
                choice<P, R>("masking", &P::masking, kMaskingNames,
                             "Shadowing and masking: smith is height-correlated.")
                    .initially(0)});
    }
    /// The row of models that can add what single scattering between facets loses.
    template <class P>
    static constexpr auto multiscatter_row() {
        return std::array{flag<P, R>("multiscatter", &P::multiscatter,
                                     "Add the light that facets scatter more than once.")
                              .initially(0)};
    }
    static constexpr auto rules() {
        return std::array{exclusive("alpha", "roughness", "exponent", "alpha_x"),
                          exclusive("alpha", "roughness", "exponent", "alpha_y"),
                          together("alpha_x", "alpha_y")};
    }

    /// What no table of rules can say; a model's own `check` begins with it.
    ParamError check_shape() const {
        if (this->alpha_x.given && Distribution(distribution.v) == Distribution::kBlinnPhong)
            return {"alpha_x", "blinn_phong is isotropic: give alpha, or take ward with alpha_x"};
        return {};
    }

    Vec2<R> alphas() const {
        if (!exponent.given) return WidthParams<R>::alphas();
        const R a = alpha_from_exponent(exponent.v);
        return {a, a};
    }
    bool any_textured() const { return exponent.textured || WidthParams<R>::any_textured(); }
    Microfacet<R> microfacet() const {
        const Vec2<R> a = alphas();
        return Microfacet<R>::make(a.x, a.y, Distribution(distribution.v), Masking(masking.v));
    }
};

}  // namespace matiere
