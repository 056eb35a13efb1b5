// From a description to a model: every parameter is a constant, a texture or another material. All
// constant: the model is prepared once. Otherwise the parameters are completed at each hit, those
// of nested materials first, and prepared there.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <span>
#include <type_traits>
#include <vector>

#include "material/description.h"
#include "material/models.h"
#include "texture/texture.h"

namespace matiere {

/// A parameter that a texture fills: row of the model's table, texture of the scene.
struct TextureSlot {
    std::uint8_t row = 0;
    int texture = -1;
};

/// Any model, as something that can be named before the list is complete.
template <class R>
struct ModelBox {
    AnyModel<R> model;
};

/// Materials inside one material, at all depths together.
inline constexpr int kMaxNested = 8;

/// Room for the nested models that one hit makes; neither allocates nor clears anything.
template <class R>
class NestedModels {
 public:
    const ModelBox<R>* add(const AnyModel<R>& model) {
        static_assert(std::is_trivially_copyable_v<AnyModel<R>>);
        return new (room_.data() + sizeof(ModelBox<R>) * std::size_t(used_++)) ModelBox<R>{model};
    }

 private:
    alignas(ModelBox<R>) std::array<std::byte, sizeof(ModelBox<R>) * kMaxNested> room_;
    int used_ = 0;
};

template <class R>
struct ModelRecipe;

template <class R>
struct NestedSlot {
    std::uint8_t row = 0;
    std::unique_ptr<ModelRecipe<R>> recipe;
};

template <class R>
struct ModelRecipe {
    ModelBox<R> made;     ///< prepared; where textured, from the textures' maxima
    AnyParams<R> params;  ///< constants filled in, textured rows still at their defaults
    std::vector<TextureSlot> slots;
    std::vector<NestedSlot<R>> nested;

    const AnyModel<R>& model() const { return made.model; }
    /// Textures decide, here or in a nested material.
    bool textured() const;
    /// The part that bounds a medium: this recipe, a nested one, or none.
    const ModelRecipe* interface() const;
    /// ModelFeature bits and lobes of all parts together.
    std::uint32_t features() const;
    std::uint8_t lobes() const;
    int nested_count() const;

    /// The model at a hit. Interfaces see the relative index `eta_rel` (other side over wo's).
    AnyModel<R> at(const TextureTable& textures, const TexturePoint& point, R eta_rel,
                   NestedModels<R>& nested) const;
};

/// Indices of refraction of the interiors that a description bounds, as far as it states them:
/// known before anything is made, so that interfaces can prepare for each other.
std::vector<Spectrumd> interior_indices(const MaterialDescription& description);

/// Checks names, kinds, ranges and rules against the model's table. Throws SceneError with the JSON
/// pointer of the bad value.
template <class R>
ModelRecipe<R> make_recipe(const MaterialDescription& description, const TextureTable& textures,
                           TableStore<R>& tables);

/// Calls of a model, whichever it is; none scatters nothing.
template <class R>
BsdfEval<R> eval_model(const AnyModel<R>& model, Vec3<R> wo, Vec3<R> wi) {
    return visit_model(model, [&]<class M>(const M& m) -> BsdfEval<R> {
        if constexpr (std::same_as<M, std::monostate>)
            return {};
        else
            return m.eval(wo, wi);
    });
}
template <class R>
std::optional<BsdfSample<R>> sample_model(const AnyModel<R>& model, Vec3<R> wo, Vec3<R> u) {
    return visit_model(model, [&]<class M>(const M& m) -> std::optional<BsdfSample<R>> {
        if constexpr (std::same_as<M, std::monostate>)
            return {};
        else
            return m.sample(wo, u);
    });
}
template <class R>
std::uint8_t model_lobes(const AnyModel<R>& model) {
    return visit_model(model, []<class M>(const M& m) -> std::uint8_t {
        if constexpr (std::same_as<M, std::monostate>)
            return 0;
        else
            return m.lobes();
    });
}
/// The part of f cos that diffuse lobes scatter back. A model with diffuse and other lobes says it
/// by `diffuse`; of the others it is all or nothing.
template <class R>
Spectrum<R> model_diffuse(const AnyModel<R>& model, Vec3<R> wo, Vec3<R> wi) {
    return visit_model(model, [&]<class M>(const M& m) -> Spectrum<R> {
        if constexpr (requires { m.diffuse(wo, wi); })
            return m.diffuse(wo, wi);
        else if constexpr (std::same_as<M, std::monostate>)
            return {};
        else
            return m.lobes() == (kDiffuse | kReflection) ? m.eval(wo, wi).f : Spectrum<R>();
    });
}
/// Share of light that goes straight through.
template <class R>
R model_null_share(const AnyModel<R>& model) {
    return visit_model(model, []<class M>(const M& m) -> R {
        if constexpr (requires { m.null_share(); })
            return m.null_share();
        else
            return R(0);
    });
}
template <class R>
bool model_is_stochastic(const AnyModel<R>& model) {
    return visit_model(model, []<class M>(const M& m) {
        if constexpr (requires { m.is_stochastic(); })
            return m.is_stochastic();
        else
            return false;
    });
}

// Code for every model: made in dispatch.cpp alone.
extern template BsdfEval<float> eval_model<float>(const AnyModel<float>&, Vec3<float>, Vec3<float>);
extern template std::optional<BsdfSample<float>> sample_model<float>(const AnyModel<float>&,
                                                                     Vec3<float>, Vec3<float>);
extern template std::uint8_t model_lobes<float>(const AnyModel<float>&);

}  // namespace matiere
