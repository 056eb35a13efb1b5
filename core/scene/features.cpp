#include "scene/features.h"

#include <variant>

#include "scene/scene.h"

namespace matiere {

namespace {

Features when(bool condition, Features bits) { return condition ? bits : 0; }

bool plain_lambert(const MaterialRecord& r) {
    return std::holds_alternative<Lambert<float>>(r.recipe.model()) && !r.recipe.textured();
}

Features of_material(const MaterialRecord& r) {
    return when(!plain_lambert(r), kNeedsModels) |
           when((r.features & kFeatureAnisotropic) != 0, kNeedsTangents) |
           when(r.textured(), kNeedsTextures) | when(r.mapped(), kNeedsMaps) |
           when(r.passes, kNeedsPassing) | when(r.has_interior, kNeedsInteriors) |
           when(r.dispersive, kNeedsDispersion) | when(r.scatters, kNeedsScattering) |
           when((r.lobes & kSpecular) != 0, kHasDelta);
}

}  // namespace

bool reads_uv(const MaterialTable& materials, int material) {
    const MaterialRecord& r = materials[material];
    return r.textured() || r.mapped() || (r.features & kFeatureAnisotropic) != 0;
}

Features scan_features(const Scene& scene) {
    const MaterialTable& materials = scene.materials();
    Features found =
        when(scene.caustics() != nullptr, kNeedsGuide) |
        when(!scene.light_layer(false).empty(), kNeedsLightLayer) |
        when(scene.lights().environment() != nullptr, kHasEnvironment) |
        when(!scene.spheres().empty(), kHasSpheres) |
        when(scene.camera().has_lens(), kHasThinLens) |
        when(scene.backdrop() != nullptr, kHasBackdrop) |
        when(scene.lights().has_points(), kHasPointLights) |
        when(!scene.lights().empty() && !scene.lights().is_one_rectangle(), kNeedsLights);
    for (int i = 0; i < materials.size(); ++i)
        found |= of_material(materials[i]) | when(materials[i].emissive, kHasAreaLights);
    for (const auto& mesh : scene.meshes())
        found |= when(mesh->light >= 0, kHasAreaLights) |
                 when(!mesh->normals.empty(), kHasSmoothNormals);
    return found;
}

}  // namespace matiere
