// Image textures: linear Rec.709 values, bilinear lookup, repeated or clamped at the border.
#pragma once

#include <string>
#include <vector>

#include "base/spectrum.h"
#include "base/vec.h"

namespace matiere {

enum class Wrap : unsigned char { kRepeat, kClamp };

/// "repeat" or "clamp"; throws SceneError otherwise.
Wrap wrap_from_name(const std::string& name, const std::string& pointer);

class ImageTexture {
 public:
    /// `rgb` holds height x width x 3 values, first row on top (v = 1). Throws SceneError where the
    /// size does not fit or a value is not finite.
    ImageTexture(int width, int height, std::vector<float> rgb, Wrap wrap,
                 const std::string& pointer);

    int width() const { return width_; }
    int height() const { return height_; }
    std::size_t bytes() const { return texels_.size() * sizeof(float); }
    Spectrumf minimum() const { return minimum_; }
    Spectrumf maximum() const { return maximum_; }
    Spectrumf mean() const { return mean_; }

    /// Bilinear value at uv: u grows to the right, v upwards, texel centres at half integers.
    Spectrumf lookup(Vec2f uv) const;

 private:
    int wrapped(int i, int n) const;
    Spectrumf texel(int x, int y) const;

    int width_, height_;
    std::vector<float> texels_;
    Wrap wrap_;
    Spectrumf minimum_, maximum_, mean_;
};

/// All textures of one scene, addressed by TextureRef::index.
class TextureTable {
 public:
    int add(ImageTexture texture) {
        textures_.push_back(std::move(texture));
        return int(textures_.size()) - 1;
    }
    int size() const { return int(textures_.size()); }
    const ImageTexture& operator[](int i) const { return textures_[std::size_t(i)]; }

 private:
    std::vector<ImageTexture> textures_;
};

}  // namespace matiere
