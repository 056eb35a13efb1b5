// The widths of a rough lobe as users give them: alpha, or roughness, or one width per axis.
#pragma once

#include "base/vec.h"
#include "material/param.h"
#include "optics/roughness.h"

namespace matiere {

template <class R>
struct WidthParams {
    Value<R> alpha, roughness, alpha_x, alpha_y;

    /// Rows for a parameter struct P that derives from this one; `initial` is alpha's default.
    template <class P>
    static constexpr auto rows(double initial) {
        return std::array{
            scalar<P, R>("alpha", &P::alpha, "Width of the facet slopes; 0 is smooth.")
                .range(0, 1)
                .initially(initial),
            scalar<P, R>("roughness", &P::roughness, "Alternative to alpha: alpha = roughness^2.")
                .range(0, 1),
            scalar<P, R>("alpha_x", &P::alpha_x, "Width along the tangent.").range(0, 1),
            scalar<P, R>("alpha_y", &P::alpha_y, "Width across the tangent.").range(0, 1)};
    }
    static constexpr auto rules() {
        return std::array{exclusive("alpha", "roughness", "alpha_x"),
                          exclusive("alpha", "roughness", "alpha_y"),
                          together("alpha_x", "alpha_y")};
    }

    Vec2<R> alphas() const {
        if (alpha_x.given) return {alpha_x.v, alpha_y.v};
        const R a = roughness.given ? alpha_from_roughness(roughness.v) : alpha.v;
        return {a, a};
    }
    bool any_textured() const {
        return alpha.textured || roughness.textured || alpha_x.textured || alpha_y.textured;
    }
};

}  // namespace matiere
