// Directional albedo of a rough Fresnel surface, as models use it: a view of a table, or the exact
// reflectance where the surface is smooth.
#pragma once

#include <vector>

#include "material/alpha_params.h"
#include "optics/albedo_builder.h"
#include "optics/fresnel_term.h"

namespace matiere {

template <class R>
struct CoatAlbedo {
    const AlbedoTable<R>* table = nullptr;  ///< null: smooth, E is the Fresnel reflectance
    Spectrum<R> smooth_average;             ///< its cosine average, where smooth
    R alpha_row{};                          ///< place of a textured alpha among the rows
    R alpha_x{R(1)}, alpha_y{R(1)};         ///< unequal: the rows go over azimuth

    /// Rows are uniform in this coordinate of the width seen from an azimuth.
    static R azimuth_row(R alpha_x, R alpha_y, Vec3<R> w) {
        const R xy2 = w.x * w.x + w.y * w.y;
        const R low = std::min(alpha_x, alpha_y);
        const R width = std::max(alpha_x, alpha_y) - low;
        if (!(xy2 > R(0)) || !(width > R(0))) return R(0);
        const R seen = std::sqrt((sqr(alpha_x * w.x) + sqr(alpha_y * w.y)) / xy2);
        return (seen - low) / width;
    }

    Spectrum<R> operator()(Vec3<R> w, const FresnelTerm<R>& fresnel) const {
        if (!table) return fresnel(w.z);
        const R row = alpha_x != alpha_y ? azimuth_row(alpha_x, alpha_y, w) : alpha_row;
        const Spectrum<R> e = table->lookup(w.z, row);
        return fresnel.is_linear() ? fresnel.combine(e) : e;
    }

    Spectrum<R> average(const FresnelTerm<R>& fresnel) const {
        const Spectrum<R> e = table ? table->lookup_average(alpha_row) : smooth_average;
        return fresnel.is_linear() ? fresnel.combine(e) : e;
    }
};

/// Rows over a textured alpha are uniform in alpha stretched by this scale.
inline constexpr int kAlphaRows = 64;
inline constexpr double kAlphaScale = 3e-4;

template <class R>
inline const Stretch<R> kAlphaStretch = Stretch<R>::make(R(kAlphaScale));
inline constexpr int kAzimuthRows = 24;

/// What `tabulate` of a model with a coat leaves in its parameters.
template <class R>
struct CoatTables {
    const AlbedoTable<R>* table = nullptr;
    Spectrum<R> smooth_average;

    /// The view for parameters of one hit.
    CoatAlbedo<R> view(const AlphaParams<R>& p) const {
        const Vec2<R> a = p.alphas();
        const bool by_azimuth = a.x != a.y;
        const R row = p.any_textured() ? kAlphaStretch<R>.forward(a.x) : R(0);
        return {table, smooth_average, row, by_azimuth ? a.x : R(1), by_azimuth ? a.y : R(1)};
    }
};

/// Unequal widths shape a table over azimuth, so they must be constant where a coat needs one.
template <class R>
ParamError check_coat_textures(const AlphaParams<R>& p) {
    if (p.alpha_x.textured) return {"alpha_x", "alpha_x over a diffuse body takes no texture"};
    if (p.alpha_y.textured) return {"alpha_y", "alpha_y over a diffuse body takes no texture"};
    return p.check_shape();
}

template <class R>
Microfacet<double> double_surface(const AlphaParams<R>& p, double alpha_x, double alpha_y) {
    return Microfacet<double>::make(alpha_x, alpha_y, Distribution(p.distribution.v),
                                    Masking(p.masking.v));
}

/// The surfaces whose albedo a material needs: one; one per alpha where that is a texture; one per
/// azimuth where it is anisotropic.
template <class R>
std::vector<AlbedoRow> coat_rows(const AlphaParams<R>& p) {
    std::vector<AlbedoRow> rows;
    const Vec2<R> a = p.alphas();
    if (p.any_textured()) {
        for (int i = 0; i < kAlphaRows; ++i) {
            const double alpha = kAlphaStretch<double>.backward(double(i) / (kAlphaRows - 1));
            rows.push_back({double_surface(p, alpha, alpha)});
        }
    } else if (a.x != a.y) {
        const double low = double(std::min(a.x, a.y));
        const double high = double(std::max(a.x, a.y));
        for (int i = 0; i < kAzimuthRows; ++i) {
            const double seen = low + (high - low) * i / (kAzimuthRows - 1);
            const double part = std::sqrt(((seen - low) * (seen + low)) /
                                          ((high - low) * (high + low)));  // sine from the low axis
            const double phi = std::asin(std::min(part, 1.0));
            rows.push_back({double_surface(p, double(a.x), double(a.y)),
                            a.x < a.y ? phi : kPi<double> / 2 - phi});
        }
    } else {
        rows.push_back({double_surface(p, double(a.x), double(a.y))});
    }
    return rows;
}

/// Anisotropic: one average for all rows, over azimuth too.
template <class R>
void average_over_azimuth(AlbedoTable<double>& table, const AlphaParams<R>& p) {
    constexpr int kAngles = 256;
    const double ax = double(p.alphas().x), ay = double(p.alphas().y);
    Spectrumd sum;
    for (int j = 0; j < kAngles; ++j) {
        const double phi = (j + 0.5) * kPi<double> / 2 / kAngles;
        const double t = CoatAlbedo<double>::azimuth_row(ax, ay, {std::cos(phi), std::sin(phi), 0});
        sum += table.lookup_average(t) * (1.0 / kAngles);
    }
    for (auto& average : table.average) average = sum;
}

template <class R>
CoatTables<R> tabulate_coat(const AlphaParams<R>& p, const FresnelTerm<R>& fresnel,
                            TableStore<R>& store) {
    const FresnelTerm<double> exact = fresnel.template cast<double>();
    const FacetReflectance reflectance = [exact](double c) {
        return exact.is_linear() ? FresnelTerm<double>::terms(c) : exact(c);
    };
    CoatTables<R> made;
    made.smooth_average = spectrum_cast<R>(cosine_average(reflectance));
    const Vec2<R> a = p.alphas();
    if (!p.any_textured() && is_delta_alpha(a.x, a.y)) return made;
    AlbedoTable<double> table = tabulate_albedo(coat_rows(p), reflectance);
    if (!p.any_textured() && a.x != a.y) average_over_azimuth(table, p);
    made.table = store.add(table.template cast<R>());
    return made;
}

}  // namespace matiere
