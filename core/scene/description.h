// Plain data of everything a render needs: the only input of the core. Names are resolved, defaults
// filled, files read and positions recentred before this point.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "base/spectrum.h"
#include "base/vec.h"
#include "camera/camera.h"
#include "film/filter.h"
#include "material/description.h"
#include "texture/texture.h"

namespace matiere {

struct FilmDescription {
    int width = 256, height = 256;
    Filter filter;
    /// Pixel window [x0, y0, x1, y1) that is rendered; the whole film where absent. Pixels inside a
    /// crop have the values they have in the whole film.
    std::optional<std::array<int, 4>> crop;
};

struct MeshDescription {
    std::vector<float> positions;          ///< 3 per vertex
    std::vector<std::uint32_t> triangles;  ///< 3 per triangle, counter-clockwise seen from outside
    std::vector<float> normals;            ///< 3 per vertex, or empty
    std::vector<float> uv;                 ///< 2 per vertex, or empty
    std::vector<float> uv1;                ///< the second set: 2 per vertex, or empty
    int material = 0;
    std::string name;
    std::string pointer;
};

struct SphereDescription {
    Vec3f center;
    float radius = 1;
    int material = 0;
    std::string pointer;
};

/// Emits along edge_u x edge_v; radiance in W/m^2/sr. Black and opaque from behind.
struct RectangleLightDescription {
    Vec3f corner, edge_u, edge_v;
    Spectrumf radiance;
    std::string pointer;
};

/// Radiant intensity in W/sr.
struct PointLightDescription {
    Vec3f position;
    Spectrumf intensity;
};

/// Shines into a cone around `direction`: all of it up to `inner_deg` from the axis, nothing beyond
/// `outer_deg`, smooth between.
struct SpotLightDescription {
    Vec3f position, direction;
    Spectrumf intensity;
    double inner_deg = 25, outer_deg = 30;
};

/// A point or spot whose light a table spreads over angles (light/profile.h); its largest value
/// is 1.
struct ProfileLightDescription {
    SpotLightDescription spot;
    bool cone = false;        ///< the spot's cone cuts the table
    double rotation_deg = 0;  ///< about the axis
    std::vector<float> vertical_deg, horizontal_deg, values;
};

/// `direction` is where the light travels; irradiance in W/m^2 on a surface facing it.
struct DirectionalLightDescription {
    Vec3f direction;
    Spectrumf irradiance;
};

using LightDescription =
    std::variant<RectangleLightDescription, PointLightDescription, SpotLightDescription,
                 ProfileLightDescription, DirectionalLightDescription>;

/// Lat-long radiance map: row 0 is +y, the centre column looks along -z, u grows to the right seen
/// from inside. A 1 x 1 map is the constant environment.
struct EnvironmentDescription {
    int width = 0, height = 0;
    std::vector<float> pixels;  ///< 3 per pixel
    double rotation_deg = 0;    ///< about +y, right-handed
    double scale = 1;
};

/// A window that the environment shines through, towards edge_u x edge_v.
struct PortalDescription {
    Vec3f corner, edge_u, edge_v;
    std::string pointer;
};

class Scene;

struct RenderDescription {
    FilmDescription film;
    CameraDescription camera;
    TextureTable textures;
    std::vector<MaterialDescription> materials;
    std::vector<MeshDescription> meshes;
    std::vector<SphereDescription> spheres;
    std::vector<LightDescription> lights;
    std::optional<EnvironmentDescription> environment;
    std::vector<PortalDescription> portals;
    std::optional<EnvironmentDescription> backdrop;  ///< seen instead of the environment
    /// A scene whose shapes, lights, textures, environment and backdrop are those of this one,
    /// which leaves out meshes, spheres, textures and maps. Lights are given.
    std::shared_ptr<const Scene> like;
    bool keep_uv = false;    ///< also where no material reads them: the film has a layer of them
    bool light_tree = true;  ///< false: lights are chosen by power alone (tests, benchmarks)
};

}  // namespace matiere
