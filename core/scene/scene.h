// Everything built from a description: geometry, materials, lights, camera. Immutable once built.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "base/features.h"
#include "camera/camera.h"
#include "light/light.h"
#include "material/material.h"
#include "sampling/photon_guide.h"
#include "scene/description.h"
#include "scene/geometry.h"
#include "scene/interior.h"
#include "scene/light_layer.h"
#include "scene/surface_hit.h"

namespace matiere {

struct SceneStats {
    std::uint64_t triangles = 0, spheres = 0, lights = 0, materials = 0;
    std::uint64_t bytes = 0;            ///< our own buffers, without Embree's hierarchy
    std::uint64_t caustic_photons = 0;  ///< what the guide to hidden light rests on; 0: not needed
    double build_s = 0, caustic_s = 0;
};

class Scene {
 public:
    /// Throws SceneError, with the code "cancelled" once `cancel` is raised. `threads` is for the
    /// build alone (0: all processors). A description with `like` takes shapes, textures and maps
    /// from there; SceneError `not_alike` where they do not fit its materials.
    Scene(RenderDescription description, int threads, const CancelToken* cancel = nullptr);

    RayHit intersect(const Ray& ray) const { return shapes_->accel.intersect(ray); }
    bool occluded(const Ray& ray) const { return shapes_->accel.occluded(ray); }
    /// The point of a hit; what the features F do not read is left at its default.
    template <Features F = kEveryFeature>
    [[gnu::always_inline]] SurfaceHit surface(const Ray& ray, const RayHit& hit) const {
        const Geometry& g = *shapes_;
        if (hit.geometry < g.meshes.size())
            return triangle_surface<F>(*g.meshes[hit.geometry], hit.primitive, hit.u, hit.v);
        return sphere_surface<F>(g.spheres[hit.primitive], g.sphere_light[hit.primitive],
                                 hit.primitive, ray.origin + ray.direction * hit.t);
    }
    /// The material of a hit without the rest.
    int material_of(const RayHit& hit) const;

    const FilmDescription& film() const { return film_; }
    const Camera& camera() const { return *camera_; }
    const MaterialTable& materials() const { return *materials_; }
    const LightSet& lights() const { return *lights_; }
    /// What the camera sees behind everything instead of the environment; lights nothing.
    const EnvironmentLight* backdrop() const { return backdrop_.get(); }
    /// The media that the camera stands in.
    const InteriorStack& camera_interior() const { return camera_interior_; }
    /// Whether shadow rays must look at what they meet: media can overlap, so that interfaces lie
    /// hidden, or surfaces let light straight through.
    bool shadows_walk() const { return shadows_walk_; }
    /// Whether a texture has mip levels, so that paths must know how wide they are.
    bool prefilters() const { return prefilters_; }
    const std::vector<std::unique_ptr<Mesh>>& meshes() const { return shapes_->meshes; }
    const std::vector<Sphere>& spheres() const { return shapes_->spheres; }
    /// Where light arrives by way of mirrors and lenses; null where no such light is hard to find.
    const PhotonGuide* caustics() const { return caustics_.empty() ? nullptr : &caustics_; }
    /// The same without the light that paths from the lights bring where there is a light layer.
    const PhotonGuide* caustics_beside_layer() const {
        return caustics_beside_.empty() ? nullptr : &caustics_beside_;
    }
    /// What paths from the lights are for; `all`: also from large lamps. Empty: there is no need.
    const LightLayer& light_layer(bool all) const { return light_layers_[all ? 1 : 0]; }
    /// What the kernels of this scene need, and what else it has.
    Features features() const { return features_; }
    const SceneStats& stats() const { return stats_; }

 private:
    void share(const Scene& like, const RenderDescription& description);
    void build_geometry(RenderDescription& description, int threads, const CancelToken* cancel);
    void add_meshes(Geometry& geometry, std::vector<MeshDescription>&& meshes) const;
    void add_spheres(Geometry& geometry, const std::vector<SphereDescription>& spheres) const;
    std::vector<MaterialUse> material_uses() const;
    void build_lights(const RenderDescription& description, Geometry* fresh);
    float bounding_radius() const;

    FilmDescription film_;
    TextureTable textures_;
    std::unique_ptr<MaterialTable> materials_;
    std::unique_ptr<Camera> camera_;
    std::shared_ptr<const Geometry> shapes_;
    std::unique_ptr<LightSet> lights_;
    std::shared_ptr<const EnvironmentLight> backdrop_;
    InteriorStack camera_interior_;
    PhotonGuide caustics_, caustics_beside_;
    std::array<LightLayer, 2> light_layers_;
    bool shadows_walk_ = false, prefilters_ = false, second_uv_ = false, keep_uv_ = false;
    Features features_ = 0;
    SceneStats stats_;
};

}  // namespace matiere
