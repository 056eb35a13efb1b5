// Layers of a film beside its light (arbitrary output variables): what the camera sees first, and
// the light apart by how it came. A film has those that were asked for; their sums are one per
// pixel, not one per replicate, so they have no error bar of their own.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

#include "base/spectrum.h"
#include "base/vec.h"

namespace matiere {

/// A set of layers: bit i is row i of `kAovs`.
using AovSet = std::uint32_t;

enum class AovMean : unsigned char {
    kSamples,   ///< over all samples, as light is; 0 where nothing was met
    kSurfaces,  ///< over the samples that met a surface
    kFirst,     ///< of the pixel's first sample: what cannot be averaged
};

struct AovInfo {
    std::string_view name;
    int channels;
    AovMean mean;
};

enum class Aov : unsigned char {
    kAlbedo,
    kNormal,
    kDepth,
    kPosition,
    kUv,
    kMaterialId,
    kEmission,
    kDirect,
    kIndirect,
    kDiffuse,
    kSpecular,
    kTransmission,
};

inline constexpr std::array<AovInfo, 12> kAovs = {{
    {"albedo", 3, AovMean::kSamples},
    {"normal", 3, AovMean::kSamples},
    {"depth", 1, AovMean::kSurfaces},
    {"position", 3, AovMean::kSurfaces},
    {"uv", 2, AovMean::kSurfaces},
    {"material_id", 1, AovMean::kFirst},
    {"emission", 3, AovMean::kSamples},
    {"direct", 3, AovMean::kSamples},
    {"indirect", 3, AovMean::kSamples},
    {"diffuse", 3, AovMean::kSamples},
    {"specular", 3, AovMean::kSamples},
    {"transmission", 3, AovMean::kSamples},
}};

/// The row of a layer's name; nothing for another name.
constexpr std::optional<Aov> aov_from_name(std::string_view name) {
    for (std::size_t i = 0; i < kAovs.size(); ++i)
        if (kAovs[i].name == name) return Aov(i);
    return std::nullopt;
}

/// What one sample says of all layers.
struct AovSample {
    bool met = false;  ///< a surface; the first six are of it
    Spectrumf albedo;  ///< weight of the sampled direction: its mean is the directional albedo
    Vec3f normal;      ///< shading normal on the viewer's side
    float depth = 0;   ///< from the camera along the ray [m]
    Vec3f position;    ///< in the core's coordinates [m]
    Vec2f uv;
    int material = -1;
    Spectrumf emission, direct, indirect, diffuse, specular, transmission;
};

/// Where the channels of a set lie in the sums of a pixel.
class AovLayout {
 public:
    /// Bits beyond the table are refused with SceneError.
    explicit AovLayout(AovSet set = 0);

    AovSet set() const { return set_; }
    int channels() const { return channels_; }
    bool has(Aov aov) const { return (set_ >> unsigned(aov) & 1U) != 0; }
    /// Whether light is told apart by the lobes that it came by.
    bool has_lobes() const {
        return has(Aov::kDiffuse) || has(Aov::kSpecular) || has(Aov::kTransmission);
    }
    /// First channel of a layer of the set.
    int offset(Aov aov) const { return offsets_[std::size_t(aov)]; }
    /// Channel that counts the samples which met a surface.
    int met() const { return channels_ - 1; }
    /// Adds a sample to the sums of its pixel.
    void add(const AovSample& sample, bool first_of_pixel, double* sums) const;

 private:
    AovSet set_ = 0;
    int channels_ = 0;
    std::array<int, kAovs.size()> offsets_{};
};

}  // namespace matiere
