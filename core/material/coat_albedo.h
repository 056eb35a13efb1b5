// Directional albedo of a rough Fresnel surface, as models use it: a view of a table, or the exact
// reflectance where the surface is smooth.
#pragma once

#include <functional>
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
    const AlbedoTable<R>* white = nullptr;  ///< of F = 1: the coat's multiple scattering is its own
    Spectrum<R> returned{};                 ///< share of the light lost there that comes back

    /// Rows are uniform in this coordinate of the width seen from an azimuth.
    static R azimuth_row(R alpha_x, R alpha_y, Vec3<R> w) {
        const R xy2 = w.x * w.x + w.y * w.y;
        const R low = std::min(alpha_x, alpha_y);
        const R width = std::max(alpha_x, alpha_y) - low;
        if (!(xy2 > R(0)) || !(width > R(0))) return R(0);
        const R seen = std::sqrt((sqr(alpha_x * w.x) + sqr(alpha_y * w.y)) / xy2);
        return (seen - low) / width;
    }

    R row(Vec3<R> w) const {
        return alpha_x != alpha_y ? azimuth_row(alpha_x, alpha_y, w) : alpha_row;
    }
    /// What the table holds; there must be one.
    Spectrum<R> raw(Vec3<R> w) const { return table->lookup(w.z, row(w)); }

    Spectrum<R> operator()(Vec3<R> w, const FresnelTerm<R>& fresnel) const {
        if (!table) return fresnel(w.z);
        const Spectrum<R> e = raw(w);
        const Spectrum<R> single = fresnel.is_linear() ? fresnel.combine(e) : e;
        return white ? single + returned * (R(1) - white->lookup(w.z, row(w))[0]) : single;
    }

    Spectrum<R> average(const FresnelTerm<R>& fresnel) const {
        const Spectrum<R> e = table ? table->lookup_average(alpha_row) : smooth_average;
        const Spectrum<R> single = fresnel.is_linear() ? fresnel.combine(e) : e;
        return table && white ? single + returned * (R(1) - white->lookup_average(alpha_row)[0])
                              : single;
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
    const AlbedoTable<R>* white = nullptr;  ///< of F = 1, where multiple scattering is asked for

    /// The view for the widths of one hit.
    CoatAlbedo<R> view(Vec2<R> a, bool textured) const {
        const bool by_azimuth = a.x != a.y;
        const R row = textured ? kAlphaStretch<R>.forward(a.x) : R(0);
        return {table, smooth_average, row, by_azimuth ? a.x : R(1), by_azimuth ? a.y : R(1)};
    }
    /// The same for F = 1.
    CoatAlbedo<R> white_view(const AlphaParams<R>& p) const {
        CoatAlbedo<R> v = view(p);
        v.table = white;
        return v;
    }
    CoatAlbedo<R> view(const AlphaParams<R>& p) const { return view(p.alphas(), p.any_textured()); }
};

/// Unequal widths shape a table over azimuth, so they must be constant where a coat needs one.
template <class R>
ParamError check_coat_textures(const AlphaParams<R>& p) {
    if (p.alpha_x.textured)
        return {"alpha_x", "beside a diffuse body or multiscatter alpha_x takes no texture"};
    if (p.alpha_y.textured)
        return {"alpha_y", "beside a diffuse body or multiscatter alpha_y takes no texture"};
    return p.check_shape();
}

template <class R>
Microfacet<double> double_surface(const AlphaParams<R>& p, double alpha_x, double alpha_y) {
    return Microfacet<double>::make(alpha_x, alpha_y, Distribution(p.distribution.v),
                                    Masking(p.masking.v));
}

/// Makes the row of a lobe of two widths (alpha_x, alpha_y) seen from an azimuth [rad].
using MakeAlbedoRow = std::function<AlbedoRow(double, double, double)>;

/// The lobes whose albedo a material needs: one; one per alpha where that is a texture; one per
/// azimuth where it is anisotropic.
inline std::vector<AlbedoRow> coat_rows(Vec2<double> a, bool textured, const MakeAlbedoRow& make) {
    std::vector<AlbedoRow> rows;
    if (textured) {
        for (int i = 0; i < kAlphaRows; ++i) {
            const double alpha = kAlphaStretch<double>.backward(double(i) / (kAlphaRows - 1));
            rows.push_back(make(alpha, alpha, 0.0));
        }
    } else if (a.x != a.y) {
        const double low = std::min(a.x, a.y);
        const double high = std::max(a.x, a.y);
        for (int i = 0; i < kAzimuthRows; ++i) {
            const double seen = low + (high - low) * i / (kAzimuthRows - 1);
            const double part = std::sqrt(((seen - low) * (seen + low)) /
                                          ((high - low) * (high + low)));  // sine from the low axis
            const double phi = std::asin(std::min(part, 1.0));
            rows.push_back(make(a.x, a.y, a.x < a.y ? phi : kPi<double> / 2 - phi));
        }
    } else {
        rows.push_back(make(a.x, a.y, 0.0));
    }
    return rows;
}

/// Anisotropic: one average for all rows, over azimuth too.
inline void average_over_azimuth(AlbedoTable<double>& table, Vec2<double> a) {
    constexpr int kAngles = 256;
    Spectrumd sum;
    for (int j = 0; j < kAngles; ++j) {
        const double phi = (j + 0.5) * kPi<double> / 2 / kAngles;
        const Vec3d w{std::cos(phi), std::sin(phi), 0};
        sum += table.lookup_average(CoatAlbedo<double>::azimuth_row(a.x, a.y, w)) * (1.0 / kAngles);
    }
    for (auto& average : table.average) average = sum;
}

/// Tables of a lobe whose widths are constant, or (textured) equal and not.
template <class R>
const AlbedoTable<R>* tabulate_lobe(Vec2<R> widths, bool textured, const MakeAlbedoRow& make,
                                    TableStore<R>& store, double ceiling = 1.0,
                                    int nodes = AlbedoTable<double>::kNodes) {
    const Vec2<double> a{double(widths.x), double(widths.y)};
    AlbedoTable<double> table = tabulate_albedo(coat_rows(a, textured, make), ceiling, nodes);
    if (!textured && a.x != a.y) average_over_azimuth(table, a);
    return store.add(table.template cast<R>());
}

/// The albedo of the surface with F = 1, or null where it is smooth.
template <class R>
const AlbedoTable<R>* tabulate_white(const AlphaParams<R>& p, TableStore<R>& store) {
    const Vec2<R> a = p.alphas();
    if (!p.any_textured() && is_delta_alpha(a.x, a.y)) return nullptr;
    const MakeAlbedoRow row = [&](double alpha_x, double alpha_y, double azimuth) {
        return surface_row(double_surface(p, alpha_x, alpha_y), azimuth,
                           [](double) { return Spectrumd(1.0); });
    };
    return tabulate_lobe(a, p.any_textured(), row, store);
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
    const MakeAlbedoRow row = [&](double alpha_x, double alpha_y, double azimuth) {
        return surface_row(double_surface(p, alpha_x, alpha_y), azimuth, reflectance);
    };
    made.table = tabulate_lobe(a, p.any_textured(), row, store);
    return made;
}

/// What a surface of given widths and Fresnel term reflects at most, over all angles of view.
template <class R>
Spectrum<R> largest_coat_albedo(const AlphaParams<R>& p, const FresnelTerm<R>& fresnel) {
    constexpr int kAngles = 32, kAzimuths = 4;
    const Vec2<R> a = p.alphas();
    if (p.any_textured() || is_delta_alpha(a.x, a.y)) return Spectrum<R>(R(1));
    const FresnelTerm<double> exact = fresnel.template cast<double>();
    const auto surface = double_surface(p, double(a.x), double(a.y));
    Spectrum<R> most;
    for (int k = 0; k < kAngles * kAzimuths; ++k) {
        const double theta = kPi<double> / 2 * (k / kAzimuths + 0.5) / kAngles;
        const double phi = kPi<double> / 2 * (k % kAzimuths) / (kAzimuths - 1);
        const double s = std::sin(theta);
        const Vec3d wo{s * std::cos(phi), s * std::sin(phi), std::cos(theta)};
        const Spectrumd e = directional_albedo(surface, wo, exact);
        for (int i = 0; i < kActiveLanes; ++i) most[i] = std::max(most[i], R(e[i]));
    }
    return most;
}

}  // namespace matiere
