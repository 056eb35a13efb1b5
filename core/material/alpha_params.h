// The parameters of a rough surface, shared by every microfacet model: width, shape and masking.
#pragma once

#include "material/param.h"
#include "optics/microfacet.h"

namespace matiere {

inline constexpr double kDefaultAlpha = 0.1;

template <class R>
struct AlphaParams {
    Value<R> alpha, roughness, exponent, alpha_x, alpha_y;
    Value<int> distribution, masking;
    Value<int> multiscatter;  ///< read by models that list its row

    /// Rows for a parameter struct P that derives from this one; `initial` is alpha's default.
    template <class P>
    static constexpr auto rows(double initial = kDefaultAlpha) {
        return std::array{
            scalar<P, R>("alpha", &P::alpha, "Width of the facet slopes; 0 is smooth.")
                .range(0, 1)
                .initially(initial),
            scalar<P, R>("roughness", &P::roughness, "Alternative to alpha: alpha = roughness^2.")
                .range(0, 1),
            scalar<P, R>("exponent", &P::exponent,
                         "Alternative to alpha, as of Blinn-Phong: alpha^2 = 2 / (exponent + 2).")
                .range(0, kMaxExponent),
            scalar<P, R>("alpha_x", &P::alpha_x, "Width along the tangent.").range(0, 1),
            scalar<P, R>("alpha_y", &P::alpha_y, "Width across the tangent.").range(0, 1),
            choice<P, R>("distribution", &P::distribution, kDistributionNames,
                         "Distribution of the facet normals; ward is the anisotropic beckmann.")
                .initially(0),
            choice<P, R>("masking", &P::masking, kMaskingNames,
                         "Shadowing and masking: smith is height-correlated.")
                .initially(0)};
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
        if (alpha_x.given && Distribution(distribution.v) == Distribution::kBlinnPhong)
            return {"alpha_x", "blinn_phong is isotropic: give alpha, or take ward with alpha_x"};
        return {};
    }

    Vec2<R> alphas() const {
        if (alpha_x.given) return {alpha_x.v, alpha_y.v};
        const R a = roughness.given  ? alpha_from_roughness(roughness.v)
                    : exponent.given ? alpha_from_exponent(exponent.v)
                                     : alpha.v;
        return {a, a};
    }
    bool any_textured() const {
        return alpha.textured || roughness.textured || exponent.textured || alpha_x.textured ||
               alpha_y.textured;
    }
    Microfacet<R> microfacet() const {
        const Vec2<R> a = alphas();
        return Microfacet<R>::make(a.x, a.y, Distribution(distribution.v), Masking(masking.v));
    }
};

}  // namespace matiere
