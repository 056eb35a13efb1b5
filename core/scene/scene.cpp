#include "scene/scene.h"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "base/error.h"
#include "scene/caustics.h"
#include "scene/features.h"
#include "scene/media_at.h"

namespace matiere {

namespace {

void check_mesh(const MeshDescription& m, int materials) {
    const std::size_t vertices = m.positions.size() / 3;
    for (const float x : m.positions)
        if (!std::isfinite(x))
            throw SceneError("not_finite",
                             "mesh '" + m.name + "' has a position that is not finite",
                             m.pointer + "/positions");
    for (const std::uint32_t i : m.triangles)
        if (i >= vertices)
            throw SceneError("index_range",
                             "triangle index " + std::to_string(i) +
                                 " is not below the vertex count " + std::to_string(vertices),
                             m.pointer + "/triangles");
    if (!m.normals.empty() && m.normals.size() != m.positions.size())
        throw SceneError("normals", "a mesh needs one normal per vertex or none",
                         m.pointer + "/normals");
    for (const auto& [values, name] : {std::pair(&m.uv, "/uv"), std::pair(&m.uv1, "/uv1")})
        if (!values->empty() && values->size() != vertices * 2)
            throw SceneError("uv", "a mesh needs one uv pair per vertex or none", m.pointer + name);
    if (m.material < 0 || m.material >= materials)
        throw SceneError("material", "mesh '" + m.name + "' has no material",
                         m.pointer + "/material");
}

MeshDescription rectangle_mesh(const RectangleLightDescription& r) {
    MeshDescription m;
    for (const Vec3f p :
         {r.corner, r.corner + r.edge_u, r.corner + r.edge_u + r.edge_v, r.corner + r.edge_v}) {
        m.positions.push_back(p.x);
        m.positions.push_back(p.y);
        m.positions.push_back(p.z);
    }
    m.triangles = {0, 1, 2, 0, 2, 3};
    return m;
}

std::unique_ptr<Mesh> make_mesh(MeshDescription&& d) {
    auto mesh = std::make_unique<Mesh>();
    mesh->positions = std::move(d.positions);
    mesh->positions.push_back(0);
    mesh->indices = std::move(d.triangles);
    mesh->normals = std::move(d.normals);
    mesh->uv = std::move(d.uv);
    mesh->uv1 = std::move(d.uv1);
    mesh->material = d.material;
    return mesh;
}

SpotLight spot_light(const SpotLightDescription& d) {
    const auto cosine = [](double deg) { return float(std::cos(deg * kPi<double> / 180)); };
    return {d.position, normalize(d.direction), d.intensity, cosine(d.outer_deg),
            cosine(d.inner_deg)};
}

ProfileLight profile_light(const ProfileLightDescription& d) {
    constexpr float kEverywhere = -2;  // below every cosine
    SpotLight spot = spot_light(d.spot);
    if (!d.cone) spot.cos_outer = spot.cos_inner = kEverywhere;
    return {spot, ProfileFrame::hung(spot.direction, d.rotation_deg),
            std::make_shared<LightProfile>(d.vertical_deg, d.horizontal_deg, d.values)};
}

std::vector<RectangleShape> portal_shapes(const std::vector<PortalDescription>& portals) {
    std::vector<RectangleShape> shapes;
    for (const PortalDescription& p : portals) {
        shapes.emplace_back(p.corner, p.edge_u, p.edge_v);
        if (!(shapes.back().area > 0))
            throw SceneError("degenerate_light", "edge_u and edge_v span no area", p.pointer);
    }
    return shapes;
}

void stop_if(const CancelToken* cancel) {
    if (cancel != nullptr && cancel->cancelled())
        throw SceneError("cancelled", "scene build was cancelled");
}

}  // namespace

Scene::Scene(RenderDescription description, int threads, const CancelToken* cancel)
    : film_(description.film),
      textures_(description.like ? description.like->textures_ : std::move(description.textures)) {
    const auto start = std::chrono::steady_clock::now();
    camera_ = std::make_unique<Camera>(description.camera, film_.width, film_.height);
    materials_ = std::make_unique<MaterialTable>(description.materials, textures_);

    int interiors = 0;
    for (int i = 0; i < materials_->size(); ++i) {
        interiors += (*materials_)[i].has_interior ? 1 : 0;
        shadows_walk_ |= (*materials_)[i].passes;
    }
    shadows_walk_ |= interiors > 1;
    keep_uv_ = description.keep_uv;
    for (int i = 0; i < textures_.size(); ++i) {
        prefilters_ |= textures_[i].levels() > 1;
        second_uv_ |= textures_[i].uv_set() == 1;
    }

    stop_if(cancel);
    if (description.like)
        share(*description.like, description);
    else
        build_geometry(description, threads, cancel);
    if (interiors > 0) camera_interior_ = media_at(*this, camera_->origin());
    const auto built = std::chrono::steady_clock::now();
    CausticScan scan = trace_caustics(*this, threads, cancel);
    stop_if(cancel);
    caustics_ = std::move(scan.guide);
    for (const bool all : {false, true}) light_layers_[all] = LightLayer(*this, scan.hard, all);
    if (!light_layers_[0].empty())
        caustics_beside_ = guide_beside(std::move(scan), light_layers_[0]);
    features_ = scan_features(*this);

    stats_.caustic_photons = caustics_.photons();
    stats_.caustic_s =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - built).count();
    stats_.bytes += caustics_.bytes();
    for (const auto& mesh : shapes_->meshes) {
        stats_.triangles += mesh->triangle_count();
        stats_.bytes += 4 * (mesh->positions.size() + mesh->indices.size() + mesh->normals.size() +
                             mesh->uv.size() + mesh->uv1.size());
    }
    for (int i = 0; i < textures_.size(); ++i) stats_.bytes += textures_[i].bytes();
    if (const auto* e = lights_->environment()) stats_.bytes += e->bytes();
    if (backdrop_) stats_.bytes += backdrop_->bytes();
    stats_.spheres = shapes_->spheres.size();
    stats_.lights = std::uint64_t(lights_->size());
    stats_.materials = std::uint64_t(materials_->size());
    stats_.build_s =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

std::vector<MaterialUse> Scene::material_uses() const {
    std::vector<MaterialUse> uses;
    for (int i = 0; i < materials_->size(); ++i)
        uses.push_back({(*materials_)[i].emissive, reads_uv(*materials_, i)});
    return uses;
}

void Scene::share(const Scene& like, const RenderDescription& description) {
    const Geometry& g = *like.shapes_;
    if (g.uses != material_uses() || g.keep_uv != keep_uv_ || g.second_uv != second_uv_)
        throw SceneError("not_alike", "the shapes of the other scene do not fit these materials");
    shapes_ = like.shapes_;
    backdrop_ = like.backdrop_;
    build_lights(description, nullptr);
}

void Scene::build_geometry(RenderDescription& description, int threads, const CancelToken* cancel) {
    const auto made = std::make_shared<Geometry>(threads);
    shapes_ = made;
    made->uses = material_uses();
    made->keep_uv = keep_uv_;
    made->second_uv = second_uv_;
    add_meshes(*made, std::move(description.meshes));
    stop_if(cancel);
    add_spheres(*made, description.spheres);
    build_lights(description, made.get());
    if (const auto& b = description.backdrop)
        backdrop_ = std::make_shared<EnvironmentLight>(b->width, b->height, b->pixels,
                                                       b->rotation_deg, b->scale);
    for (const auto& mesh : made->meshes) made->accel.add_mesh(mesh->positions, mesh->indices);
    if (!made->spheres.empty()) made->accel.add_spheres(made->spheres);
    stop_if(cancel);
    made->accel.commit(cancel);
}

void Scene::add_meshes(Geometry& geometry, std::vector<MeshDescription>&& meshes) const {
    for (auto& m : meshes) {
        check_mesh(m, materials_->size());
        if (!keep_uv_ && !reads_uv(*materials_, m.material)) m.uv = m.uv1 = {};
        if (!second_uv_) m.uv1 = {};
        geometry.meshes.push_back(make_mesh(std::move(m)));
    }
}

void Scene::add_spheres(Geometry& geometry, const std::vector<SphereDescription>& spheres) const {
    for (const auto& s : spheres) {
        if (s.material < 0 || s.material >= materials_->size())
            throw SceneError("material", "sphere has no material", s.pointer + "/material");
        geometry.spheres.push_back({s.center, s.radius, s.material});
    }
    geometry.sphere_light.assign(geometry.spheres.size(), -1);
}

/// Shapes learn which light they are where they are `fresh`; shared ones know.
void Scene::build_lights(const RenderDescription& description, Geometry* fresh) {
    std::vector<Light> lights;
    for (const auto& mesh : shapes_->meshes) {
        if (mesh->material < 0 || !(*materials_)[mesh->material].emissive) continue;
        if (fresh) mesh->light = int(lights.size());
        const std::vector<double> weight(mesh->triangle_count(), 1.0);
        lights.emplace_back(MeshLight{MeshShape(*mesh, weight), mesh->material});
    }
    const std::vector<Sphere>& spheres = shapes_->spheres;
    for (std::size_t i = 0; i < spheres.size(); ++i) {
        if (!(*materials_)[spheres[i].material].emissive) continue;
        if (fresh) fresh->sphere_light[i] = int(lights.size());
        lights.emplace_back(SphereLight{SphereShape{spheres[i]}, spheres[i].material});
    }
    for (const auto& l : description.lights) {
        if (const auto* r = std::get_if<RectangleLightDescription>(&l)) {
            const RectangleShape shape(r->corner, r->edge_u, r->edge_v);
            if (!(shape.area > 0))
                throw SceneError("degenerate_light", "edge_u and edge_v span no area", r->pointer);
            if (fresh) {
                auto mesh = make_mesh(rectangle_mesh(*r));
                mesh->material = -1;
                mesh->light = int(lights.size());
                fresh->meshes.push_back(std::move(mesh));
            }
            lights.emplace_back(RectangleLight{shape, r->radiance});
        } else if (const auto* p = std::get_if<PointLightDescription>(&l)) {
            lights.emplace_back(PointLight{p->position, p->intensity});
        } else if (const auto* s = std::get_if<SpotLightDescription>(&l)) {
            lights.emplace_back(spot_light(*s));
        } else if (const auto* table = std::get_if<ProfileLightDescription>(&l)) {
            lights.emplace_back(profile_light(*table));
        } else if (const auto* d = std::get_if<DirectionalLightDescription>(&l)) {
            lights.emplace_back(DirectionalLight{normalize(d->direction), d->irradiance});
        }
    }
    std::shared_ptr<const EnvironmentLight> environment;
    if (description.like)
        environment = description.like->lights_->shared_environment();
    else if (const auto& e = description.environment)
        environment = std::make_shared<EnvironmentLight>(
            e->width, e->height, e->pixels, e->rotation_deg, e->scale,
            Portals(portal_shapes(description.portals)));
    lights_ = std::make_unique<LightSet>(std::move(lights), std::move(environment), *materials_,
                                         bounding_radius(), description.light_tree);
}

float Scene::bounding_radius() const {
    float r2 = 0;
    for (const auto& mesh : shapes_->meshes)
        for (std::uint32_t v = 0; v < mesh->positions.size() / 3; ++v)
            r2 = std::max(r2, length_squared(mesh->position(v)));
    float radius = std::sqrt(r2);
    for (const Sphere& s : shapes_->spheres) radius = std::max(radius, length(s.center) + s.radius);
    return std::max(radius, 1e-30F);
}

int Scene::material_of(const RayHit& hit) const {
    const Geometry& g = *shapes_;
    return hit.geometry < g.meshes.size() ? g.meshes[hit.geometry]->material
                                          : g.spheres[hit.primitive].material;
}

}  // namespace matiere
