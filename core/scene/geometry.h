// Meshes, spheres and the acceleration structure over them: what scenes that differ in their
// materials may have in common. Immutable once its first scene is built.
#pragma once

#include <memory>
#include <vector>

#include "accel/embree_scene.h"
#include "shape/mesh.h"
#include "shape/sphere.h"

namespace matiere {

/// What a geometry keeps of a material that shapes it.
struct MaterialUse {
    bool emissive = false, reads_uv = false;

    bool operator==(const MaterialUse&) const = default;
};

struct Geometry {
    explicit Geometry(int threads) : accel(threads) {}

    std::vector<std::unique_ptr<Mesh>> meshes;  ///< geometry id = index
    std::vector<Sphere> spheres;                ///< geometry id = meshes.size()
    std::vector<int> sphere_light;
    EmbreeScene accel;
    std::vector<MaterialUse> uses;  ///< by material
    bool keep_uv = false, second_uv = false;
};

}  // namespace matiere
