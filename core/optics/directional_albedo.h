// Tables of directional albedo: what share of the light from one direction a lobe scatters at all.
// Energy couplings (plastic, diffuse under a specular lobe) are built on them.
#pragma once

#include <algorithm>
#include <cmath>
#include <deque>
#include <memory>
#include <utility>
#include <vector>

#include "base/spectrum.h"

namespace matiere {

/// A stretched coordinate: [0, 1] to [0, 1], linear below `scale`, logarithmic above.
template <class R>
struct Stretch {
    R inverse_scale{R(1)};
    R inverse_log{R(1)};

    static Stretch make(R scale) { return {R(1) / scale, R(1) / std::log1p(R(1) / scale)}; }
    /// Without log1p: near 0 an absolute error of a rounding does no harm to a table.
    R forward(R x) const { return std::log(R(1) + x * inverse_scale) * inverse_log; }
    R backward(R t) const { return std::expm1(t / inverse_log) / inverse_scale; }

    R slope(R x) const { return inverse_scale * inverse_log / (R(1) + x * inverse_scale); }

    template <class To>
    Stretch<To> cast() const {
        return {To(inverse_scale), To(inverse_log)};
    }
};

/// Directional albedo over (cos theta, one more axis), three lanes: RGB, or three terms that a
/// model combines. Nodes in cos theta are stretched: grazing masking has the scale of alpha.
/// The second axis t in [0, 1] is whatever the model varies (alpha of a texture, azimuth).
template <class R>
struct AlbedoTable {
    static constexpr int kNodes = 64;  ///< enough unless a critical angle bends the albedo

    int nodes = kNodes;
    std::vector<Spectrum<R>> E;        ///< [row][node]
    std::vector<Spectrum<R>> average;  ///< [row]: 2 * integral of E(mu) mu dmu
    std::vector<Stretch<R>> stretch;   ///< [row]: of the cosine
    R ceiling{R(1)};                   ///< above 1 only for lobes that gain energy

    /// Scale of the cosine for a surface of width alpha.
    static R cosine_scale(R alpha) {
        return alpha > R(0) ? std::clamp(R(0.5) * alpha, R(1e-6), R(0.02)) : R(0.02);
    }

    int rows() const { return int(average.size()); }
    R node_cosine(int row, int i) const {
        return std::min(stretch[std::size_t(row)].backward(R(i) / R(nodes - 1)), R(1));
    }

    template <class To>
    AlbedoTable<To> cast() const {
        AlbedoTable<To> t;
        t.nodes = nodes;
        for (const auto& e : E) t.E.push_back(spectrum_cast<To>(e));
        for (const auto& a : average) t.average.push_back(spectrum_cast<To>(a));
        for (const auto& s : stretch) t.stretch.push_back(s.template cast<To>());
        t.ceiling = To(ceiling);
        return t;
    }

    Spectrum<R> lookup(R cos_theta, R t = R(0)) const {
        if (rows() == 1) return row_value(0, cos_theta);
        const auto [row, w] = row_position(t);
        return row_value(row, cos_theta) * (R(1) - w) + row_value(row + 1, cos_theta) * w;
    }

    Spectrum<R> lookup_average(R t = R(0)) const {
        if (rows() == 1) return average[0];
        const auto [row, w] = row_position(t);
        return average[std::size_t(row)] * (R(1) - w) + average[std::size_t(row) + 1] * w;
    }

 private:
    std::pair<int, R> row_position(R t) const {
        const R x = std::clamp(t, R(0), R(1)) * R(rows() - 1);
        const int row = std::min(int(x), rows() - 2);
        return {row, x - R(row)};
    }

    /// Cubic through four nodes (Catmull-Rom inside, one-sided at the ends).
    Spectrum<R> row_value(int row, R cos_theta) const {
        const R mu = std::clamp(cos_theta, R(0), R(1));
        const R x = std::min(stretch[std::size_t(row)].forward(mu), R(1)) * R(nodes - 1);
        const int i = std::min(int(x), nodes - 2);
        const R w = x - R(i);
        const Spectrum<R>* e = &E[std::size_t(row) * std::size_t(nodes)];
        const Spectrum<R>& b = e[i];
        const Spectrum<R>& c = e[i + 1];
        const Spectrum<R> a = i > 0 ? e[i - 1] : b * R(2) - c;
        const Spectrum<R> d = i + 2 < nodes ? e[i + 2] : c * R(2) - b;
        const R w2 = w * w;
        const R w3 = w2 * w;
        const Spectrum<R> value = b + (c - a) * (R(0.5) * w) +
                                  (a * R(2) - b * R(5) + c * R(4) - d) * (R(0.5) * w2) +
                                  (b * R(3) - a - c * R(3) + d) * (R(0.5) * w3);
        return value.map([this](R v) { return std::clamp(v, R(0), ceiling); });
    }
};

/// Owns the immutable tables of the materials of one scene; models keep const views into it.
template <class R>
class TableStore {
 public:
    /// Indices of refraction that an interface of this scene may meet on its outside: the vacuum,
    /// and the interiors of its materials, per lane.
    std::vector<Spectrumd> media{Spectrumd(1.0)};

    const AlbedoTable<R>* add(AlbedoTable<R> table) {
        return &tables_.emplace_back(std::move(table));
    }
    template <class T>
    const T* keep(std::shared_ptr<const T> any) {
        kept_.push_back(any);
        return any.get();
    }

 private:
    std::deque<AlbedoTable<R>> tables_;  // a deque: views stay valid while it grows
    std::vector<std::shared_ptr<const void>> kept_;
};

}  // namespace matiere
