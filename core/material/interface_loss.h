// Light that the facets of a rough interface scatter more than once, as diffuse lobes on both sides
// that fill the furnace (after Kulla & Conty 2017, reflection and transmission together).
//
// With E the share that single scattering passes on from the side of wo and E' the same from the
// other side, the missing light (1 - E(o)) leaves in proportion to (1 - E(i)) cos on this side, or
// to (1 - E'(i)) cos on the other. Reciprocity ties the shares t that cross: t (1 - E_avg) =
// t' eta^2 (1 - E'_avg). They are taken as t = (1 - F_avg) min(1, (1 - E'_avg) / (1 - E_avg)):
// what Fresnel lets through, as far as the other side has room for it.
#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "material/coat_albedo.h"
#include "material/compensated_lobe.h"
#include "optics/interface_albedo.h"

namespace matiere {

/// The albedo of an interface as seen from one side.
template <class R>
struct InterfaceSide {
    R eta{};  ///< index beyond the surface over that on this side
    const AlbedoTable<R>* table = nullptr;
};

template <class R>
using InterfaceSides = std::vector<InterfaceSide<R>>;

template <class R>
struct InterfaceLoss {
    CoatAlbedo<R> here, there;  ///< from the side of wo, from the other; no table: no compensation
    R eta2{R(1)};
    R crossing{};               ///< share t of the missing light that leaves on the other side
    R per_here{}, per_there{};  ///< 1 / (1 - E_avg)
    LostLobe<R> lobe_here, lobe_there;

    bool on() const { return here.table != nullptr; }

    static InterfaceLoss make(const InterfaceSides<R>& sides, const CoatAlbedo<R>& view, R eta) {
        InterfaceLoss loss;
        loss.here = loss.there = view;
        loss.here.table = find(sides, eta);
        loss.there.table = find(sides, R(1) / eta);
        if (!loss.here.table || !loss.there.table) return {};
        loss.eta2 = eta * eta;
        const R lost_here = average_lost(loss.here);
        const R lost_there = average_lost(loss.there);
        // (1 - F_avg) = eta^2 (1 - F'_avg) by reciprocity; from the side where F is smooth.
        const R denser = std::max(eta, R(1) / eta);
        R through = R(1) - FresnelTerm<R>::dielectric(Spectrum<R>(denser)).average()[0];
        if (eta < R(1)) through *= loss.eta2;
        loss.crossing = through * std::min(R(1), lost_there / lost_here);
        loss.per_here = R(1) / lost_here;
        loss.per_there = R(1) / lost_there;
        loss.lobe_here = LostLobe<R>::make(loss.here, lost_here);
        loss.lobe_there = LostLobe<R>::make(loss.there, lost_there);
        return loss;
    }

    R lost(Vec3<R> w) const { return R(1) - here.raw(w)[0]; }

    /// f |cos| and density of the diffuse lobes; `lost_o` = lost(wo).
    BsdfEval<R> eval(R lost_o, Vec3<R> wi) const {
        if (wi.z > R(0)) {
            const R cosine = cosine_hemisphere_pdf(wi.z) * (R(1) - crossing);
            return {Spectrum<R>(lost_o * lost(wi) * per_here * cosine),
                    (R(1) - crossing) * lobe_here.pdf(wi.z)};
        }
        const R cosine = cosine_hemisphere_pdf(-wi.z) * crossing;
        const R lost_i = R(1) - there.raw({wi.x, wi.y, -wi.z})[0];
        return {Spectrum<R>(lost_o * lost_i * per_there * cosine / eta2),
                crossing * lobe_there.pdf(-wi.z)};
    }

    /// A direction of these lobes; u.x picks the side.
    Vec3<R> sample(Vec3<R> u) const {
        const bool crosses = u.x < crossing;
        const R rest = crosses ? u.x / crossing : (u.x - crossing) / (R(1) - crossing);
        Vec3<R> wi = (crosses ? lobe_there : lobe_here).sample({rest, u.y, u.z});
        if (crosses) wi.z = -wi.z;
        return wi;
    }

 private:
    /// Relative indices that differ by less are the same to a float quotient.
    static constexpr double kSameIndex = 1e-5;

    static const AlbedoTable<R>* find(const InterfaceSides<R>& sides, R eta) {
        const AlbedoTable<R>* best = nullptr;
        R nearest = R(kSameIndex) * eta;
        for (const auto& side : sides) {
            const R gap = std::abs(side.eta - eta);
            if (gap > nearest) continue;
            nearest = gap;
            best = side.table;
        }
        return best;
    }
    static R average_lost(const CoatAlbedo<R>& side) {
        return std::max(R(1) - side.table->lookup_average(side.alpha_row)[0], R(kMinLost));
    }
};

/// Tables for an interior of indices `eta` (one per lane) against every medium of the scene.
template <class R>
const InterfaceSides<R>* tabulate_interface(const AlphaParams<R>& p, const Spectrum<R>& eta,
                                            TableStore<R>& store) {
    InterfaceSides<R> sides;
    const Vec2<R> a = p.alphas();
    const bool one_row = a.x == a.y && !p.any_textured();
    const auto add = [&](double ratio) {
        for (const auto& side : sides)
            if (std::abs(double(side.eta) / ratio - 1.0) < 1e-7) return;
        const MakeAlbedoRow row = [&](double alpha_x, double alpha_y, double azimuth) {
            const Microfacet<double> surface = double_surface(p, alpha_x, alpha_y);
            // At grazing the share goes with the logarithm of the cosine, however rough the
            // surface.
            constexpr double kGrazing = 4e-3;
            const double width = std::min(
                std::hypot(alpha_x * std::cos(azimuth), alpha_y * std::sin(azimuth)), kGrazing);
            return AlbedoRow{width, azimuth, [surface, ratio, one_row](Vec3d wo) {
                                 return Spectrumd(interface_albedo(surface, wo, ratio, one_row));
                             }};
        };
        const int nodes = one_row ? 192 : 96;  // a critical angle bends the share within alpha
        sides.push_back({R(ratio), tabulate_lobe(a, p.any_textured(), row, store, 1.0, nodes)});
    };
    for (const Spectrumd& medium : store.media)
        for (int lane = 0; lane < kActiveLanes; ++lane) {
            const double ratio = double(eta[lane]) / medium[lane];
            if (ratio == 1.0) continue;
            add(ratio);
            add(1.0 / ratio);
        }
    return store.keep(std::make_shared<const InterfaceSides<R>>(std::move(sides)));
}

}  // namespace matiere
