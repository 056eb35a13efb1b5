// RenderDescription, filled call by call from Python, and the Scene built from it.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <memory>

#include "base/error.h"
#include "base/parallel.h"
#include "param_value.h"
#include "scene/scene.h"
#include "texel_grid.h"

namespace py = pybind11;

namespace matiere {
namespace {

template <class T>
using Array = py::array_t<T, py::array::c_style | py::array::forcecast>;
using Triple = std::array<double, 3>;

Vec3d vec3d(const Triple& t) { return {t[0], t[1], t[2]}; }
Vec3f vec3f(const Triple& t) { return {float(t[0]), float(t[1]), float(t[2])}; }
Spectrumf spectrum(const Triple& t) { return {float(t[0]), float(t[1]), float(t[2])}; }

template <class T>
std::vector<T> rows(const py::object& object, py::ssize_t columns, const char* name) {
    if (object.is_none()) return {};
    const auto a = object.cast<Array<T>>();
    if (a.ndim() != 2 || a.shape(1) != columns)
        throw py::value_error(std::string(name) + " must have shape (N, " +
                              std::to_string(columns) + ")");
    return std::vector<T>(a.data(), a.data() + a.size());
}

std::vector<float> image(const Array<float>& a, const char* name) {
    if (a.ndim() != 3 || a.shape(2) != 3)
        throw py::value_error(std::string(name) + " must have shape (H, W, 3)");
    return std::vector<float>(a.data(), a.data() + a.size());
}

void set_film(RenderDescription& d, int width, int height, const std::string& filter,
              float filter_radius, const std::optional<std::array<int, 4>>& crop) {
    d.film.width = width;
    d.film.height = height;
    d.film.filter = Filter(filter, filter_radius);
    d.film.crop = crop;
}

CameraType camera_type(const std::string& name) {
    if (name == "pinhole") return CameraType::kPinhole;
    if (name == "thin_lens") return CameraType::kThinLens;
    if (name == "orthographic") return CameraType::kOrthographic;
    if (name == "panorama") return CameraType::kPanorama;
    if (name == "material_probe") return CameraType::kMaterialProbe;
    throw SceneError("camera_type", "camera type '" + name + "' is not known", "/camera/type");
}

void set_camera(RenderDescription& d, const std::string& type, const Triple& origin,
                const Triple& target, const Triple& up, double vfov_deg, double height,
                double aperture_radius, double focus_distance, int blades,
                double blade_rotation_deg, double aperture_ratio) {
    CameraDescription c;
    c.type = camera_type(type);
    c.origin = vec3d(origin);
    c.target = vec3d(target);
    c.up = vec3d(up);
    c.vfov_deg = vfov_deg;
    c.height = height;
    c.aperture_radius = aperture_radius;
    c.focus_distance = focus_distance;
    c.blades = blades;
    c.blade_rotation_deg = blade_rotation_deg;
    c.aperture_ratio = aperture_ratio;
    d.camera = c;
}

int add_texture(RenderDescription& d, const py::array& pixels, const std::string& wrap,
                const std::string& filter, bool srgb, int uv_set,
                const std::array<float, 6>& transform, const std::string& pointer) {
    if (uv_set < 0 || uv_set > 1) throw py::value_error("uv_set must be 0 or 1");
    const auto& t = transform;
    return d.textures.add(ImageTexture(texel_grid(pixels, srgb),
                                       {wrap_from_name(wrap, pointer),
                                        filter_from_name(filter, pointer),
                                        uv_set,
                                        {t[0], t[1], t[2], t[3], {t[4], t[5]}}},
                                       pointer));
}

int add_material(RenderDescription& d, const std::string& type, const py::dict& params,
                 const py::object& emission, const py::object& opacity, bool two_sided,
                 int priority, const std::string& name, const std::string& pointer,
                 const py::dict& maps) {
    MaterialDescription m;
    m.type = type;
    m.params = param_values(params);
    if (!emission.is_none()) m.emission = param_value(emission);
    if (!opacity.is_none()) m.opacity = param_value(opacity);
    if (maps.contains("normal_map")) m.normal_map = maps["normal_map"].cast<int>();
    if (maps.contains("bump_map")) m.bump_map = maps["bump_map"].cast<int>();
    if (maps.contains("bump_height")) m.bump_height = maps["bump_height"].cast<double>();
    m.two_sided = two_sided;
    m.priority = priority;
    m.name = name;
    m.pointer = pointer;
    d.materials.push_back(std::move(m));
    return int(d.materials.size()) - 1;
}

void add_mesh(RenderDescription& d, const py::object& positions, const py::object& triangles,
              const py::object& normals, const py::object& uv, int material,
              const std::string& name, const std::string& pointer, const py::object& uv1) {
    MeshDescription m;
    m.positions = rows<float>(positions, 3, "positions");
    m.triangles = rows<std::uint32_t>(triangles, 3, "triangles");
    m.normals = rows<float>(normals, 3, "normals");
    m.uv = rows<float>(uv, 2, "uv");
    m.uv1 = rows<float>(uv1, 2, "uv1");
    m.material = material;
    m.name = name;
    m.pointer = pointer;
    d.meshes.push_back(std::move(m));
}

EnvironmentDescription lat_long(const Array<float>& pixels, double rotation_deg, double scale) {
    auto data = image(pixels, "environment");
    return {int(pixels.shape(1)), int(pixels.shape(0)), std::move(data), rotation_deg, scale};
}

void set_environment(RenderDescription& d, const Array<float>& pixels, double rotation_deg,
                     double scale) {
    d.environment = lat_long(pixels, rotation_deg, scale);
}

void set_backdrop(RenderDescription& d, const Array<float>& pixels, double rotation_deg,
                  double scale) {
    d.backdrop = lat_long(pixels, rotation_deg, scale);
}

void set_constant_environment(RenderDescription& d, const Triple& radiance) {
    d.environment = EnvironmentDescription{
        1, 1, {float(radiance[0]), float(radiance[1]), float(radiance[2])}, 0, 1};
}

void add_profile_light(RenderDescription& d, const Triple& position, const Triple& direction,
                       const Triple& intensity, const py::dict& profile,
                       const std::optional<std::array<double, 2>>& cone, double rotation_deg) {
    const auto list = [&](const char* key) {
        const auto a = profile[key].cast<Array<float>>();
        return std::vector<float>(a.data(), a.data() + a.size());
    };
    ProfileLightDescription light;
    light.spot.position = vec3f(position);
    light.spot.direction = vec3f(direction);
    light.spot.intensity = spectrum(intensity);
    light.cone = cone.has_value();
    if (cone) {
        light.spot.inner_deg = (*cone)[0];
        light.spot.outer_deg = (*cone)[1];
    }
    light.rotation_deg = rotation_deg;
    light.vertical_deg = list("vertical_deg");
    light.horizontal_deg = list("horizontal_deg");
    light.values = list("values");
    if (light.vertical_deg.size() < 2 || light.horizontal_deg.empty() ||
        light.values.size() != light.vertical_deg.size() * light.horizontal_deg.size())
        throw py::value_error("a profile needs values for each of its angles");
    d.lights.emplace_back(std::move(light));
}

void bind_view(py::class_<RenderDescription>& description) {
    description.def_readwrite("light_tree", &RenderDescription::light_tree)
        .def_readwrite("keep_uv", &RenderDescription::keep_uv)
        .def("set_film", &set_film, py::arg("width"), py::arg("height"),
             py::arg("filter") = "gaussian", py::arg("filter_radius") = 0.0F,
             py::arg("crop") = py::none())
        .def("set_camera", &set_camera, py::arg("type"), py::arg("origin"), py::arg("target"),
             py::arg("up"), py::arg("vfov_deg") = 40.0, py::kw_only(), py::arg("height") = 2.0,
             py::arg("aperture_radius") = 0.0, py::arg("focus_distance") = 1.0,
             py::arg("blades") = 0, py::arg("blade_rotation_deg") = 0.0,
             py::arg("aperture_ratio") = 1.0);
}

void bind_description(py::module_& m) {
    py::class_<RenderDescription> description(
        m, "RenderDescription",
        "Plain data of a scene: names resolved, files read, metres, "
        "linear Rec.709, recentred before it is rounded to float.");
    description.def(py::init<>())
        .def("add_texture", &add_texture, py::arg("pixels"), py::arg("wrap") = "repeat",
             py::kw_only(), py::arg("filter") = "bilinear", py::arg("srgb") = false,
             py::arg("uv_set") = 0, py::arg("transform") = std::array<float, 6>{1, 0, 0, 1, 0, 0},
             py::arg("pointer") = "")
        .def("add_material", &add_material, py::arg("type"), py::arg("params"),
             py::arg("emission") = py::none(), py::arg("opacity") = py::none(),
             py::arg("two_sided") = true, py::arg("priority") = 0, py::arg("name") = "",
             py::arg("pointer") = "", py::arg("maps") = py::dict())
        .def("add_mesh", &add_mesh, py::arg("positions"), py::arg("triangles"),
             py::arg("normals") = py::none(), py::arg("uv") = py::none(), py::arg("material") = 0,
             py::arg("name") = "", py::arg("pointer") = "", py::arg("uv1") = py::none())
        .def(
            "add_sphere",
            [](RenderDescription& d, const Triple& center, double radius, int material,
               const std::string& pointer) {
                d.spheres.push_back({vec3f(center), float(radius), material, pointer});
            },
            py::arg("center"), py::arg("radius"), py::arg("material"), py::arg("pointer") = "")
        .def(
            "add_rectangle_light",
            [](RenderDescription& d, const Triple& corner, const Triple& edge_u,
               const Triple& edge_v, const Triple& radiance, const std::string& pointer) {
                d.lights.emplace_back(RectangleLightDescription{
                    vec3f(corner), vec3f(edge_u), vec3f(edge_v), spectrum(radiance), pointer});
            },
            py::arg("corner"), py::arg("edge_u"), py::arg("edge_v"), py::arg("radiance"),
            py::arg("pointer") = "")
        .def(
            "add_point_light",
            [](RenderDescription& d, const Triple& position, const Triple& intensity) {
                d.lights.emplace_back(PointLightDescription{vec3f(position), spectrum(intensity)});
            },
            py::arg("position"), py::arg("intensity"))
        .def(
            "add_spot_light",
            [](RenderDescription& d, const Triple& position, const Triple& direction,
               const Triple& intensity, double inner_deg, double outer_deg) {
                d.lights.emplace_back(SpotLightDescription{
                    vec3f(position), vec3f(direction), spectrum(intensity), inner_deg, outer_deg});
            },
            py::arg("position"), py::arg("direction"), py::arg("intensity"), py::arg("inner_deg"),
            py::arg("outer_deg"))
        .def(
            "add_directional_light",
            [](RenderDescription& d, const Triple& direction, const Triple& irradiance) {
                d.lights.emplace_back(
                    DirectionalLightDescription{vec3f(direction), spectrum(irradiance)});
            },
            py::arg("direction"), py::arg("irradiance"))
        .def("add_profile_light", &add_profile_light, py::arg("position"), py::arg("direction"),
             py::arg("intensity"), py::arg("profile"), py::arg("cone") = py::none(),
             py::arg("rotation_deg") = 0.0,
             "`profile`: vertical_deg, horizontal_deg, values; `cone`: (inner, outer) in degrees.")
        .def(
            "add_portal",
            [](RenderDescription& d, const Triple& corner, const Triple& edge_u,
               const Triple& edge_v, const std::string& pointer) {
                d.portals.push_back({vec3f(corner), vec3f(edge_u), vec3f(edge_v), pointer});
            },
            py::arg("corner"), py::arg("edge_u"), py::arg("edge_v"), py::arg("pointer") = "")
        .def("set_environment", &set_environment, py::arg("pixels"), py::arg("rotation_deg") = 0.0,
             py::arg("scale") = 1.0)
        .def("set_backdrop", &set_backdrop, py::arg("pixels"), py::arg("rotation_deg") = 0.0,
             py::arg("scale") = 1.0)
        .def("set_constant_environment", &set_constant_environment, py::arg("radiance"))
        .def(
            "share",
            [](RenderDescription& d, const std::shared_ptr<Scene>& scene) { d.like = scene; },
            py::arg("scene"),
            "Take shapes, textures, environment and backdrop from a built scene.");
    bind_view(description);
}

py::dict stats_dict(const Scene& scene) {
    const SceneStats& s = scene.stats();
    py::dict d;
    d["triangles"] = s.triangles;
    d["spheres"] = s.spheres;
    d["lights"] = s.lights;
    d["materials"] = s.materials;
    d["bytes"] = s.bytes;
    d["build_s"] = s.build_s;
    d["caustic_photons"] = s.caustic_photons;
    d["caustic_s"] = s.caustic_s;
    return d;
}

py::dict intersect(const Scene& scene, const Array<float>& origins,
                   const Array<float>& directions) {
    if (origins.ndim() != 2 || origins.shape(1) != 3 || directions.ndim() != 2 ||
        directions.shape(1) != 3 || origins.shape(0) != directions.shape(0))
        throw py::value_error("origins and directions must both have shape (N, 3)");
    const py::ssize_t n = origins.shape(0);
    py::array_t<float> t(n), u(n), v(n);
    py::array_t<std::uint32_t> geometry(n), primitive(n);
    py::array_t<float> normal({n, py::ssize_t(3)}), position({n, py::ssize_t(3)});
    const auto o = origins.unchecked<2>(), d = directions.unchecked<2>();
    for (py::ssize_t i = 0; i < n; ++i) {
        const Ray ray{{o(i, 0), o(i, 1), o(i, 2)}, {d(i, 0), d(i, 1), d(i, 2)}};
        const RayHit hit = scene.intersect(ray);
        t.mutable_at(i) = hit.t;
        u.mutable_at(i) = hit.u;
        v.mutable_at(i) = hit.v;
        geometry.mutable_at(i) = hit.geometry;
        primitive.mutable_at(i) = hit.primitive;
        const SurfaceHit s = hit.missed() ? SurfaceHit{} : scene.surface(ray, hit);
        for (py::ssize_t k = 0; k < 3; ++k) {
            normal.mutable_at(i, k) = s.point.n_g[std::size_t(k)];
            position.mutable_at(i, k) = s.point.p[std::size_t(k)];
        }
    }
    py::dict out;
    out["t"] = t;
    out["u"] = u;
    out["v"] = v;
    out["geometry"] = geometry;
    out["primitive"] = primitive;
    out["normal"] = normal;
    out["position"] = position;
    return out;
}

}  // namespace

void bind_scene(py::module_& m) {
    bind_description(m);
    py::class_<Scene, std::shared_ptr<Scene>>(m, "Scene",
                                              "A built scene; immutable, shared by threads.")
        .def(py::init([](const RenderDescription& d, int threads,
                         const std::shared_ptr<CancelToken>& cancel) {
                 const py::gil_scoped_release release;
                 RenderDescription copy = d;
                 return std::make_shared<Scene>(std::move(copy), threads, cancel.get());
             }),
             py::arg("description"), py::arg("threads") = 0, py::arg("cancel") = nullptr)
        .def("stats", &stats_dict)
        .def("intersect", &intersect, py::arg("origins"), py::arg("directions"),
             "Closest hits of rays: t, u, v, geometry, primitive, normal, position (tests).");
}

}  // namespace matiere
