// What a material model is. A model is a plain struct of numbers in the local shading frame: the
// normal is +z, wo (to the viewer) lies on the +z side, both directions leave the surface. It knows
// no textures, no world, no scene; `material.h` brings it there.
#pragma once

#include <concepts>
#include <optional>
#include <string_view>

#include "material/bsdf.h"
#include "material/param.h"
#include "optics/directional_albedo.h"

namespace matiere {

/// Facts about a model that hold for every parameter; the scene's feature scan collects them.
enum ModelFeature : std::uint32_t {
    kFeatureReflection = 1,
    kFeatureTransmission = 2,
    kFeatureInterior = 4,         ///< bounds a medium: takes part in the interior stack
    kFeatureAnisotropic = 8,      ///< reads the shading tangent
    kFeatureDelta = 16,           ///< may own a delta lobe
    kFeatureTextured = 32,        ///< set by the material record, never by a model
    kFeatureEmission = 64,        ///< set by the material record, never by a model
    kFeatureNotReciprocal = 128,  ///< f(o, i) = f(i, o) is not promised: measured data
};

template <class M, class R>
concept Model = requires(const M& m, Vec3<R> w, const typename M::Params& params) {
    { M::kName } -> std::convertible_to<std::string_view>;
    { M::kDoc } -> std::convertible_to<std::string_view>;
    { M::kSource } -> std::convertible_to<std::string_view>;
    { M::kFeatures } -> std::convertible_to<std::uint32_t>;
    M::Params::table();
    M::Params::rules();
    { M::prepare(params) } -> std::same_as<M>;
    { m.eval(w, w) } -> std::same_as<BsdfEval<R>>;
    { m.sample(w, w) } -> std::same_as<std::optional<BsdfSample<R>>>;
    { m.lobes() } -> std::same_as<std::uint8_t>;
};

/// A model that needs tables: built once per material, before the first `prepare`, from parameters
/// that are constant or marked textured. `prepare` itself is pure and never allocates.
template <class M, class R>
concept TabulatedModel =
    Model<M, R> &&
    requires(typename M::Params& params, TableStore<R>& tables) { M::tabulate(params, tables); };

/// A model that bounds a medium (where it has `bounds_medium`, if that says so): at a hit it is
/// asked for itself with the relative index of the two media that really meet there (other side
/// over the side of wo).
template <class M, class R>
concept InterfaceModel = Model<M, R> && requires(const M& m, R eta) {
    { m.at_interface(eta) } -> std::same_as<M>;
    { m.interior() };
};

}  // namespace matiere
