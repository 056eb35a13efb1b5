// From a description to a model: every parameter is a constant or a texture. All constant: the
// model is prepared once. Otherwise the parameters are completed at each hit and prepared there.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
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

template <class R>
struct ModelRecipe {
    AnyModel<R> model;    ///< prepared; where textured, from the textures' maxima
    AnyParams<R> params;  ///< constants filled in, textured rows still at their defaults
    std::vector<TextureSlot> slots;

    bool textured() const { return !slots.empty(); }
    /// The model at a hit of a textured recipe.
    AnyModel<R> at(const TextureTable& textures, Vec2f uv) const;
};

/// Checks names, kinds, ranges and rules against the model's table. Throws SceneError with the JSON
/// pointer of the bad value.
template <class R>
ModelRecipe<R> make_recipe(const MaterialDescription& description, const TextureTable& textures,
                           TableStore<R>& tables);

}  // namespace matiere
