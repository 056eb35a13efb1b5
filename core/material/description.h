// A material as the scene gives it: names and values, not yet checked against the model's table.
#pragma once

#include <array>
#include <map>
#include <memory>
#include <string>
#include <variant>

#include "optics/tensor.h"

namespace matiere {

struct TextureRef {
    int index = -1;  ///< into the scene's TextureTable
    bool operator==(const TextureRef&) const = default;
};

/// How many objects a list has; their parameters have the keys "list/k/name".
struct ListSize {
    int count = 0;
};

struct MaterialDescription;
using NestedDescription = std::shared_ptr<const MaterialDescription>;

using DataRef = std::shared_ptr<const TensorSet>;

/// A number, a linear Rec.709 colour, a word (enum), a flag, a texture, another material, the
/// arrays of a file, or the size of a list.
using ParamValue = std::variant<double, std::array<double, 3>, std::string, bool, TextureRef,
                                NestedDescription, DataRef, ListSize>;

/// Of a nested material only type and params count; its pointer is made from its parent's.
struct MaterialDescription {
    std::string type;  ///< a model name of models.h
    std::map<std::string, ParamValue> params;
    ParamValue emission = 0.0;  ///< radiance [W/m^2/sr]; number, colour or texture
    ParamValue opacity = 1.0;   ///< share of the surface that is there; number or texture
    int normal_map = -1;        ///< texture of tangent-space normals; -1: none
    int bump_map = -1;          ///< texture of heights; -1: none
    double bump_height = 0.01;  ///< height of the texture's 1 [m]
    bool two_sided = true;      ///< opaque models: scatter on both sides; else the back is black
    int priority = 0;           ///< interiors: the higher priority wins where two overlap
    std::string name;
    std::string pointer;  ///< JSON pointer of the material, prefix of every error
};

}  // namespace matiere
