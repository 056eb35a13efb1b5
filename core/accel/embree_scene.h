// The acceleration structure over triangle meshes and spheres.
#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "accel/embree_device.h"
#include "base/parallel.h"
#include "base/vec.h"
#include "shape/sphere.h"

namespace matiere {

struct Ray {
    Vec3f origin;
    Vec3f direction;  ///< need not be unit; t is in multiples of it
    float t_max = kInfinity<float>;
};

struct RayHit {
    float t = kInfinity<float>;
    std::uint32_t geometry = kMiss;
    std::uint32_t primitive = 0;
    float u = 0, v = 0;  ///< barycentric weights of vertices 1 and 2 (triangles)

    static constexpr std::uint32_t kMiss = ~std::uint32_t(0);
    bool missed() const { return geometry == kMiss; }
};

/// Built with RTC_SCENE_FLAG_ROBUST (watertight at edges) and MEDIUM quality: HIGH is not
/// repeatable.
class EmbreeScene {
 public:
    explicit EmbreeScene(int threads);

    /// Both return the geometry id of later hits. `positions` must stay alive and hold one float
    /// more than 3 per vertex (Embree reads 16 bytes at the last vertex).
    std::uint32_t add_mesh(std::span<const float> positions,
                           std::span<const std::uint32_t> indices);
    /// One geometry for all spheres; `spheres` must stay alive.
    std::uint32_t add_spheres(std::span<const Sphere> spheres);
    /// Builds the hierarchy; polls `cancel` if given.
    void commit(const CancelToken* cancel);

    RayHit intersect(const Ray& ray) const;
    bool occluded(const Ray& ray) const;

 private:
    EmbreeDevice device_;
    std::shared_ptr<void> scene_;
};

}  // namespace matiere
