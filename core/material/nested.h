// A material inside another one, as the models that combine materials see it. What it points to is
// made with its parent, at build or at a hit (`record.h`), and lives as long.
#pragma once

#include <optional>
#include <string_view>

#include "material/bsdf.h"

namespace matiere {

template <class R>
struct ModelBox;  // any model of the list: record.h

template <class R>
struct Nested {
    const ModelBox<R>* box = nullptr;

    BsdfEval<R> eval(Vec3<R> wo, Vec3<R> wi) const;
    std::optional<BsdfSample<R>> sample(Vec3<R> wo, Vec3<R> u) const;
    std::string_view name() const;
    std::uint8_t lobes() const;
    /// The part of eval's f that diffuse lobes scatter.
    Spectrum<R> diffuse(Vec3<R> wo, Vec3<R> wi) const;
    /// Share of light that goes straight through as if nothing were there, at every angle.
    R null_share() const;
    /// eval is an unbiased estimate and pdf a stand-in: a sample's weight is not eval / pdf.
    bool is_stochastic() const;
};

}  // namespace matiere
