// Image textures: linear Rec.709 values at texture coordinates, filtered and wrapped as asked for.
//
// `trilinear` is a pre-filter: where a material parameter reads it, it is averaged over the part of
// the surface that half a pixel sees (mip levels, Williams 1983; how wide that is: ray_cone.h).
// What light is emitted, what passes and where normals point is read at full resolution by every
// filter.
#pragma once

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "base/spectrum.h"
#include "base/vec.h"
#include "texture/texels.h"

namespace matiere {

enum class Wrap : unsigned char { kRepeat, kClamp, kMirror, kBlack };
enum class TextureFilter : unsigned char { kNearest, kBilinear, kTrilinear };

/// "repeat", "clamp", "mirror" or "black"; throws SceneError otherwise.
Wrap wrap_from_name(const std::string& name, const std::string& pointer);
/// "nearest", "bilinear" or "trilinear"; throws SceneError otherwise.
TextureFilter filter_from_name(const std::string& name, const std::string& pointer);

/// Where textures are read: the coordinates of both uv sets, and the uv area that a ray covers.
struct TexturePoint {
    std::array<Vec2f, 2> uv{};
    std::array<float, 2> area{};  ///< 0: a point
};

/// Texture coordinates from those of the surface: (u', v') = (a u + b v, c u + d v) + offset.
struct UvTransform {
    float a = 1, b = 0, c = 0, d = 1;
    Vec2f offset;

    bool is_identity() const {
        return a == 1 && b == 0 && c == 0 && d == 1 && offset.x == 0 && offset.y == 0;
    }
    float determinant() const { return a * d - b * c; }
};

struct TextureOptions {
    Wrap wrap = Wrap::kRepeat;
    TextureFilter filter = TextureFilter::kBilinear;
    int uv_set = 0;  ///< 0 or 1
    UvTransform transform;
};

class ImageTexture {
 public:
    /// First row of `texels` on top (v = 1). Throws SceneError where the size does not fit, a value
    /// is not finite or the transform has no inverse.
    ImageTexture(TexelGrid texels, const TextureOptions& options, const std::string& pointer);

    int width() const { return levels_[0].width; }
    int height() const { return levels_[0].height; }
    int levels() const { return int(levels_.size()); }
    const TexelGrid& level(int i) const { return levels_[std::size_t(i)]; }
    int uv_set() const { return options_.uv_set; }
    const UvTransform& transform() const { return options_.transform; }
    std::size_t bytes() const;
    Spectrumf minimum() const { return minimum_; }
    Spectrumf maximum() const { return maximum_; }
    Spectrumf mean() const { return mean_; }

    /// Value for a material parameter: pre-filtered where the texture asks for it.
    Spectrumf lookup(const TexturePoint& at) const;
    /// Value at full resolution.
    Spectrumf fine(const TexturePoint& at) const;
    /// Texture coordinates of a point: u grows to the right, v upwards, texel centres at half
    /// integers.
    Vec2f coordinates(Vec2f uv) const;
    /// Values at texture coordinates, at full resolution.
    Spectrumf fine_at(Vec2f coordinates) const;
    Spectrumf bilinear_at(Vec2f coordinates) const { return bilinear(levels_[0], coordinates); }

 private:
    Spectrumf bilinear(const TexelGrid& grid, Vec2f uv) const;
    Spectrumf nearest(const TexelGrid& grid, Vec2f uv) const;
    Vec2f folded(Vec2f uv) const;
    int wrapped(int i, int n) const;
    void find_range();

    std::vector<TexelGrid> levels_;  ///< the image, then its mip levels if it is pre-filtered
    TextureOptions options_;
    float texels_per_area_ = 0;  ///< of the image per unit of uv area of the surface
    bool moved_ = false;         ///< by a transform
    Spectrumf minimum_, maximum_, mean_;
};

/// All textures of one scene, addressed by TextureRef::index; copies share the images.
class TextureTable {
 public:
    int add(ImageTexture texture) {
        textures_.push_back(std::make_shared<const ImageTexture>(std::move(texture)));
        return int(textures_.size()) - 1;
    }
    int size() const { return int(textures_.size()); }
    const ImageTexture& operator[](int i) const { return *textures_[std::size_t(i)]; }

 private:
    std::vector<std::shared_ptr<const ImageTexture>> textures_;
};

}  // namespace matiere
