#include "accel/embree_scene.h"

#include "accel/embree_api.h"

namespace matiere {

namespace {

RTCScene handle(const std::shared_ptr<void>& scene) { return RTCScene(scene.get()); }

void sphere_bounds(const RTCBoundsFunctionArguments* args) {
    const Sphere& s = static_cast<const Sphere*>(args->geometryUserPtr)[args->primID];
    RTCBounds& b = *args->bounds_o;
    // One part in 2^20 wider: the box must hold every point that the quadratic can return.
    const float r = s.radius * (1 + 0x1p-20F);
    const float e = (std::abs(s.center.x) + std::abs(s.center.y) + std::abs(s.center.z)) * 0x1p-22F;
    b.lower_x = s.center.x - r - e;
    b.lower_y = s.center.y - r - e;
    b.lower_z = s.center.z - r - e;
    b.upper_x = s.center.x + r + e;
    b.upper_y = s.center.y + r + e;
    b.upper_z = s.center.z + r + e;
}

SphereRay to_sphere_ray(const RTCRay& ray) {
    return {
        {ray.org_x, ray.org_y, ray.org_z}, {ray.dir_x, ray.dir_y, ray.dir_z}, ray.tnear, ray.tfar};
}

void sphere_intersect(const RTCIntersectFunctionNArguments* args) {
    if (args->N != 1 || args->valid[0] == 0) return;
    auto& rayhit = *reinterpret_cast<RTCRayHit*>(args->rayhit);
    const Sphere& sphere = static_cast<const Sphere*>(args->geometryUserPtr)[args->primID];
    const auto t = intersect_sphere(sphere, to_sphere_ray(rayhit.ray));
    if (!t) return;
    rayhit.ray.tfar = *t;
    rayhit.hit.u = rayhit.hit.v = 0;
    rayhit.hit.Ng_x = rayhit.hit.Ng_y = 0;
    rayhit.hit.Ng_z = 1;
    rayhit.hit.geomID = args->geomID;
    rayhit.hit.primID = args->primID;
    rayhit.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
}

void sphere_occluded(const RTCOccludedFunctionNArguments* args) {
    if (args->N != 1 || args->valid[0] == 0) return;
    auto& ray = *reinterpret_cast<RTCRay*>(args->ray);
    const Sphere& sphere = static_cast<const Sphere*>(args->geometryUserPtr)[args->primID];
    if (intersect_sphere(sphere, to_sphere_ray(ray))) ray.tfar = -kInfinity<float>;
}

/// Not 0: on a plane through the origin of an axis the error bound of a point is exactly 0, and so
/// is the distance at which a ray that starts there meets the plane again.
constexpr float kNear = std::numeric_limits<float>::min();

RTCRay to_embree(const Ray& ray) {
    RTCRay r;
    r.org_x = ray.origin.x;
    r.org_y = ray.origin.y;
    r.org_z = ray.origin.z;
    r.dir_x = ray.direction.x;
    r.dir_y = ray.direction.y;
    r.dir_z = ray.direction.z;
    r.tnear = kNear;
    r.tfar = ray.t_max;
    r.time = 0;
    r.mask = ~0U;
    r.id = 0;
    r.flags = 0;
    return r;
}

bool poll_cancel(void* token, double /*progress*/) {
    return !static_cast<const CancelToken*>(token)->cancelled();
}

}  // namespace

EmbreeScene::EmbreeScene(int threads) : device_(threads) {
    RTCScene scene = rtcNewScene(RTCDevice(device_.handle()));
    rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
    rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_MEDIUM);
    scene_ = std::shared_ptr<void>(scene, [](void* s) { rtcReleaseScene(RTCScene(s)); });
}

std::uint32_t EmbreeScene::add_mesh(std::span<const float> positions,
                                    std::span<const std::uint32_t> indices) {
    RTCGeometry g = rtcNewGeometry(RTCDevice(device_.handle()), RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, positions.data(), 0,
                               3 * sizeof(float), positions.size() / 3);
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, indices.data(), 0,
                               3 * sizeof(std::uint32_t), indices.size() / 3);
    rtcCommitGeometry(g);
    const unsigned id = rtcAttachGeometry(handle(scene_), g);
    rtcReleaseGeometry(g);
    device_.check("mesh set-up");
    return id;
}

std::uint32_t EmbreeScene::add_spheres(std::span<const Sphere> spheres) {
    RTCGeometry g = rtcNewGeometry(RTCDevice(device_.handle()), RTC_GEOMETRY_TYPE_USER);
    rtcSetGeometryUserPrimitiveCount(g, unsigned(spheres.size()));
    rtcSetGeometryUserData(g, const_cast<Sphere*>(spheres.data()));
    rtcSetGeometryBoundsFunction(g, sphere_bounds, nullptr);
    rtcSetGeometryIntersectFunction(g, sphere_intersect);
    rtcSetGeometryOccludedFunction(g, sphere_occluded);
    rtcCommitGeometry(g);
    const unsigned id = rtcAttachGeometry(handle(scene_), g);
    rtcReleaseGeometry(g);
    device_.check("sphere set-up");
    return id;
}

void EmbreeScene::commit(const CancelToken* cancel) {
    if (cancel != nullptr)
        rtcSetSceneProgressMonitorFunction(handle(scene_), poll_cancel,
                                           const_cast<CancelToken*>(cancel));
    rtcCommitScene(handle(scene_));
    rtcSetSceneProgressMonitorFunction(handle(scene_), nullptr, nullptr);
    device_.check("scene build");
}

RayHit EmbreeScene::intersect(const Ray& ray) const {
    RTCRayHit r;
    r.ray = to_embree(ray);
    r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    r.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    embree::intersect(handle(scene_), r);
    if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) return {};
    return {r.ray.tfar, r.hit.geomID, r.hit.primID, r.hit.u, r.hit.v};
}

bool EmbreeScene::occluded(const Ray& ray) const {
    RTCRay r = to_embree(ray);
    embree::occluded(handle(scene_), r);
    return r.tfar < 0;
}

}  // namespace matiere
