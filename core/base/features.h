// What a scene may need of the path kernels, as bits. `scan_features` (core/scene) finds them in a
// built scene; a kernel is code for a set of them, so that a scene does not pay for the others.
#pragma once

#include <array>
#include <cstdint>
#include <string_view>

namespace matiere {

using Features = std::uint32_t;

// Kernels are made with or without these.
inline constexpr Features kNeedsModels = 1U << 0;       ///< a surface that is not plain lambert
inline constexpr Features kNeedsGuide = 1U << 1;        ///< light by way of mirrors and lenses
inline constexpr Features kNeedsTangents = 1U << 2;     ///< lobes that are wider one way
inline constexpr Features kNeedsTextures = 1U << 3;     ///< parameters, opacity, emission
inline constexpr Features kNeedsMaps = 1U << 4;         ///< normal and bump maps
inline constexpr Features kNeedsPassing = 1U << 5;      ///< opacity and null parts
inline constexpr Features kNeedsInteriors = 1U << 6;    ///< absorption, refraction, nesting
inline constexpr Features kNeedsDispersion = 1U << 7;   ///< an index per lane
inline constexpr Features kNeedsLights = 1U << 8;       ///< more than one rectangle
inline constexpr Features kNeedsScattering = 1U << 9;   ///< media that scatter
inline constexpr Features kNeedsLightLayer = 1U << 10;  ///< paths from the lights find some light
/// Not of a scene: the kernel that writes down what a path met.
inline constexpr Features kRecords = 1U << 31;
/// Not of a scene: the kernel that tells the layers of a film apart.
inline constexpr Features kCollects = 1U << 30;

// Every kernel has these: a scene without them skips them at the cost of a test.
inline constexpr Features kHasDelta = 1U << 16;
inline constexpr Features kHasEnvironment = 1U << 17;
inline constexpr Features kHasAreaLights = 1U << 18;
inline constexpr Features kHasPointLights = 1U << 19;
inline constexpr Features kHasSpheres = 1U << 20;
inline constexpr Features kHasSmoothNormals = 1U << 21;
inline constexpr Features kHasThinLens = 1U << 22;
inline constexpr Features kHasBackdrop = 1U << 23;

inline constexpr Features kKernelFeatures = (kNeedsLightLayer << 1) - 1;
inline constexpr Features kEveryFeature = kKernelFeatures;

struct FeatureName {
    Features bit;
    std::string_view name;
};

inline constexpr std::array<FeatureName, 19> kFeatureNames = {{
    {kNeedsModels, "models"},
    {kNeedsGuide, "caustic_guide"},
    {kNeedsTangents, "tangents"},
    {kNeedsTextures, "textures"},
    {kNeedsMaps, "normal_maps"},
    {kNeedsPassing, "passing"},
    {kNeedsInteriors, "interiors"},
    {kNeedsDispersion, "dispersion"},
    {kNeedsLights, "any_lights"},
    {kNeedsScattering, "scattering"},
    {kNeedsLightLayer, "light_layer"},
    {kHasDelta, "delta_lobes"},
    {kHasEnvironment, "environment"},
    {kHasAreaLights, "area_lights"},
    {kHasPointLights, "point_lights"},
    {kHasSpheres, "spheres"},
    {kHasSmoothNormals, "smooth_normals"},
    {kHasThinLens, "thin_lens"},
    {kHasBackdrop, "backdrop"},
}};

constexpr bool has(Features set, Features any) { return (set & any) != 0; }

}  // namespace matiere
